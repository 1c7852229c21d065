//! Formats media for Mitsuba 3, as a Python dictionary and as XML.
//!
//! The plugin is `homogeneous` with a nested `hg`, or a `blendphase` of two, whose weight is that of the second: σ_t is in
//! inverse scene units and multiplied by `scale`, which is 1000 for coefficients per mm in a scene in metres. Source:
//! Mitsuba's documentation, "Participating media" (mitsuba.readthedocs.io, `generated/plugins_media`) and
//! `src/media/homogeneous.cpp`; tried with 3.9.1:
//!
//! - An rgb value is a reflectance, and above 1 an error (mitsuba3 issue 1620). The ways around it, `unbounded` of the
//!   plugin `srgb` and a nested `constvolume`, are right in RGB variants and silently wrong in spectral ones, where
//!   such a colour is cut off at 1. Here σ_t is divided by a power of ten and `scale` multiplied by it, which is
//!   right in RGB variants and as near in spectral ones as the smooth spectrum that Mitsuba makes of a colour.
//! - A spectrum may exceed 1, but only in spectral variants; the others convert it to a colour and clamp that.
//! - A spectrum needs two entries, and a number must be a float: an integer is an error.

use optics_model::Medium;
use optics_model::fit::MaterialFit;
use optics_model::phase::SecondLobe;

use super::{BlockPhase, MediumBlock, Values, blocks};

const UNITS: &str =
    "Coefficients are per mm, for a scene in mm; for one in metres multiply each scale by 1000.";

/// Bright media scatter light hundreds of times: a limited depth makes them too dark without a word.
const INTEGRATOR: &str = "volpathmis with max_depth -1 and rr_depth 10000: light is scattered hundreds of times, and a \
    limit of 200 makes bright media some 10 % too dark";

/// A Python assignment, `media = {…}`, whose entries belong in the dictionary of a scene.
pub(crate) fn mitsuba_dict(fits: &[MaterialFit]) -> String {
    let mut text = format!(
        "# Measured media for Mitsuba 3: {{\"type\": \"scene\", **media, …}}\n# {UNITS}\n\
         # Render with {INTEGRATOR}.\nmedia = {{\n"
    );
    for block in blocks(fits) {
        let (name, scale) = (&block.name, scale(&block.values));
        let phase = python_phase(block.phase);
        let sigma_t = python(&block.values, |c| c.sigma_t_per_mm() / scale);
        let albedo = python(&block.values, Medium::albedo);
        text += &notes(&block).map(|note| format!("    # {note}\n")).collect::<String>();
        text += &format!(
            "    \"{name}\": {{
        \"type\": \"homogeneous\",
        \"sigma_t\": {sigma_t},
        \"albedo\": {albedo},
        \"scale\": {scale:?},
        \"phase\": {phase},
    }},\n"
        );
    }
    text + "}\n"
}

/// A scene that contains only media: it can be loaded by itself, or included by another scene, whose shapes then refer
/// to the media by their ids.
pub(crate) fn mitsuba_xml(fits: &[MaterialFit]) -> String {
    let mut text = format!(
        "<!-- Measured media for Mitsuba 3: put <include filename=\"media.xml\"/> into a scene, and into a shape
     <ref name=\"interior\" id=\"…\"/> with the id of a medium. -->
<!-- Render with {INTEGRATOR}. Where sigma_t differs between channels volpath is noisy. -->
<!-- <integrator type=\"volpathmis\"><integer name=\"max_depth\" value=\"-1\"/><integer name=\"rr_depth\" value=\"10000\"/></integrator> -->
<!-- {UNITS} -->
<scene version=\"3.0.0\">\n"
    );
    for block in blocks(fits) {
        let (name, scale) = (&block.name, scale(&block.values));
        let phase = xml_phase(block.phase);
        let sigma_t = xml("sigma_t", &block.values, |c| c.sigma_t_per_mm() / scale);
        let albedo = xml("albedo", &block.values, Medium::albedo);
        text += &notes(&block).map(|note| xml_comment(&note, "    ")).collect::<String>();
        text += &format!(
            "    <medium type=\"homogeneous\" id=\"{name}\">
        {sigma_t}
        {albedo}
        <float name=\"scale\" value=\"{scale:?}\"/>
{phase}
    </medium>\n"
        );
    }
    text + "</scene>\n"
}

