//! Answers of the fit. They have no invariants, so their fields are public: `farmctl --json` serialises them, and figures
//! are drawn from them.
//!
//! Names and order of the fields are those of `farmctl/1`. A number that is not finite becomes null.

use serde::{Serialize, Serializer};

use super::budget::SourceShare;
use super::suspicion::Suspicion;
use crate::descent::DescentEnd;
use crate::medium::Medium;
use crate::phase::SecondLobe;
use crate::scene::Scope;

/// One term of Eq. 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ThicknessError {
    pub thickness_mm: f64,
    /// Root mean square of μ F_A − F_S.
    pub value_rms: f64,
    /// Root mean square of |∇ μ F_A| − |∇ F_S|, before λ.
    pub gradient_rms: f64,
    /// Number of the record compared with; none if it lies between records.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub record: Option<usize>,
}

/// A medium of the dictionary and how well it explains a channel.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Candidate {
    #[serde(flatten)]
    pub medium: Medium,
    pub sample_ior: f64,
    /// Eq. 1: Σ over thicknesses of value_rms + λ · gradient_rms. With the likelihood: root mean square of the residuals
    /// over their noise, with the nuisances of the set-up at their estimates.
    pub error: f64,
    pub thicknesses: Vec<ThicknessError>,
}

/// The 95 % confidence interval of a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    pub low: f64,
    pub high: f64,
    /// The data allow still lower values; `low` is merely the end of the dictionary or of the given bounds.
    pub open_low: bool,
    /// The data allow still higher values; `high` is merely the end of the dictionary or of the given bounds.
    pub open_high: bool,
}

impl Interval {
    pub fn contains(&self, value: f64) -> bool {
        (self.open_low || value >= self.low) && (self.open_high || value <= self.high)
    }
}

/// The maximum of the likelihood between the records, and its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::struct_excessive_bools, reason = "they are fields of farmctl/1")]
pub struct Refined {
    #[serde(flatten)]
    pub best: Candidate,
    /// Whether the data determine σ_t and the albedo: their intervals are bounded, and span no more than a factor of 2 in
    /// σ_t and 0.2 in the albedo.
    pub resolved: bool,
    /// Whether the data would determine them with g held at its best value. If this alone is true, g is open: σ_t and the
    /// albedo are valid together with this g only.
    pub resolved_at_g: bool,
    /// σ_t and g trade off along media that are equivalent by similarity theory: neither is determined on its own.
    pub valley: bool,
    #[serde(rename = "sigma_t_interval")]
    pub sigma_t_per_mm: Interval,
    #[serde(rename = "albedo_interval")]
    pub albedo: Interval,
    #[serde(rename = "g_interval")]
    pub g: Interval,
    /// Reduced scattering coefficient σ_s (1 − g), invariant under similarity theory.
    #[serde(rename = "reduced_scattering_interval")]
    pub reduced_scattering_per_mm: Interval,
    /// Absorption coefficient σ_t (1 − α), invariant under similarity theory.
    #[serde(rename = "absorption_interval")]
    pub absorption_per_mm: Interval,
    /// Covariance of (ln σ_t, √(1 − α), ln(1 − g)), row by row; zeros where a parameter was held, or came from mixtures.
    pub covariance: [[f64; 3]; 3],
    /// Correlation of ln σ_t with ln(1 − g); zero if one of them was held.
    pub correlation: f64,
    /// Standard error of one measured value (times μ): root mean square over pixels.
    pub measurement_noise: f64,
    /// Share of the variance of ln σ_t that comes from the dictionary's noise, 0 to 1.
    pub dictionary_share: f64,
    /// Root mean square of the residuals over that of the noise, of the measurement and of the dictionary: 1 if noise
    /// explains all.
    pub misfit: f64,
    /// The most likely cause of a deviation that neither noise nor the priors of the set-up explain.
    pub suspicion: Option<Suspicion>,
    /// Results of the likelihood beyond the medium.
    pub likelihood: Likelihood,
    /// Medium and intervals come from mixtures with other inks: these profiles by themselves do not determine them.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub from_mixtures: bool,
    /// The second lobe of the phase function, at its estimate; missing if the function has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub second_lobe: Option<SecondLobe>,
    /// How the descent to this medium ended. If not at a minimum, nothing counts as resolved, and the intervals do not
    /// hold; missing if it converged.
    #[serde(skip_serializing_if = "is_default")]
    pub descent: DescentEnd,
}

/// Whether a field is left out of JSON.
pub(super) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl Refined {
    /// Whether the data determine σ_t and the albedo at one g, but not that g.
    pub fn g_is_open(&self) -> bool {
        self.resolved_at_g && !self.resolved
    }
}

