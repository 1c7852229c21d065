//! Smooth dielectric interfaces: unpolarised Fresnel reflectance and Snell refraction.

use glam::Vec3;

/// Relative index of refraction at an interface: the index on the incident side over that on the other.
#[derive(Debug, Clone, Copy)]
pub struct RelativeIndex {
    pub eta: f32,
    /// η².
    pub squared: f32,
    /// 1 − η².
    pub complement: f32,
}

impl RelativeIndex {
    pub fn new(incident: f64, other: f64) -> Self {
        let eta = incident / other;
        Self { eta: eta as f32, squared: (eta * eta) as f32, complement: (1.0 - eta * eta) as f32 }
    }
}

/// Refraction and reflectance of a ray at a (micro)facet.
///
/// R = (r_s² + r_p²)/2, r_s = (η cos i − cos t)/(η cos i + cos t), r_p = (cos i − η cos t)/(cos i + η cos t).
#[derive(Debug, Clone, Copy)]
pub struct Facet {
    /// Cosine of the angle of refraction; 0 under total internal reflection.
    pub cos_t: f32,
    /// (r_s² + r_p²) × denominator: R is stored as a fraction, so that comparing with it needs no division.
    numerator: f32,
    denominator: f32,
}

impl Facet {
    pub fn new(cos_i: f32, index: RelativeIndex) -> Self {
        let RelativeIndex { eta, squared, complement } = index;
        let cos_t = (complement + squared * (cos_i * cos_i)).max(0.0).sqrt();
        let (a, b) = (eta * cos_i, eta * cos_t);
        let (s, s_below) = (a - cos_t, a + cos_t);
        let (p, p_below) = (cos_i - b, cos_i + b);
        let (s, p, below) = (s * p_below, p * s_below, s_below * p_below);
        Self { cos_t, numerator: s * s + p * p, denominator: below * below }
    }

    /// Whether a uniform number chooses reflection, which has the probability R.
    pub fn reflects(&self, u: f32) -> bool {
        (u + u) * self.denominator < self.numerator || self.cos_t <= 0.0
    }

    /// R.
    pub fn reflectance(&self) -> f32 {
        0.5 * self.numerator / self.denominator
    }
}

/// Mirror image of `wi` about the facet normal `m`, both pointing away from the facet.
pub fn reflect(wi: Vec3, m: Vec3, cos_i: f32) -> Vec3 {
    m * (2.0 * cos_i) - wi
}

/// Direction of the refracted ray, pointing away from the facet on its other side.
pub fn refract(wi: Vec3, m: Vec3, cos_i: f32, cos_t: f32, eta: f32) -> Vec3 {
    m * (eta * cos_i - cos_t) - wi * eta
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facet(cos_i: f32, eta: f64) -> Facet {
        Facet::new(cos_i, RelativeIndex::new(eta, 1.0))
    }

    #[test]
    fn normal_incidence_and_brewster_angle() {
        assert!((facet(1.0, 1.0 / 1.5).reflectance() - 0.04).abs() < 1e-6);
        // At Brewster's angle only half of r_s² is left.
        let brewster = libm::atanf(1.5);
        let s = (1.0 - 1.5_f32 * 1.5) / (1.0 + 1.5 * 1.5);
        assert!((facet(libm::cosf(brewster), 1.0 / 1.5).reflectance() - 0.5 * s * s).abs() < 1e-6);
    }

    /// R + T = 1 for the amplitudes: T = (n_t cos t / n_i cos i) (t_s² + t_p²)/2.
    #[test]
    fn reflectance_and_transmittance_add_up_to_one() {
        for eta in [1.0 / 1.53, 1.53, 1.33 / 1.49] {
            for i in 1..1000 {
                let cos_i = i as f32 / 1000.0;
                let facet = facet(cos_i, eta);
                if facet.cos_t == 0.0 {
                    assert_eq!(facet.reflectance(), 1.0);
                    continue;
                }
                let eta = eta as f32;
                let t_s = 2.0 * eta * cos_i / (eta * cos_i + facet.cos_t);
                let t_p = 2.0 * eta * cos_i / (cos_i + eta * facet.cos_t);
                let transmittance = facet.cos_t / (eta * cos_i) * 0.5 * (t_s * t_s + t_p * t_p);
                assert!((facet.reflectance() + transmittance - 1.0).abs() < 3e-6, "eta {eta} cos {cos_i}");
            }
        }
    }

    /// Reflection is chosen with the probability of the reflectance.
    #[test]
    fn reflection_probability_is_the_reflectance() {
        for (cos_i, eta) in [(1.0, 1.0 / 1.5), (0.2, 1.0 / 1.5), (0.8, 1.53), (0.3, 1.53), (1e-6, 1.0 / 1.3)]
        {
            let facet = facet(cos_i, eta);
            let n = 100_000;
            let chosen = (0..n).filter(|&i| facet.reflects((i as f32 + 0.5) / n as f32)).count();
            assert!((chosen as f32 / n as f32 - facet.reflectance()).abs() < 2e-5, "{cos_i} {eta}");
        }
    }

    #[test]
    fn refraction_obeys_snell_and_keeps_unit_length() {
        let m = Vec3::new(0.1, -0.05, 1.0).normalize();
        let wi = Vec3::new(-0.5, 0.2, 0.7).normalize();
        let eta = 1.0 / 1.53;
        let cos_i = wi.dot(m);
        let facet = facet(cos_i, eta);
        let eta = eta as f32;
        let wt = refract(wi, m, cos_i, facet.cos_t, eta);
        assert!((wt.length() - 1.0).abs() < 1e-6);
        assert!((wt.cross(m) + wi.cross(m) * eta).length() < 1e-6);
        assert!((reflect(wi, m, cos_i).dot(m) - cos_i).abs() < 1e-6);
    }
}
