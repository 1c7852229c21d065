//! The samples: a table of all, and each with profiles, errors by source and photographs.

use std::collections::BTreeMap;

use farm_figures::numbers::{significant, with_error};
use farm_figures::{EdgeCurve, edge_figure};
use optics_capture::{EdgeProfile, Source, Warning};
use serde::Serialize;

use super::{remarks, shots};
use crate::capture::captured::{Captured, CapturedPart, CapturedSample};
use crate::capture::channels::{CapturedChannel, ends, mean, profiles};
use crate::document::{Block, Figure, PagePicture, ValueTable};

/// Results of one channel of a sample.
#[derive(Debug, Serialize)]
pub struct CapturedRow {
    sample: String,
    material: String,
    thickness_mm: f64,
    channel: String,
    shots: usize,
    dark: f64,
    light: f64,
    /// Mean random error of a bin.
    noise: f64,
    /// Share of rejected samples.
    rejected: f64,
    blur_mm: f64,
    blur_std_error_mm: f64,
    origin_std_error_mm: f64,
}

/// Every channel of every sample.
pub fn captured_rows(captured: &Captured) -> Vec<CapturedRow> {
    let row = |(channel, sample): (&CapturedChannel, &CapturedSample)| {
        let (profile, blur) = (channel.profile(sample), channel.blur_mm());
        let [dark, light] = ends(profile);
        CapturedRow {
            sample: sample.about.label(),
            material: sample.about.material.clone(),
            thickness_mm: sample.about.thickness_mm,
            channel: channel.name.clone(),
            shots: sample.profile.shots.len(),
            dark,
            light,
            noise: mean(&profile.std_errors),
            rejected: mean(&profile.rejected),
            blur_mm: blur.value,
            blur_std_error_mm: blur.std_error,
            origin_std_error_mm: channel.error(sample, &[Source::Origin]),
        }
    };
    profiles(&captured.channels()).map(row).collect()
}

/// The rows as report and terminal show them.
pub fn captured_table(rows: &[CapturedRow]) -> ValueTable {
    let head = "sample | ch | >shots | >dark | >light | >noise | >rejected | >blur σ\n[µm] | >origin\n[µm]";
    let row = |row: &CapturedRow| {
        vec![
            row.sample.clone(),
            row.channel.clone(),
            row.shots.to_string(),
            format!("{:.3}", row.dark),
            format!("{:.3}", row.light),
            format!("{:.5}", row.noise),
            format!("{:.1} %", 100.0 * row.rejected),
            with_error(1000.0 * row.blur_mm, 1000.0 * row.blur_std_error_mm),
            format!("± {}", significant(1000.0 * row.origin_std_error_mm, 1)),
        ]
    };
    ValueTable::new(head, rows.iter().map(row))
}

/// The results as a sentence and a table.
pub(super) fn overview(captured: &Captured) -> Vec<Block> {
    let warnings = captured.parts.iter().flat_map(|part| {
        let samples = part.samples.iter().flat_map(|sample| &sample.profile.warnings);
        samples.chain(&part.calibration.warnings).chain(&part.board.warnings)
    });
    let (notes, doubts): (Vec<&Warning>, Vec<&Warning>) = warnings.partition(|warning| warning.is_note());
    let doubtful = match doubts.len() {
        0 => "There are no warnings.".to_owned(),
        1 => "There is one warning, below.".to_owned(),
        n => format!("There are {n} warnings, below."),
    };
    let noted = if notes.is_empty() { "" } else { " What was corrected is noted below." };
    let table = captured_table(&captured_rows(captured)).block();
    let (photographs, slabs) = (captured.inputs.len(), captured.parts[0].samples.len());
    let (bands, table) = match captured.parts[0].band {
        Some(_) => (
            format!(", {} bands", captured.parts.len()),
            Block::Folded("All profiles as numbers".to_owned(), vec![table]),
        ),
        None => (String::new(), table),
    };
    let sentence = format!("{photographs} photographs, {slabs} slabs{bands}. {doubtful}{noted}");
    vec![Block::Paragraph(sentence), table]
}

/// A strip of a photograph, by the sample's label.
pub(super) fn strip(sample: &CapturedSample) -> Option<(String, PagePicture)> {
    let uri = sample.strip.as_ref()?.data_uri(&sample.profile.profiles);
    let alt = "strip across the edge, photograph".to_owned();
    Some((sample.about.label(), PagePicture::Strip { uri, alt }))
}

/// One slab.
pub(super) fn blocks(
    captured: &Captured,
    part: &CapturedPart,
    sample: &CapturedSample,
    strips: &BTreeMap<String, PagePicture>,
) -> Vec<Block> {
    let label = sample.about.label();
    let caption = "Profiles across the edge; bands are two standard errors, random ones only.";
    let strip = strips.get(&label).map(|strip| Figure {
        pictures: vec![strip.clone()],
        caption: "10 × 2 mm of a photograph, in radiance factors.".to_owned(),
    });
    let mut blocks = vec![
        Block::Heading(3, format!("{label} ± {} mm", sample.about.thickness_std_error_mm)),
        remarks(&sample.profile.warnings),
        Block::chart(chart(&sample.profile.profiles), caption),
    ];
    blocks.extend(strip.map(Block::Figure));
    blocks.push(Block::Folded("Errors by source".to_owned(), vec![errors(sample)]));
    blocks.push(shots::row(captured, part, &sample.profile.shots));
    blocks
}

/// The profiles of all channels, as SVG.
pub(super) fn chart(profiles: &[EdgeProfile]) -> String {
    let curve = |profile| {
        let EdgeProfile { colour, x_mm, values, std_errors, .. }: &EdgeProfile = profile;
        EdgeCurve { channel: colour.letter(), x_mm, values, std_errors }
    };
    let curves: Vec<EdgeCurve> = profiles.iter().map(curve).collect();
    edge_figure(&curves).svg()
}

fn errors(sample: &CapturedSample) -> Block {
    let rows = sample.profile.budget.iter().map(|line| {
        let mut row = vec![line.source.name().replace('_', " ")];
        row.extend(line.std_error.iter().map(|error| significant(*error, 2)));
        row.push(line.source.unit().to_owned());
        row
    });
    ValueTable::new("source | >R | >G | >B | >unit", rows).block()
}
