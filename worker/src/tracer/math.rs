//! Elementary functions in single precision that give the same bits on every machine.
//!
//! The standard library's `ln`, `sin` and `exp` differ between platforms; these are polynomials
//! evaluated with separate multiplications and additions only. Coefficients: minimax fits computed for
//! this project (Lawson iteration); errors as stated and tested against double precision.

use std::f32::consts::{LN_2, LOG2_E, SQRT_2, TAU};

/// Natural logarithm of a positive normal number; relative error below 2e-7.
pub fn ln(x: f32) -> f32 {
    debug_assert!(x >= f32::MIN_POSITIVE && x.is_finite());
    let bits = x.to_bits();
    // m in [√½, √2), x = m · 2^e.
    let e = (bits.wrapping_sub((SQRT_2 / 2.0).to_bits()) as i32) >> 23;
    let m = f32::from_bits(bits.wrapping_sub((e << 23) as u32));
    let f = m - 1.0;
    let p = -0.076_344_93;
    let p = p * f + 0.127_615_75;
    let p = p * f - 0.131_601_83;
    let p = p * f + 0.142_017_59;
    let p = p * f - 0.166_233_57;
    let p = p * f + 0.200_012_27;
    let p = p * f - 0.250_008_2;
    let p = p * f + 0.333_333_3;
    let ff = f * f;
    e as f32 * LN_2 + (f + (ff * f * p - 0.5 * ff))
}

/// Exponential for arguments in [−87, 87]; relative error below 3e-7. Below the range the result is 0.
pub fn exp(x: f32) -> f32 {
    debug_assert!(x <= 87.0);
    if x < -87.0 {
        return 0.0;
    }
    let n = (x * LOG2_E).round();
    // LN_2 in two parts, the first with trailing zeros, so that n times it is exact.
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let p = 0.001_395_048_1;
    let p = p * r + 0.008_368_883;
    let p = p * r + 0.041_666_206;
    let p = p * r + 0.166_665_18;
    let p = p * r + 0.5;
    let y = (p * (r * r) + r) + 1.0;
    y * f32::from_bits(((n as i32 + 127) << 23) as u32)
}

/// x^y for 0 < x ≤ 1 and y ≥ 0; relative error below 3e-7 (1 + |y ln x|).
pub fn pow(x: f32, y: f32) -> f32 {
    exp(y * ln(x))
}

/// (sin 2πu, cos 2πu) for u in [0, 1]; absolute error below 1.5e-7.
pub fn sin_cos_turns(u: f32) -> (f32, f32) {
    let q = (4.0 * u + 0.5) as i32;
    // The subtraction is exact: r in [−1/8, 1/8] of a turn.
    let r = (u - q as f32 * 0.25) * TAU;
    let z = r * r;
    let s = (-0.000_195_173 * z + 0.008_332_178) * z - 0.166_666_55;
    let s = s * z * r + r;
    let c = (2.443_845_2e-5 * z - 0.001_388_736_8) * z + 0.041_666_646;
    let c = c * z * z - 0.5 * z + 1.0;
    match q & 3 {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn relative(a: f32, b: f64) -> f64 {
        ((f64::from(a) - b) / b).abs()
    }

    #[test]
    fn ln_is_accurate_to_two_units_in_the_last_place() {
        let mut worst = 0.0_f64;
        for i in 0..2_000_000_u32 {
            let x = (i as f32 + 0.5) / 2_000_000.0;
            worst = worst.max(relative(ln(x), f64::from(x).ln()));
        }
        for x in [1e-30, 2.0_f32.powi(-24), 1.0 - 2.0_f32.powi(-24), 3.0, 1e30] {
            worst = worst.max(relative(ln(x), f64::from(x).ln()));
        }
        assert!(worst < 2e-7, "{worst:e}");
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    fn exp_and_pow_are_accurate() {
        let mut worst = 0.0_f64;
        for i in -870_000..870_000 {
            let x = i as f32 * 1e-4;
            worst = worst.max(relative(exp(x), f64::from(x).exp()));
        }
        assert!(worst < 3e-7, "{worst:e}");
        assert_eq!((exp(0.0), exp(-100.0)), (1.0, 0.0));
        assert!(relative(pow(0.25, 1.5), 0.125) < 1e-6);
    }

    #[test]
    fn sine_and_cosine_are_accurate() {
        let mut worst = 0.0_f64;
        for i in 0..=1_000_000 {
            let u = i as f32 / 1_000_000.0;
            let (s, c) = sin_cos_turns(u);
            let (s0, c0) = (f64::from(u) * std::f64::consts::TAU).sin_cos();
            worst = worst.max((f64::from(s) - s0).abs()).max((f64::from(c) - c0).abs());
        }
        assert!(worst < 1.5e-7, "{worst:e}");
    }

    /// A change here changes every record: raise `PHYSICS_VERSION` with it.
    #[test]
    fn results_have_known_bits() {
        assert_eq!(ln(0.3).to_bits(), 0xbf9a_1bc8);
        assert_eq!(exp(-0.7).to_bits(), 0x3efe_406e);
        let (s, c) = sin_cos_turns(0.3);
        assert_eq!((s.to_bits(), c.to_bits()), (0x3f73_7870, 0xbe9e_377d));
    }
}
