//! Formats measured media for renderers, ready to paste: Mitsuba 3 (Python and XML), pbrt-v4 and Blender.
//!
//! Mitsuba and pbrt describe a homogeneous medium by coefficients that may differ between channels or wavelengths, and
//! one phase function; Blender has three colours. A material becomes one medium where its channels are R, G and B
//! with a common phase function, or wavelengths in nm, whose g may differ; and one medium per channel otherwise.

mod blender;
mod mitsuba;
mod pbrt;
mod rgb;
mod similar;

use std::collections::HashSet;

use optics_model::Medium;
use optics_model::fit::{ChannelFit, MaterialFit, Refined};
use optics_model::measurement::wavelength_nm;
use optics_model::phase::SecondLobe;

pub(crate) use self::blender::blender;
pub(crate) use self::mitsuba::{mitsuba_dict, mitsuba_xml};
pub(crate) use self::pbrt::pbrt;
use similar::{SIMILAR, mean_g, with_common_g};

/// Whether a measurement determines a channel's medium.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ChannelState {
    Resolved,
    /// σ_t and the albedo are valid together with this g only.
    GOpen,
    /// The values are only the best ones found.
    Unresolved,
}

impl ChannelState {
    fn of(refined: &Refined) -> Self {
        if refined.g_is_open() {
            Self::GOpen
        } else if refined.resolved {
            Self::Resolved
        } else {
            Self::Unresolved
        }
    }
}

/// One refined channel of a measured material.
#[derive(Debug)]
struct RenderedChannel<'a> {
    /// R, G or B, a wavelength in nm, or any name.
    name: &'a str,
    medium: Medium,
    second_lobe: Option<SecondLobe>,
    ior: f64,
    state: ChannelState,
}

impl<'a> RenderedChannel<'a> {
    fn of(fit: &'a ChannelFit) -> Option<Self> {
        let refined = fit.refined.as_ref()?;
        let (medium, second_lobe) = (refined.best.medium, refined.second_lobe);
        let ior = refined.best.sample_ior;
        Some(Self { name: &fit.channel, medium, second_lobe, ior, state: ChannelState::of(refined) })
    }
}

/// Wavelengths that renderers sample. They take a spectrum for zero outside its values, where a medium would vanish.
const RENDERED_NM: (f64, f64) = (360.0, 830.0);

/// Names with another meaning among the keys of a scene.
const RESERVED: [&str; 2] = ["id", "type"];

/// One medium of a renderer.
#[derive(Debug)]
struct MediumBlock {
    /// An ASCII identifier, unique in its file: it needs no quoting in Python, XML and pbrt.
    name: String,
    /// Lines for people, for a comment: names in them are quoted, with control characters escaped.
    notes: Vec<String>,
    values: Values,
    phase: BlockPhase,
    /// Refractive index.
    ior: f64,
}

/// The phase function of a medium.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct BlockPhase {
    /// The mean cosine.
    g: f64,
    second_lobe: Option<SecondLobe>,
}

#[derive(Debug, PartialEq)]
enum Values {
    /// In the order R, G, B.
    Rgb([Medium; 3]),
    /// By increasing wavelength in nm, over the whole range that renderers sample.
    Spectrum(Vec<(f64, Medium)>),
    Scalar(Medium),
}

fn blocks(fits: &[MaterialFit]) -> Vec<MediumBlock> {
    let mut names = Names::default();
    let mut blocks = Vec::new();
    for fit in fits {
        let channels: Vec<_> = fit.channels.iter().filter_map(RenderedChannel::of).collect();
        let block_phase = |c: &RenderedChannel| BlockPhase { g: c.medium.g(), second_lobe: c.second_lobe };
        let phase = channels.first().map(block_phase).unwrap_or_default();
        let is_common = channels.iter().all(|c| block_phase(c) == phase);
        let joint = if is_common { rgb(&channels).or_else(|| spectrum(&channels)) } else { None };
        let with_one_g = || Some((spectrum(&with_common_g(&channels)?)?, true));
        if let Some(((values, what), is_similar)) = joint.map(|joint| (joint, false)).or_else(with_one_g) {
            let mut notes = vec![format!("{:?}: {what}", fit.material)];
            notes.extend(is_similar.then(|| SIMILAR.to_owned()));
            let phase = BlockPhase { g: if is_similar { mean_g(&channels) } else { phase.g }, ..phase };
            notes.extend(doubts(&channels));
            let (name, ior) = (names.take(&fit.material), channels[0].ior);
            blocks.push(MediumBlock { name, notes, values, phase, ior });
            continue;
        }
        for channel in &channels {
            let mut notes = vec![format!("{:?}: channel {:?}", fit.material, channel.name)];
            notes.extend(doubts(std::slice::from_ref(channel)));
            if !is_common {
                let note =
                    "The channels differ in phase function and a medium takes one: one medium per channel.";
                notes.push(note.to_owned());
            }
            let name = names.take(&format!("{}_{}", fit.material, channel.name));
            let values = Values::Scalar(channel.medium);
            blocks.push(MediumBlock { name, notes, values, phase: block_phase(channel), ior: channel.ior });
        }
    }
    blocks
}

