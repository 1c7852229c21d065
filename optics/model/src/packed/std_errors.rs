//! Encodes standard errors in one byte each.
//!
//! A standard error comes from some hundred batches and is itself accurate to 7 %, so 32 bits are more precise than it
//! is. Here it is rounded to one of some hundred *grades*, sixteen to an octave: the rounding is within ±3 %, ±1.3 % as a
//! root mean square.
//!
//! The grade is the upper 12 bits of the 32-bit float, rounded: its exponent and four more. An estimate's errors are
//! encoded as the largest grade in two bytes, little endian, and one byte per pixel: 255 less the number of grades by
//! which the pixel's error lies below the largest, or 0 if the error is 0. Errors more than 254 grades (16 octaves) below
//! the largest are rounded up to that.

use crate::invalid::{Invalid, Result};

/// Bytes of the largest grade.
const LARGEST: usize = size_of::<u16>();
/// Bits of a float that its grade leaves out.
const LEFT_OUT: u32 = 19;
/// The grade of the largest number.
const MOST: u32 = f32::MAX.to_bits() >> LEFT_OUT;
/// The byte of the largest grade.
const TOP: u32 = u8::MAX as u32;

/// Bytes that the errors of an estimate take.
pub(super) const fn size(pixels: usize) -> usize {
    LARGEST + pixels
}

/// Rounds errors to the grades.
pub(crate) fn round(std_errors: &mut [f32]) {
    let largest = largest_grade(std_errors);
    for error in std_errors {
        *error = number(largest, byte(largest, *error));
    }
}

/// Appends errors, rounded.
pub(super) fn extend(std_errors: &[f32], bytes: &mut Vec<u8>) {
    let largest = largest_grade(std_errors);
    bytes.extend((largest as u16).to_le_bytes());
    bytes.extend(std_errors.iter().map(|error| byte(largest, *error)));
}

/// Decodes errors; refused if [`extend`] cannot have written these bytes.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<f32>> {
    let (largest, of_pixels) = split(bytes);
    if !is_sound(bytes) {
        let most = of_pixels.iter().max().copied().unwrap_or_default();
        let given = format!("{largest} as the largest grade, {most} as the largest byte");
        let allowed = format!("allowed are a grade of 1 to {MOST} with {TOP}, or no errors at all");
        return Err(Invalid::new("std_errors", given, allowed));
    }
    Ok(of_pixels.iter().map(|byte| number(largest, *byte)).collect())
}

/// Whether [`extend`] can have written these bytes: the encoding of errors is unique.
pub(super) fn is_sound(bytes: &[u8]) -> bool {
    let (largest, bytes) = split(bytes);
    let most = bytes.iter().fold(0, |most, byte| most.max(*byte));
    // 0 wraps around to the largest byte, which leaves it out of the minimum.
    let least = bytes.iter().fold(u8::MAX, |least, byte| least.min(byte.wrapping_sub(1)));
    if largest == 0 {
        return most == 0;
    }
    let rank_of_least = largest + 1 + u32::from(least);
    u32::from(most) == TOP && largest <= MOST && rank_of_least > TOP
}

fn split(bytes: &[u8]) -> (u32, &[u8]) {
    let (largest, bytes) = bytes.split_at(LARGEST);
    (u32::from(u16::from_le_bytes(largest.try_into().expect("two bytes"))), bytes)
}

fn grade(error: f32) -> u32 {
    // The bits of positive floats are ordered like the floats.
    let rounded = (error.to_bits() + (1 << (LEFT_OUT - 1))) >> LEFT_OUT;
    if error > 0.0 { rounded.clamp(1, MOST) } else { 0 }
}

fn largest_grade(std_errors: &[f32]) -> u32 {
    std_errors.iter().map(|error| grade(*error)).max().unwrap_or(0)
}

fn byte(largest: u32, error: f32) -> u8 {
    match grade(error) {
        0 => 0,
        grade => (TOP - (largest - grade).min(TOP - 1)) as u8,
    }
}

