//! Renders the report of a session as one self-contained page.
//!
//! `capture` keeps the sections as data, so that `measure` renders the page again with the fitted media.

mod bands;
mod media;
mod samples;
mod set_up;
mod shots;
mod verdict;

use optics_capture::Warning;
use serde::{Deserialize, Serialize};

pub use media::{Media, Simulated};
pub use verdict::{MeasureVerdict, PrecisionRow};

use super::captured::{Captured, CapturedPart};
use crate::page::{escaped, page};
use samples::SlabSection;

/// The parts of the page from `capture`: sections as HTML, and the slabs with their pictures.
#[derive(Debug, Serialize, Deserialize)]
pub struct CaptureReport {
    title: String,
    summary: String,
    slabs: Vec<SlabSection>,
    set_up: String,
    /// Sections of the bands; empty for red, green and blue.
    #[serde(default)]
    bands: String,
    inputs: String,
}

impl CaptureReport {
    pub(super) fn of(captured: &Captured) -> Self {
        let colours: Vec<&CapturedPart> = captured.parts.iter().filter(|part| part.band.is_none()).collect();
        let slabs = |captured, part: &&CapturedPart| {
            let section = |sample| SlabSection::of(captured, part, sample);
            part.samples.iter().map(section).collect::<Vec<_>>()
        };
        Self {
            title: title(captured),
            summary: samples::summary(captured),
            slabs: colours.iter().flat_map(|part| slabs(captured, part)).collect(),
            set_up: colours.iter().map(|part| set_up::section(captured, part)).collect(),
            bands: bands::section(captured),
            inputs: inputs(captured),
        }
    }

    /// The page; with the media once they are measured.
    pub fn page(&self, media: Option<&Media>) -> String {
        let Self { summary, set_up, bands, inputs, .. } = self;
        let title = escaped(&self.title);
        let slabs: String = self.slabs.iter().map(SlabSection::section).collect();
        let slabs = if slabs.is_empty() { slabs } else { format!("<h2>Samples</h2>\n{slabs}\n") };
        let verdict = media.map_or_else(
            || "<p class=\"faint\">Nothing is fitted yet: run <code>farmctl measure</code> with this folder.</p>\n".to_owned(),
            |media| media.verdict.section(),
        );
        let media = media.map_or_else(String::new, |media| {
            format!("<h2>Media</h2>\n{}{}", media.section(&self.slabs), media::FILES)
        });
        page(
            &self.title,
            &format!("<h1>{title}</h1>\n{verdict}{summary}\n{media}\n{slabs}{set_up}{bands}\n{inputs}\n"),
        )
    }
}

fn title(captured: &Captured) -> String {
    let mut materials: Vec<&str> =
        captured.parts[0].samples.iter().map(|s| s.about.material.as_str()).collect();
    materials.dedup();
    format!("Session: {}", materials.join(", "))
}

/// Every photograph with its digest.
fn inputs(captured: &Captured) -> String {
    let rows = captured.inputs.iter().map(|input| {
        format!(
            "<tr><td>{}</td><td class=\"words\"><code>{}</code></td></tr>",
            escaped(&input.label),
            input.digest
        )
    });
    format!(
        "<h2>Photographs</h2>\n<details><summary>{} files and their BLAKE3 digests</summary>\n<div class=\"wide\"><table>{}</table></div>\n</details>",
        captured.inputs.len(),
        rows.collect::<String>()
    )
}

pub(super) fn texts(warnings: &[Warning]) -> Vec<String> {
    warnings.iter().map(ToString::to_string).collect()
}

/// The warnings as a list; empty without warnings.
fn warnings(warnings: &[Warning]) -> String {
    let texts = texts(warnings);
    warning_list(&texts.iter().map(String::as_str).collect::<Vec<_>>())
}

fn warning_list(texts: &[&str]) -> String {
    if texts.is_empty() {
        return String::new();
    }
    let items = texts.iter().map(|text| format!("<li>{}</li>", escaped(text)));
    format!("<ul class=\"warnings\">{}</ul>\n", items.collect::<String>())
}
