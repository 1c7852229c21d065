//! Runs loops over pixels with the widest vectors of the machine.
//!
//! Every lane is a pixel, and products and sums are not fused, so results are the same on all machines.

use fearless_simd::{Level, dispatch};

/// Runs `f` compiled for this machine's vectors. `f` and all functions that it calls must be `#[inline(always)]`; others
/// run as well, but in vectors of two numbers.
#[expect(clippy::inline_always, reason = "what is left out is compiled for every machine")]
#[inline(always)]
pub(crate) fn wide<R>(f: impl FnOnce() -> R) -> R {
    dispatch!(Level::new(), _simd => f())
}
