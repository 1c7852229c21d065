//! Elementary functions in single precision that give the same bits on every machine.
//!
//! The standard library's `ln`, `sin` and `exp` differ between platforms; these are polynomials
//! evaluated with separate multiplications and additions only. Coefficients: minimax fits computed for
//! this project (Lawson iteration); errors as stated and tested against double precision.

use std::f32::consts::{LN_2, LOG2_E, SQRT_2};

use super::rng::uniform;

/// Coefficients of [`ln`], highest power first: (ln(1 + f) − f + f²/2)/f³.
pub const LN: [f32; 8] = [
    -0.076_344_93,
    0.127_615_75,
    -0.131_601_83,
    0.142_017_59,
    -0.166_233_57,
    0.200_012_27,
    -0.250_008_2,
    0.333_333_3,
];

/// Natural logarithm of a positive normal number; relative error below 2e-7.
pub fn ln(x: f32) -> f32 {
    if cfg!(test) {
        assert!(x >= f32::MIN_POSITIVE && x.is_finite());
    }
    let bits = x.to_bits();
    // m in [√½, √2), x = m · 2^e.
    let e = (bits.wrapping_sub((SQRT_2 / 2.0).to_bits()) as i32) >> 23;
    let m = f32::from_bits(bits.wrapping_sub((e << 23) as u32));
    let f = m - 1.0;
    let p = LN[1..].iter().fold(LN[0], |p, c| p * f + c);
    let ff = f * f;
    e as f32 * LN_2 + (f + (ff * f * p - 0.5 * ff))
}

