//! Media as three colours, for programs that take neither spectra nor several media for one material.

use super::{MediumBlock, Values};

/// Wavelengths that stand for red, green and blue in a spectrum, in nm.
const COLOURS_NM: [f64; 3] = [610.0, 550.0, 465.0];

/// A note on spectra.
const NEAREST: &str = "Red, green and blue are the measured wavelengths next to 610, 550 and 465 nm.";

/// Coefficients of red, green and blue, in 1/mm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RgbMedium<'a> {
    pub name: &'a str,
    pub notes: Vec<String>,
    pub scattering: [f64; 3],
    pub absorption: [f64; 3],
    pub g: f64,
    pub ior: f64,
}

impl<'a> RgbMedium<'a> {
    pub(super) fn of(block: &'a MediumBlock) -> Self {
        let mut notes = block.notes.clone();
        let media = match &block.values {
            Values::Rgb(media) => *media,
            Values::Scalar(medium) => [*medium; 3],
            Values::Spectrum(samples) => {
                notes.push(NEAREST.to_owned());
                COLOURS_NM.map(|nm| {
                    let off = |at: &f64| (at - nm).abs();
                    let nearest = samples.iter().min_by(|a, b| off(&a.0).total_cmp(&off(&b.0)));
                    nearest.expect("a spectrum has samples").1
                })
            }
        };
        if let Some(second) = block.phase.second_lobe {
            let (first, b) = (second.first(block.phase.g), second.weight());
            notes.push(format!(
                "One lobe: g is the mean cosine of {:.4} HG({first:.4}) + {b:.4} HG({:.4}).",
                1.0 - b,
                second.g()
            ));
        }
        Self {
            name: &block.name,
            notes,
            scattering: media.map(|m| m.sigma_t_per_mm() * m.albedo()),
            absorption: media.map(|m| m.absorption_per_mm()),
            g: block.phase.g,
            ior: block.ior,
        }
    }
}

/// `a, b, c` with nine digits: T is close to 1 where hardly anything is absorbed.
pub(super) fn triple(values: [f64; 3]) -> String {
    values.map(|v| format!("{v:.9}")).join(", ")
}
