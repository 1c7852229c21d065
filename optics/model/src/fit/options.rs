//! Settings of Eqs. 1 to 3.

use serde::Serialize;

use crate::invalid::{Invalid, Result, check};
use crate::limits::FitLimits;
use crate::measurement::ProfileSetup;
use crate::medium::{check_albedo, check_sigma_t};
use crate::phase::check_g;
use crate::quantities::Quantity;
use crate::scene::PriorKind;
use crate::with_quantities;

/// Wavelet whose smoothing function is differentiated for the gradients.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Wavelet {
    /// Low-pass √2 [1, 3, 3, 1]/8, high-pass √2 [−2, 2].
    #[default]
    #[serde(rename = "spline")]
    QuadraticSpline,
    /// Low-pass [1, 1]/√2, high-pass [−1, 1]/√2.
    Haar,
}

/// The function that is minimised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Objective {
    /// Eq. 1 of the paper: a sum of norms of values and gradients, as if the set-up were perfect but for μ.
    Paper,
    /// Minus twice the logarithm of the likelihood: residuals over their noise, with the nuisances of a real set-up
    /// estimated in addition to the medium.
    Likelihood,
}

/// The phase function that a fit assumes, if the dictionary's scene has a second lobe of uncertain weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PhaseModel {
    /// As the scene has it: one weight for all channels of a material, unless the scene has another scope.
    #[default]
    TwoLobes,
    /// One weight for each channel.
    PerChannel,
    /// Henyey–Greenstein: the weight is 0.
    HenyeyGreenstein,
}

/// An interval that a parameter must lie in; one value if both ends are equal. An end that is open is null in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bounds {
    min: f64,
    max: f64,
}

impl Bounds {
    pub const FREE: Self = Self { min: f64::NEG_INFINITY, max: f64::INFINITY };

    /// `field` is named in the error if the ends are the wrong way round.
    pub fn new(field: &str, min: Option<f64>, max: Option<f64>) -> Result<Self> {
        let bounds = Self { min: min.unwrap_or(f64::NEG_INFINITY), max: max.unwrap_or(f64::INFINITY) };
        if bounds.min > bounds.max {
            let given = format!("{} to {}", bounds.min, bounds.max);
            return Err(Invalid::new(field, given, "the lower bound must not exceed the upper"));
        }
        Ok(bounds)
    }

    pub fn fixed(value: f64) -> Self {
        Self { min: value, max: value }
    }

    pub fn min(&self) -> f64 {
        self.min
    }

    pub fn max(&self) -> f64 {
        self.max
    }

    pub fn is_fixed(&self) -> bool {
        self.min == self.max
    }

    pub fn is_free(&self) -> bool {
        *self == Self::FREE
    }

    pub fn contains(&self, value: f64) -> bool {
        (self.min..=self.max).contains(&value)
    }

    fn check(self, check: impl Fn(f64) -> Result<f64>) -> Result<Self> {
        for end in [self.min, self.max] {
            if !end.is_infinite() {
                check(end)?;
            }
        }
        Ok(self)
    }
}

macro_rules! settings {
    ($($name:ident { $unit:ident, $default:expr, $range:tt, $form:ident, $label:literal, $help:literal })+) => {
        /// The parts of [`FitOptions`], not yet checked.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct FitSettings {
            /// Weight of the gradient term of Eq. 2.
            pub lambda: f64,
            /// Factor on the measured values.
            pub mu: f64,
            /// Standard error of μ; the error bars of a refined fit contain it.
            pub mu_std_error: f64,
            /// The objective. None selects the likelihood.
            pub objective: Option<Objective>,
            /// The phase function of the likelihood.
            pub phase: PhaseModel,
            pub wavelet: Wavelet,
            /// Level of the wavelet: it smooths over about 2^level pixels.
            pub level: u32,
            pub sigma_t_per_mm: Bounds,
            pub albedo: Bounds,
            pub g: Bounds,
            /// Number of neighbours to return.
            pub top: u32,
            /// Continue from the best record to a continuous optimum with error bars.
            pub refine: bool,
            /// Return the profiles and gradients that were compared.
            pub curves: bool,
            /// Values that the session has measured, with their standard errors, in the order of
            /// [`PriorKind::OF_SESSION`]: in place of the scene's priors.
            pub measured: [Option<[f64; 2]>; PriorKind::OF_SESSION.len()],
            $(#[doc = $help] pub $name: f64,)+
        }

        impl Default for FitSettings {
            /// The paper's λ = 20, μ = 1, the quadratic spline at level 4, everything free, five neighbours. Each profile's
            /// scale is known to 0.3 %, and its zero to 0.1 % of white, the best that photographs allow; the thickness is
            /// known as by a micrometer, the edge as by eye, and the light is even to 0.2 % over 10 mm.
            fn default() -> Self {
                Self {
                    lambda: 20.0,
                    mu: 1.0,
                    mu_std_error: 0.0,
                    objective: None,
                    phase: PhaseModel::TwoLobes,
                    wavelet: Wavelet::QuadraticSpline,
                    level: 4,
                    sigma_t_per_mm: Bounds::FREE,
                    albedo: Bounds::FREE,
                    g: Bounds::FREE,
                    top: 5,
                    refine: false,
                    curves: false,
                    measured: [None; PriorKind::OF_SESSION.len()],
                    $($name: $default,)+
                }
            }
        }

        impl FitSettings {
            /// The quantities of the set-up, in the order of their table.
            pub fn set_up(&self) -> impl Iterator<Item = (&'static Quantity, f64)> {
                Quantity::OF_OPTIONS.iter().zip([$(self.$name),+])
            }

            pub fn set_up_mut(&mut self) -> impl Iterator<Item = (&'static Quantity, &mut f64)> {
                Quantity::OF_OPTIONS.iter().zip([$(&mut self.$name),+])
            }
        }
    };
}

