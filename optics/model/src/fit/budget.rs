//! The error budget of a medium: sources of error, and their shares of its variances.

use serde::Serialize;

/// A source of error of a medium.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorSource {
    /// Noise of the channel's own pixels.
    Noise,
    /// Noise of the dictionary's records.
    Dictionary,
    /// Thicknesses of the slabs.
    Thickness,
    /// Place of the edge in each profile.
    Origin,
    /// Blur of the camera.
    Blur,
    /// Scale of each profile.
    Gain,
    /// Zero of each profile.
    Zero,
    /// Rise of the light across each profile.
    Slope,
    /// Slope of the thickness across each slab.
    Wedge,
    /// Factor common to all profiles, μ.
    Scale,
    /// Errors of other channels and materials, through the parameters that they share with this one.
    OtherChannels,
    /// The anisotropy, which the data have to determine as well.
    G,
    /// An uncertain quantity of the scene.
    Scene,
    /// A source that this version does not have.
    Unknown,
}

/// Shares of the variances of ln σ_t, √(1 − α), ln σ_s(1 − g) and √σ_a that are due to a source: the shares of all
/// sources add up to 1. They are (response of the estimate to the source × standard error of the source)² with g held;
/// the share of g is the growth of the variance when g is left free.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SourceShare {
    pub source: ErrorSource,
    /// Which quantity, if the source is one of the scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quantity: Option<String>,
    pub sigma_t: f64,
    pub albedo: f64,
    pub reduced_scattering: f64,
    pub absorption: f64,
}
