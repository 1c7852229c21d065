//! Fit options and answers.

use super::required;
use crate::wire;
use optics_model::fit::{
    Bounds, Candidate, Cause, ChannelFit, Curve, FitCurves, FitOptions, FitSettings, Interval, MaterialFit,
    Objective, Outside, Refined, Suspicion, ThicknessError, Wavelet,
};
use optics_model::invalid::{Invalid, Result, each};

fn bounds(field: &str, bounds: Option<wire::Bounds>) -> Result<Bounds> {
    let bounds = bounds.unwrap_or_default();
    Bounds::new(field, bounds.min, bounds.max)
}

fn objective(objective: i32) -> Result<Option<Objective>> {
    match wire::Objective::try_from(objective) {
        Ok(wire::Objective::Unspecified) => Ok(None),
        Ok(wire::Objective::Paper) => Ok(Some(Objective::Paper)),
        Ok(wire::Objective::Likelihood) => Ok(Some(Objective::Likelihood)),
        Err(_) => {
            let allowed = "allowed are 1 (the paper's distance) and 2 (the likelihood)";
            Err(Invalid::new("objective", objective, allowed))
        }
    }
}

impl From<Bounds> for wire::Bounds {
    fn from(bounds: Bounds) -> Self {
        let end = |v: f64| v.is_finite().then_some(v);
        Self { min: end(bounds.min()), max: end(bounds.max()) }
    }
}

impl TryFrom<wire::FitOptions> for FitOptions {
    type Error = Invalid;

    fn try_from(options: wire::FitOptions) -> Result<Self> {
        let default = FitSettings::default();
        let wavelet = match wire::Wavelet::try_from(options.wavelet) {
            Ok(wire::Wavelet::Unspecified | wire::Wavelet::QuadraticSpline) => Wavelet::QuadraticSpline,
            Ok(wire::Wavelet::Haar) => Wavelet::Haar,
            Err(_) => {
                let allowed = "allowed are 1 (quadratic spline) and 2 (Haar)";
                return Err(Invalid::new("wavelet", options.wavelet, allowed));
            }
        };
        Self::new(FitSettings {
            lambda: options.lambda.unwrap_or(default.lambda),
            mu: options.mu.unwrap_or(default.mu),
            mu_std_error: options.mu_std_error.unwrap_or(default.mu_std_error),
            gain_std_error: options.gain_std_error.unwrap_or(default.gain_std_error),
            offset_std_error: options.offset_std_error.unwrap_or(default.offset_std_error),
            objective: objective(options.objective)?,
            thickness_std_error_mm: options.thickness_std_error_mm.unwrap_or(default.thickness_std_error_mm),
            origin_std_error_mm: options.origin_std_error_mm.unwrap_or(default.origin_std_error_mm),
            blur_mm: options.blur_mm.unwrap_or(default.blur_mm),
            blur_std_error_mm: options.blur_std_error_mm.unwrap_or(default.blur_std_error_mm),
            slope_std_error: options.slope_std_error.unwrap_or(default.slope_std_error),
            wavelet,
            level: options.level.unwrap_or(default.level),
            sigma_t_per_mm: bounds("sigma_t_per_mm", options.sigma_t_per_mm)?,
            albedo: bounds("albedo", options.albedo)?,
            g: bounds("g", options.g)?,
            top: options.top.unwrap_or(default.top),
            refine: options.refine,
            curves: options.curves,
        })
    }
}

impl From<&FitOptions> for wire::FitOptions {
    fn from(options: &FitOptions) -> Self {
        let s = options.settings();
        let wavelet = match s.wavelet {
            Wavelet::QuadraticSpline => wire::Wavelet::QuadraticSpline,
            Wavelet::Haar => wire::Wavelet::Haar,
        };
        Self {
            lambda: Some(s.lambda),
            mu: Some(s.mu),
            mu_std_error: Some(s.mu_std_error),
            gain_std_error: Some(s.gain_std_error),
            offset_std_error: Some(s.offset_std_error),
            wavelet: wavelet.into(),
            level: Some(s.level),
            sigma_t_per_mm: Some(s.sigma_t_per_mm.into()),
            albedo: Some(s.albedo.into()),
            g: Some(s.g.into()),
            top: Some(s.top),
            refine: s.refine,
            curves: s.curves,
            objective: match s.objective {
                None => wire::Objective::Unspecified,
                Some(Objective::Paper) => wire::Objective::Paper,
                Some(Objective::Likelihood) => wire::Objective::Likelihood,
            }
            .into(),
            thickness_std_error_mm: Some(s.thickness_std_error_mm),
            origin_std_error_mm: Some(s.origin_std_error_mm),
            blur_mm: Some(s.blur_mm),
            blur_std_error_mm: Some(s.blur_std_error_mm),
            slope_std_error: Some(s.slope_std_error),
        }
    }
}

impl From<MaterialFit> for wire::MaterialFit {
    fn from(fit: MaterialFit) -> Self {
        Self { material: fit.material, channels: fit.channels.into_iter().map(Into::into).collect() }
    }
}

impl TryFrom<wire::MaterialFit> for MaterialFit {
    type Error = Invalid;

