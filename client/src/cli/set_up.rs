//! Arguments for the quantities of a set-up.

use std::path::{Path, PathBuf};

use clap::Args;

use farm_lab::set_up::{ByChannel, Session, SetUp};

/// Heading of the help.
pub(super) const SET_UP: &str = "What is known of the set-up";

/// Quantities of a set-up. Values of single profiles in the measurement take precedence.
#[derive(Debug, Default, Args)]
pub struct SetUpArgs {
    /// Take the values below from a session file (JSON) where they are not given here.
    #[arg(long, value_name = "FILE", help_heading = SET_UP)]
    pub session: Option<PathBuf>,
    /// Standard error of each profile's own gain (exposure, illumination), as a share [default: 0.003].
    #[arg(long, value_name = "ERROR", allow_negative_numbers = true, help_heading = SET_UP)]
    pub gain_std_error: Option<f64>,
    /// Standard error of each profile's zero (stray light, black level), as a radiance factor [default: 0.001].
    #[arg(long, value_name = "ERROR", allow_negative_numbers = true, help_heading = SET_UP)]
    pub offset_std_error: Option<f64>,
    /// Standard error of the light's rise across each profile, as a share per 10 mm [default: 0.002].
    #[arg(long, value_name = "ERROR", allow_negative_numbers = true, help_heading = SET_UP)]
    pub slope_std_error: Option<f64>,
    /// Standard error of the thickness of each slab [default: 0.005].
    #[arg(long, value_name = "MM", allow_negative_numbers = true, help_heading = SET_UP)]
    pub thickness_std_error_mm: Option<f64>,
    /// Standard error of the place of the edge in each profile [default: 0.05].
    #[arg(long, value_name = "MM", allow_negative_numbers = true, help_heading = SET_UP)]
    pub origin_std_error_mm: Option<f64>,
    /// Blur of the camera: standard deviation of a Gaussian in the plane of the sample [default: 0].
    #[arg(long, value_name = "MM", allow_negative_numbers = true, help_heading = SET_UP)]
    pub blur_mm: Option<f64>,
    /// Standard error of the blur [default: 0.03].
    #[arg(long, value_name = "MM", allow_negative_numbers = true, help_heading = SET_UP)]
    pub blur_std_error_mm: Option<f64>,
}

impl SetUpArgs {
    /// These values, and those of the session file where none is given here: of the one that is named, or else of
    /// `session`.
    pub(crate) fn read(&self, session: Option<&Path>) -> anyhow::Result<SetUp> {
        let given = Session {
            gain_std_error: self.gain_std_error,
            mu_std_error: None,
            offset_std_error: self.offset_std_error,
            slope_std_error: self.slope_std_error,
            thickness_std_error_mm: self.thickness_std_error_mm,
            origin_std_error_mm: self.origin_std_error_mm,
            blur_mm: self.blur_mm.map(ByChannel::All),
            blur_std_error_mm: self.blur_std_error_mm.map(ByChannel::All),
        };
        SetUp::new(self.session.as_deref().or(session), given)
    }
}
