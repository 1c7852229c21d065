//! Options of fits that several verbs share.

use clap::{Args, ValueEnum};
use farm_lab::set_up::SetUp;
use optics_model::fit::{FitSettings, MuRange, Objective, PhaseModel, Wavelet};
use serde::Deserialize;

use super::bounds::BoundsArg;
use super::set_up::SetUpArgs;

/// The options of all fits to a dictionary, on the command line and of the page.
#[derive(Debug, Args, Deserialize)]
#[serde(default)]
pub(crate) struct OptionArgs {
    /// Dictionary to search [default: lab, else the only one but paper].
    #[arg(long, value_name = "NAME")]
    pub(crate) dictionary: Option<String>,
    /// Only this anisotropy, or a range such as 0.2..0.6 [default: any].
    #[arg(long, value_name = "RANGE", allow_hyphen_values = true, help_heading = MEDIUM)]
    pub(crate) g: Option<BoundsArg>,
    /// Only this extinction coefficient in 1/mm, or a range such as 4..8 [default: any].
    #[arg(long, value_name = "RANGE", allow_hyphen_values = true, help_heading = MEDIUM)]
    pub(crate) sigma_t: Option<BoundsArg>,
    /// Only this albedo, or a range such as 0.9.. [default: any].
    #[arg(long, value_name = "RANGE", allow_hyphen_values = true, help_heading = MEDIUM)]
    pub(crate) albedo: Option<BoundsArg>,
    /// Objective to minimise [default: likelihood].
    #[arg(long, value_enum, help_heading = OBJECTIVE)]
    pub(crate) objective: Option<ObjectiveArg>,
    /// Phase function of the medium.
    #[arg(long, value_enum, default_value_t = PhaseArg::TwoLobes, help_heading = OBJECTIVE)]
    pub(crate) phase: PhaseArg,
    /// Weight of the profiles' gradients in the paper's distance.
    #[arg(long, default_value_t = 20.0, allow_negative_numbers = true, help_heading = OBJECTIVE)]
    pub(crate) lambda: f64,
    /// Wavelet used to take the gradients.
    #[arg(long, value_enum, default_value_t = WaveletArg::Spline, help_heading = OBJECTIVE)]
    pub(crate) wavelet: WaveletArg,
    /// Level of the wavelet: gradients are smoothed over about 2^LEVEL pixels.
    #[arg(long, default_value_t = 4, help_heading = OBJECTIVE)]
    pub(crate) level: u32,
    #[command(flatten)]
    #[serde(flatten)]
    pub(crate) set_up: SetUpArgs,
}

/// Headings of the help.
const MEDIUM: &str = "Bounds of the medium";
pub(super) const OBJECTIVE: &str = "Objective of the fit";
pub(super) const SEARCH: &str = "Search of the scale factor";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum ObjectiveArg {
    /// Least distance after Eq. 1 of the paper, as if the set-up were perfect but for the scale factor.
    Paper,
    /// Maximum likelihood, with the errors of the set-up estimated as nuisances.
    Likelihood,
}

impl From<ObjectiveArg> for Objective {
    fn from(arg: ObjectiveArg) -> Self {
        match arg {
            ObjectiveArg::Paper => Self::Paper,
            ObjectiveArg::Likelihood => Self::Likelihood,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum PhaseArg {
    /// Two-term Henyey–Greenstein: all channels of a material share the weight of the second lobe, which is estimated
    /// if the dictionary's scene has one of uncertain weight, as `lab` has.
    TwoLobes,
    /// The same, with a weight for each channel.
    PerChannel,
    /// Henyey–Greenstein: the weight of the second lobe is 0.
    Hg,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum WaveletArg {
    /// The quadratic spline.
    Spline,
    /// The Haar wavelet.
    Haar,
}

impl Default for OptionArgs {
    fn default() -> Self {
        let FitSettings { lambda, level, .. } = FitSettings::default();
        Self {
            dictionary: None,
            g: None,
            sigma_t: None,
            albedo: None,
            objective: None,
            phase: PhaseArg::TwoLobes,
            lambda,
            wavelet: WaveletArg::Spline,
            level,
            set_up: SetUpArgs::default(),
        }
    }
}

impl OptionArgs {
    /// The settings of the fit; `set_up` combines the arguments with the session file.
    pub(crate) fn settings(&self, set_up: &SetUp) -> optics_model::Result<FitSettings> {
        let settings = FitSettings {
            lambda: self.lambda,
            wavelet: match self.wavelet {
                WaveletArg::Spline => Wavelet::QuadraticSpline,
                WaveletArg::Haar => Wavelet::Haar,
            },
            phase: match self.phase {
                PhaseArg::TwoLobes => PhaseModel::TwoLobes,
                PhaseArg::PerChannel => PhaseModel::PerChannel,
                PhaseArg::Hg => PhaseModel::HenyeyGreenstein,
            },
            level: self.level,
            objective: self.objective.map(Into::into),
            sigma_t_per_mm: BoundsArg::check(self.sigma_t, "sigma_t_per_mm")?,
            albedo: BoundsArg::check(self.albedo, "albedo")?,
            g: BoundsArg::check(self.g, "g")?,
            ..FitSettings::default()
        };
        Ok(set_up.settings(settings))
    }
}

/// Scale factors to search.
#[derive(Debug, Args)]
#[expect(clippy::struct_field_names, reason = "they are the options' names")]
pub(crate) struct MuArgs {
    /// Smallest scale factor to try.
    #[arg(long, value_name = "MU", default_value_t = 0.8, allow_negative_numbers = true, help_heading = SEARCH)]
    pub(crate) mu_min: f64,
    /// Largest scale factor to try.
    #[arg(long, value_name = "MU", default_value_t = 1.1, allow_negative_numbers = true, help_heading = SEARCH)]
    pub(crate) mu_max: f64,
    /// Step from one scale factor to the next.
    #[arg(long, value_name = "STEP", default_value_t = 0.001, allow_negative_numbers = true, help_heading = SEARCH)]
    pub(crate) mu_step: f64,
}

impl Default for MuArgs {
    fn default() -> Self {
        Self { mu_min: 0.8, mu_max: 1.1, mu_step: 0.001 }
    }
}

impl MuArgs {
    pub(crate) fn range(&self) -> optics_model::Result<MuRange> {
        MuRange::new(self.mu_min, self.mu_max, self.mu_step)
    }
}
