//! Arguments of the verbs that ask a dictionary.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use farm_lab::set_up::SetUp;
use optics_model::fit::{FitOptions, FitSettings, MuRange, Objective, Wavelet};

use super::bounds::BoundsArg;
use super::set_up::{SET_UP, SetUpArgs};

/// What all questions to a dictionary have in common.
#[derive(Debug, Args)]
pub struct OptionArgs {
    /// Dictionary to search [default: the only one, or paper].
    #[arg(long, value_name = "NAME")]
    pub dictionary: Option<String>,
    /// Only this anisotropy, or a range such as 0.2..0.6 [default: any].
    #[arg(long, value_name = "RANGE", allow_hyphen_values = true, help_heading = MEDIUM)]
    pub g: Option<BoundsArg>,
    /// Only this extinction coefficient in 1/mm, or a range such as 4..8 [default: any].
    #[arg(long, value_name = "RANGE", allow_hyphen_values = true, help_heading = MEDIUM)]
    pub sigma_t: Option<BoundsArg>,
    /// Only this albedo, or a range such as 0.9.. [default: any].
    #[arg(long, value_name = "RANGE", allow_hyphen_values = true, help_heading = MEDIUM)]
    pub albedo: Option<BoundsArg>,
    /// Objective to minimise [default: likelihood].
    #[arg(long, value_enum, help_heading = OBJECTIVE)]
    pub objective: Option<ObjectiveArg>,
    /// Weight of the profiles' gradients in the paper's distance.
    #[arg(long, default_value_t = 20.0, allow_negative_numbers = true, help_heading = OBJECTIVE)]
    pub lambda: f64,
    /// Wavelet used to take the gradients.
    #[arg(long, value_enum, default_value_t = WaveletArg::Spline, help_heading = OBJECTIVE)]
    pub wavelet: WaveletArg,
    /// Level of the wavelet: gradients are smoothed over about 2^LEVEL pixels.
    #[arg(long, default_value_t = 4, help_heading = OBJECTIVE)]
    pub level: u32,
    #[command(flatten)]
    pub set_up: SetUpArgs,
}

/// Headings of the help.
const MEDIUM: &str = "What is known of the medium";
const OBJECTIVE: &str = "Objective of the fit";
const SEARCH: &str = "Search of the scale factor";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ObjectiveArg {
    /// Least distance after Eq. 1 of the paper, as if the set-up were perfect but for the scale factor.
    Paper,
    /// Maximum likelihood, with the errors of the set-up estimated as nuisances.
    Likelihood,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum WaveletArg {
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
            lambda,
            wavelet: WaveletArg::Spline,
            level,
            set_up: SetUpArgs::default(),
        }
    }
}

impl OptionArgs {
    /// `set_up` combines its arguments with the session file.
    pub(crate) fn settings(&self, set_up: &SetUp) -> optics_model::Result<FitSettings> {
        let settings = FitSettings {
            lambda: self.lambda,
            wavelet: match self.wavelet {
                WaveletArg::Spline => Wavelet::QuadraticSpline,
                WaveletArg::Haar => Wavelet::Haar,
            },
            level: self.level,
            objective: self.objective.map(|objective| match objective {
                ObjectiveArg::Paper => Objective::Paper,
                ObjectiveArg::Likelihood => Objective::Likelihood,
            }),
            sigma_t_per_mm: BoundsArg::check(self.sigma_t, "sigma_t_per_mm")?,
            albedo: BoundsArg::check(self.albedo, "albedo")?,
            g: BoundsArg::check(self.g, "g")?,
            ..FitSettings::default()
        };
        Ok(set_up.settings(settings))
    }
}

