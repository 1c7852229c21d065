//! Resamples a measured profile to the pixels of the dictionary.

use std::ops::Range;

use optics_model::scene::Sensor;

/// Share of a pixel by which a measurement may fall short of a dictionary pixel that it still counts as covering:
/// coordinates in files are rounded.
const SLACK: f64 = 0.02;

/// The dictionary pixels that a measurement covers, with the weights of the measured pixels in them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Resampled {
    pub pixels: Range<usize>,
    pub values: Vec<f64>,
    shares: Vec<Share>,
}

/// Weights of the measured pixels from `first` on in a dictionary pixel; they add up to 1.
#[derive(Debug, Clone, PartialEq)]
struct Share {
    first: usize,
    weights: Vec<f64>,
}

impl Resampled {
    /// Variances of the dictionary pixels' values, the measured pixels being independent.
    pub(crate) fn variances(&self, std_errors: &[f64]) -> Vec<f64> {
        let variance = |share: &Share| {
            share.weights.iter().zip(&std_errors[share.first..]).map(|(w, e)| (w * e).powi(2)).sum()
        };
        self.shares.iter().map(variance).collect()
    }
}

/// Averages of the measured profile over each dictionary pixel, from its integral between the measured pixels' edges:
/// averages over the measured pixels themselves are kept exactly.
///
/// Between the edges the integral is straight if the measured pixels are as fine as the dictionary's – then these are
/// box averages – and of fifth order if they are coarser, since the profile may not be taken as a staircase then: its
/// steps would count as blur. Pixels that the measurement does not cover are left out.
pub(crate) fn resample(x_mm: &[f64], values: &[f64], sensor: Sensor) -> Resampled {
    let cells = x_mm.len();
    let pitch = (x_mm[cells - 1] - x_mm[0]) / (cells - 1) as f64;
    let left = x_mm[0] - 0.5 * pitch;
    let right = left + pitch * cells as f64;
    let edge = |pixel: usize| pixel as f64 * sensor.pitch_mm() - 0.5 * sensor.width_mm();
    let slack = SLACK * sensor.pitch_mm();
    let covered = |pixel: &usize| edge(*pixel) >= left - slack && edge(pixel + 1) <= right + slack;
    let first = (0..sensor.pixels()).find(covered).unwrap_or(0);
    let count = (first..sensor.pixels()).take_while(covered).count();
    let position = |x: f64| ((x - left) / pitch).clamp(0.0, cells as f64);
    let edges_used = if pitch > (1.0 + SLACK) * sensor.pitch_mm() { 6 } else { 2 };
    let shares: Vec<Share> = (first..first + count)
        .map(|pixel| share(position(edge(pixel)), position(edge(pixel + 1)), cells, edges_used))
        .collect();
    let value =
        |share: &Share| share.weights.iter().zip(&values[share.first..]).map(|(w, v)| w * v).sum::<f64>();
    let values = shares.iter().map(value).collect();
    Resampled { pixels: first..first + count, values, shares }
}

/// Shares of the cells of unit width, the first beginning at 0, in the mean from `from` to `to`.
fn share(from: f64, to: f64, cells: usize, edges_used: usize) -> Share {
    let (below, above) = (Integral::at(from, cells, edges_used), Integral::at(to, cells, edges_used));
    let first = below.first_edge.min(above.first_edge);
    let last = (below.first_edge + below.weights.len()).max(above.first_edge + above.weights.len()) - 1;
    let weight = |cell: usize| (above.weight_of(cell) - below.weight_of(cell)) / (to - from);
    Share { first, weights: (first..last).map(weight).collect() }
}

/// The integral from 0 to some place, as a combination of those up to the edges from `first_edge` on.
struct Integral {
    first_edge: usize,
    weights: Vec<f64>,
}

