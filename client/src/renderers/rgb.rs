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

    /// OpenPBR 1.1: T, S and λ in mm with μ_t = −ln T/λ and μ_s = S/λ. With λ = 1/max μ_t, T is 1/e or more and S 1 or
    /// less, so that nothing is clamped.
    pub(super) fn open_pbr(&self) -> OpenPbr {
        let extinction: [f64; 3] = std::array::from_fn(|i| self.scattering[i] + self.absorption[i]);
        let depth = 1.0 / extinction.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        OpenPbr {
            depth,
            colour: extinction.map(|mu| libm::exp(-mu * depth)),
            scatter: self.scattering.map(|mu| mu * depth),
        }
    }
}

/// The transmission of an `open_pbr_surface`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OpenPbr {
    /// λ.
    pub depth: f64,
    /// T.
    pub colour: [f64; 3],
    /// S.
    pub scatter: [f64; 3],
}

/// `a, b, c` with nine digits: T is close to 1 where hardly anything is absorbed.
pub(super) fn triple(values: [f64; 3]) -> String {
    values.map(|v| format!("{v:.9}")).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::renderers::{blocks, tests::three_kinds};

    /// T, S and λ give back the coefficients by OpenPBR's formulas.
    #[test]
    fn open_pbr_gives_the_coefficients_back() {
        for block in &blocks(&three_kinds()) {
            let medium = RgbMedium::of(block);
            let OpenPbr { depth, colour, scatter } = medium.open_pbr();
            for i in 0..3 {
                assert!((0.3..=1.0).contains(&colour[i]) && (0.0..=1.0).contains(&scatter[i]));
                let (extinction, scattering) = (-libm::log(colour[i]) / depth, scatter[i] / depth);
                assert!((scattering / medium.scattering[i] - 1.0).abs() < 1e-12);
                assert!((extinction - scattering - medium.absorption[i]).abs() < 1e-12 / depth, "{medium:?}");
            }
        }
    }
}
