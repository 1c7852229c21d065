//! Prepares a profile for the checks of its shape.

/// Most pixels of a trace; more are averaged in groups.
const MOST_PIXELS: usize = 1000;

use crate::measurement::MeasuredProfile;

/// Values at equally spaced x with their noise.
#[derive(Debug)]
pub(super) struct Trace {
    /// Relative to `origin`.
    pub x: Vec<f64>,
    /// The edge's place by the set-up.
    pub origin: f64,
    pub values: Vec<f64>,
    pub pitch: f64,
    /// Standard deviation of the noise that is independent between neighbours.
    scatter: f64,
    /// Standard deviation of the noise that neighbours share: their standard errors beyond their scatter. Simulated
    /// profiles have such noise, since their pixels share walks.
    shared: f64,
}

impl Trace {
    /// The trace of a profile, from its edge by the set-up.
    pub fn of(profile: &MeasuredProfile) -> Self {
        let origin = profile.setup().origin_mm.unwrap_or(0.0);
        let x: Vec<f64> = profile.x_mm().iter().map(|x| x - origin).collect();
        Self { origin, ..Self::new(&x, profile.values(), profile.std_errors()) }
    }

    /// The trace of at least eight pixels, x rising.
    pub fn new(x: &[f64], values: &[f64], std_errors: Option<&[f64]>) -> Self {
        let group = x.len().div_ceil(MOST_PIXELS);
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let grouped = |v: &[f64]| -> Vec<f64> { v.chunks_exact(group).map(mean).collect() };
        let (x, values) = (grouped(x), grouped(values));
        // Noise grows with light: the noisier half counts.
        let (dark, light) = values.split_at(values.len() / 2);
        let scatter = scatter(dark, 2).max(scatter(light, 2));
        let stated = std_errors.map_or(0.0, |e| median(e.to_vec()));
        let pitch = (x[x.len() - 1] - x[0]) / (x.len() - 1) as f64;
        Self {
            pitch,
            scatter,
            shared: (stated * stated - scatter * scatter).max(0.0).sqrt(),
            x,
            origin: 0.0,
            values,
        }
    }

    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Median of the values of a range of pixels, insensitive to rare outliers such as dust.
    pub fn level(&self, pixels: std::ops::Range<usize>) -> f64 {
        median(self.values[pixels].to_vec())
    }

    /// Standard deviation of the level of a window.
    pub fn noise(&self, pixels: usize) -> f64 {
        // The standard error of a median is 1.25 times that of a mean.
        libm::hypot(self.shared, 1.25 * self.scatter / (pixels as f64).sqrt())
    }

    /// Pixels of a length, at least `least`.
    pub fn pixels(&self, length_mm: f64, least: usize) -> usize {
        ((length_mm / self.pitch).round() as usize).max(least)
    }

    /// The first pixel whose centre is not left of 0.
    pub fn edge(&self) -> usize {
        self.x.partition_point(|x| *x < 0.0)
    }

    /// Distance that the profile covers on both sides of 0; negative if 0 is outside.
    pub fn reach(&self) -> f64 {
        (-self.x[0]).min(self.x[self.len() - 1]) + 0.5 * self.pitch
    }

    /// Mean over `from` ≤ |x| ≤ `to`, half from each side, pixels counted by the share of them that lies within.
    pub fn mean_of_both(&self, from: f64, to: f64) -> f64 {
        let half = 0.5 * self.pitch;
        let side = |sign: f64| {
            let share = |x: f64| ((sign * x + half).min(to) - (sign * x - half).max(from)).max(0.0);
            let (sum, weight) = self.x.iter().zip(&self.values).fold((0.0, 0.0), |(sum, weight), (x, v)| {
                let w = share(*x);
                (sum + w * v, weight + w)
            });
            sum / weight
        };
        0.5 * (side(1.0) + side(-1.0))
    }

    /// Light level less dark level at the given place, each the median of `width` pixels next to it.
    pub fn rise(&self, place: usize, width: usize) -> f64 {
        self.level(place..place + width) - self.level(place - width..place)
    }
}

/// Standard deviation of independent noise, from differences of this order, which remove smooth variation.
pub(super) fn scatter(values: &[f64], order: u32) -> f64 {
    let mut differences = values.to_vec();
    let mut variance = 1.0;
    for k in 1..=order {
        differences = differences.windows(2).map(|w| w[1] - w[0]).collect();
        // The sum of the squares of the weights is the binomial coefficient of 2k over k.
        variance *= f64::from(2 * (2 * k - 1)) / f64::from(k);
    }
    // The median of |normal| is 0.6745 σ.
    median(differences.into_iter().map(f64::abs).collect()) / (0.6745 * variance.sqrt())
}

/// The middle value, or the mean of the two in the middle.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    0.5 * (values[(n - 1) / 2] + values[n / 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The windows of a trace follow from lengths in mm and from shares of its pixels.
    #[test]
    fn windows_have_lengths_and_pixel_shares() {
        let x: Vec<f64> = (0..40).map(|i| (f64::from(i) - 19.5) * 0.1).collect();
        let trace = Trace::new(&x, &x.iter().map(|x| x.abs()).collect::<Vec<_>>(), None);
        assert_eq!((trace.edge(), trace.pixels(0.52, 3), trace.pixels(0.1, 3)), (20, 5, 3));
        assert!((trace.reach() - 2.0).abs() < 1e-12);
        assert!((trace.mean_of_both(1.0, 2.0) - 1.5).abs() < 1e-12);
        assert!(trace.rise(20, 5).abs() < 1e-12);
    }

    /// Noise is estimated on a slope too, and long profiles are averaged.
    #[test]
    fn noise_is_found_on_a_slope() {
        let noisy = |i: usize| 0.01 * i as f64 + if i.is_multiple_of(3) { 0.2 } else { -0.1 };
        let x: Vec<f64> = (0..5000).map(|i| f64::from(i) * 0.001).collect();
        let short = Trace::new(&x[..300], &(0..300).map(noisy).collect::<Vec<_>>(), None);
        assert!((0.1..0.4).contains(&short.noise(1)), "{}", short.noise(1));
        assert!((short.noise(1) / short.noise(100) - 10.0).abs() < 1e-9);
        let long = Trace::new(&x, &vec![0.5; 5000], Some(&vec![0.02; 5000]));
        assert_eq!((long.len(), long.noise(100)), (1000, 0.02));
        assert!((long.pitch - 0.005).abs() < 1e-12);
    }
}
