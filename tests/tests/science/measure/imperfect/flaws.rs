//! Imperfections of a measurement, and the profiles that they produce.

use farm_tests::statistics::Normal;
use optics_model::MeasuredProfile;

use super::rows::{Kind, Row};
use super::{FINE, MARGIN, SLABS_MM, scene};
use crate::measure::{centres_mm, noisy};

/// Noise of a pixel: a share of its value, and a floor.
const NOISE_SHARE: f64 = 0.004;
const NOISE_FLOOR: f64 = 0.0002;

/// Typical sizes: standard deviations, except for the blur and the number of specks in a profile.
const ORIGIN_MM: f64 = 0.05;
const BLUR_MM: f64 = 0.025;
const GAIN: f64 = 0.003;
const ZERO: f64 = 0.001;
const SLOPE_PER_10_MM: f64 = 0.002;
const SPECKS: f64 = 15.0;
pub(super) const SCALE: f64 = 0.02;

/// A grain of dust or a bubble: a Gaussian over pixels that changes the value by a share.
#[derive(Debug, Clone, Copy)]
struct Speck {
    pixel: f64,
    sigma_pixels: f64,
    share: f64,
}

/// The imperfections of one profile.
#[derive(Debug, Clone)]
struct Flaws {
    origin_mm: f64,
    blur_mm: f64,
    gain: f64,
    zero: f64,
    slope_per_10_mm: f64,
    specks: Vec<Speck>,
    mu: f64,
}

impl Flaws {
    /// Draws the imperfections of a row. A subject has the same deviates at every size.
    fn draw(row: &Row, subject: u64, slab: usize) -> Self {
        let pixels = scene().sensor().pixels() as f64;
        let own = |kind: Kind| Normal::new(430_000 + (subject * 2 + slab as u64) * 16 + kind as u64);
        let deviate = |kind: Kind, unit: f64| row.size(kind) * unit * own(kind).normal();
        let mut dust = own(Kind::Dust);
        let count = (row.size(Kind::Dust) * SPECKS) as usize;
        // The exposure is common to the slabs.
        let scale = Normal::new(440_000 + subject).normal();
        Self {
            origin_mm: deviate(Kind::Origin, ORIGIN_MM),
            blur_mm: row.size(Kind::Blur) * BLUR_MM,
            gain: deviate(Kind::Gain, GAIN),
            zero: deviate(Kind::Zero, ZERO),
            slope_per_10_mm: deviate(Kind::Slope, SLOPE_PER_10_MM),
            specks: (0..count).map(|_| Speck::draw(&mut dust, pixels)).collect(),
            mu: 1.0 + row.size(Kind::Scale) * SCALE * scale,
        }
    }

    fn seen(&self, radiance_factor: f64, x_mm: f64, pixel: f64) -> f64 {
        let light = 1.0 + self.slope_per_10_mm * x_mm / 10.0;
        let dust: f64 = self.specks.iter().map(|s| s.factor(pixel)).product();
        (1.0 + self.gain) * light * dust * radiance_factor / self.mu + self.zero
    }
}

impl Speck {
    /// Draws a speck: anywhere, one to three pixels wide at half its depth, equally often dark (5 to 40 %) and bright
    /// (5 to 20 %).
    fn draw(random: &mut Normal, pixels: f64) -> Self {
        let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
        let pixel = between(0.0, pixels);
        let sigma_pixels = between(1.0, 3.0) / (8.0 * libm::log(2.0_f64)).sqrt();
        let dark = between(0.0, 1.0) < 0.5;
        Self { pixel, sigma_pixels, share: if dark { -between(0.05, 0.4) } else { between(0.05, 0.2) } }
    }

    fn factor(&self, pixel: f64) -> f64 {
        1.0 + self.share * libm::exp(-0.5 * ((pixel - self.pixel) / self.sigma_pixels).powi(2))
    }
}

/// The profile of a slab as measured in a laboratory, with its nominal thickness, from its exact one on fine pixels.
pub(super) fn photographed(truth: &[f64], row: &Row, subject: u64, slab: usize) -> MeasuredProfile {
    let (flaws, scene) = (Flaws::draw(row, subject, slab), scene());
    let seen = seen(truth, flaws.origin_mm, flaws.blur_mm);
    let x = centres_mm(&scene);
    let exact: Vec<f64> = (0..x.len()).map(|i| flaws.seen(seen[i], x[i], i as f64 + 0.5)).collect();
    let mut noise = Normal::new(450_000 + subject * 2 + slab as u64);
    noisy(("R", SLABS_MM[slab]), x, &exact, |v| libm::hypot(NOISE_SHARE * v, NOISE_FLOOR), &mut noise)
}