/// The values of exactly R, G and B, and their description.
fn rgb(channels: &[RenderedChannel]) -> Option<(Values, String)> {
    let find = |name| channels.iter().find(|c| c.name == name).map(|c| c.medium);
    let values = [find("R")?, find("G")?, find("B")?];
    (channels.len() == values.len()).then(|| (Values::Rgb(values), "R, G, B".to_owned()))
}

/// The values of channels that are all distinct wavelengths, and their description.
fn spectrum(channels: &[RenderedChannel]) -> Option<(Values, String)> {
    let sample = |c: &RenderedChannel| Some((wavelength_nm(c.name)?, c.medium));
    let mut samples = channels.iter().map(sample).collect::<Option<Vec<(f64, _)>>>()?;
    samples.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    if samples.windows(2).any(|pair| pair[0].0 == pair[1].0) {
        return None;
    }
    let (&(first_nm, first), &(last_nm, last)) = (samples.first()?, samples.last()?);
    let range =
        if first_nm == last_nm { format!("at {first_nm}") } else { format!("from {first_nm} to {last_nm}") };
    if first_nm > RENDERED_NM.0 {
        samples.insert(0, (RENDERED_NM.0, first));
    }
    if last_nm < RENDERED_NM.1 {
        samples.push((RENDERED_NM.1, last));
    }
    let what = format!("spectra, measured {range} nm and held constant beyond");
    Some((Values::Spectrum(samples), what))
}

/// Notes on values that the measurement does not determine.
fn doubts(channels: &[RenderedChannel]) -> Vec<String> {
    let names = |state: ChannelState| {
        let names = channels.iter().filter(|c| c.state == state).map(|c| format!("{:?}", c.name));
        names.collect::<Vec<_>>().join(", ")
    };
    let (unresolved, open) = (names(ChannelState::Unresolved), names(ChannelState::GOpen));
    let mut doubts = Vec::new();
    if !unresolved.is_empty() {
        doubts.push(format!("Unresolved: the measurement does not determine {unresolved}; best values."));
    }
    if !open.is_empty() {
        doubts.push(format!("g open: sigma_t and albedo of {open} are valid for this g only."));
    }
    doubts
}

/// The names of the media in a file.
#[derive(Debug, Default)]
struct Names(HashSet<String>);

impl Names {
    /// A new identifier like `wanted`.
    fn take(&mut self, wanted: &str) -> String {
        let base = identifier(wanted);
        let mut name = base.clone();
        let mut n = 1;
        while !self.0.insert(name.clone()) {
            n += 1;
            name = format!("{base}_{n}");
        }
        name
    }
}

/// ASCII letters, digits and single underscores, beginning with a letter. Mitsuba reserves leading underscores and
/// gives `.` and `$` a meaning.
fn identifier(text: &str) -> String {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let name = words.collect::<Vec<_>>().join("_");
    if name.is_empty() {
        "medium".to_owned()
    } else if name.starts_with(|c: char| c.is_ascii_digit()) || RESERVED.contains(&name.as_str()) {
        format!("medium_{name}")
    } else {
        name
    }
}

#[cfg(test)]
mod tests {
    use farm_figures::testing;

    use super::*;
    use crate::testing::is_stable;

    fn channel(name: &str, sigma_t_per_mm: f64, albedo: f64) -> ChannelFit {
        with_g(testing::channel(name, sigma_t_per_mm, 1.0), albedo, 0.4)
    }

    fn with_g(mut channel: ChannelFit, albedo: f64, g: f64) -> ChannelFit {
        let best = &mut channel.refined.as_mut().unwrap().best;
        best.medium = Medium::new(best.medium.sigma_t_per_mm(), albedo, g).unwrap();
        channel
    }

    fn with_lobe(mut channel: ChannelFit, weight: f64) -> ChannelFit {
        channel.refined.as_mut().unwrap().second_lobe = Some(SecondLobe::new(weight, -0.5).unwrap());
        channel
    }

