//! A measured profile on the pixels of the dictionary.

use std::ops::Range;

use farm_proto::MeasuredProfile;
use farm_proto::scene::Sensor;

/// Share of a pixel by which a measurement may fall short of a dictionary pixel that it still counts as covering:
/// coordinates in files are rounded.
const SLACK: f64 = 0.02;

/// The dictionary pixels that a measurement covers, and its averages over them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Resampled {
    pub pixels: Range<usize>,
    pub values: Vec<f64>,
}

/// Box averages: the measured pixels are taken as constant over their pitch, and their mean over each dictionary
/// pixel is exact. Pixels that the measurement does not cover are left out.
pub(super) fn resample(profile: &MeasuredProfile, sensor: Sensor) -> Resampled {
    let pitch = profile.pitch_mm();
    let left = profile.x_mm()[0] - 0.5 * pitch;
    let right = left + pitch * profile.x_mm().len() as f64;
    let edge = |pixel: usize| pixel as f64 * sensor.pitch_mm() - 0.5 * sensor.width_mm();
    let slack = SLACK * sensor.pitch_mm();
    let covered = |pixel: &usize| edge(*pixel) >= left - slack && edge(pixel + 1) <= right + slack;
    let first = (0..sensor.pixels()).find(covered).unwrap_or(0);
    let count = (first..sensor.pixels()).take_while(covered).count();
    let cumulative = Cumulative::new(profile.values());
    let position = |x: f64| (x - left) / pitch;
    let values =
        (first..first + count).map(|pixel| cumulative.mean(position(edge(pixel)), position(edge(pixel + 1))));
    Resampled { pixels: first..first + count, values: values.collect() }
}

/// Integral of a piecewise constant function with unit steps.
struct Cumulative<'a> {
    values: &'a [f64],
    sums: Vec<f64>,
}

impl<'a> Cumulative<'a> {
    fn new(values: &'a [f64]) -> Self {
        let mut sum = 0.0;
        let sums = std::iter::once(0.0).chain(values.iter().map(|v| {
            sum += v;
            sum
        }));
        Self { values, sums: sums.collect() }
    }

    fn mean(&self, from: f64, to: f64) -> f64 {
        let n = self.values.len() as f64;
        let (from, to) = (from.clamp(0.0, n), to.clamp(0.0, n));
        (self.at(to) - self.at(from)) / (to - from)
    }

    fn at(&self, x: f64) -> f64 {
        let cell = (x as usize).min(self.values.len() - 1);
        self.sums[cell] + (x - cell as f64) * self.values[cell]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(n: usize, width: f64, shift: f64, f: impl Fn(f64) -> f64) -> MeasuredProfile {
        let pitch = width / n as f64;
        let x: Vec<f64> = (0..n).map(|i| (i as f64 + 0.5) * pitch - 0.5 * width + shift).collect();
        let values = x.iter().map(|x| f(*x)).collect();
        MeasuredProfile::new("R", 0.5, x, values, None).unwrap()
    }

    fn sensor(n: u32) -> Sensor {
        Sensor::new(10.0, n, 0.0).unwrap()
    }

    #[test]
    fn the_same_pixels_come_back_unchanged() {
        let profile = measured(360, 10.0, 0.0, |x| x * x);
        let resampled = resample(&profile, sensor(360));
        assert_eq!(resampled.pixels, 0..360);
        for (a, b) in resampled.values.iter().zip(profile.values()) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn coarse_pixels_are_means_of_fine_ones_also_when_they_do_not_divide() {
        let profile = measured(700, 10.0, 0.0, |x| 2.0 * x);
        for n in [100, 90] {
            let resampled = resample(&profile, sensor(n));
            assert_eq!(resampled.pixels, 0..n as usize);
            for (i, v) in resampled.values.iter().enumerate() {
                assert!((v - 2.0 * sensor(n).centre_mm(i)).abs() < 1e-3, "{n} pixels, {i}: {v}");
            }
        }
    }

    #[test]
    fn only_the_overlap_is_kept() {
        let resampled = resample(&measured(80, 4.0, 1.0, |x| x), sensor(100));
        assert_eq!(resampled.pixels, 40..80);
        assert!(resample(&measured(80, 4.0, 20.0, |x| x), sensor(100)).values.is_empty());
    }
}
