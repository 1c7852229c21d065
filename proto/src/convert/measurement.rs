//! Measurements.

use crate::wire;
use optics_model::invalid::{Invalid, Result, each};
use optics_model::measurement::{MeasuredProfile, Measurement};

impl From<&Measurement> for wire::Measurement {
    fn from(measurement: &Measurement) -> Self {
        let profile = |p: &MeasuredProfile| wire::MeasuredProfile {
            channel: p.channel().to_owned(),
            thickness_mm: p.thickness_mm(),
            x_mm: p.x_mm().to_vec(),
            values: p.values().to_vec(),
            std_errors: p.std_errors().unwrap_or_default().to_vec(),
        };
        Self {
            material: measurement.material().to_owned(),
            profiles: measurement.profiles().iter().map(profile).collect(),
        }
    }
}

impl TryFrom<wire::Measurement> for Measurement {
    type Error = Invalid;

    fn try_from(measurement: wire::Measurement) -> Result<Self> {
        let profiles = each("profiles", measurement.profiles, |p| {
            let std_errors = (!p.std_errors.is_empty()).then_some(p.std_errors);
            MeasuredProfile::new(p.channel, p.thickness_mm, p.x_mm, p.values, std_errors)
        })?;
        Self::new(measurement.material, profiles)
    }
}