impl Integral {
    /// Polynomial interpolation between the nearest edges.
    fn at(x: f64, cells: usize, edges_used: usize) -> Self {
        let edges_used = edges_used.min(cells + 1);
        let cell = (x as usize).min(cells - 1);
        let first_edge = (cell + 1).saturating_sub(edges_used / 2).min(cells + 1 - edges_used);
        let weight = |i: usize| {
            let others = (0..edges_used).filter(|j| *j != i);
            others.map(|j| (x - (first_edge + j) as f64) / (i as f64 - j as f64)).product()
        };
        Self { first_edge, weights: (0..edges_used).map(weight).collect() }
    }

    /// Weight of a cell: the sum of those of the edges behind it.
    fn weight_of(&self, cell: usize) -> f64 {
        self.weights.iter().zip(self.first_edge..).filter(|(_, edge)| *edge > cell).map(|(w, _)| w).sum()
    }
}

#[cfg(test)]
mod tests {
    use optics_model::MeasuredProfile;

    use super::*;

    fn of(profile: &MeasuredProfile, sensor: Sensor) -> Resampled {
        resample(profile.x_mm(), profile.values(), sensor)
    }

    fn measured(n: usize, width: f64, shift: f64, f: impl Fn(f64) -> f64) -> MeasuredProfile {
        let pitch = width / n as f64;
        let x: Vec<f64> = (0..n).map(|i| (i as f64 + 0.5) * pitch - 0.5 * width + shift).collect();
        let values = x.iter().map(|x| f(*x)).collect();
        MeasuredProfile::new("R", 0.5, x, values, None).unwrap()
    }

    fn sensor(n: u32) -> Sensor {
        Sensor::new(10.0, n, 0.0).unwrap()
    }

    /// A profile with the sensor's own pixels is unchanged by resampling.
    #[test]
    fn same_pixels_stay_unchanged() {
        let profile = measured(360, 10.0, 0.0, |x| x * x);
        let resampled = of(&profile, sensor(360));
        assert_eq!(resampled.pixels, 0..360);
        for (a, b) in resampled.values.iter().zip(profile.values()) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    /// Coarse pixels are the means of fine ones, also where their number does not divide that of the fine ones.
    #[test]
    fn coarse_pixels_are_means_of_fine_ones() {
        let profile = measured(700, 10.0, 0.0, |x| 2.0 * x);
        for n in [100, 90] {
            let resampled = of(&profile, sensor(n));
            assert_eq!(resampled.pixels, 0..n as usize);
            for (i, v) in resampled.values.iter().enumerate() {
                assert!((v - 2.0 * sensor(n).centre_mm(i)).abs() < 1e-3, "{n} pixels, {i}: {v}");
            }
        }
    }

    /// On pixels twice as coarse, a blurred edge keeps its shape: a staircase would be off by a quarter of a step.
    #[test]
    fn coarse_measurements_are_not_taken_as_staircases() {
        // The exact mean of tanh(x/0.2) over a pixel.
        let mean = |x: f64, pitch: f64| {
            let integral = |x: f64| 0.2 * libm::log(libm::cosh(x / 0.2));
            (integral(x + pitch / 2.0) - integral(x - pitch / 2.0)) / pitch
        };
        let coarse = measured(180, 10.0, 0.0, |x| mean(x, 10.0 / 180.0));
        let resampled = of(&coarse, sensor(360));
        assert_eq!(resampled.pixels, 0..360);
        for (i, v) in resampled.values.iter().enumerate() {
            let exact = mean(sensor(360).centre_mm(i), 10.0 / 360.0);
            assert!((v - exact).abs() < 1e-3, "pixel {i}: {v} {exact}");
        }
        // Means over the measured pixels equal the measured values.
        for (pair, v) in resampled.values.chunks(2).zip(coarse.values()) {
            assert!((0.5 * (pair[0] + pair[1]) - v).abs() < 1e-12);
        }
    }

    #[test]
    fn only_the_overlap_is_kept() {
        let resampled = of(&measured(80, 4.0, 1.0, |x| x), sensor(100));
        assert_eq!(resampled.pixels, 40..80);
        assert!(of(&measured(80, 4.0, 20.0, |x| x), sensor(100)).values.is_empty());
    }
}
