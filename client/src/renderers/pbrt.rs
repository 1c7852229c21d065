//! Formats media for pbrt-v4: a `MakeNamedMedium` for each medium.
//!
//! σ_a = σ_t (1 − α) and σ_s = σ_t α with the albedo α, both multiplied by `scale`, which is 1 unless given; the
//! transformation at the place of the statement does not change them. Source: "pbrt-v4 Input File Format"
//! (pbrt.org/fileformat-v4), and of mmp/pbrt-v4 `HomogeneousMedium::Create` in `src/pbrt/media.cpp`,
//! `extractSpectrumArray` in `paramdict.cpp` and the tokenizer in `parser.cpp`:
//!
//! - There is no σ_t and no albedo: an unknown parameter stops pbrt. Without `sigma_a` or
//!   `sigma_s` that coefficient is 1.
//! - `preset` silently replaces both coefficients by built-in measured ones per mm, whose scattering is the reduced one,
//!   meant for g = 0. It must not be added to a measured medium.
//! - pbrt renders spectrally. It converts an rgb value to a smooth spectrum, in which the channels are no longer separate,
//!   and equal values are not quite constant; so a scalar is written as a spectrum, as in pbrt's own scenes.

use optics_model::Medium;
use optics_model::fit::MaterialFit;

use super::{RENDERED_NM, Values, blocks};

/// Statements that are valid before and after `WorldBegin`.
pub(crate) fn pbrt(fits: &[MaterialFit]) -> String {
    let mut text = "# Measured media for pbrt-v4.\n\
        # Coefficients are per mm, for a scene in mm; for one in metres set each scale to 1000.\n\
        # Light is scattered hundreds of times: Integrator \"volpath\" \"integer maxdepth\" 10000 \
        loses none.\n"
        .to_owned();
    for block in blocks(fits) {
        text += &block.notes.iter().map(|note| format!("# {note}\n")).collect::<String>();
        if let Values::Rgb(_) = block.values {
            text += "# pbrt turns rgb into smooth spectra: channels hold nearly, not exactly.\n";
        }
        let (name, g) = (&block.name, block.phase.g);
        if let Some(second) = block.phase.second_lobe {
            let (first, b, of_second) = (second.first(g), second.weight(), second.g());
            text += &format!(
                "# pbrt's media have one lobe: g is the mean cosine of {:.4} HG({first:.4}) + {b:.4} HG({of_second:.4}).\n",
                1.0 - b
            );
        }
        let sigma_a = parameter("sigma_a", &block.values, Medium::absorption_per_mm);
        let sigma_s = parameter("sigma_s", &block.values, |c| c.sigma_t_per_mm() * c.albedo());
        text += &format!(
            "MakeNamedMedium \"{name}\"
    \"string type\" \"homogeneous\"
    {sigma_a}
    {sigma_s}
    \"float g\" {g:?}
    \"float scale\" 1.0\n"
        );
    }
    text
}

/// The coefficients are computed from the measured values, which leaves rounding errors in their last digits: they are
/// written in single precision, as pbrt reads them.
fn parameter(name: &str, values: &Values, coefficient: impl Fn(&Medium) -> f64) -> String {
    let number = |c: &Medium| format!("{:?}", coefficient(c) as f32);
    let (kind, list): (_, Vec<_>) = match values {
        Values::Rgb(rgb) => ("rgb", rgb.iter().map(number).collect()),
        Values::Spectrum(samples) => {
            ("spectrum", samples.iter().map(|(nm, c)| format!("{nm} {}", number(c))).collect())
        }
        Values::Scalar(c) => {
            let (from, to) = RENDERED_NM;
            ("spectrum", [from, to].map(|nm| format!("{nm} {}", number(c))).into())
        }
    };
    format!("\"{kind} {name}\" [ {} ]", list.join("  "))
}