/// Results of the likelihood for a channel's profiles, in addition to the medium.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Likelihood {
    /// Sum of the squares of the residuals over their noise, outliers left out, and of the deviations of the nuisances
    /// from their priors.
    pub chi2: f64,
    /// Pixels less parameters of the medium.
    pub degrees_of_freedom: f64,
    /// Probability that noise alone makes χ² as large.
    pub probability: f64,
    /// Estimated nuisances of the set-up.
    pub nuisances: Vec<NuisanceEstimate>,
    /// Pixels that do not belong to the profile: dust, scratches, bubbles.
    pub outliers: Vec<OutlierPixel>,
    /// Ranges of x in which neighbouring pixels deviate together by more than noise explains.
    pub stretches: Vec<Stretch>,
    /// The Cramér–Rao bound of these pixels.
    pub bound: Bound,
    /// Error budget of the medium; empty if the data determine nothing.
    pub budget: Vec<SourceShare>,
    /// Uncertain quantities of the scene, as estimated; empty if it was taken as exact.
    pub scene: Vec<SceneEstimate>,
}

/// Prior and estimate of an uncertain quantity of the scene, in its unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneEstimate {
    /// Name, such as `gel thickness`.
    pub quantity: String,
    /// `mm`, `°`, or nothing for pure numbers.
    pub unit: String,
    /// The scope within which the quantity has this value.
    pub scope: Scope,
    /// The slab that it belongs to, by its nominal thickness.
    pub slab_mm: Option<f64>,
    pub value: f64,
    pub std_error: f64,
    /// Mean of its prior: the scene's value.
    pub prior: f64,
    pub prior_std_error: f64,
    /// The data pull the estimate beyond the range of the responses, where the true value may lie.
    pub at_end: bool,
}

impl SceneEstimate {
    /// Distance from the prior, in its standard deviations, above which the scene is in doubt.
    pub const CONFLICT: f64 = 3.0;

    /// Whether the data contradict the prior.
    pub fn is_conflict(&self) -> bool {
        (self.value - self.prior).abs() > Self::CONFLICT * self.prior_std_error
    }
}

/// A nuisance parameter of the set-up, with a prior, estimated along with the medium.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Nuisance {
    /// Factor on all profiles, 1/μ.
    Scale,
    /// Variance of the camera's blur, in mm².
    #[serde(rename = "blur_variance_mm2")]
    BlurVariance,
    /// Thickness of a slab in mm.
    #[serde(rename = "thickness_mm")]
    Thickness,
    /// Position of the edge in a profile, in mm.
    #[serde(rename = "origin_mm")]
    Origin,
    /// The profile's values are too large by this share.
    Gain,
    /// The profile's values are too large by this radiance factor.
    Zero,
    /// The light rises across the profile by this share per 10 mm.
    Slope,
    /// The thickness of the slab rises across the profile by this share per 10 mm.
    Wedge,
}

/// Prior and estimate of a nuisance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NuisanceEstimate {
    pub nuisance: Nuisance,
    /// The profile concerned, by its nominal thickness; none if all are.
    pub profile_mm: Option<f64>,
    pub value: f64,
    pub std_error: f64,
    /// Mean of its prior, as given or by default.
    pub prior: f64,
    pub prior_std_error: f64,
}

/// A pixel of a measurement that was given no weight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OutlierPixel {
    pub profile_mm: f64,
    pub x_mm: f64,
    /// In standard deviations of its noise; positive if it is too bright.
    pub deviation: f64,
}

/// Neighbouring pixels that deviate together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Stretch {
    pub profile_mm: f64,
    pub from_mm: f64,
    pub to_mm: f64,
    /// Their mean deviation over its standard deviation.
    pub deviation: f64,
}

/// The Cramér–Rao bound: 95 % intervals about the optimum that an ideal estimator would have, given the noise of the
/// pixels, the priors of the set-up and a dictionary without noise. Infinite ends are null in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bound {
    pub sigma_t_per_mm: Ends,
    pub albedo: Ends,
    pub g: Ends,
    pub reduced_scattering_per_mm: Ends,
    pub absorption_per_mm: Ends,
}

/// The ends of an interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Ends {
    pub low: f64,
    pub high: f64,
}

/// Whether a profile lies beyond all records of the dictionary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outside {
    Brighter,
    Darker,
}

/// A profile and the magnitude of its gradient per pixel of 10 mm / 360.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Curve {
    pub values: Vec<f64>,
    pub gradient: Vec<f64>,
}

