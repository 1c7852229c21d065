//! Quantities of a set-up. A profile's own values in the measurement win over the command line, and this over the
//! session file. For the rest defaults are used, and reported as assumed.

mod assumed;
mod of_channel;
mod session;

use std::path::Path;

use anyhow::Result;
use optics_model::Measurement;
use optics_model::fit::FitSettings;
use optics_model::measurement::{MeasuredProfile, ProfileSetup};

pub use assumed::Assumed;
pub use session::{ByChannel, Session};

/// The values of command line and session file together.
#[derive(Debug, Default)]
pub struct SetUp {
    values: Session,
}

impl SetUp {
    /// Reads the session file, if there is one. What the command line gives goes before it.
    pub fn new(file: Option<&Path>, given: Session) -> Result<Self> {
        let session = file.map(Session::read).transpose()?.unwrap_or_default();
        let values = Session {
            gain_std_error: given.gain_std_error.or(session.gain_std_error),
            mu_std_error: given.mu_std_error.or(session.mu_std_error),
            offset_std_error: given.offset_std_error.or(session.offset_std_error),
            slope_std_error: given.slope_std_error.or(session.slope_std_error),
            thickness_std_error_mm: given.thickness_std_error_mm.or(session.thickness_std_error_mm),
            origin_std_error_mm: given.origin_std_error_mm.or(session.origin_std_error_mm),
            blur_mm: given.blur_mm.or(session.blur_mm),
            blur_std_error_mm: given.blur_std_error_mm.or(session.blur_std_error_mm),
        };
        Ok(Self { values })
    }

    /// Standard error of the scale factor, if the session has one for its white reference.
    pub fn mu_std_error(&self) -> Option<f64> {
        self.values.mu_std_error
    }

    /// The settings with the values that hold for all profiles.
    pub fn settings(&self, settings: FitSettings) -> FitSettings {
        let values = &self.values;
        let common = |by_channel: &Option<ByChannel>, otherwise: f64| {
            by_channel.as_ref().and_then(ByChannel::common).unwrap_or(otherwise)
        };
        FitSettings {
            gain_std_error: values.gain_std_error.unwrap_or(settings.gain_std_error),
            offset_std_error: values.offset_std_error.unwrap_or(settings.offset_std_error),
            slope_std_error: values.slope_std_error.unwrap_or(settings.slope_std_error),
            thickness_std_error_mm: values.thickness_std_error_mm.unwrap_or(settings.thickness_std_error_mm),
            origin_std_error_mm: values.origin_std_error_mm.unwrap_or(settings.origin_std_error_mm),
            blur_mm: common(&values.blur_mm, settings.blur_mm),
            blur_std_error_mm: common(&values.blur_std_error_mm, settings.blur_std_error_mm),
            ..settings
        }
    }

    /// The measurements, completed with the values of their channels that are not in their file.
    pub fn apply_to(&self, materials: Vec<Measurement>) -> Result<Vec<Measurement>> {
        let named = |v: &Option<ByChannel>| matches!(v, Some(ByChannel::Named(_)));
        if !named(&self.values.blur_mm) && !named(&self.values.blur_std_error_mm) {
            return Ok(materials);
        }
        let with_profiles = |m: Measurement| {
            let profiles = m.profiles().iter().map(|p| p.clone().with_setup(self.of(p)));
            Ok(Measurement::new(m.material(), profiles.collect::<Result<_, _>>()?)?)
        };
        materials.into_iter().map(with_profiles).collect()
    }

    /// The set-up of a profile, with the blur of its channel.
    fn of(&self, profile: &MeasuredProfile) -> ProfileSetup {
        let setup = *profile.setup();
        let of_channel = |v: &Option<ByChannel>| v.as_ref().and_then(|v| v.of(profile.channel()));
        ProfileSetup {
            blur_mm: setup.blur_mm.or_else(|| of_channel(&self.values.blur_mm)),
            blur_std_error_mm: setup.blur_std_error_mm.or_else(|| of_channel(&self.values.blur_std_error_mm)),
            ..setup
        }
    }

    /// The quantities of these measurements for which defaults are used.
    pub fn assumed(&self, materials: &[Measurement]) -> Assumed {
        let setups = materials.iter().flat_map(Measurement::profiles).map(|p| self.of(p));
        Assumed::of(&self.values, &setups.collect::<Vec<_>>())
    }
}

#[cfg(test)]
mod tests;