with_quantities!(options settings);

/// Checked settings of Eqs. 1 and 2.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FitOptions(FitSettings);

impl FitSettings {
    /// Standard error of ln μ.
    pub fn ln_mu_std_error(&self) -> f64 {
        self.mu_std_error / self.mu
    }

    /// The value that the session has measured for a quantity, with its standard error.
    pub fn measured(&self, kind: PriorKind) -> Option<[f64; 2]> {
        self.measured[PriorKind::OF_SESSION.iter().position(|k| *k == kind)?]
    }

    /// These settings with the profile's own values where it has any.
    #[must_use]
    pub fn of_profile(mut self, profile: &ProfileSetup) -> Self {
        for (quantity, value) in self.set_up_mut() {
            *value = profile.value_of(quantity).unwrap_or(*value);
        }
        self
    }
}

impl FitOptions {
    /// The objective that is set, or the likelihood.
    pub fn objective(&self) -> Objective {
        self.0.objective.unwrap_or(Objective::Likelihood)
    }

    pub fn new(settings: FitSettings) -> Result<Self> {
        let s = &settings;
        if !(1..=FitLimits::TOP).contains(&s.top) {
            return Err(Invalid::new("top", s.top, format!("allowed are 1 to {}", FitLimits::TOP)));
        }
        if !(1..=FitLimits::WAVELET_LEVEL).contains(&s.level) {
            let allowed = format!("allowed are 1 to {}", FitLimits::WAVELET_LEVEL);
            return Err(Invalid::new("level", s.level, allowed));
        }
        check("lambda", s.lambda, |v| (0.0..=1e9).contains(&v), "allowed are 0 to 1e9")?;
        check_mu("mu", s.mu)?;
        check("mu_std_error", s.mu_std_error, |v| (0.0..=1.0).contains(&v), "allowed are 0 to 1")?;
        for (quantity, value) in s.set_up() {
            quantity.check(value)?;
        }
        for (kind, measured) in PriorKind::OF_SESSION.into_iter().zip(s.measured) {
            let Some([value, std_error]) = measured else { continue };
            let (key, [low, high]) = kind.session_key();
            let allowed = format!("allowed are {low} to {high}");
            check(key, value, |v| (low..=high).contains(&v), &allowed)?;
            let allowed = "allowed are numbers above 0, at most 1";
            let is_error = |v: f64| v > 0.0 && v <= 1.0;
            check("std_error", std_error, is_error, allowed).map_err(|e| e.within(key))?;
        }
        s.sigma_t_per_mm.check(check_sigma_t)?;
        s.albedo.check(check_albedo)?;
        s.g.check(check_g)?;
        if s.objective == Some(Objective::Paper) && s.phase != PhaseModel::TwoLobes {
            let allowed = "the paper's objective compares with the records as they are: leave it out, or take the likelihood";
            return Err(Invalid::new("phase", "given with the paper's objective", allowed));
        }
        Ok(Self(settings))
    }

    pub fn settings(&self) -> &FitSettings {
        &self.0
    }

    /// These options with another μ, and its standard error.
    pub fn with_mu(self, mu: f64, mu_std_error: f64) -> Result<Self> {
        Self::new(FitSettings { mu, mu_std_error, ..self.0 })
    }

    /// These options with the anisotropy held at a value.
    pub fn with_g(self, g: f64) -> Result<Self> {
        Self::new(FitSettings { g: Bounds::fixed(g), ..self.0 })
    }
}