    fn medium(material: &str, channels: Vec<ChannelFit>) -> MaterialFit {
        MaterialFit { material: material.to_owned(), channels }
    }

    /// One medium of each kind: unsorted colours of which one is unresolved, wavelengths, and a name.
    pub(super) fn three_kinds() -> Vec<MaterialFit> {
        let mut green = channel("G", 5.0, 0.99);
        let refined = green.refined.as_mut().unwrap();
        (refined.resolved, refined.resolved_at_g) = (false, false);
        vec![
            medium("Clear resin", vec![channel("B", 4.0, 0.98), channel("R", 6.0, 0.9991), green]),
            medium("Grey", vec![channel("650", 7.5, 0.5), channel("450", 9.0, 0.25)]),
            medium("Wax", vec![channel("mean", 1e-6, 1.0)]),
        ]
    }

    fn names(media: &[MaterialFit]) -> Vec<String> {
        blocks(media).into_iter().map(|b| b.name).collect()
    }

    /// Media of each kind, and one of two lobes whose g is open, as every renderer reads them; `FARM_TEST_ACCEPT=1` writes
    /// the files.
    #[test]
    fn files_for_renderers_are_stable() {
        let mut media = three_kinds();
        let mut open = with_lobe(channel("R", 6.0, 0.9991), 0.2);
        open.refined.as_mut().unwrap().resolved = false;
        media.push(medium("white", vec![open]));
        for (name, text) in [
            ("mitsuba-dict", mitsuba_dict(&media)),
            ("mitsuba-xml", mitsuba_xml(&media)),
            ("pbrt", pbrt(&media)),
            ("blender", blender(&media)),
        ] {
            is_stable(&format!("renderers/tests/{name}.txt"), &text);
        }
    }

