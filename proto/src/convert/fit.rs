//! Converts fit options and answers.

use super::mirror::{
    Numbered, list, matrix, mirror, mirror_enum, number, optional, optional_index, optional_number, required,
};
use crate::wire;
use optics_model::descent::DescentEnd;
use optics_model::fit::{
    Bounds, Candidate, Cause, ChannelFit, Curve, FitCurves, FitOptions, FitSettings, Interval, MaterialFit,
    Objective, Outside, PhaseModel, Refined, Suspicion, ThicknessError, Wavelet,
};
use optics_model::invalid::{Invalid, Result};
use optics_model::scene::PriorKind;
use optics_model::with_quantities;

fn bounds(field: &str, bounds: Option<wire::Bounds>) -> Result<Bounds> {
    let bounds = bounds.unwrap_or_default();
    Bounds::new(field, bounds.min, bounds.max)
}

mirror_enum!(Objective { Paper, Likelihood });
mirror_enum!(Wavelet { QuadraticSpline, Haar });
mirror_enum!(PhaseModel { PerChannel, HenyeyGreenstein } or TwoLobes);

fn objective(number: i32) -> Result<Option<Objective>> {
    let objective = Objective::of_number(number);
    if objective.is_none() && number != 0 {
        let allowed = "allowed are 1 (the paper's distance) and 2 (the likelihood)";
        return Err(Invalid::new("objective", number, allowed));
    }
    Ok(objective)
}

fn phase(number: i32) -> Result<PhaseModel> {
    let allowed = "allowed are 0 (two lobes), 1 (two lobes per channel) and 2 (Henyey–Greenstein)";
    match wire::PhaseModel::try_from(number) {
        Ok(_) => Ok(PhaseModel::of_number(number).unwrap_or_default()),
        Err(_) => Err(Invalid::new("phase", number, allowed)),
    }
}

fn wavelet(number: i32) -> Result<Wavelet> {
    let allowed = "allowed are 1 (quadratic spline) and 2 (Haar)";
    match number {
        0 => Ok(Wavelet::QuadraticSpline),
        _ => Wavelet::of_number(number).ok_or_else(|| Invalid::new("wavelet", number, allowed)),
    }
}

impl From<Bounds> for wire::Bounds {
    fn from(bounds: Bounds) -> Self {
        let end = |v: f64| v.is_finite().then_some(v);
        Self { min: end(bounds.min()), max: end(bounds.max()) }
    }
}

fn measured(given: &[wire::MeasuredQuantity]) -> Result<[Option<[f64; 2]>; PriorKind::OF_SESSION.len()]> {
    let mut measured = [None; PriorKind::OF_SESSION.len()];
    for quantity in given {
        let newer = || Invalid::new("measured.kind", quantity.kind, "this version measures no such quantity");
        let is_kind = |kind: &PriorKind| kind.number() == quantity.kind;
        let place = PriorKind::OF_SESSION.iter().position(is_kind).ok_or_else(newer)?;
        measured[place] = Some([quantity.value, quantity.std_error]);
    }
    Ok(measured)
}

fn wire_measured(settings: &FitSettings) -> Vec<wire::MeasuredQuantity> {
    let quantity = |(kind, measured): (PriorKind, Option<[f64; 2]>)| {
        let [value, std_error] = measured?;
        Some(wire::MeasuredQuantity { kind: kind.number(), value, std_error })
    };
    PriorKind::OF_SESSION.into_iter().zip(settings.measured).filter_map(quantity).collect()
}

macro_rules! options {
    ($($name:ident $row:tt)+) => {
        impl TryFrom<wire::FitOptions> for FitOptions {
            type Error = Invalid;

            fn try_from(options: wire::FitOptions) -> Result<Self> {
                let default = FitSettings::default();
                let measured = measured(&options.measured)?;
                Self::new(FitSettings {
                    measured,
                    lambda: options.lambda.unwrap_or(default.lambda),
                    mu: options.mu.unwrap_or(default.mu),
                    mu_std_error: options.mu_std_error.unwrap_or(default.mu_std_error),
                    objective: objective(options.objective)?,
                    wavelet: wavelet(options.wavelet)?,
                    phase: phase(options.phase)?,
                    level: options.level.unwrap_or(default.level),
                    sigma_t_per_mm: bounds("sigma_t_per_mm", options.sigma_t_per_mm)?,
                    albedo: bounds("albedo", options.albedo)?,
                    g: bounds("g", options.g)?,
                    top: options.top.unwrap_or(default.top),
                    refine: options.refine,
                    curves: options.curves,
                    $($name: options.$name.unwrap_or(default.$name),)+
                })
            }
        }

        impl From<&FitOptions> for wire::FitOptions {
            fn from(options: &FitOptions) -> Self {
                let s = options.settings();
                Self {
                    lambda: Some(s.lambda),
                    mu: Some(s.mu),
                    mu_std_error: Some(s.mu_std_error),
                    wavelet: s.wavelet.number(),
                    phase: s.phase.number(),
                    level: Some(s.level),
                    sigma_t_per_mm: Some(s.sigma_t_per_mm.into()),
                    albedo: Some(s.albedo.into()),
                    g: Some(s.g.into()),
                    top: Some(s.top),
                    refine: s.refine,
                    curves: s.curves,
                    objective: optional_number::to_wire(s.objective),
                    measured: wire_measured(s),
                    $($name: Some(s.$name),)+
                }
            }
        }
    };
}

