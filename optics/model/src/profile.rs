//! Defines edge profiles and the records that hold them.

use crate::invalid::{Invalid, Result};

/// One number per pixel with its standard error, from the spread between batches of walks.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    values: Vec<f32>,
    std_errors: Vec<f32>,
}

impl Estimate {
    pub fn new(values: Vec<f32>, std_errors: Vec<f32>) -> Result<Self> {
        if values.len() != std_errors.len() {
            let given = format!("{} for {} values", std_errors.len(), values.len());
            return Err(Invalid::new("std_errors", given, "one per value is needed"));
        }
        if let Some(i) = values.iter().position(|v| !v.is_finite()) {
            return Err(Invalid::new(format!("values[{i}]"), values[i], "numbers must be finite"));
        }
        if let Some(i) = std_errors.iter().position(|v| !(v.is_finite() && *v >= 0.0)) {
            return Err(Invalid::new(format!("std_errors[{i}]"), std_errors[i], "finite and not negative"));
        }
        Ok(Self { values, std_errors })
    }

    pub fn values(&self) -> &[f32] {
        &self.values
    }

    pub fn std_errors(&self) -> &[f32] {
        &self.std_errors
    }

    pub fn into_parts(self) -> (Vec<f32>, Vec<f32>) {
        (self.values, self.std_errors)
    }
}

/// Exact derivatives of a radiance factor, from the same walks.
#[derive(Debug, Clone, PartialEq)]
pub struct Derivatives {
    /// ∂/∂α, per unit albedo.
    pub albedo: Estimate,
    /// ∂/∂σ_t at constant albedo, in mm.
    pub sigma_t: Estimate,
}

/// The edge profile of one channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Ratio to a perfect white Lambertian surface in air under the same light.
    pub radiance_factor: Estimate,
    pub derivatives: Option<Derivatives>,
}

impl Profile {
    /// The estimates in their fixed order: radiance factor, ∂/∂α, ∂/∂σ_t.
    pub fn estimates(&self) -> impl Iterator<Item = &Estimate> {
        let derivatives = self.derivatives.as_ref().map(|d| [&d.albedo, &d.sigma_t]);
        std::iter::once(&self.radiance_factor).chain(derivatives.into_iter().flatten())
    }
}

/// The profiles of one parameter combination, one per channel of the scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Number in the grid.
    pub index: usize,
    pub profiles: Vec<Profile>,
}

/// The shape that a grid prescribes for its records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordShape {
    pub channels: usize,
    pub pixels: usize,
    pub derivatives: bool,
}

impl RecordShape {
    /// Number of estimates of a channel.
    pub fn estimates(self) -> usize {
        if self.derivatives { 3 } else { 1 }
    }

    /// Refuses a record of another shape.
    pub fn check(&self, record: &Record) -> Result<()> {
        let found = |profile: &Profile| Self {
            channels: record.profiles.len(),
            pixels: profile.radiance_factor.values.len(),
            derivatives: profile.derivatives.is_some(),
        };
        let fits = record.profiles.len() == self.channels
            && record
                .profiles
                .iter()
                .all(|p| found(p) == *self && p.estimates().all(|e| e.values.len() == self.pixels));
        if fits {
            return Ok(());
        }
        let given = format!("{:?}", record.profiles.first().map(found));
        Err(Invalid::new(format!("record {}", record.index), given, format!("the grid asks for {self:?}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Estimates with NaN, negative errors or a missing error are refused.
    #[test]
    fn invalid_estimates_are_refused() {
        assert_eq!(Estimate::new(vec![0.1, f32::NAN], vec![0.0; 2]).unwrap_err().field(), "values[1]");
        assert_eq!(Estimate::new(vec![0.1], vec![-0.1]).unwrap_err().field(), "std_errors[0]");
        assert_eq!(Estimate::new(vec![0.1], vec![]).unwrap_err().field(), "std_errors");
    }
}
