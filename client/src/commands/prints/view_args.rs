//! The arguments of all verbs that predict prints: geometry, illuminant and observer.

use clap::{Args, ValueEnum};
use farm_lab::colour::{Illuminant, StandardObserver, Viewing};

use crate::prints::geometry::Geometry;
use crate::prints::view::ViewOptions;

#[derive(Debug, Clone, Args)]
pub(super) struct ViewArgs {
    /// Lamps and sensor [default: session; 45:0 for a chart of a spectrophotometer].
    #[arg(long, value_enum)]
    geometry: Option<Geometry>,
    /// GGX roughness of a bare print's faces; 0 is polished [default: that of the measured samples].
    #[arg(long, value_name = "ALPHA", allow_negative_numbers = true)]
    roughness: Option<f64>,
    /// Illuminant of colours, for channels that are wavelengths.
    #[arg(long, value_enum, default_value = "d50")]
    illuminant: IlluminantArg,
    /// Observer of colours: 2 or 10 degrees.
    #[arg(long, value_enum, default_value = "2")]
    observer: ObserverArg,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum IlluminantArg {
    D50,
    D65,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ObserverArg {
    #[value(name = "2")]
    Two,
    #[value(name = "10")]
    Ten,
}

impl ViewArgs {
    pub(super) fn options(&self) -> ViewOptions {
        self.options_or(Geometry::Session)
    }

    /// The options with a geometry where none is given.
    pub(super) fn options_or(&self, geometry: Geometry) -> ViewOptions {
        let geometry = self.geometry.unwrap_or(geometry);
        ViewOptions { geometry, roughness: self.roughness, viewing: self.viewing() }
    }

    fn viewing(&self) -> Viewing {
        let illuminant = match self.illuminant {
            IlluminantArg::D50 => Illuminant::D50,
            IlluminantArg::D65 => Illuminant::D65,
        };
        let observer = match self.observer {
            ObserverArg::Two => StandardObserver::TwoDegrees,
            ObserverArg::Ten => StandardObserver::TenDegrees,
        };
        Viewing { illuminant, observer }
    }
}