with_quantities!(options options);

mirror!(MaterialFit { material, channels: list });
mirror!(ChannelFit {
    channel,
    candidates: list,
    refined: from_any_version,
    outside: optional_number,
    curves: list
});
mirror_enum!(Outside { Brighter, Darker });
mirror!(Candidate { medium: required, sample_ior, error, thicknesses: list });
mirror!(ThicknessError { thickness_mm, value_rms, gradient_rms, record: optional_index });
mirror!(Interval { low, high, open_low, open_high });
mirror!(Refined {
    best: required,
    sigma_t_per_mm: required,
    albedo: required,
    g: required,
    reduced_scattering_per_mm: required,
    absorption_per_mm: required,
    covariance: matrix,
    correlation,
    valley,
    resolved,
    resolved_at_g,
    measurement_noise,
    dictionary_share,
    misfit,
    suspicion: optional,
    likelihood: required,
    from_mixtures,
    second_lobe: optional,
    descent: number,
});
mirror_enum!(DescentEnd { AtBound, NoDescent, OutOfSteps } or Converged);

/// Accepts answers of older coordinators, which send one flag of resolution only, and no likelihood with the paper's
/// objective.
mod from_any_version {
    pub use super::optional::to_wire;
    use super::{Refined, Result, optional, wire};

    /// A likelihood of no pixels, which bounds nothing.
    fn no_likelihood() -> wire::Likelihood {
        let open = Some(wire::Ends { low: f64::NEG_INFINITY, high: f64::INFINITY });
        let bound = wire::Bound {
            sigma_t_per_mm: open,
            albedo: open,
            g: open,
            reduced_scattering_per_mm: open,
            absorption_per_mm: open,
        };
        wire::Likelihood { probability: 1.0, bound: Some(bound), ..wire::Likelihood::default() }
    }

    pub fn from_wire(field: &str, refined: Option<wire::Refined>) -> Result<Option<Refined>> {
        let refined = refined
            .map(|r| wire::Refined { likelihood: Some(r.likelihood.unwrap_or_else(no_likelihood)), ..r });
        let refined: Option<Refined> = optional::from_wire(field, refined)?;
        Ok(refined.map(|r| Refined { resolved_at_g: r.resolved_at_g || r.resolved, ..r }))
    }
}

mirror!(Suspicion { cause: number, thickness_mm, amount, misfit_left });
mirror_enum!(Cause {
    EdgeOffset, Gain, Zero, Slope, Blur, GammaCoded, Exponent, ThicknessesSwapped, Thickness, Wedge,
} or Unknown);
mirror!(Curve { values, gradient });
mirror!(FitCurves {
    thickness_mm,
    x_mm,
    measured: required,
    candidates: list,
    refined: optional,
    residuals,
    left_out
});

#[cfg(test)]
mod tests {
    use super::*;

    /// No value is the default, so that a forgotten field is detected.
    #[test]
    fn fit_options_round_trip() {
        for objective in [None, Some(Objective::Paper), Some(Objective::Likelihood)] {
            let mut settings = FitSettings {
                lambda: 12.5,
                mu: 0.913,
                mu_std_error: 0.004,
                objective,
                wavelet: Wavelet::Haar,
                level: 3,
                sigma_t_per_mm: Bounds::new("sigma_t_per_mm", Some(0.5), None).unwrap(),
                albedo: Bounds::new("albedo", None, Some(0.99)).unwrap(),
                g: Bounds::fixed(0.4),
                top: 2,
                refine: true,
                curves: true,
                ..FitSettings::default()
            };
            settings.measured[0] = Some([0.02, 0.003]);
            for (i, (_, value)) in settings.set_up_mut().enumerate() {
                *value = 0.01 * (i as f64 + 1.5);
            }
            let options = FitOptions::new(settings).unwrap();
            assert_eq!(FitOptions::try_from(wire::FitOptions::from(&options)).unwrap(), options);
        }
    }

    /// Absent options are the defaults, and unknown or invalid ones are refused.
    #[test]
    fn absent_fit_options_are_defaults() {
        let options = FitOptions::try_from(wire::FitOptions::default()).unwrap();
        assert_eq!(options, FitOptions::default());
        let refused = |options: wire::FitOptions| FitOptions::try_from(options).unwrap_err();
        let unknown = refused(wire::FitOptions { objective: 9, ..Default::default() });
        assert_eq!((unknown.field(), unknown.given()), ("objective", "9"));
        let negative = refused(wire::FitOptions { blur_std_error_mm: Some(-0.1), ..Default::default() });
        assert_eq!(negative.field(), "blur_std_error_mm");
    }
}
