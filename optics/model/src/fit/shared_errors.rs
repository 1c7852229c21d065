//! Errors that the media of a measurement share with each other and with the quantities of their set-up.

/// Estimated errors of a joint fit as linear functions of independent sources of variance 1: entry k of a row is the change
/// by one standard deviation of source k, so the covariance of two numbers is the dot product of their rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SharedErrors {
    /// Number of sources.
    pub sources: usize,
    /// By material, channel and source, the changes of (ln σ_t, √(1 − α), ln(1 − g), b, g₂), with weight b and anisotropy
    /// g₂ of the second lobe. What remains of a channel's own covariance is independent of all others.
    pub media: Vec<[f64; Self::OF_MEDIUM]>,
    /// Quantities of the scene, in its order.
    pub scene: Vec<SetUpDifference>,
}

/// The estimate of a quantity of the scene that a session or a material has.
#[derive(Debug, Clone, PartialEq)]
pub struct SetUpDifference {
    /// Index into the scene's priors.
    pub prior: usize,
    /// Index of the material; None for one value in the whole session.
    pub material: Option<usize>,
    /// Index into the scene's channels; None for one value in all of them.
    pub channel: Option<usize>,
    /// Difference from the scene's value, in the unit of the quantity.
    pub difference: f64,
    /// Its changes by source.
    pub changes: Vec<f64>,
}

impl SharedErrors {
    /// Numbers of a medium.
    pub const OF_MEDIUM: usize = 5;

    /// The changes of a channel, counted over all materials; none if the fit had none.
    pub fn of_channel(&self, channel: usize) -> &[[f64; Self::OF_MEDIUM]] {
        self.media.get(channel * self.sources..(channel + 1) * self.sources).unwrap_or_default()
    }
}