/// Exponential for arguments in [−87, 87]; relative error below 3e-7. Below the range the result is 0.
pub fn exp(x: f32) -> f32 {
    if cfg!(test) {
        assert!(x <= 87.0);
    }
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

/// A distance to either side with an exponential distribution of this mean, from two words.
pub fn two_sided(mean: f32, [size, side]: [u32; 2]) -> f32 {
    let distance = -mean * ln(uniform(size));
    if side & 1 == 0 { distance } else { -distance }
}

/// Approximates 2^x for −100 ≤ x < 128, at most 6 % above it: the bits of a float are nearly its logarithm. Smaller x
/// count as −100.
pub fn power_of_two(x: f32) -> f32 {
    f32::from_bits(((x.max(-100.0) + 127.0) * 8_388_608.0) as u32)
}

/// Exponential of a number that is not above 0, in double precision; relative error below 1e-14.
pub fn exp_f64(x: f64) -> f64 {
    if x < -700.0 {
        return 0.0;
    }
    let n = (x * std::f64::consts::LOG2_E).round();
    // LN_2 in two parts, the first with trailing zeros, so that n times it is exact.
    let r = (x - n * 0.693_147_180_369_123_8) - n * 1.908_214_929_270_587_7e-10;
    let series = (1..=13).rev().fold(1.0, |p, k| 1.0 + p * r / f64::from(k));
    series * f64::from_bits(((n as i64 + 1023) as u64) << 52)
}

/// x^y for 0 < x ≤ 1 and y ≥ 0; relative error below 3e-7 (1 + |y ln x|).
pub fn pow(x: f32, y: f32) -> f32 {
    exp(y * ln(x))
}

/// Coefficients of [`unit_vector`]: sin(πv)/v in powers of v², and (cos(πv) − 1)/v².
pub const SIN_PI: [f32; 5] = [3.141_592_5, -5.167_707, 2.550_031_4, -0.598_045_2, 0.077_220_13];
pub const COS_PI: [f32; 4] = [-4.934_795_4, 4.058_451, -1.332_093_8, 0.220_080_64];

/// Unit vector (cos φ, sin φ) for one of 2¹⁶ azimuths, from the lower 16 random bits; absolute error below 2e-7.
///
/// Fifteen bits are φ between −90° and 90°, as the midpoint of a cell; one bit turns the vector by 180°.
pub fn unit_vector(bits: u32) -> (f32, f32) {
    // v in (−½, ½) half turns, exact.
    let v = f32::from_bits((bits << 8 & 0x007f_ff00) | 0x3f80_0000) - (1.5 - 1.0 / 65_536.0);
    let z = v * v;
    let [s0, s1, s2, s3, s4] = SIN_PI;
    let s = ((((s4 * z + s3) * z + s2) * z + s1) * z + s0) * v;
    let [c0, c1, c2, c3] = COS_PI;
    let c = (((c3 * z + c2) * z + c1) * z + c0) * z + 1.0;
    let turn = (bits & 0x8000) << 16;
    (f32::from_bits(c.to_bits() ^ turn), f32::from_bits(s.to_bits() ^ turn))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn relative(a: f32, b: f64) -> f64 {
        ((f64::from(a) - b) / b).abs()
    }

    /// The logarithm is accurate to two units in the last place.
    #[test]
    fn ln_is_accurate_to_two_ulps() {
        let mut worst = 0.0_f64;
        for i in 0..2_000_000_u32 {
            let x = (i as f32 + 0.5) / 2_000_000.0;
            worst = worst.max(relative(ln(x), libm::log(f64::from(x))));
        }
        for x in [1e-30, 2.0_f32.powi(-24), 1.0 - 2.0_f32.powi(-24), 3.0, 1e30] {
            worst = worst.max(relative(ln(x), libm::log(f64::from(x))));
        }
        assert!(worst < 2e-7, "{worst:e}");
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    fn exp_and_pow_are_accurate() {
        let mut worst = 0.0_f64;
        for i in -870_000..870_000 {
            let x = i as f32 * 1e-4;
            worst = worst.max(relative(exp(x), libm::exp(f64::from(x))));
        }
        assert!(worst < 3e-7, "{worst:e}");
        assert_eq!((exp(0.0), exp(-100.0)), (1.0, 0.0));
        assert!(relative(pow(0.25, 1.5), 0.125) < 1e-6);
    }

    #[test]
    fn exponentials_in_double_precision_are_accurate() {
        for i in 0..70_000 {
            let x = -0.01 * f64::from(i);
            assert!((exp_f64(x) / libm::exp(x) - 1.0).abs() < 1e-14, "{x}");
        }
        assert_eq!((exp_f64(0.0), exp_f64(-1e6)), (1.0, 0.0));
    }

    /// The approximate power of two is at most 6 % above the exact one, and hardly below.
    #[test]
    fn power_of_two_is_an_upper_estimate() {
        for i in -99_000..1000 {
            let x = i as f32 * 1e-3;
            let ratio = f64::from(power_of_two(x)) / libm::exp2(f64::from(x));
            assert!((0.9999..1.0615).contains(&ratio), "{x}: {ratio}");
        }
        assert_eq!((power_of_two(0.0), power_of_two(-3.0)), (1.0, 0.125));
        assert_eq!(power_of_two(-1e9), power_of_two(-100.0));
    }

    #[test]
    fn unit_vectors_are_accurate_and_evenly_spread() {
        let (mut worst, mut sum) = (0.0_f64, [0.0; 4]);
        let mut angles = Vec::new();
        for bits in 0..1 << 16 {
            let (c, s) = unit_vector(0xabcd_0000 | bits);
            let half_turns = (f64::from(bits & 0x7fff) + 0.5) / 32_768.0 - 0.5 + f64::from(bits >> 15);
            let (s0, c0) = libm::sincos(half_turns * std::f64::consts::PI);
            let (c, s) = (f64::from(c), f64::from(s));
            worst = worst.max((s - s0).abs()).max((c - c0).abs());
            for (sum, term) in sum.iter_mut().zip([c, s, c * c - s * s, c * c + s * s - 1.0]) {
                *sum += term / 65_536.0;
            }
            angles.push((half_turns * 65_536.0).rem_euclid(131_072.0) as u32);
        }
        assert!(worst < 2e-7, "{worst:e}");
        assert!(sum.iter().all(|s| s.abs() < 1e-7), "{sum:?}");
        angles.sort_unstable();
        angles.dedup();
        assert_eq!(angles.len(), 1 << 16, "every azimuth once");
    }

    /// A change here changes every record: raise `PHYSICS_VERSION` with it.
    #[test]
    fn results_have_expected_bits() {
        assert_eq!(ln(0.3).to_bits(), 0xbf9a_1bc8);
        assert_eq!(exp(-0.7).to_bits(), 0x3efe_406e);
        let (c, s) = unit_vector(0x1234);
        assert_eq!((c.to_bits(), s.to_bits()), (0x3edd_3c30, 0xbf66_de0e));
    }
}