/// The curves compared at one thickness.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FitCurves {
    pub thickness_mm: f64,
    pub x_mm: Vec<f64>,
    /// μ F_A on the dictionary's pixels.
    pub measured: Curve,
    /// The candidates' profiles, in their order.
    pub candidates: Vec<Curve>,
    pub refined: Option<Curve>,
    /// Measured less refined values over their standard errors, those of the records included; empty without likelihood.
    pub residuals: Vec<f64>,
    /// Indices of pixels that the likelihood leaves out, such as dust.
    pub left_out: Vec<u32>,
}

/// The answer for one channel.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelFit {
    pub channel: String,
    /// Records, best first.
    pub candidates: Vec<Candidate>,
    pub refined: Option<Refined>,
    pub outside: Option<Outside>,
    /// One per thickness, if requested.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub curves: Vec<FitCurves>,
}

/// The answers for one material.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MaterialFit {
    pub material: String,
    pub channels: Vec<ChannelFit>,
}

/// One value of Eq. 3's curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ScalePoint {
    pub mu: f64,
    /// (1/μ) Σ over materials and channels of the least error.
    pub error: f64,
}

/// The error of all materials at one anisotropy.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GError {
    pub g: f64,
    /// Eq. 3's error at μ*. With the likelihood: the least −2 ln L of all channels up to a constant, at the value of
    /// μ on the search's mesh next to the estimate.
    pub error: f64,
    /// The scale factor that would be the best with this anisotropy.
    pub best_mu: f64,
    /// The error at `best_mu`.
    pub best_mu_error: f64,
}

/// The search of Eq. 3.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScaleCurve {
    /// μ*: the least error.
    #[serde(flatten)]
    pub best: ScalePoint,
    /// Jackknife over materials and channels; none with fewer than two.
    pub std_error: Option<f64>,
    /// Second derivative of the relative error by μ at μ*: how sharp the minimum is.
    pub curvature: Option<f64>,
    /// μ* lies at an end of the values that were tried.
    pub at_end: bool,
    /// The anisotropy with the least error common to all materials, at μ*.
    pub best_g: f64,
    pub by_g: Vec<GError>,
    #[serde(rename = "curve")]
    pub points: Vec<ScalePoint>,
}

/// The parameters that all channels of a set of materials share, chosen by refined fits of all of them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Common {
    pub mu: f64,
    pub mu_std_error: f64,
    /// Open where the range of the search ends first; on both sides if the data do not determine μ.
    pub mu_interval: Interval,
    /// Whether μ was searched, not given.
    pub mu_chosen: bool,
    /// Anisotropy of all channels, or the mean of the materials; none if every channel has its own, or each wavelength.
    pub g: Option<f64>,
    /// Standard deviation of ln(1 − g) of a material about the mean, given or estimated, if there are several materials.
    pub g_spread: Option<f64>,
    /// Probability that media of one g make the materials' estimates differ as much (a likelihood-ratio test).
    pub g_equal_probability: Option<f64>,
    /// Standard deviation of the prior of the change of ln(1 − g) over 100 nm, if the channels of a material share g.
    pub g_change: Option<f64>,
    /// None if g was given, if the dictionary has one only, or if records were compared.
    pub g_interval: Option<Interval>,
    /// The objective with each anisotropy of the dictionary; empty if g was given.
    pub by_g: Vec<GError>,
}

/// Distances of one channel's measurement to all media of one anisotropy.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapLayer {
    pub g: f64,
    /// `[sigma_t][albedo]`.
    pub errors: Vec<Vec<f64>>,
    pub best: Candidate,
    /// The medium similar to the best of all layers, after Eqs. 4 and 6.
    #[serde(serialize_with = "without_g")]
    pub similar: Option<Medium>,
}

/// The distance over all media, Fig. 9.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DistanceMap {
    pub channel: String,
    pub sigma_t_per_mm: Vec<f64>,
    pub albedo: Vec<f64>,
    pub sample_ior: f64,
    /// The layer of the best medium.
    pub best_layer: usize,
    pub layers: Vec<MapLayer>,
}

/// Serialises a medium without its anisotropy, which the layer already contains.
#[expect(clippy::ref_option, reason = "serde passes the field as it is")]
fn without_g<S: Serializer>(medium: &Option<Medium>, serializer: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct WithoutG {
        sigma_t_per_mm: f64,
        albedo: f64,
    }
    let without_g = |m: &Medium| WithoutG { sigma_t_per_mm: m.sigma_t_per_mm(), albedo: m.albedo() };
    medium.as_ref().map(without_g).serialize(serializer)
}
