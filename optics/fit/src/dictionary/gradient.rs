//! Computes a robust derivative of a noisy profile by an undecimated wavelet transform, after Luo, Bai and Shao 2006
//! ("Application of the wavelet transforms on axial strain calculation in ultrasound elastography").

use optics_model::fit::Wavelet;

use crate::dictionary::wide::wide;

/// Derivative per sample of f, at i + ½.
///
/// The chord from the first to the last sample is subtracted before and its slope added afterwards, so that both ends are
/// 0 and straight lines are differentiated exactly. `level` stages of full convolution follow, the taps of stage n being
/// 2^(n−1) apart: low-pass, and high-pass in the last.
///
/// # Panics
/// With fewer than two samples or a level outside 1 to 10.
pub fn derivative(f: &[f64], wavelet: Wavelet, level: u32) -> Vec<f64> {
    assert!(f.len() >= 2 && (1..=10).contains(&level), "{} samples, level {level}", f.len());
    let n = f.len();
    let slope = (f[n - 1] - f[0]) / (n - 1) as f64;
    let mut y: Vec<f64> = f.iter().enumerate().map(|(i, v)| v - f[0] - slope * i as f64).collect();
    let (low, high, scale) = filters(wavelet);
    for stage in 1..=level {
        let taps = stage_taps(stage, level, low, high);
        y = wide(
            #[inline(always)]
            || convolve(&y, taps, 1 << (stage - 1)),
        );
    }
    // The middle N of the longer result, rounding half away from zero.
    let offset = (y.len() - n).div_ceil(2);
    let factor = scale / libm::pow(2_f64.powi(level as i32), 1.5);
    y[offset..offset + n].iter().map(|v| slope - factor * v).collect()
}

/// The derivative for display, which is correct at the ends, too.
///
/// The objective compares [`derivative`] in data and model alike, but near the abrupt ends of a profile that is no
/// derivative of the profile. Here the profile is continued beyond each end, by point reflection at the end of the
/// straight line through its last pixels.
///
/// # Panics
/// As [`derivative`].
pub fn shown_derivative(f: &[f64], wavelet: Wavelet, level: u32) -> Vec<f64> {
    let beyond = (4 << level).min(f.len() - 1);
    let reversed: Vec<f64> = f.iter().rev().copied().collect();
    let line = (1 << level).min(beyond);
    let mut whole = carried_on(&reversed, beyond, line);
    whole.reverse();
    whole.extend_from_slice(f);
    whole.extend(carried_on(f, beyond, line));
    derivative(&whole, wavelet, level)[beyond..beyond + f.len()].to_vec()
}

/// The `count` pixels that continue a profile; the straight line is fitted to its last `line` + 1 pixels.
fn carried_on(f: &[f64], count: usize, line: usize) -> Vec<f64> {
    let last = &f[f.len() - 1 - line..];
    let (middle, mean) = (0.5 * line as f64, last.iter().sum::<f64>() / last.len() as f64);
    let (product, square) = last.iter().enumerate().fold((0.0, 0.0), |(product, square), (i, v)| {
        let x = i as f64 - middle;
        (product + x * (v - mean), square + x * x)
    });
    let end = mean + middle * product / f64::max(square, f64::MIN_POSITIVE);
    f.iter().rev().skip(1).take(count).map(|v| 2.0 * end - v).collect()
}

fn stage_taps(stage: u32, level: u32, low: &'static [f64], high: &'static [f64]) -> &'static [f64] {
    if stage < level { low } else { high }
}

/// Low-pass taps, high-pass taps, and the factor that makes the result a derivative per sample.
fn filters(wavelet: Wavelet) -> (&'static [f64], &'static [f64], f64) {
    const R: f64 = std::f64::consts::SQRT_2;
    match wavelet {
        Wavelet::QuadraticSpline => {
            (&[R / 8.0, 3.0 * R / 8.0, 3.0 * R / 8.0, R / 8.0], &[-2.0 * R, 2.0 * R], 1.0)
        }
        Wavelet::Haar => (&[1.0 / R, 1.0 / R], &[-1.0 / R, 1.0 / R], 4.0),
    }
}

/// Full convolution with `spacing` − 1 zeros between the taps.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn convolve(x: &[f64], taps: &[f64], spacing: usize) -> Vec<f64> {
    let mut y = vec![0.0; x.len() + (taps.len() - 1) * spacing];
    for (k, tap) in taps.iter().enumerate() {
        for (out, v) in y[k * spacing..].iter_mut().zip(x) {
            *out += tap * v;
        }
    }
    y
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns of `tests/data/wavelet.csv`: f, spline levels 2 to 5, Haar level 4.
    fn golden() -> Vec<Vec<f64>> {
        let text = include_str!("../../../../tests/data/wavelet.csv");
        let rows = text.lines().filter(|l| !l.starts_with('#')).skip(1);
        let rows: Vec<Vec<f64>> = rows.map(|l| l.split(',').map(|v| v.parse().unwrap()).collect()).collect();
        (0..rows[0].len()).map(|c| rows.iter().map(|r| r[c]).collect()).collect()
    }

    #[test]
    fn derivatives_equal_the_golden_values() {
        let columns = golden();
        let spline = (2..=5).map(|level| (Wavelet::QuadraticSpline, level));
        for ((wavelet, level), expected) in spline.chain([(Wavelet::Haar, 4)]).zip(&columns[1..]) {
            for (i, (a, b)) in derivative(&columns[0], wavelet, level).iter().zip(expected).enumerate() {
                assert!((a - b).abs() < 1e-9, "{wavelet:?} level {level}, sample {i}: {a} {b}");
            }
        }
    }

    /// For a profile whose tails level off towards both ends of ±5 mm, derivatives are within 0.2 % of the steepest slope
    /// near the ends, and equal to the plain ones further inside than the transform reaches.
    #[test]
    fn shown_derivatives_are_right_at_the_ends() {
        let pitch = 10.0 / 360.0;
        let x = |i: i32| (f64::from(i) + 0.5) * pitch - 5.0;
        let f: Vec<f64> = (0..360).map(|i| libm::tanh(0.9 * x(i))).collect();
        let shown = shown_derivative(&f, Wavelet::QuadraticSpline, 4);
        let plain = derivative(&f, Wavelet::QuadraticSpline, 4);
        let exact = |i: i32| 0.9 / libm::cosh(0.9 * (x(i) + 0.5 * pitch)).powi(2) * pitch;
        for i in 0..360_i32 {
            let k = usize::try_from(i).unwrap();
            let inside = (64..296).contains(&k);
            assert!(
                inside || (shown[k] - exact(i)).abs() < 2e-3 * 0.9 * pitch,
                "{i}: {} {}",
                shown[k],
                exact(i)
            );
            assert!(!inside || (shown[k] - plain[k]).abs() < 1e-12, "{i}");
        }
        assert!((plain[0] - exact(0)).abs() > 0.05 * 0.9 * pitch, "the artefact that is not shown");
        let line: Vec<f64> = (0..12).map(|i| 3.0 - 0.25 * f64::from(i)).collect();
        assert!(shown_derivative(&line, Wavelet::Haar, 5).iter().all(|d| (d + 0.25).abs() < 1e-12));
    }

    #[test]
    fn level_one_is_the_forward_difference() {
        let f: Vec<f64> = (0..20).map(|i| f64::from(i * i)).collect();
        let d = derivative(&f, Wavelet::QuadraticSpline, 1);
        for i in 0..19 {
            assert!((d[i] - (f[i + 1] - f[i])).abs() < 1e-9, "{i}");
        }
    }
}