#[derive(Debug, Args)]
pub struct FitArgs {
    /// CSV with columns material, channel, thickness_mm, x_mm, value and, if known, std_error and the set-up.
    pub measurement: PathBuf,
    #[command(flatten)]
    pub options: OptionArgs,
    /// Factor on the measured values, μ.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true, help_heading = SET_UP)]
    pub mu: f64,
    /// Standard error of that factor, which goes into the error bars.
    #[arg(long, value_name = "ERROR", default_value_t = 0.0, allow_negative_numbers = true, help_heading = SET_UP)]
    pub mu_std_error: f64,
    /// Number of best records to show per channel.
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub top: u32,
    /// Report only records of the dictionary: no optimum between them, no error bars.
    #[arg(long)]
    pub no_refine: bool,
    /// Compare the intervals with the Cramér–Rao bound: the least errors that these pixels allow.
    #[arg(long, conflicts_with = "no_refine")]
    pub bound: bool,
    /// Draw profiles and gradients with their fits, one figure per material: FILE.svg or FILE.png.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

impl FitArgs {
    pub(crate) fn options(&self, set_up: &SetUp) -> optics_model::Result<FitOptions> {
        FitOptions::new(FitSettings {
            mu: self.mu,
            mu_std_error: self.mu_std_error,
            top: self.top,
            refine: !self.no_refine,
            curves: self.plot.is_some(),
            ..self.options.settings(set_up)?
        })
    }
}

/// Scale factors to search.
#[derive(Debug, Args)]
pub struct MuArgs {
    /// Smallest scale factor to try.
    #[arg(long, value_name = "MU", default_value_t = 0.8, allow_negative_numbers = true, help_heading = SEARCH)]
    pub mu_min: f64,
    /// Largest scale factor to try.
    #[arg(long, value_name = "MU", default_value_t = 1.1, allow_negative_numbers = true, help_heading = SEARCH)]
    pub mu_max: f64,
    /// Step from one scale factor to the next.
    #[arg(long, value_name = "STEP", default_value_t = 0.001, allow_negative_numbers = true, help_heading = SEARCH)]
    pub mu_step: f64,
}

impl Default for MuArgs {
    fn default() -> Self {
        Self { mu_min: 0.8, mu_max: 1.1, mu_step: 0.001 }
    }
}

impl MuArgs {
    pub fn range(&self) -> optics_model::Result<MuRange> {
        MuRange::new(self.mu_min, self.mu_max, self.mu_step)
    }
}

#[derive(Debug, Args)]
pub struct ScaleArgs {
    /// CSV with the profiles of all materials of one set-up.
    pub measurements: PathBuf,
    #[command(flatten)]
    pub options: OptionArgs,
    #[command(flatten)]
    pub mu: MuArgs,
    /// Draw the error over the scale factor and over g: FILE.svg or FILE.png.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct MeasureArgs {
    /// CSV with the profiles of all materials of one set-up, or a folder that `farmctl capture` wrote: its white reference
    /// is then taken for the scale factor (--mu 1), its report completed, and its dictionary computed if it is not there.
    /// Without --dictionary, a farm on this machine that has none computes the paper's first, and goes on with one that
    /// was interrupted.
    pub measurements: PathBuf,
    #[command(flatten)]
    pub options: OptionArgs,
    /// Take this scale factor instead of searching for it.
    #[arg(
        long,
        value_name = "MU",
        allow_negative_numbers = true,
        conflicts_with_all = ["mu_min", "mu_max", "mu_step"],
        help_heading = SET_UP
    )]
    pub mu: Option<f64>,
    /// Standard error of that factor.
    #[arg(
        long,
        value_name = "ERROR",
        default_value_t = 0.0,
        allow_negative_numbers = true,
        requires = "mu",
        help_heading = SET_UP
    )]
    pub mu_std_error: f64,
    #[command(flatten)]
    pub search: MuArgs,
    /// TOML file with the mixtures and their volume fractions: strong absorbers are then determined
    /// from how they darken other materials.
    #[arg(long, value_name = "FILE")]
    pub mixtures: Option<PathBuf>,
    /// Let every channel have its own anisotropy; without this, and without --g, all share the best common one.
    #[arg(long, conflicts_with = "g")]
    pub free_g: bool,
    /// Compare the intervals with the Cramér–Rao bound: the least errors that these pixels allow.
    #[arg(long)]
    pub bound: bool,
    /// Write a folder with table.csv, media for Mitsuba 3 (media.py, media.xml) and pbrt-v4 (media.pbrt).
    #[arg(long, short, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Draw profiles and gradients with their fits, one figure per material: FILE.svg or FILE.png.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

impl MeasureArgs {
    /// All arguments but the measurements at their defaults.
    pub(crate) fn new(measurements: PathBuf) -> Self {
        Self {
            measurements,
            options: OptionArgs::default(),
            mu: None,
            mu_std_error: 0.0,
            search: MuArgs::default(),
            mixtures: None,
            free_g: false,
            bound: false,
            output: None,
            plot: None,
        }
    }
}

#[derive(Debug, Args)]
pub struct MapArgs {
    /// CSV with columns material, channel, thickness_mm, x_mm, value and, if known, std_error and the set-up.
    pub measurement: PathBuf,
    #[command(flatten)]
    pub options: OptionArgs,
    /// Factor on the measured values, μ.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true, help_heading = SET_UP)]
    pub mu: f64,
    /// Only this material [default: all].
    #[arg(long, value_name = "NAME")]
    pub material: Option<String>,
    /// Only this channel [default: all].
    #[arg(long, value_name = "NAME")]
    pub channel: Option<String>,
    /// Draw the maps, one picture per material and channel: FILE.svg or FILE.png.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct SimilarArgs {
    /// Extinction coefficient, per mm.
    #[arg(long, value_name = "PER_MM", allow_negative_numbers = true)]
    pub sigma_t: f64,
    /// Single-scattering albedo.
    #[arg(long, allow_negative_numbers = true)]
    pub albedo: f64,
    /// Anisotropy.
    #[arg(long, allow_negative_numbers = true)]
    pub g: f64,
    /// Anisotropies of the similar media, as in 0,0.4,0.8.
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        allow_negative_numbers = true,
        default_value = "0,0.1,0.2,0.3,0.4,0.45,0.5,0.55,0.6,0.7,0.8"
    )]
    pub to: Vec<f64>,
}