fn number(largest: u32, byte: u8) -> f32 {
    match u32::from(byte) {
        0 => 0.0,
        byte => f32::from_bits((largest + byte - TOP) << LEFT_OUT),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(std_errors: &[f32]) -> Vec<u8> {
        let mut bytes = Vec::new();
        extend(std_errors, &mut bytes);
        assert_eq!(bytes.len(), size(std_errors.len()));
        bytes
    }

    /// Errors over eight orders of magnitude, and all around a power of two.
    fn many() -> impl Iterator<Item = f32> {
        (0..20_000).map(|i| 1e-6 * 1.001_f32.powi(i)).chain((0..10_000).map(|i| 0.9 + 2e-5 * i as f32))
    }

    /// Rounded standard errors are within 1/32 of the original and unbiased.
    #[test]
    fn rounded_errors_are_close_and_unbiased() {
        let (mut squares, mut n) = (0.0, 0.0);
        for error in many() {
            let mut told = [error];
            round(&mut told);
            let off = f64::from(told[0]) / f64::from(error) - 1.0;
            assert!(off.abs() <= 1.0 / 32.0, "{error}: {}", told[0]);
            squares += off;
            n += 1.0;
        }
        assert!((squares / n).abs() < 0.001, "{}", squares / n);
    }

    /// Errors that were rounded once are read back exactly, and rounding again changes nothing.
    #[test]
    fn errors_round_trip_once_rounded() {
        let mut errors = vec![3.2e-4, 0.0, 5.1e-3, 2.2e-3, 1e-5, 1.9e-6];
        round(&mut errors);
        let bytes = written(&errors);
        assert!(is_sound(&bytes));
        assert_eq!(read(&bytes).unwrap(), errors);
        let again = errors.clone();
        round(&mut errors);
        assert_eq!(errors, again);
    }

    /// Errors far below the largest are rounded up.
    #[test]
    fn tiny_errors_are_rounded_up() {
        let mut errors = [1.0, 1e-5, 1e-6, f32::MIN_POSITIVE];
        round(&mut errors);
        let least = 2.0_f32.powi(-16) * 1.125;
        assert_eq!((errors[0], errors[2], errors[3]), (1.0, least, least));
        assert!(errors[1] < least * 1.01, "{}", errors[1]);
    }

    /// The largest and the smallest errors stay finite and above zero after rounding.
    #[test]
    fn extreme_errors_stay_finite() {
        for extreme in [f32::MAX, f32::MIN_POSITIVE, f32::from_bits(1)] {
            let mut errors = [extreme, 0.0];
            round(&mut errors);
            assert!(errors[0].is_finite() && errors[0] > 0.0 && errors[1] == 0.0, "{extreme:e}: {errors:?}");
            assert!(is_sound(&written(&errors)));
        }
        assert!(is_sound(&written(&[0.0; 3])));
    }

    /// Bytes that the writer never produces are not sound.
    #[test]
    fn impossible_bytes_are_not_sound() {
        let [low, high] = (largest_grade(&[1e-3]) as u16).to_le_bytes();
        for (bytes, sound, what) in [
            ([low, high, 255, 7], true, "the largest is there"),
            ([low, high, 254, 7], false, "none is the largest"),
            ([low, high, 0, 0], false, "none is the largest"),
            ([0, 0, 255, 0], false, "the largest is none"),
            ([0xf8, 0x0f, 255, 0], false, "infinite"),
            ([3, 0, 255, 252], false, "below the smallest"),
            ([3, 0, 255, 253], true, "the smallest"),
        ] {
            assert_eq!(is_sound(&bytes), sound, "{what}");
        }
        let error = read(&[low, high, 254, 7]).unwrap_err();
        assert_eq!(error.field(), "std_errors");
        assert!(error.to_string().contains("254 as the largest byte"), "{error}");
    }
}
