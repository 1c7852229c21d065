//! JSON shapes of fits; see client/README.md.

use optics_model::fit::{
    Bounds, Candidate, Cause, ChannelFit, Common, Curve, FitOptions, GError, Interval, MaterialFit, Outside,
    Refined, ScaleCurve, ScalePoint, Suspicion, Wavelet,
};
use serde::Serialize;

/// Settings of Eqs. 1 and 2, as they were used.
#[derive(Debug, Serialize)]
pub(crate) struct OptionsJson {
    dictionary: String,
    lambda: f64,
    mu: f64,
    mu_std_error: f64,
    gain_std_error: f64,
    offset_std_error: f64,
    /// Null if free or a range.
    g: Option<f64>,
    g_range: RangeJson,
    sigma_t_range: RangeJson,
    albedo_range: RangeJson,
    wavelet: &'static str,
    level: u32,
}

#[derive(Debug, Serialize)]
struct RangeJson {
    min: Option<f64>,
    max: Option<f64>,
}

impl From<Bounds> for RangeJson {
    fn from(bounds: Bounds) -> Self {
        let end = |v: f64| v.is_finite().then_some(v);
        Self { min: end(bounds.min()), max: end(bounds.max()) }
    }
}

impl OptionsJson {
    pub(crate) fn new(dictionary: &str, options: &FitOptions) -> Self {
        let s = options.settings();
        Self {
            dictionary: dictionary.to_owned(),
            lambda: s.lambda,
            mu: s.mu,
            mu_std_error: s.mu_std_error,
            gain_std_error: s.gain_std_error,
            offset_std_error: s.offset_std_error,
            g: s.g.is_fixed().then_some(s.g.min()),
            g_range: s.g.into(),
            sigma_t_range: s.sigma_t_per_mm.into(),
            albedo_range: s.albedo.into(),
            wavelet: match s.wavelet {
                Wavelet::QuadraticSpline => "spline",
                Wavelet::Haar => "haar",
            },
            level: s.level,
        }
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct MaterialJson {
    material: String,
    channels: Vec<ChannelJson>,
}

impl From<&MaterialFit> for MaterialJson {
    fn from(fit: &MaterialFit) -> Self {
        Self { material: fit.material.clone(), channels: fit.channels.iter().map(Into::into).collect() }
    }
}

#[derive(Debug, Serialize)]
struct ChannelJson {
    channel: String,
    candidates: Vec<CandidateJson>,
    refined: Option<RefinedJson>,
    outside: Option<&'static str>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    curves: Vec<CurvesJson>,
}

impl From<&ChannelFit> for ChannelJson {
    fn from(fit: &ChannelFit) -> Self {
        let curves = fit.curves.iter().map(|c| CurvesJson {
            thickness_mm: c.thickness_mm,
            x_mm: c.x_mm.clone(),
            measured: (&c.measured).into(),
            candidates: c.candidates.iter().map(Into::into).collect(),
            refined: c.refined.as_ref().map(Into::into),
        });
        Self {
            channel: fit.channel.clone(),
            candidates: fit.candidates.iter().map(Into::into).collect(),
            refined: fit.refined.as_ref().map(Into::into),
            outside: fit.outside.map(Outside::as_str),
            curves: curves.collect(),
        }
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct CandidateJson {
    sigma_t_per_mm: f64,
    albedo: f64,
    g: f64,
    sample_ior: f64,
    error: f64,
    thicknesses: Vec<ThicknessJson>,
}

#[derive(Debug, Serialize)]
struct ThicknessJson {
    thickness_mm: f64,
    value_rms: f64,
    gradient_rms: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    record: Option<usize>,
}

impl From<&Candidate> for CandidateJson {
    fn from(c: &Candidate) -> Self {
        let thickness = |t: &optics_model::fit::ThicknessError| ThicknessJson {
            thickness_mm: t.thickness_mm,
            value_rms: t.value_rms,
            gradient_rms: t.gradient_rms,
            record: t.record,
        };
        Self {
            sigma_t_per_mm: c.medium.sigma_t_per_mm(),
            albedo: c.medium.albedo(),
            g: c.medium.g(),
            sample_ior: c.sample_ior,
            error: c.error,
            thicknesses: c.thicknesses.iter().map(thickness).collect(),
        }
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct IntervalJson {
    low: f64,
    high: f64,
    open_low: bool,
    open_high: bool,
}

impl From<Interval> for IntervalJson {
    fn from(i: Interval) -> Self {
        Self { low: i.low, high: i.high, open_low: i.open_low, open_high: i.open_high }
    }
}

#[derive(Debug, Serialize)]
struct RefinedJson {
    #[serde(flatten)]
    best: CandidateJson,
    resolved: bool,
    valley: bool,
    sigma_t_interval: IntervalJson,
    albedo_interval: IntervalJson,
    g_interval: IntervalJson,
    reduced_scattering_interval: IntervalJson,
    absorption_interval: IntervalJson,
    covariance: [[f64; 3]; 3],
    correlation: f64,
    measurement_noise: f64,
    dictionary_share: f64,
    misfit: f64,
    /// The likeliest reason, if the misfit exceeds 2.
    suspicion: Option<SuspicionJson>,
}

#[derive(Debug, Serialize)]
struct SuspicionJson {
    cause: &'static str,
    thickness_mm: Option<f64>,
    amount: f64,
    misfit_left: f64,
}

impl From<&Suspicion> for SuspicionJson {
    fn from(s: &Suspicion) -> Self {
        let cause = match s.cause {
            Cause::Unknown => "unknown",
            Cause::EdgeOffset => "edge_offset_mm",
            Cause::Gain => "gain",
            Cause::Zero => "zero",
            Cause::Slope => "slope",
            Cause::Blur => "blur_mm",
            Cause::Outliers => "outliers",
            Cause::GammaCoded => "gamma_coded",
            Cause::ThicknessesSwapped => "thicknesses_swapped",
        };
        Self { cause, thickness_mm: s.thickness_mm, amount: s.amount, misfit_left: s.misfit_left }
    }
}

impl From<&Refined> for RefinedJson {
    fn from(r: &Refined) -> Self {
        Self {
            best: (&r.best).into(),
            resolved: r.resolved,
            valley: r.valley,
            sigma_t_interval: r.sigma_t_per_mm.into(),
            albedo_interval: r.albedo.into(),
            g_interval: r.g.into(),
            reduced_scattering_interval: r.reduced_scattering_per_mm.into(),
            absorption_interval: r.absorption_per_mm.into(),
            covariance: r.covariance,
            correlation: r.correlation,
            measurement_noise: r.measurement_noise,
            dictionary_share: r.dictionary_share,
            misfit: r.misfit,
            suspicion: r.suspicion.as_ref().map(Into::into),
        }
    }
}

#[derive(Debug, Serialize)]
struct CurvesJson {
    thickness_mm: f64,
    x_mm: Vec<f64>,
    measured: CurveJson,
    candidates: Vec<CurveJson>,
    refined: Option<CurveJson>,
}

#[derive(Debug, Serialize)]
struct CurveJson {
    values: Vec<f64>,
    gradient: Vec<f64>,
}

impl From<&Curve> for CurveJson {
    fn from(curve: &Curve) -> Self {
        Self { values: curve.values.clone(), gradient: curve.gradient.clone() }
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct ScaleJson {
    mu: f64,
    error: f64,
    std_error: Option<f64>,
    curvature: Option<f64>,
    at_end: bool,
    best_g: f64,
    by_g: Vec<GJson>,
    curve: Vec<PointJson>,
}

#[derive(Debug, Serialize)]
struct GJson {
    g: f64,
    error: f64,
    best_mu: f64,
    best_mu_error: f64,
}

impl From<&GError> for GJson {
    fn from(e: &GError) -> Self {
        Self { g: e.g, error: e.error, best_mu: e.best.mu, best_mu_error: e.best.error }
    }
}

/// What all channels share, chosen by refined errors.
#[derive(Debug, Serialize)]
pub(crate) struct CommonJson {
    mu: f64,
    mu_std_error: f64,
    mu_interval: IntervalJson,
    /// Whether μ was searched, not given.
    mu_chosen: bool,
    g: Option<f64>,
    /// Null if g was given.
    g_interval: Option<IntervalJson>,
    by_g: Vec<GJson>,
}

impl From<&Common> for CommonJson {
    fn from(common: &Common) -> Self {
        Self {
            mu: common.mu,
            mu_std_error: common.mu_std_error,
            mu_interval: common.mu_interval.into(),
            mu_chosen: common.mu_chosen,
            g: common.g,
            g_interval: common.g_interval.map(Into::into),
            by_g: common.by_g.iter().map(Into::into).collect(),
        }
    }
}

#[derive(Debug, Serialize)]
struct PointJson {
    mu: f64,
    error: f64,
}

impl From<&ScaleCurve> for ScaleJson {
    fn from(curve: &ScaleCurve) -> Self {
        let point = |p: &ScalePoint| PointJson { mu: p.mu, error: p.error };
        Self {
            mu: curve.best.mu,
            error: curve.best.error,
            std_error: curve.std_error,
            curvature: curve.curvature,
            at_end: curve.at_end,
            best_g: curve.best_g,
            by_g: curve.by_g.iter().map(Into::into).collect(),
            curve: curve.points.iter().map(point).collect(),
        }
    }
}
