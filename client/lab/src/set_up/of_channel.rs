//! Set-up quantities of one channel, for photographs that are not taken yet.

use anyhow::{Result, bail};
use optics_model::fit::FitSettings;
use optics_model::measurement::ProfileSetup;

use super::session::ByChannel;
use super::{Assumed, SetUp};

impl SetUp {
    /// The settings with the values of a channel.
    pub fn settings_of(&self, settings: FitSettings, channel: Option<&str>) -> Result<FitSettings> {
        let settings = self.settings(settings);
        let blur_mm = blur_of(self.values.blur_mm.as_ref(), channel)?;
        let blur_std_error_mm = blur_of(self.values.blur_std_error_mm.as_ref(), channel)?;
        Ok(FitSettings {
            blur_mm: blur_mm.unwrap_or(settings.blur_mm),
            blur_std_error_mm: blur_std_error_mm.unwrap_or(settings.blur_std_error_mm),
            ..settings
        })
    }

    /// The quantities of a channel for which defaults are used.
    pub fn assumed_of(&self, channel: Option<&str>) -> Assumed {
        let of = |values: &Option<ByChannel>| {
            values
                .as_ref()
                .and_then(|values| channel.map_or_else(|| values.common(), |channel| values.of(channel)))
        };
        let setup = ProfileSetup {
            blur_mm: of(&self.values.blur_mm),
            blur_std_error_mm: of(&self.values.blur_std_error_mm),
            ..ProfileSetup::default()
        };
        Assumed::of(&self.values, &[setup])
    }
}

fn blur_of(values: Option<&ByChannel>, channel: Option<&str>) -> Result<Option<f64>> {
    match (values, channel) {
        (Some(ByChannel::Named(_)), None) => {
            bail!("the session file gives a blur for each channel: name one with --channel")
        }
        (Some(values), Some(channel)) => Ok(values.of(channel)),
        (values, None) => Ok(values.and_then(ByChannel::common)),
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
        let values = Session { blur_mm: named(0.02, 0.03), ..Session::default() };
        let set_up = SetUp { values };
        let of = |channel| set_up.settings_of(FitSettings::default(), channel);
        assert_eq!(of(Some("G")).unwrap().blur_mm, 0.03);
        // A channel that is not in the session has the default.
        assert_eq!(of(Some("IR")).unwrap().blur_mm, FitSettings::default().blur_mm);
        assert!(of(None).unwrap_err().to_string().ends_with("name one with --channel"));
        assert!(set_up.assumed_of(Some("G")).names().contains(&"blur_std_error_mm"));
        let values = Session { blur_std_error_mm: Some(ByChannel::All(0.001)), ..Session::default() };
        let set_up = SetUp { values };
        assert_eq!(set_up.settings_of(FitSettings::default(), None).unwrap().blur_std_error_mm, 0.001);
        assert!(!set_up.assumed_of(None).names().contains(&"blur_std_error_mm"));
    }
}