/// g₁, and b and g₂ of a second lobe.
fn lobes(phase: BlockPhase) -> (f64, Option<SecondLobe>) {
    (phase.second_lobe.map_or(phase.g, |second| second.first(phase.g)), phase.second_lobe)
}

fn python_phase(phase: BlockPhase) -> String {
    let (g, second) = lobes(phase);
    let Some(second) = second else { return format!("{{\"type\": \"hg\", \"g\": {g:?}}}") };
    format!(
        "{{
            \"type\": \"blendphase\",
            \"weight\": {:?},
            \"first\": {{\"type\": \"hg\", \"g\": {g:?}}},
            \"second\": {{\"type\": \"hg\", \"g\": {:?}}},
        }}",
        second.weight(),
        second.g()
    )
}

fn xml_phase(phase: BlockPhase) -> String {
    let (g, second) = lobes(phase);
    let lobe = |g: f64, indent: &str| {
        format!(
            "{indent}<phase type=\"hg\">\n{indent}    <float name=\"g\" value=\"{g:?}\"/>\n{indent}</phase>"
        )
    };
    let Some(second) = second else { return lobe(g, "        ") };
    let (inner, weight) = ("            ", second.weight());
    format!(
        "        <phase type=\"blendphase\">\n{inner}<float name=\"weight\" value=\"{weight:?}\"/>\n{}\n{}\n        </phase>",
        lobe(g, inner),
        lobe(second.g(), inner)
    )
}

fn notes(block: &MediumBlock) -> impl Iterator<Item = String> {
    let own = match block.values {
        Values::Rgb(_) => Some(
            "sigma_t is in units of scale: Mitsuba takes rgb up to 1. Spectral variants smooth the channels.",
        ),
        Values::Spectrum(_) => Some("For spectral variants only: the others clamp these spectra."),
        Values::Scalar(_) => None,
    };
    block.notes.iter().cloned().chain(own.map(str::to_owned))
}

/// The power of ten by which rgb values of σ_t must be divided to be at most 1.
fn scale(values: &Values) -> f64 {
    let mut scale = 1.0;
    if let Values::Rgb(values) = values {
        let greatest = values.iter().map(Medium::sigma_t_per_mm).fold(0.0, f64::max);
        while scale < greatest {
            scale *= 10.0;
        }
    }
    scale
}

fn python(values: &Values, value: impl Fn(&Medium) -> f64) -> String {
    match values {
        Values::Rgb(rgb) => format!("{{\"type\": \"rgb\", \"value\": {:?}}}", rgb.each_ref().map(value)),
        Values::Spectrum(samples) => {
            let pairs: Vec<_> = samples.iter().map(|(nm, c)| format!("({nm}, {:?})", value(c))).collect();
            format!("{{\"type\": \"spectrum\", \"value\": [{}]}}", pairs.join(", "))
        }
        Values::Scalar(c) => format!("{:?}", value(c)),
    }
}

fn xml(name: &str, values: &Values, value: impl Fn(&Medium) -> f64) -> String {
    let (tag, list) = match values {
        Values::Rgb(rgb) => ("rgb", rgb.iter().map(|c| format!("{:?}", value(c))).collect::<Vec<_>>()),
        Values::Spectrum(samples) => {
            ("spectrum", samples.iter().map(|(nm, c)| format!("{nm}:{:?}", value(c))).collect())
        }
        Values::Scalar(c) => ("float", vec![format!("{:?}", value(c))]),
    };
    format!("<{tag} name=\"{name}\" value=\"{}\"/>", list.join(", "))
}

/// XML escapes nothing in a comment and forbids two hyphens in a row.
pub(super) fn xml_comment(text: &str, indent: &str) -> String {
    let mut text = text.to_owned();
    while text.contains("--") {
        text = text.replace("--", "- -");
    }
    format!("{indent}<!-- {text} -->\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The scale is a power of ten, and 1 for values that need none.
    #[test]
    fn scale_brings_rgb_to_at_most_one() {
        let scale_for = |sigma_t: [f64; 3]| {
            scale(&Values::Rgb(sigma_t.map(|sigma_t| Medium::new(sigma_t, 0.5, 0.0).unwrap())))
        };
        let scales =
            [[1e-6, 1e-6, 1e-6], [0.2, 1.0, 0.1], [0.2, 1.1, 0.1], [10.0, 2.0, 3.0], [2.0, 3.0, 10.1]];
        assert_eq!(scales.map(scale_for), [1.0, 1.0, 10.0, 10.0, 100.0]);
    }
}
