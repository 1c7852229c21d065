//! Computes the spatial frequency response of the camera from the bare edge (e-SFR, after ISO 12233).
//!
//! The derivative of the edge's profile is the line spread function. A window centred on the edge limits it to the
//! neighbourhood: flat over its inner half and tapered by a cosine, since the standard's Hamming window would narrow a
//! wide spread and make the response too high. The Fourier transform, relative to frequency 0, is the response of lens
//! and pixel together. Means over bins and differences between bins of width w are convolutions with a box of that width,
//! so that the transform is divided by sinc²(f w), where the standard corrects for the differences alone.

use std::f64::consts::PI;

use crate::bins::EdgeProfile;

/// Response to a sinusoid in the plane of the board, relative to that to even light.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeSfr {
    /// From 0 to one cycle per pixel, in even steps.
    pub cycles_per_mm: Vec<f64>,
    pub response: Vec<f64>,
}

/// Number of frequencies.
const FREQUENCIES: usize = 101;
/// Half-width of the window: in mm at least, and in standard deviations of the blur.
const REACH_MM: f64 = 0.6;
const REACH_SIGMAS: f64 = 10.0;

impl EdgeSfr {
    /// None if a bin near the edge has no value.
    pub(crate) fn of(profile: &EdgeProfile, origin_mm: f64, blur_mm: f64, mm_per_px: f64) -> Option<Self> {
        let reach_mm = REACH_MM.max(REACH_SIGMAS * blur_mm);
        let width = profile.x_mm.get(1)? - profile.x_mm.first()?;
        let near = |x: f64| (x - origin_mm).abs() <= reach_mm;
        let points = profile.x_mm.iter().copied().zip(profile.values.iter().copied());
        let points: Vec<(f64, f64)> = points.filter(|(x, _)| near(*x)).collect();
        let spread: Vec<(f64, f64)> =
            points.windows(2).map(|pair| line_spread(pair, origin_mm, reach_mm)).collect();
        let (real, _) = transform(&spread, 0.0);
        if !real.is_finite() || real == 0.0 || spread.len() < 16 {
            return None;
        }
        let cycles_per_mm: Vec<f64> =
            (0..FREQUENCIES).map(|k| k as f64 / (FREQUENCIES - 1) as f64 / mm_per_px).collect();
        let response = cycles_per_mm.iter().map(|f| {
            let (a, b) = transform(&spread, *f);
            libm::hypot(a, b) / real.abs() / sinc(f * width).powi(2)
        });
        let response = response.collect();
        Some(Self { cycles_per_mm, response })
    }

    /// The frequency at which the response falls to a half; None if it stays above.
    pub fn mtf50_per_mm(&self) -> Option<f64> {
        let below = self.response.iter().position(|r| *r < 0.5)?;
        let (f, r) = (&self.cycles_per_mm, &self.response);
        let before = below.checked_sub(1)?;
        let share = (r[before] - 0.5) / (r[before] - r[below]);
        Some(f[before] + share * (f[below] - f[before]))
    }
}

/// Place relative to the edge, and windowed difference, of two neighbouring bins.
fn line_spread(pair: &[(f64, f64)], origin_mm: f64, reach_mm: f64) -> (f64, f64) {
    let [(x, v), (next_x, next_v)] = [pair[0], pair[1]];
    let at = f64::midpoint(x, next_x) - origin_mm;
    let tapered = (2.0 * at.abs() / reach_mm - 1.0).clamp(0.0, 1.0);
    let window = 0.5 + 0.5 * libm::cos(PI * tapered);
    (at, window * (next_v - v))
}

/// Real and imaginary part of the Fourier transform at a frequency.
fn transform(spread: &[(f64, f64)], frequency: f64) -> (f64, f64) {
    spread.iter().fold((0.0, 0.0), |(a, b), (x, v)| {
        let angle = 2.0 * PI * frequency * x;
        (a + v * libm::cos(angle), b + v * libm::sin(angle))
    })
}

/// sin(πx)/(πx)
fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-9 { 1.0 } else { libm::sin(PI * x) / (PI * x) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::profile;

    /// Bins of 7 µm of an edge that a Gaussian has blurred.
    fn edge(sigma_mm: f64, origin_mm: f64) -> EdgeProfile {
        let width = 0.007;
        let x_mm: Vec<f64> = (-400..=400).map(|k| f64::from(k) * width).collect();
        // ∫ Φ(z/σ) dz
        let primitive = |z: f64| {
            let u = z / sigma_mm;
            let normal = 0.5 * libm::erfc(-u / std::f64::consts::SQRT_2);
            z * normal + sigma_mm * libm::exp(-0.5 * u * u) / (2.0 * PI).sqrt()
        };
        let value = |x: &f64| {
            let z = x - origin_mm;
            0.05 + 0.8 * (primitive(z + 0.5 * width) - primitive(z - 0.5 * width)) / width
        };
        let values = x_mm.iter().map(value).collect();
        profile(x_mm, values, 1e-4)
    }

    /// The response of a Gaussian of σ is exp(−2π²σ²f²), which is a half at f = √(ln 2/2)/(πσ).
    #[test]
    fn gaussian_blur_has_its_exact_response() {
        for (sigma, origin) in [(0.02, 0.0), (0.035, 0.011), (0.06, -0.03)] {
            let sfr = EdgeSfr::of(&edge(sigma, origin), origin, sigma, 0.04).unwrap();
            for (f, r) in sfr.cycles_per_mm.iter().zip(&sfr.response) {
                let exact = libm::exp(-2.0 * (PI * sigma * f).powi(2));
                assert!((r - exact).abs() < 1e-4, "σ {sigma}, f {f}: {r} instead of {exact}");
            }
            let exact = (0.5 * std::f64::consts::LN_2).sqrt() / (PI * sigma);
            let found = sfr.mtf50_per_mm().unwrap();
            assert!((found / exact - 1.0).abs() < 1e-3, "σ {sigma}: {found} instead of {exact}");
        }
    }

    /// A camera that resolves more than its pixels can show has no MTF50; a gap at the edge is no response.
    #[test]
    fn sharp_edges_and_gaps_have_no_mtf50() {
        assert_eq!(EdgeSfr::of(&edge(0.01, 0.0), 0.0, 0.01, 0.1).unwrap().mtf50_per_mm(), None);
        let mut gap = edge(0.03, 0.0);
        gap.values[402] = f64::NAN;
        assert_eq!(EdgeSfr::of(&gap, 0.0, 0.03, 0.04), None);
    }
}