    fn try_from(fit: wire::MaterialFit) -> Result<Self> {
        let channels = each("channels", fit.channels, ChannelFit::try_from)?;
        Ok(Self { material: fit.material, channels })
    }
}

impl From<ChannelFit> for wire::ChannelFit {
    fn from(fit: ChannelFit) -> Self {
        let outside = match fit.outside {
            None => wire::Outside::Unspecified,
            Some(Outside::Brighter) => wire::Outside::Brighter,
            Some(Outside::Darker) => wire::Outside::Darker,
        };
        Self {
            channel: fit.channel,
            candidates: fit.candidates.into_iter().map(Into::into).collect(),
            refined: fit.refined.map(Into::into),
            outside: outside.into(),
            curves: fit.curves.into_iter().map(Into::into).collect(),
        }
    }
}

impl TryFrom<wire::ChannelFit> for ChannelFit {
    type Error = Invalid;

    fn try_from(fit: wire::ChannelFit) -> Result<Self> {
        let outside = match wire::Outside::try_from(fit.outside) {
            Ok(wire::Outside::Brighter) => Some(Outside::Brighter),
            Ok(wire::Outside::Darker) => Some(Outside::Darker),
            Ok(wire::Outside::Unspecified) | Err(_) => None,
        };
        Ok(Self {
            candidates: each("candidates", fit.candidates, Candidate::try_from)?,
            refined: fit.refined.map(Refined::try_from).transpose()?,
            outside,
            curves: each("curves", fit.curves, FitCurves::try_from)?,
            channel: fit.channel,
        })
    }
}

impl From<Candidate> for wire::Candidate {
    fn from(candidate: Candidate) -> Self {
        let term = |t: ThicknessError| wire::ThicknessError {
            thickness_mm: t.thickness_mm,
            value_rms: t.value_rms,
            gradient_rms: t.gradient_rms,
            record: t.record.map(|r| r as u32),
        };
        Self {
            medium: Some(candidate.medium.into()),
            sample_ior: candidate.sample_ior,
            error: candidate.error,
            thicknesses: candidate.thicknesses.into_iter().map(term).collect(),
        }
    }
}

impl TryFrom<wire::Candidate> for Candidate {
    type Error = Invalid;

    fn try_from(candidate: wire::Candidate) -> Result<Self> {
        let term = |t: wire::ThicknessError| ThicknessError {
            thickness_mm: t.thickness_mm,
            value_rms: t.value_rms,
            gradient_rms: t.gradient_rms,
            record: t.record.map(|r| r as usize),
        };
        Ok(Self {
            medium: required("medium", candidate.medium)?.try_into()?,
            sample_ior: candidate.sample_ior,
            error: candidate.error,
            thicknesses: candidate.thicknesses.into_iter().map(term).collect(),
        })
    }
}

impl From<Interval> for wire::Interval {
    fn from(i: Interval) -> Self {
        Self { low: i.low, high: i.high, open_low: i.open_low, open_high: i.open_high }
    }
}

impl From<wire::Interval> for Interval {
    fn from(i: wire::Interval) -> Self {
        Self { low: i.low, high: i.high, open_low: i.open_low, open_high: i.open_high }
    }
}

impl From<Refined> for wire::Refined {
    fn from(r: Refined) -> Self {
        Self {
            best: Some(r.best.into()),
            sigma_t_per_mm: Some(r.sigma_t_per_mm.into()),
            albedo: Some(r.albedo.into()),
            g: Some(r.g.into()),
            reduced_scattering_per_mm: Some(r.reduced_scattering_per_mm.into()),
            absorption_per_mm: Some(r.absorption_per_mm.into()),
            covariance: r.covariance.as_flattened().to_vec(),
            correlation: r.correlation,
            valley: r.valley,
            resolved: r.resolved,
            resolved_at_g: r.resolved_at_g,
            measurement_noise: r.measurement_noise,
            dictionary_share: r.dictionary_share,
            misfit: r.misfit,
            suspicion: r.suspicion.map(Into::into),
            likelihood: r.likelihood.map(Into::into),
            from_mixtures: r.from_mixtures,
        }
    }
}

impl TryFrom<wire::Refined> for Refined {
    type Error = Invalid;

    fn try_from(r: wire::Refined) -> Result<Self> {
        let interval = |field, i: Option<wire::Interval>| required(field, i).map(Interval::from);
        let count = r.covariance.len();
        let (rows, []) = r.covariance.as_chunks::<3>() else {
            return Err(Invalid::new("covariance", count, "nine numbers are needed"));
        };
        Ok(Self {
            likelihood: r.likelihood.map(TryInto::try_into).transpose()?,
            from_mixtures: r.from_mixtures,
            best: required("best", r.best)?.try_into()?,
            sigma_t_per_mm: interval("sigma_t_per_mm", r.sigma_t_per_mm)?,
            albedo: interval("albedo", r.albedo)?,
            g: interval("g", r.g)?,
            reduced_scattering_per_mm: interval("reduced_scattering_per_mm", r.reduced_scattering_per_mm)?,
            absorption_per_mm: interval("absorption_per_mm", r.absorption_per_mm)?,
            covariance: rows
                .try_into()
                .map_err(|_| Invalid::new("covariance", count, "nine numbers are needed"))?,
            correlation: r.correlation,
            valley: r.valley,
            resolved: r.resolved,
            // Older coordinators send one flag only.
            resolved_at_g: r.resolved_at_g || r.resolved,
            measurement_noise: r.measurement_noise,
            dictionary_share: r.dictionary_share,
            misfit: r.misfit,
            suspicion: r.suspicion.map(Into::into),
        })
    }
}

