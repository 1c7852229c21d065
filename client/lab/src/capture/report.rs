//! The report of a session as a document.
//!
//! `capture` keeps its parts as data, so that `measure` renders the page again with the fitted media.

mod bands;
mod media;
mod samples;
mod set_up;
mod shots;
mod verdict;

use std::collections::BTreeMap;

use optics_capture::Warning;
use serde::{Deserialize, Serialize};

pub use media::{Media, Simulated, budget_blocks, estimate_blocks};
pub use samples::{CapturedRow, captured_rows, captured_table};
pub use verdict::{MeasureVerdict, PrecisionRow};

use super::captured::Captured;
use crate::document::{Block, Document, PagePicture, Remark};

/// The parts of the page from `capture`. Those of another version of farmctl are empty.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct CaptureReport {
    title: String,
    overview: Vec<Block>,
    /// A strip of a photograph for each slab, by the sample's label.
    strips: BTreeMap<String, PagePicture>,
    /// Samples, set-up, bands and photographs.
    details: Vec<Block>,
}

impl CaptureReport {
    pub(super) fn of(captured: &Captured) -> Self {
        let colours = || captured.parts.iter().filter(|part| part.band.is_none());
        let slabs = || colours().flat_map(|part| part.samples.iter().map(move |sample| (part, sample)));
        let strips: BTreeMap<String, PagePicture> =
            slabs().filter_map(|(_, sample)| samples::strip(sample)).collect();
        let mut details = Vec::new();
        if slabs().next().is_some() {
            details.push(Block::heading(2, "Samples"));
        }
        details.extend(slabs().flat_map(|(part, sample)| samples::blocks(captured, part, sample, &strips)));
        details.extend(colours().flat_map(|part| set_up::blocks(captured, part)));
        details.extend(bands::blocks(captured));
        details.extend(photographs(captured));
        Self { title: title(captured), overview: samples::overview(captured), strips, details }
    }

    /// The page; with the media once they are measured.
    pub fn page(&self, media: Option<&Media>) -> String {
        let mut blocks = media.map_or_else(
            || vec![Block::aside("Nothing is fitted yet: run `farmctl measure` with this folder.")],
            |media| media.verdict.blocks(),
        );
        blocks.extend(self.overview.clone());
        blocks.extend(media.map(|media| media.blocks(&self.strips)).unwrap_or_default());
        blocks.extend(self.details.clone());
        if self.details.is_empty() {
            blocks.push(Block::aside(
                "Another version of farmctl has kept photographs and set-up: run `farmctl capture` again to see them.",
            ));
        }
        Document { title: self.title.clone(), blocks }.page()
    }
}

fn title(captured: &Captured) -> String {
    let mut materials: Vec<&str> =
        captured.parts[0].samples.iter().map(|s| s.about.material.as_str()).collect();
    materials.dedup();
    format!("Session: {}", materials.join(", "))
}

/// Every photograph with its digest.
fn photographs(captured: &Captured) -> [Block; 2] {
    let entry = |input: &super::shots::Input| (input.label.clone(), format!("`{}`", input.digest));
    let summary = format!("{} files and their BLAKE3 digests", captured.inputs.len());
    let entries = Block::Entries(captured.inputs.iter().map(entry).collect());
    [Block::heading(2, "Photographs"), Block::Folded(summary, vec![entries])]
}

pub(super) fn texts(warnings: &[Warning]) -> Vec<String> {
    warnings.iter().map(ToString::to_string).collect()
}

/// The warnings as remarks; those about corrections are notes.
fn remarks(warnings: &[Warning]) -> Block {
    let remark = |w: &Warning| Remark { about: Vec::new(), text: w.to_string(), warning: !w.is_note() };
    Block::Remarks(warnings.iter().map(remark).collect())
}