fn check_mu(field: &str, mu: f64) -> Result<f64> {
    check(field, mu, |v| v > 0.0 && v <= 1e3, "allowed are numbers above 0, at most 1000")
}

/// Equally spaced scale factors to try.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MuRange {
    min: f64,
    max: f64,
    step: f64,
}

impl MuRange {
    pub fn new(min: f64, max: f64, step: f64) -> Result<Self> {
        check_mu("mu_min", min)?;
        check_mu("mu_max", max)?;
        if min > max {
            let given = format!("{min} to {max}");
            return Err(Invalid::new("mu_min", given, "the lower bound must not exceed the upper"));
        }
        check("mu_step", step, |v| v > 0.0, "allowed are numbers above 0")?;
        let range = Self { min, max, step };
        let most = FitLimits::MU_VALUES;
        let count = (max - min) / step;
        if count >= most as f64 {
            let allowed = format!("at most {most} values are allowed");
            return Err(Invalid::new("mu_step", format_args!("{step} over {min} to {max}"), allowed));
        }
        Ok(range)
    }

    /// First value, last value, step.
    pub fn parts(&self) -> (f64, f64, f64) {
        (self.min, self.max, self.step)
    }

    /// Values from the first to the last that does not exceed the end, by more than rounding.
    pub fn values(&self) -> Vec<f64> {
        let count = ((self.max - self.min) / self.step + 1e-9).floor() as usize + 1;
        // Decimals such as 0.913 come out as they are written.
        let tidy = |v: f64| (v * 1e12).round() / 1e12;
        (0..count).map(|i| tidy(self.min + i as f64 * self.step)).collect()
    }
}

impl Default for MuRange {
    /// 0.8 to 1.1 in steps of 0.001: the paper's range ends at 1, where calibrated photographs lie.
    fn default() -> Self {
        Self { min: 0.8, max: 1.1, step: 1e-3 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings out of range are refused with the field, the value and the range.
    #[test]
    fn settings_out_of_range_are_refused() {
        let default = FitSettings::default;
        for (settings, field) in [
            (FitSettings { mu: 0.0, ..default() }, "mu"),
            (FitSettings { mu: f64::NAN, ..default() }, "mu"),
            (FitSettings { lambda: -1.0, ..default() }, "lambda"),
            (FitSettings { level: 0, ..default() }, "level"),
            (FitSettings { level: 11, ..default() }, "level"),
            (FitSettings { top: 0, ..default() }, "top"),
            (FitSettings { g: Bounds::fixed(1.0), ..default() }, "g"),
            (FitSettings { albedo: Bounds::fixed(1.5), ..default() }, "albedo"),
            (FitSettings { mu_std_error: -0.1, ..default() }, "mu_std_error"),
            (FitSettings { gain_std_error: f64::NAN, ..default() }, "gain_std_error"),
            (FitSettings { thickness_std_error_mm: -0.001, ..default() }, "thickness_std_error_mm"),
            (FitSettings { origin_std_error_mm: f64::INFINITY, ..default() }, "origin_std_error_mm"),
            (FitSettings { blur_mm: 2.0, ..default() }, "blur_mm"),
            (FitSettings { blur_std_error_mm: f64::NAN, ..default() }, "blur_std_error_mm"),
            (FitSettings { slope_std_error: 1.5, ..default() }, "slope_std_error"),
        ] {
            assert_eq!(FitOptions::new(settings).unwrap_err().field(), field);
        }
    }

    #[test]
    fn contradictory_bounds_are_refused() {
        let error = Bounds::new("sigma_t_per_mm", Some(9.0), Some(4.0)).unwrap_err();
        let expected = "sigma_t_per_mm = 9 to 4 is not valid: the lower bound must not exceed the upper";
        assert_eq!(error.to_string(), expected);
        assert!(Bounds::new("g", None, Some(0.4)).unwrap().contains(-0.5));
    }

    /// The scale factors are by default those of the paper, and their number is bounded.
    #[test]
    fn scale_factors_match_the_paper() {
        let values = MuRange::default().values();
        assert_eq!((values.len(), values[0], values[113], values[300]), (301, 0.8, 0.913, 1.1));
        assert_eq!(MuRange::new(0.0, 1.0, 0.1).unwrap_err().field(), "mu_min");
        assert_eq!(MuRange::new(0.9, 0.8, 0.1).unwrap_err().field(), "mu_min");
        assert_eq!(MuRange::new(0.8, 1.0, 1e-9).unwrap_err().field(), "mu_step");
        assert_eq!(MuRange::new(0.9, 0.9, 0.1).unwrap().values(), [0.9]);
    }
}