    /// Names can end neither the comments nor the quotes that contain them.
    #[test]
    fn names_cannot_escape_comments_or_quotes() {
        let media = [medium(
            "x --> <scene> \n--- \" \"Skin1\n\rShape \"y\u{2028}\u{202e}\0",
            vec![channel("c", 1.0, 0.5)],
        )];
        let xml = mitsuba_xml(&media);
        let document = roxmltree::Document::parse(&xml).unwrap();
        assert_eq!(document.root_element().tag_name().name(), "scene");
        assert_eq!(document.descendants().filter(|n| n.has_tag_name("medium")).count(), 1, "{xml}");
        for line in xml.lines().filter_map(|line| line.trim_start().strip_prefix("<!--")) {
            assert!(!line.trim_end_matches("-->").contains("--"), "{line}");
        }
        let python = mitsuba_dict(&media);
        assert!(python.lines().nth(4).is_some_and(|line| line.starts_with("    # ")), "{python}");
        assert_eq!(python.lines().nth(5), Some(r#"    "x_scene_Skin1_Shape_y_c": {"#));
        let pbrt = pbrt(&media);
        let statements: Vec<_> = pbrt.lines().filter(|line| !line.starts_with('#')).collect();
        assert_eq!(statements[0], r#"MakeNamedMedium "x_scene_Skin1_Shape_y_c""#);
        assert!(statements[1..].iter().all(|line| line.starts_with("    \"")), "{pbrt}");
        assert!(!pbrt.contains('\r'), "{pbrt:?}");
        assert!(
            blocks(&media)[0].notes[0]
                .starts_with(r#""x --> <scene> \n--- \" \"Skin1\n\rShape \"y\u{2028}\u{202e}\0": "#)
        );
    }

    /// The channels R, G and B are sorted to one medium; it needs all three and no other.
    #[test]
    fn rgb_needs_exactly_three_channels() {
        for (channels, expected) in
            [("B R G", "m"), ("R G", "m_R m_G"), ("R G G", "m_R m_G m_G_2"), ("R G B B", "m_R m_G m_B m_B_2")]
        {
            let channels = channels.split(' ').map(|c| channel(c, 1.0, 0.5)).collect();
            assert_eq!(names(&[medium("m", channels)]).join(" "), expected);
        }
    }

    /// Spectra increase in wavelength and reach the ends that renderers sample.
    #[test]
    fn spectra_increase_to_the_renderer_ends() {
        let samples = |wavelengths: &str| {
            let channels: Vec<_> =
                wavelengths.split(',').zip(1..).map(|(w, i)| channel(w, f64::from(i), 0.5)).collect();
            let rendered = channels.iter().filter_map(RenderedChannel::of).collect::<Vec<_>>();
            let Values::Spectrum(samples) = spectrum(&rendered)?.0 else { return None };
            Some(samples.iter().map(|(nm, c)| (*nm, c.sigma_t_per_mm())).collect::<Vec<_>>())
        };
        for (wavelengths, expected) in [
            ("650, 450", vec![(360.0, 2.0), (450.0, 2.0), (650.0, 1.0), (830.0, 1.0)]),
            ("532.5", vec![(360.0, 1.0), (532.5, 1.0), (830.0, 1.0)]),
            ("300,940", vec![(300.0, 1.0), (940.0, 2.0)]),
            ("360,830", vec![(360.0, 1.0), (830.0, 2.0)]),
        ] {
            assert_eq!(samples(wavelengths), Some(expected), "{wavelengths}");
        }
        for not_wavelengths in ["450,450.0", "450,G", "1,2", "nan", "inf", ""] {
            assert_eq!(samples(not_wavelengths), None, "{not_wavelengths:?}");
        }
    }

    /// Spectra whose g differs have the mean g, weighted by σ_s, and keep σ_s (1 − g) and σ_a.
    #[test]
    fn spectra_with_several_g_become_similar() {
        let own = |name: &str, sigma_t, albedo, g| with_g(channel(name, sigma_t, albedo), albedo, g);
        let media = [medium("m", vec![own("450", 10.0, 0.8, 0.5), own("650", 5.0, 0.8, 0.2)])];
        let [block] = &blocks(&media)[..] else { panic!("one medium") };
        assert!((block.phase.g - 0.4).abs() < 1e-12, "{}", block.phase.g);
        let Values::Spectrum(samples) = &block.values else { panic!("a spectrum") };
        for ((_, m), [reduced, absorption]) in samples[1..].iter().zip([[4.0, 2.0], [3.2, 1.0]]) {
            assert!((m.sigma_t_per_mm() * m.albedo() * (1.0 - m.g()) - reduced).abs() < 1e-12, "{m:?}");
            assert!((m.sigma_t_per_mm() * (1.0 - m.albedo()) - absorption).abs() < 1e-12, "{m:?}");
        }
        assert_eq!(block.notes[1], SIMILAR);
    }

    /// Channels that differ in g, or in their second lobe, become separate media.
    #[test]
    fn channels_with_other_phases_are_separate_media() {
        let red = || three_kinds().remove(0).channels.remove(1);
        for (changed, phase) in [
            (with_g(red(), 0.9991, -0.2), BlockPhase { g: -0.2, second_lobe: None }),
            (with_lobe(red(), 0.1), BlockPhase { g: 0.4, second_lobe: SecondLobe::new(0.1, -0.5).ok() }),
        ] {
            let mut media = three_kinds();
            media[0].channels[1] = changed;
            let blocks = blocks(&media[..1]);
            let plain = BlockPhase { g: 0.4, second_lobe: None };
            let found: Vec<_> = blocks.iter().map(|b| (b.name.as_str(), b.phase)).collect();
            assert_eq!(found, [("Clear_resin_B", plain), ("Clear_resin_R", phase), ("Clear_resin_G", plain)]);
            assert_eq!(blocks[1].values, Values::Scalar(Medium::new(6.0, 0.9991, phase.g).unwrap()));
            let notes: Vec<String> = blocks.iter().map(|b| b.notes.join("\n")).collect();
            assert!(notes.iter().all(|n| n.contains("differ in phase function")), "{notes:?}");
            let unresolved: Vec<_> = notes.iter().map(|n| n.contains("Unresolved")).collect();
            assert_eq!(unresolved, [false, false, true]);
        }
    }

    #[test]
    fn names_are_identifiers() {
        for (name, expected) in [
            ("Clear resin", "Clear_resin"),
            ("a.b$c--d", "a_b_c_d"),
            ("_x_", "x"),
            ("3D\n\"gel\"", "medium_3D_gel"),
            ("", "medium"),
            ("树脂", "medium"),
            ("type", "medium_type"),
            ("Größe", "Gr_e"),
        ] {
            assert_eq!(identifier(name), expected);
        }
    }

    /// Names are unique, even if one looks like a numbered one.
    #[test]
    fn generated_names_are_unique() {
        let rgb = || ["R", "G", "B"].map(|name| channel(name, 1.0, 0.5)).to_vec();
        let media = ["a", "a_2", "a!", "a", "a 2"].map(|name| medium(name, rgb()));
        assert_eq!(names(&media), ["a", "a_2", "a_3", "a_4", "a_2_2"]);
        let clash = [medium("m_R", rgb()), medium("m", vec![channel("R", 1.0, 0.5)])];
        assert_eq!(names(&clash), ["m_R", "m_R_2"]);
    }
}
