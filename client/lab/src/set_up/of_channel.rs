//! What is known of the set-up of photographs that are not made yet.

use anyhow::{Result, bail};
use optics_model::fit::FitSettings;
use optics_model::measurement::ProfileSetup;

use super::session::ByChannel;
use super::{Assumed, SetUp};

impl SetUp {
    /// The settings with what is told of a channel.
    pub fn settings_of(&self, settings: FitSettings, channel: Option<&str>) -> Result<FitSettings> {
        let settings = self.settings(settings);
        let blur_mm = blur_of(self.told.blur_mm.as_ref(), channel)?;
        let blur_std_error_mm = blur_of(self.told.blur_std_error_mm.as_ref(), channel)?;
        Ok(FitSettings {
            blur_mm: blur_mm.unwrap_or(settings.blur_mm),
            blur_std_error_mm: blur_std_error_mm.unwrap_or(settings.blur_std_error_mm),
            ..settings
        })
    }

    /// What nobody told of a channel's photographs to come.
    pub fn assumed_of(&self, channel: Option<&str>) -> Assumed {
        let of = |told: &Option<ByChannel>| {
            told.as_ref().and_then(|told| channel.map_or_else(|| told.common(), |channel| told.of(channel)))
        };
        let setup = ProfileSetup {
            blur_mm: of(&self.told.blur_mm),
            blur_std_error_mm: of(&self.told.blur_std_error_mm),
            ..ProfileSetup::default()
        };
        Assumed::of(&self.told, &[setup])
    }
}

fn blur_of(told: Option<&ByChannel>, channel: Option<&str>) -> Result<Option<f64>> {
    match (told, channel) {
        (Some(ByChannel::Named(_)), None) => {
            bail!("the session file tells the blur of each channel: name one with --channel")
        }
        (Some(told), Some(channel)) => Ok(told.of(channel)),
        (told, None) => Ok(told.and_then(ByChannel::common)),
        (None, Some(_)) => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::set_up::session::Session;

    #[test]
    fn a_session_tells_the_blur_of_the_channel_that_is_photographed() {
        let named = |r: f64, g: f64| Some(ByChannel::Named(vec![("R".into(), r), ("G".into(), g)]));
        let told = Session { blur_mm: named(0.02, 0.03), ..Session::default() };
        let set_up = SetUp { told };
        let of = |channel| set_up.settings_of(FitSettings::default(), channel);
        assert_eq!(of(Some("G")).unwrap().blur_mm, 0.03);
        // A channel that the session does not know has the default.
        assert_eq!(of(Some("IR")).unwrap().blur_mm, FitSettings::default().blur_mm);
        assert!(of(None).unwrap_err().to_string().ends_with("name one with --channel"));
        assert!(set_up.assumed_of(Some("G")).names().contains(&"blur_std_error_mm"));
        let told = Session { blur_std_error_mm: Some(ByChannel::All(0.001)), ..Session::default() };
        let set_up = SetUp { told };
        assert_eq!(set_up.settings_of(FitSettings::default(), None).unwrap().blur_std_error_mm, 0.001);
        assert!(!set_up.assumed_of(None).names().contains(&"blur_std_error_mm"));
    }
}
