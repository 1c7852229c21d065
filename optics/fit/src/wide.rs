//! Loops over pixels with the widest vectors that the machine has.
//!
//! Every lane is a pixel, and products and sums are not fused, so results are the same on all machines.

use fearless_simd::{Level, dispatch};

/// Runs `f` as it is compiled for this machine's vectors: what it calls must be inlined into it.
#[inline]
pub(super) fn wide<R>(f: impl FnOnce() -> R) -> R {
    dispatch!(Level::new(), _simd => f())
}
