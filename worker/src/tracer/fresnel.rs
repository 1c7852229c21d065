//! Smooth dielectric interfaces: unpolarised Fresnel reflectance and Snell refraction.

use glam::Vec3;

/// What a ray does at a (micro)facet.
#[derive(Debug, Clone, Copy)]
pub struct Facet {
    /// Reflectance, 1 under total internal reflection.
    pub reflectance: f32,
    /// Cosine of the angle of refraction; 0 under total internal reflection.
    pub cos_t: f32,
}

impl Facet {
    /// `eta` is the index on the incident side over that on the other; `cos_i` and `sin2_i` belong to the
    /// angle of incidence. They are given separately since one cannot be had from the other near
    /// normal incidence without loss.
    ///
    /// R = (r_s² + r_p²)/2, r_s = (η cos i − cos t)/(η cos i + cos t), r_p = (cos i − η cos t)/(cos i + η cos t).
    pub fn new(cos_i: f32, sin2_i: f32, eta: f32) -> Self {
        let cos2_t = 1.0 - eta * eta * sin2_i;
        if cos2_t <= 0.0 {
            return Self { reflectance: 1.0, cos_t: 0.0 };
        }
        let cos_t = cos2_t.sqrt();
        let s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
        let p = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
        Self { reflectance: 0.5 * (s * s + p * p), cos_t }
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

    #[test]
    fn normal_incidence_and_brewster_angle() {
        let normal = Facet::new(1.0, 0.0, 1.0 / 1.5);
        assert!((normal.reflectance - 0.04).abs() < 1e-6);
        // At Brewster's angle only half of r_s² is left.
        let brewster = 1.5_f32.atan();
        let facet = Facet::new(brewster.cos(), brewster.sin().powi(2), 1.0 / 1.5);
        let s = (1.0 - 1.5_f32 * 1.5) / (1.0 + 1.5 * 1.5);
        assert!((facet.reflectance - 0.5 * s * s).abs() < 1e-6);
    }

    /// R + T = 1 for the amplitudes: T = (n_t cos t / n_i cos i) (t_s² + t_p²)/2.
    #[test]
    fn reflectance_and_transmittance_add_up_to_one() {
        for eta in [1.0 / 1.53, 1.53, 1.33 / 1.49] {
            for i in 1..1000 {
                let cos_i = i as f32 / 1000.0;
                let facet = Facet::new(cos_i, 1.0 - cos_i * cos_i, eta);
                if facet.cos_t == 0.0 {
                    assert_eq!(facet.reflectance, 1.0);
                    continue;
                }
                let t_s = 2.0 * eta * cos_i / (eta * cos_i + facet.cos_t);
                let t_p = 2.0 * eta * cos_i / (cos_i + eta * facet.cos_t);
                let transmittance = facet.cos_t / (eta * cos_i) * 0.5 * (t_s * t_s + t_p * t_p);
                assert!((facet.reflectance + transmittance - 1.0).abs() < 3e-6, "eta {eta} cos {cos_i}");
            }
        }
    }

    #[test]
    fn refraction_obeys_snell_and_keeps_unit_length() {
        let m = Vec3::new(0.1, -0.05, 1.0).normalize();
        let wi = Vec3::new(-0.5, 0.2, 0.7).normalize();
        let eta = 1.0 / 1.53;
        let cos_i = wi.dot(m);
        let facet = Facet::new(cos_i, 1.0 - cos_i * cos_i, eta);
        let wt = refract(wi, m, cos_i, facet.cos_t, eta);
        assert!((wt.length() - 1.0).abs() < 1e-6);
        assert!((wt.cross(m) + wi.cross(m) * eta).length() < 1e-6);
        assert!((reflect(wi, m, cos_i).dot(m) - cos_i).abs() < 1e-6);
    }
}
