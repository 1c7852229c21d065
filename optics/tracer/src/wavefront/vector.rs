//! Vectors of sixteen lanes, one walk each.
//!
//! The width is the same for every instruction set: AVX-512 takes one register for it, AVX2 two, SSE and NEON four.
//! Two or four registers per vector keep independent instructions at hand while others wait.

use fearless_simd::{f32x16, mask32x16, u32x16};

pub const WIDTH: usize = 16;

pub type Floats<S> = f32x16<S>;
pub type Words<S> = u32x16<S>;
pub type Mask<S> = mask32x16<S>;
