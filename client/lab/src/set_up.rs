//! Combines the quantities of a set-up. A profile's values in the measurement take precedence over the command line, and
//! this over the session file. For other quantities defaults are used, and reported as assumed.

mod assumed;
mod of_channel;
mod session;

use std::path::Path;

use anyhow::Result;
use optics_model::Measurement;
use optics_model::fit::FitSettings;
use optics_model::measurement::{MeasuredProfile, ProfileSetup};
use optics_model::quantities::Form;

pub use assumed::Assumed;
pub use session::{ByChannel, Session};

/// The combined values of command line and session file.
#[derive(Debug, Default)]
pub struct SetUp {
    values: Session,
}

impl SetUp {
    /// Reads the session file, if there is one. The values of the command line take precedence over it.
    pub fn new(file: Option<&Path>, given: Session) -> Result<Self> {
        let session = file.map(Session::read).transpose()?.unwrap_or_default();
        Ok(Self { values: given.or(session) })
    }

    /// These values; where there is none, those settings that differ from the defaults, since they were given.
    #[must_use]
    pub fn with_given(mut self, settings: &FitSettings) -> Self {
        for ((quantity, own), (_, value)) in self.values.values_mut().zip(settings.set_up()) {
            if own.is_none() && value != quantity.default {
                *own = Some(ByChannel::All(value));
            }
        }
        self
    }

    /// Standard error of the scale factor, if the session has one for its white reference.
    pub fn mu_std_error(&self) -> Option<f64> {
        self.values.mu_std_error
    }

    /// The settings with the values that all profiles share.
    pub fn settings(&self, mut settings: FitSettings) -> FitSettings {
        for ((_, value), (_, given)) in settings.set_up_mut().zip(self.values.values()) {
            *value = given.and_then(ByChannel::common).unwrap_or(*value);
        }
        settings.measured = self.values.measured;
        settings
    }

    /// The measurements, with the values of their channels where their file contains none.
    pub fn apply_to(&self, materials: Vec<Measurement>) -> Result<Vec<Measurement>> {
        if !self.values.values().any(|(_, given)| matches!(given, Some(ByChannel::Named(_)))) {
            return Ok(materials);
        }
        let with_profiles = |m: Measurement| {
            let profiles = m.profiles().iter().map(|p| p.clone().with_setup(self.of(p)));
            Ok(Measurement::new(m.material(), profiles.collect::<Result<_, _>>()?)?)
        };
        materials.into_iter().map(with_profiles).collect()
    }

    /// The set-up of a profile, with the values of its channel.
    fn of(&self, profile: &MeasuredProfile) -> ProfileSetup {
        let given = self.of_channel(|given| given.of(profile.channel()));
        let mut setup = *profile.setup();
        for ((_, value), (_, of_channel)) in setup.values_mut().zip(given.values()) {
            *value = value.or(of_channel);
        }
        setup
    }

    /// The set-up of a channel's profiles, as far as a session may give it for each channel.
    fn of_channel(&self, pick: impl Fn(&ByChannel) -> Option<f64>) -> ProfileSetup {
        let mut setup = ProfileSetup::default();
        for (quantity, value) in setup.values_mut().filter(|(q, _)| q.form == Form::PerChannel) {
            let given = self.values.values().find(|(other, _)| other.name == quantity.name);
            *value = given.and_then(|(_, given)| given).and_then(&pick);
        }
        setup
    }

    /// The quantities of these measurements for which defaults are used.
    pub fn assumed(&self, materials: &[Measurement]) -> Assumed {
        let setups = materials.iter().flat_map(Measurement::profiles).map(|p| self.of(p));
        Assumed::of(&self.values, &setups.collect::<Vec<_>>())
    }
}

#[cfg(test)]
mod tests;