/// The blurred truth averaged over the dictionary's pixels, with the edge at `origin_mm`.
fn seen(truth: &[f64], origin_mm: f64, blur_mm: f64) -> Vec<f64> {
    let pitch_mm = scene().sensor().pitch_mm() / FINE as f64;
    let fine = blurred(truth, blur_mm / pitch_mm);
    let mut sums = vec![0.0];
    sums.extend(fine.iter().scan(0.0, |sum, v| {
        *sum += v;
        Some(*sum)
    }));
    let sum_to = |edge: f64| {
        let below = edge.floor().clamp(0.0, (fine.len() - 1) as f64);
        sums[below as usize] + (edge - below) * fine[below as usize]
    };
    let pixels = fine.len() / FINE - 2 * MARGIN;
    let edge = |i: usize| ((i + MARGIN) * FINE) as f64 - origin_mm / pitch_mm;
    (0..pixels).map(|i| (sum_to(edge(i + 1)) - sum_to(edge(i))) / FINE as f64).collect()
}

/// Convolution with a Gaussian; values beyond the ends equal the end values.
fn blurred(values: &[f64], sigma: f64) -> Vec<f64> {
    if sigma == 0.0 {
        return values.to_vec();
    }
    let reach = (6.0 * sigma).ceil() as isize;
    let weights: Vec<f64> = (-reach..=reach).map(|k| libm::exp(-0.5 * (k as f64 / sigma).powi(2))).collect();
    let total: f64 = weights.iter().sum();
    let last = values.len() as isize - 1;
    let at = |i: isize| values[i.clamp(0, last) as usize];
    let sum = |i: isize| (-reach..=reach).zip(&weights).map(|(k, w)| w * at(i + k)).sum::<f64>();
    (0..=last).map(|i| sum(i) / total).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::imperfect::fine;
    use crate::measure::{traced, values};
    use optics_model::Medium;

    /// A shift and a blur change a parabola as calculus predicts, and without flaws only the stated noise is added.
    #[test]
    fn parabola_is_shifted_and_blurred_exactly() {
        let (sensor, pitch) = (fine().sensor(), scene().sensor().pitch_mm());
        let parabola = |i| 1e-4 * (sensor.centre_mm(i) / pitch).powi(2) + 1.0;
        let truth: Vec<f64> = (0..sensor.pixels()).map(parabola).collect();
        let (origin, sigma) = (3.3, 2.7);
        let found = seen(&truth, origin * pitch, sigma * pitch);
        for i in [60, 180, 300] {
            let x = i as f64 + 0.5 - 180.0 - origin;
            // The variances of Gaussian and pixel add up; with fine pixels as points the latter is (1 − 1/16)/12.
            let expected = 1.0 + 1e-4 * (x * x + sigma * sigma + (1.0 - 1.0 / 16.0) / 12.0);
            assert!((found[i] - expected).abs() < 1e-4 * 0.05, "{i}: {} {expected}", found[i]);
        }
        let found = photographed(&truth, &Row::named("none"), 7, 0);
        let exact = seen(&truth, 0.0, 0.0);
        let errors = found.std_errors().unwrap();
        let z2: f64 = (0..360).map(|i| ((found.values()[i] - exact[i]) / errors[i]).powi(2)).sum();
        // χ² of 360 has a standard deviation of 27.
        assert!((z2 - 360.0).abs() < 4.0 * 27.0, "{z2}");
    }

    /// The flaws have the standard deviations that their row states.
    #[test]
    fn flaws_have_the_stated_deviations() {
        let row = Row::named("all x3");
        let drawn: Vec<Flaws> =
            (0..1000).flat_map(|s| [0, 1].map(|slab| Flaws::draw(&row, s, slab))).collect();
        let parts = |f: &Flaws| [f.origin_mm, f.gain, f.zero, f.slope_per_10_mm];
        for (part, expected) in [0.15, 0.009, 0.003, 0.006].into_iter().enumerate() {
            let squares = drawn.iter().map(|f| parts(f)[part].powi(2));
            let sigma = (squares.sum::<f64>() / drawn.len() as f64).sqrt();
            // From 2000 deviates it is determined to 1.6 %.
            assert!((sigma / expected - 1.0).abs() < 0.06, "{sigma} {expected}");
        }
        assert!(drawn.iter().all(|f| f.specks.len() == 45 && f.blur_mm == 3.0 * BLUR_MM && f.mu == 1.0));
    }

    /// The fine pixels average to those of the dictionary.
    #[test]
    fn fine_pixels_sum_to_dictionary_pixels() {
        let medium = Medium::new(4.0, 0.97, 0.4).unwrap();
        let [coarse, fine] =
            [scene(), fine()].map(|scene| values(&traced(&scene, &medium, 0.5, 25_000, 3), 0));
        for (mean, value) in seen(&fine, 0.0, 0.0).iter().zip(&coarse) {
            assert!((mean - value).abs() < 1e-5, "{mean} {value}");
        }
    }
}
