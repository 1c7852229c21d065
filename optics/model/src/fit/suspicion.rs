//! Names the likely cause of a misfit, with its size.

use serde::Serialize;

/// Misfit above which a fit is reported not to explain its measurement.
pub const MISFIT: f64 = 2.0;

/// The most likely single cause of residuals beyond the noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Suspicion {
    pub cause: Cause,
    /// The profile concerned; none if all are.
    pub thickness_mm: Option<f64>,
    /// Amount in the unit of the cause.
    pub amount: f64,
    /// The misfit that would be left without it.
    pub misfit_left: f64,
}

/// A possible fault of a measurement, or of the scene that it is compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// No single cause tried explains it.
    Unknown,
    /// Offset of the edge from x = 0, in mm.
    #[serde(rename = "edge_offset_mm")]
    EdgeOffset,
    /// The values are too large by this share.
    Gain,
    /// The values are too large by this radiance factor.
    Zero,
    /// The light rises from x = −5 mm to 5 mm by this share.
    Slope,
    /// The edge is blurred by a camera: standard deviation in mm.
    #[serde(rename = "blur_mm")]
    Blur,
    /// The values are coded as for a screen (sRGB), not linear.
    GammaCoded,
    /// The values are this power of linear ones, in all profiles of all materials.
    Exponent,
    /// The profiles of the thicknesses are exchanged.
    ThicknessesSwapped,
    /// A slab has another thickness than stated, in mm: the mean, if there are several.
    #[serde(rename = "thickness_mm")]
    Thickness,
    /// The thickness of a slab rises by this share from x = −5 mm to 5 mm.
    Wedge,
}
