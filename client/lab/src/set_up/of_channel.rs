//! Selects the set-up quantities of one channel, for future photographs.

use anyhow::{Result, bail};
use optics_model::fit::FitSettings;

use super::session::ByChannel;
use super::{Assumed, SetUp};

impl SetUp {
    /// The settings with the values of a channel.
    pub fn settings_of(&self, settings: FitSettings, channel: Option<&str>) -> Result<FitSettings> {
        let mut settings = self.settings(settings);
        for ((quantity, value), (_, given)) in settings.set_up_mut().zip(self.values.values()) {
            match (given, channel) {
                (Some(ByChannel::Named(_)), None) => {
                    bail!("the session file has {} for each channel: name one with --channel", quantity.name)
                }
                (Some(given), Some(channel)) => *value = given.of(channel).unwrap_or(*value),
                _ => {}
            }
        }
        Ok(settings)
    }

    /// The quantities of a channel's future photographs without a value.
    pub fn assumed_of(&self, channel: Option<&str>) -> Assumed {
        let pick = |given: &ByChannel| channel.map_or_else(|| given.common(), |channel| given.of(channel));
        Assumed::of(&self.values, &[self.of_channel(pick)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::set_up::session::Session;

    /// The blur is that of the session for the photographed channel, or the default.
    #[test]
    fn session_gives_the_blur_of_each_channel() {
        let named = |r: f64, g: f64| Some(ByChannel::Named(vec![("R".into(), r), ("G".into(), g)]));
        let values = Session { blur_mm: named(0.02, 0.03), ..Session::default() };
        let set_up = SetUp { values };
        let settings = |channel| set_up.settings_of(FitSettings::default(), channel);
        assert_eq!(settings(Some("G")).unwrap().blur_mm, 0.03);
        // A channel that is not in the session has the default.
        assert_eq!(settings(Some("IR")).unwrap().blur_mm, FitSettings::default().blur_mm);
        assert!(settings(None).unwrap_err().to_string().ends_with("name one with --channel"));
        assert!(set_up.assumed_of(Some("G")).names().contains(&"blur_std_error_mm"));
        let values = Session { blur_std_error_mm: Some(ByChannel::All(0.001)), ..Session::default() };
        let set_up = SetUp { values };
        assert_eq!(set_up.settings_of(FitSettings::default(), None).unwrap().blur_std_error_mm, 0.001);
        assert!(!set_up.assumed_of(None).names().contains(&"blur_std_error_mm"));
    }
}
