//! Scenes, and statistics for the unit tests of distributions.

use optics_model::TransportPoint;
use optics_model::scene::{Channel, Layer, RingLight, Scene, Sensor};

use crate::stack::Stack;

/// Layers over a white base in a ring light, seen from this angle.
pub(crate) fn scene(layers: Vec<Layer>, [inner, outer]: [f64; 2], polar_deg: f64) -> Scene {
    let (white, ring) = (Channel::new("mono", 1.0, 1.0).unwrap(), RingLight::new(inner, outer).unwrap());
    Scene::new(layers, vec![white], ring, Sensor::new(10.0, 8, polar_deg).unwrap(), false).unwrap()
}

pub(crate) fn sample(roughness: f64) -> Layer {
    Layer::sample("sample", roughness).unwrap()
}

pub(crate) fn clear(ior: f64, thickness_mm: f64, roughness: f64) -> Layer {
    Layer::clear("clear", ior, thickness_mm, roughness).unwrap()
}

/// With σ_t, g, thickness and index of the sample.
pub(crate) fn stack(scene: &Scene, [sigma_t, g, thickness, ior]: [f64; 4]) -> Stack {
    Stack::new(scene, &TransportPoint::new(sigma_t, g, thickness, ior).unwrap())
}

/// Unpolarised Fresnel reflectance in double precision; 1 under total reflection.
pub(crate) fn fresnel(cos_i: f64, eta: f64) -> f64 {
    let sin2_t = eta * eta * (1.0 - cos_i * cos_i);
    if sin2_t >= 1.0 {
        return 1.0;
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    let s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    let p = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    f64::midpoint(s * s, p * p)
}

/// p-value of Pearson's χ² test: the probability of a fit at least this bad if the counts follow the
/// probabilities (Wilson–Hilferty approximation of the χ² distribution).
pub(crate) fn chi_square(counts: &[u64], probabilities: &[f64]) -> f64 {
    let total = counts.iter().sum::<u64>() as f64;
    let (mut chi2, mut cells) = (0.0, 0.0);
    for (&count, &p) in counts.iter().zip(probabilities) {
        if p * total >= 10.0 {
            chi2 += (count as f64 - p * total).powi(2) / (p * total);
            cells += 1.0;
        }
    }
    let dof: f64 = cells - 1.0;
    let spread = 2.0 / (9.0 * dof);
    let z = (libm::cbrt(chi2 / dof) - (1.0 - spread)) / spread.sqrt();
    normal_tail(z)
}

/// Upper tail of the standard normal distribution (Abramowitz and Stegun 26.2.17, error below 1e-7).
fn normal_tail(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let series = [0.319_381_530, -0.356_563_782, 1.781_477_937, -1.821_255_978, 1.330_274_429];
    let poly = series.iter().rev().fold(0.0, |sum, c| (sum + c) * t);
    let tail = libm::exp(-0.5 * z * z) / std::f64::consts::TAU.sqrt() * poly;
    if z > 0.0 { tail } else { 1.0 - tail }
}
