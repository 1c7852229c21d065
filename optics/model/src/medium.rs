//! Optical parameters of the sample.

use serde::Serialize;

use crate::invalid::{Result, check};
use crate::phase::check_g;

/// Refuses a value that is not a usable extinction coefficient, in 1/mm.
pub fn check_sigma_t(value: f64) -> Result<f64> {
    check("sigma_t_per_mm", value, |v| (1e-6..=1e6).contains(&v), "allowed are 1e-6 to 1e6 per mm")
}

/// Refuses a value that is not a single-scattering albedo.
pub fn check_albedo(value: f64) -> Result<f64> {
    check("albedo", value, |v| (0.0..=1.0).contains(&v), "allowed are 0 to 1")
}

/// Refuses a value that is not a usable slab thickness, in mm.
pub fn check_thickness(value: f64) -> Result<f64> {
    check("thickness_mm", value, |v| (1e-4..=1e3).contains(&v), "allowed are 1e-4 to 1000 mm")
}

/// Largest optical thickness σ_t · t of a sample: beyond it single steps would be lost in the rounding of positions.
pub const MAX_OPTICAL_THICKNESS: f64 = 1e4;

/// Refuses a slab that is optically too thick.
pub fn check_optical_thickness(sigma_t_per_mm: f64, thickness_mm: f64) -> Result<f64> {
    let allowed = "allowed is an optical thickness up to 10000";
    check(
        "sigma_t_per_mm × thickness_mm",
        sigma_t_per_mm * thickness_mm,
        |v| v <= MAX_OPTICAL_THICKNESS,
        allowed,
    )
}

/// Refuses a value that is not the refractive index of a dielectric.
pub fn check_ior(field: &str, value: f64) -> Result<f64> {
    check(field, value, |v| (1.0..=4.0).contains(&v), "allowed are 1 to 4")
}

/// A homogeneous scattering medium: extinction σ_t in 1/mm, single-scattering albedo α, mean cosine g of the phase
/// function, whose shape is the scene's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Medium {
    sigma_t_per_mm: f64,
    albedo: f64,
    g: f64,
}

impl Medium {
    pub fn new(sigma_t_per_mm: f64, albedo: f64, g: f64) -> Result<Self> {
        Ok(Self {
            sigma_t_per_mm: check_sigma_t(sigma_t_per_mm)?,
            albedo: check_albedo(albedo)?,
            g: check_g(g)?,
        })
    }

    pub fn sigma_t_per_mm(&self) -> f64 {
        self.sigma_t_per_mm
    }

    pub fn albedo(&self) -> f64 {
        self.albedo
    }

    pub fn g(&self) -> f64 {
        self.g
    }

    /// Reduced scattering coefficient σ_s (1 − g): equal for similar media, as is [`Self::absorption_per_mm`].
    pub fn reduced_scattering_per_mm(&self) -> f64 {
        self.sigma_t_per_mm * self.albedo * (1.0 - self.g)
    }

    /// Absorption coefficient σ_a = σ_t (1 − α).
    pub fn absorption_per_mm(&self) -> f64 {
        self.sigma_t_per_mm * (1.0 - self.albedo)
    }
}

/// The parameters that one set of random walks depends on: all those of a sample but its albedo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TransportPoint {
    sigma_t_per_mm: f64,
    g: f64,
    thickness_mm: f64,
    sample_ior: f64,
}

/// The parameters of a slab that its walks depend on, with lengths in mean free paths. Points with the same parameters
/// share their walks: only lengths in mm differ.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct WalkedSlab {
    /// In the precision of walks.
    pub optical_thickness: f32,
    pub g: f64,
    pub ior: f64,
}

impl TransportPoint {
    pub fn new(sigma_t_per_mm: f64, g: f64, thickness_mm: f64, sample_ior: f64) -> Result<Self> {
        let point = Self {
            sigma_t_per_mm: check_sigma_t(sigma_t_per_mm)?,
            g: check_g(g)?,
            thickness_mm: check_thickness(thickness_mm)?,
            sample_ior: check_ior("sample_ior", sample_ior)?,
        };
        check_optical_thickness(sigma_t_per_mm, thickness_mm)?;
        Ok(point)
    }

    pub fn sigma_t_per_mm(&self) -> f64 {
        self.sigma_t_per_mm
    }

    pub fn g(&self) -> f64 {
        self.g
    }

    pub fn thickness_mm(&self) -> f64 {
        self.thickness_mm
    }

    pub fn sample_ior(&self) -> f64 {
        self.sample_ior
    }

    /// Optical thickness σ_t · t.
    pub fn optical_thickness(&self) -> f64 {
        self.sigma_t_per_mm * self.thickness_mm
    }

    pub fn walked_slab(&self) -> WalkedSlab {
        WalkedSlab { optical_thickness: self.optical_thickness() as f32, g: self.g, ior: self.sample_ior }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The message contains field, value and range.
    #[test]
    fn out_of_range_parameters_are_refused() {
        for (medium, field, given) in [
            (Medium::new(0.0, 0.5, 0.0), "sigma_t_per_mm", "0"),
            (Medium::new(f64::NAN, 0.5, 0.0), "sigma_t_per_mm", "NaN"),
            (Medium::new(1.0, 1.2, 0.0), "albedo", "1.2"),
            (Medium::new(1.0, 0.5, 1.0), "g", "1"),
        ] {
            let error = medium.unwrap_err();
            assert_eq!(error.field(), field);
            assert!(error.to_string().contains(&format!("{field} = {given} ")), "{error}");
            assert!(error.to_string().contains("allowed are"), "{error}");
        }
        let thick = TransportPoint::new(1e4, 0.0, 2.0, 1.53).unwrap_err();
        assert_eq!(thick.field(), "sigma_t_per_mm × thickness_mm");
        let negative = TransportPoint::new(1.0, 0.0, -0.5, 1.53).unwrap_err();
        assert_eq!(negative.to_string(), "thickness_mm = -0.5 is not valid: allowed are 1e-4 to 1000 mm");
    }
}
