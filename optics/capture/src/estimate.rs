//! Numbers with standard errors, and the sources of correlated errors.

/// A number with its standard error.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Estimate {
    pub value: f64,
    pub std_error: f64,
}

impl Estimate {
    pub fn new(value: f64, std_error: f64) -> Self {
        Self { value, std_error }
    }
}

/// Source of a correlated error of profiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Source {
    /// Photons and electronics; independent in each bin.
    Noise,
    /// Certificate of the white reference: relative, common to all profiles.
    WhiteReference,
    /// Drift of the light between the shots of the reference and of the sample: relative, common to a sample.
    Drift,
    /// Differences of brightness between mountings: relative, of one sample.
    Mounting,
    /// Remaining nonlinearity between numbers and light: relative.
    Linearity,
    /// Black level: as a radiance factor.
    Black,
    /// Stray light: as a radiance factor.
    Glare,
    /// Slope of the light across the crop: relative, per 10 mm.
    Slope,
    /// Place of the edge, in mm.
    Origin,
    /// Millimetres per pixel: relative.
    Scale,
    /// Thickness of the slab, in mm.
    Thickness,
    /// Blur of the camera, in mm.
    Blur,
    /// Reflectance of the board's light side.
    RhoLight,
    /// Reflectance of the board's dark side.
    RhoDark,
}

impl Source {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Noise => "noise",
            Self::WhiteReference => "white_reference",
            Self::Drift => "drift",
            Self::Mounting => "mounting",
            Self::Linearity => "linearity",
            Self::Black => "black",
            Self::Glare => "glare",
            Self::Slope => "slope",
            Self::Origin => "origin",
            Self::Scale => "scale",
            Self::Thickness => "thickness",
            Self::Blur => "blur",
            Self::RhoLight => "rho_light",
            Self::RhoDark => "rho_dark",
        }
    }

    /// Unit of its standard error.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Noise | Self::Black | Self::Glare => "radiance factor",
            Self::WhiteReference | Self::Drift | Self::Mounting | Self::Linearity | Self::Scale => "relative",
            Self::Slope => "relative per 10 mm",
            Self::Origin | Self::Thickness | Self::Blur => "mm",
            Self::RhoLight | Self::RhoDark => "reflectance",
        }
    }
}

/// One line of an error budget.
#[derive(Debug, Clone, PartialEq)]
pub struct Contribution {
    pub source: Source,
    /// Standard error per channel, in [`Source::unit`].
    pub std_error: Vec<f64>,
}