const CAUSES: [(Cause, wire::Cause); 10] = [
    (Cause::Unknown, wire::Cause::Unspecified),
    (Cause::EdgeOffset, wire::Cause::EdgeOffset),
    (Cause::Gain, wire::Cause::Gain),
    (Cause::Zero, wire::Cause::Zero),
    (Cause::Slope, wire::Cause::Slope),
    (Cause::Blur, wire::Cause::Blur),
    (Cause::Outliers, wire::Cause::Outliers),
    (Cause::GammaCoded, wire::Cause::GammaCoded),
    (Cause::Exponent, wire::Cause::Exponent),
    (Cause::ThicknessesSwapped, wire::Cause::ThicknessesSwapped),
];

impl From<Suspicion> for wire::Suspicion {
    fn from(s: Suspicion) -> Self {
        let cause = CAUSES.into_iter().find(|(cause, _)| *cause == s.cause);
        Self {
            cause: cause.map_or(wire::Cause::Unspecified, |(_, wire)| wire).into(),
            thickness_mm: s.thickness_mm,
            amount: s.amount,
            misfit_left: s.misfit_left,
        }
    }
}

impl From<wire::Suspicion> for Suspicion {
    fn from(s: wire::Suspicion) -> Self {
        // A cause that a newer coordinator knows is unknown here.
        let cause = CAUSES.into_iter().find(|(_, wire)| *wire == s.cause());
        Self {
            cause: cause.map_or(Cause::Unknown, |(cause, _)| cause),
            thickness_mm: s.thickness_mm,
            amount: s.amount,
            misfit_left: s.misfit_left,
        }
    }
}

impl From<Curve> for wire::Curve {
    fn from(curve: Curve) -> Self {
        Self { values: curve.values, gradient: curve.gradient }
    }
}

impl From<wire::Curve> for Curve {
    fn from(curve: wire::Curve) -> Self {
        Self { values: curve.values, gradient: curve.gradient }
    }
}

impl From<FitCurves> for wire::FitCurves {
    fn from(curves: FitCurves) -> Self {
        Self {
            thickness_mm: curves.thickness_mm,
            x_mm: curves.x_mm,
            measured: Some(curves.measured.into()),
            candidates: curves.candidates.into_iter().map(Into::into).collect(),
            refined: curves.refined.map(Into::into),
        }
    }
}

impl TryFrom<wire::FitCurves> for FitCurves {
    type Error = Invalid;

    fn try_from(curves: wire::FitCurves) -> Result<Self> {
        Ok(Self {
            thickness_mm: curves.thickness_mm,
            x_mm: curves.x_mm,
            measured: required("measured", curves.measured)?.into(),
            candidates: curves.candidates.into_iter().map(Into::into).collect(),
            refined: curves.refined.map(Into::into),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No value is its default, so that a field that is forgotten shows.
    #[test]
    fn options_come_through() {
        for objective in [None, Some(Objective::Paper), Some(Objective::Likelihood)] {
            let settings = FitSettings {
                lambda: 12.5,
                mu: 0.913,
                mu_std_error: 0.004,
                gain_std_error: 0.01,
                offset_std_error: 0.02,
                objective,
                thickness_std_error_mm: 0.03,
                origin_std_error_mm: 0.04,
                blur_mm: 0.06,
                blur_std_error_mm: 0.07,
                slope_std_error: 0.08,
                wavelet: Wavelet::Haar,
                level: 3,
                sigma_t_per_mm: Bounds::new("sigma_t_per_mm", Some(0.5), None).unwrap(),
                albedo: Bounds::new("albedo", None, Some(0.99)).unwrap(),
                g: Bounds::fixed(0.4),
                top: 2,
                refine: true,
                curves: true,
            };
            let options = FitOptions::new(settings).unwrap();
            assert_eq!(FitOptions::try_from(wire::FitOptions::from(&options)).unwrap(), options);
        }
    }

    #[test]
    fn absent_options_are_the_defaults_and_unknown_ones_refused() {
        let options = FitOptions::try_from(wire::FitOptions::default()).unwrap();
        assert_eq!(options, FitOptions::default());
        let refused = |options: wire::FitOptions| FitOptions::try_from(options).unwrap_err();
        let unknown = refused(wire::FitOptions { objective: 9, ..Default::default() });
        assert_eq!((unknown.field(), unknown.given()), ("objective", "9"));
        let negative = refused(wire::FitOptions { blur_std_error_mm: Some(-0.1), ..Default::default() });
        assert_eq!(negative.field(), "blur_std_error_mm");
    }
}
