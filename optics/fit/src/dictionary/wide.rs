//! Loops over pixels with the widest vectors that the machine has.
//!
//! Every lane is a pixel, and products and sums are not fused, so results are the same on all machines.

use fearless_simd::{Level, dispatch};

/// Runs `f` as it is compiled for this machine's vectors: it must be `#[inline(always)]` itself, as all that it calls. What
/// is not runs all the same, in vectors of two numbers.
#[expect(clippy::inline_always, reason = "what is left out is compiled for every machine")]
#[inline(always)]
pub(crate) fn wide<R>(f: impl FnOnce() -> R) -> R {
    dispatch!(Level::new(), _simd => f())
}
