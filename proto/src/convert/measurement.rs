//! Converts measurements, and checks their number of pixels.

use crate::wire;
use optics_model::invalid::{Invalid, Result, each};
use optics_model::limits::FitLimits;
use optics_model::measurement::{MeasuredProfile, Measurement, ProfileSetup};
use optics_model::with_quantities;

macro_rules! profiles {
    ($($name:ident $row:tt)+) => {
        impl From<&MeasuredProfile> for wire::MeasuredProfile {
            fn from(profile: &MeasuredProfile) -> Self {
                Self {
                    channel: profile.channel().to_owned(),
                    thickness_mm: profile.thickness_mm(),
                    x_mm: profile.x_mm().to_vec(),
                    values: profile.values().to_vec(),
                    std_errors: profile.std_errors().unwrap_or_default().to_vec(),
                    $($name: profile.setup().$name,)+
                }
            }
        }

        impl TryFrom<wire::MeasuredProfile> for MeasuredProfile {
            type Error = Invalid;

            fn try_from(p: wire::MeasuredProfile) -> Result<Self> {
                let std_errors = (!p.std_errors.is_empty()).then_some(p.std_errors);
                Self::new(p.channel, p.thickness_mm, p.x_mm, p.values, std_errors)?
                    .with_setup(ProfileSetup { $($name: p.$name),+ })
            }
        }
    };
}

with_quantities!(profiles profiles);

impl From<&Measurement> for wire::Measurement {
    fn from(measurement: &Measurement) -> Self {
        let profiles = measurement.profiles().iter().map(Into::into).collect();
        Self { material: measurement.material().to_owned(), profiles }
    }
}

impl TryFrom<wire::Measurement> for Measurement {
    type Error = Invalid;

    fn try_from(measurement: wire::Measurement) -> Result<Self> {
        Self::new(measurement.material, each("profiles", measurement.profiles, TryInto::try_into)?)
    }
}

/// Refuses a question with more pixels than `most`, in all its profiles together.
pub fn check_pixels(field: &str, materials: &[wire::Measurement], most: usize) -> Result<()> {
    let profiles = materials.iter().flat_map(|m| &m.profiles);
    let pixels: usize = profiles.map(|p| p.x_mm.len().max(p.values.len()).max(p.std_errors.len())).sum();
    if pixels > most {
        let allowed =
            format!("a coordinator accepts at most {most} in one request; {}", FitLimits::MANY_PIXELS_ADVICE);
        return Err(Invalid::new(field, format_args!("{pixels} pixels"), allowed));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_counted_over_all_profiles() {
        let one = wire::Measurement::from(&measurement(ProfileSetup::default()));
        let both = [one.clone(), one];
        assert!(check_pixels("materials", &both, 16).is_ok());
        let refused = check_pixels("materials", &both, 15).unwrap_err().to_string();
        assert!(
            refused.starts_with("materials = 16 pixels is not valid: a coordinator accepts at most 15"),
            "{refused}"
        );
    }

    fn measurement(setup: ProfileSetup) -> Measurement {
        let x: Vec<f64> = (0..8).map(f64::from).collect();
        let profile = MeasuredProfile::new("R", 0.5, x.clone(), x, None).unwrap();
        Measurement::new("white", vec![profile.with_setup(setup).unwrap()]).unwrap()
    }

    /// The set-up of a profile is unchanged after conversion.
    #[test]
    fn set_up_round_trips() {
        let mut setup = ProfileSetup::default();
        for (i, (_, value)) in setup.values_mut().enumerate() {
            *value = Some(0.01 * (i as f64 + 1.0));
        }
        for setup in [setup, ProfileSetup::default(), ProfileSetup { origin_mm: Some(0.0), ..setup }] {
            let there = measurement(setup);
            assert_eq!(Measurement::try_from(wire::Measurement::from(&there)).unwrap(), there);
        }
    }

    /// A set-up out of range is refused with its field.
    #[test]
    fn set_up_out_of_range_is_refused() {
        let mut message = wire::Measurement::from(&measurement(ProfileSetup::default()));
        message.profiles[0].blur_mm = Some(-0.1);
        let refused = Measurement::try_from(message).unwrap_err();
        assert_eq!(refused.field(), "profiles[0].blur_mm");
    }
}
