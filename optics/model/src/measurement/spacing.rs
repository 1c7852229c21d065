//! Checks that pixels have a constant pitch, and restores it where decimals are rounded.

use super::pitch;
use crate::invalid::{Invalid, Result};

/// Largest deviation of a step from the mean one, as a share of it.
const UNEVEN: f64 = 0.02;
/// Most decimals that count as rounded.
const DECIMALS: i32 = 6;
/// Largest distance of a rounded position from the line through all, in units of its last digit: half a unit, and the
/// tilt of the line where halves were rounded away from 0.
const ROUNDED: f64 = 1.25;

/// Evenly spaced positions. Positions rounded to few decimals lie on a line to within about their last digit, and are
/// moved onto it.
pub(super) fn even(x: Vec<f64>) -> Result<Vec<f64>> {
    if let Some(i) = x.iter().position(|v| !v.is_finite()) {
        return Err(Invalid::new(format!("x_mm[{i}]"), x[i], "numbers must be finite"));
    }
    if let Some(i) = x.windows(2).position(|w| w[1] <= w[0]) {
        return Err(Invalid::new(format!("x_mm[{}]", i + 1), x[i + 1], "x must be strictly rising"));
    }
    let mean = pitch(&x);
    let Some(i) = x.windows(2).position(|w| ((w[1] - w[0]) / mean - 1.0).abs() > UNEVEN) else {
        return Ok(x);
    };
    unrounded(&x).ok_or_else(|| {
        let given = format!("{} after {}", x[i + 1], x[i]);
        let allowed = format!("pixels must be equally spaced (mean pitch {mean:.5} mm)");
        Invalid::new(format!("x_mm[{}]", i + 1), given, allowed)
    })
}

/// The least-squares line through positions, if they are rounded.
fn unrounded(x: &[f64]) -> Option<Vec<f64>> {
    let unit = last_digit(x)?;
    let n = x.len() as f64;
    let (middle, mean) = (0.5 * (n - 1.0), x.iter().sum::<f64>() / n);
    let moment: f64 = x.iter().enumerate().map(|(i, x)| (i as f64 - middle) * (x - mean)).sum();
    let slope = 12.0 * moment / (n * (n * n - 1.0));
    let line: Vec<f64> = (0..x.len()).map(|i| mean + slope * (i as f64 - middle)).collect();
    let near = x.iter().zip(&line).all(|(x, even)| (x - even).abs() <= ROUNDED * unit);
    // With coarser digits a missing pixel could not be detected.
    (near && 2.0 * ROUNDED * unit < slope).then_some(line)
}

/// The unit of the last decimal that any of the numbers has.
fn last_digit(x: &[f64]) -> Option<f64> {
    let units = (0..=DECIMALS).map(|decimals| 0.1f64.powi(decimals));
    let whole = |v: f64| (v - v.round()).abs() < 1e-6;
    units.into_iter().find(|unit| x.iter().all(|x| whole(x / unit)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rounded(n: usize, pitch: f64, decimals: i32) -> Vec<f64> {
        let unit = 10f64.powi(decimals);
        (0..n).map(|i| ((i as f64 + 0.5) * pitch - 5.0) * unit).map(|x| x.round() / unit).collect()
    }

    /// Rounded positions are restored to the even spacing.
    #[test]
    fn rounded_positions_are_restored() {
        for (n, pitch, decimals) in [
            (360, 1.0 / 36.0, 2),
            (360, 1.0 / 36.0, 3),
            (180, 1.0 / 18.0, 2),
            (100, 0.05, 2),
            (30, 1.0 / 3.0, 1),
        ] {
            let even = even(rounded(n, pitch, decimals)).unwrap();
            let unit = 0.1f64.powi(decimals);
            for (i, x) in even.iter().enumerate() {
                let error = (x - ((i as f64 + 0.5) * pitch - 5.0)).abs();
                assert!(error < unit, "{n} {decimals}: {error} at {i}");
            }
        }
        let exact = rounded(100, 0.05, 3);
        assert_eq!(even(exact.clone()).unwrap(), exact, "nothing is moved without need");
    }

    /// A missing pixel is not taken for rounding.
    #[test]
    fn missing_pixel_is_not_taken_for_rounding() {
        for missing in [1, 5, 180, 357] {
            let mut x = rounded(360, 1.0 / 36.0, 2);
            x.remove(missing);
            assert!(even(x).unwrap_err().to_string().contains("equally spaced"), "{missing}");
        }
        assert!(even(vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0]).is_err());
        assert!(even(rounded(700, 0.014, 2)).is_err(), "the digits are too coarse");
    }
}
