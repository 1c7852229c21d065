//! Noise and profiles for the tests of this crate.

use crate::bins::EdgeProfile;
use crate::frame::{Colour, Pattern};

pub const RGGB: Pattern = Pattern::Bayer([Colour::Red, Colour::Green, Colour::Green, Colour::Blue]);

/// A profile of green with an error that is the same everywhere.
pub fn profile(x_mm: Vec<f64>, values: Vec<f64>, error: f64) -> EdgeProfile {
    let n = x_mm.len();
    let (std_errors, counts, rejected) = (vec![error; n], vec![100; n], vec![0.0; n]);
    EdgeProfile { colour: Colour::Green, x_mm, values, std_errors, counts, rejected }
}

/// Numbers by a linear congruence, summed to nearly normal ones.
pub fn normal(state: &mut u64) -> f64 {
    let mut sum = -6.0;
    for _ in 0..12 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        sum += (*state >> 11) as f64 / (1_u64 << 53) as f64;
    }
    sum
}
