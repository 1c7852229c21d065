//! Renders the samples: a table of all, and each with profiles, budget and photographs.

use farm_figures::numbers::significant;
use farm_figures::{EdgeCurve, edge_figure};
use optics_capture::{EdgeProfile, Source, Warning};
use serde::{Deserialize, Serialize};

use super::{shots, warnings};
use crate::capture::captured::{Captured, CapturedPart, CapturedSample};
use crate::capture::channels::{CapturedChannel, ends, mean, profiles};
use crate::page::escaped;

/// Micrometres per millimetre.
const MICROMETRES: f64 = 1000.0;

/// The results as a sentence and a table.
pub(super) fn summary(captured: &Captured) -> String {
    let channels = captured.channels();
    let rows = profiles(&channels).map(|(channel, sample)| row(channel, sample));
    let are_notes = |part: &'_ CapturedPart| -> Vec<bool> {
        let of_samples = part.samples.iter().flat_map(|s| &s.profile.warnings);
        let all = of_samples.chain(&part.calibration.warnings).chain(&part.board.warnings);
        all.map(Warning::is_note).collect()
    };
    let all: Vec<bool> = captured.parts.iter().flat_map(are_notes).collect();
    let notes = all.iter().filter(|is_note| **is_note).count();
    let doubtful = match all.len() - notes {
        0 => "There are no warnings.".to_owned(),
        1 => "There is one warning, below.".to_owned(),
        n => format!("There are {n} warnings, below."),
    };
    let noted = match notes {
        0 => String::new(),
        1 => " What was corrected is noted once, below.".to_owned(),
        n => format!(" What was corrected is noted {n} times, below."),
    };
    let table = format!(
        "<div class=\"wide\"><table>\n<tr><th>sample</th><th>channel</th><th>shots</th>\
         <th>dark</th><th>light</th><th>noise per bin</th><th>rejected</th><th>blur σ [µm]</th><th>origin [µm]</th></tr>\n{}</table></div>\n",
        rows.collect::<String>()
    );
    let has_bands = captured.parts[0].band.is_some();
    let table = if has_bands {
        format!("<details><summary>All profiles as numbers</summary>\n{table}</details>\n")
    } else {
        table
    };
    let (photographs, slabs) = (captured.inputs.len(), captured.parts[0].samples.len());
    let bands = if has_bands { format!(", {} bands", captured.parts.len()) } else { String::new() };
    format!("<p>{photographs} photographs, {slabs} slabs{bands}. {doubtful}{noted}</p>\n{table}")
}

fn row(channel: &CapturedChannel, sample: &CapturedSample) -> String {
    let (blur, profile) = (channel.blur_mm(), channel.profile(sample));
    let origin = channel.error(sample, &[Source::Origin]);
    let ends = ends(profile);
    let cells = [
        escaped(&sample.about.label()),
        format!("<span class=\"{0}\">{0}</span>", escaped(&channel.name)),
        sample.profile.shots.len().to_string(),
        format!("{:.4}", ends[0]),
        format!("{:.4}", ends[1]),
        format!("{:.5}", mean(&profile.std_errors)),
        format!("{:.2} %", 100.0 * mean(&profile.rejected)),
        format!("{:.1} ± {:.2}", MICROMETRES * blur.value, MICROMETRES * blur.std_error),
        format!("0 ± {:.1}", MICROMETRES * origin),
    ];
    format!("<tr>{}</tr>\n", cells.map(|cell| format!("<td>{cell}</td>")).concat())
}

/// One slab: its strip of a photograph as a data URI, and the HTML before and after the strip.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SlabSection {
    pub(super) label: String,
    strip: String,
    before: String,
    after: String,
}

impl SlabSection {
    pub(super) fn of(captured: &Captured, part: &CapturedPart, sample: &CapturedSample) -> Self {
        let label = sample.about.label();
        let figure_of = |shot| shots::figure(captured, part, shot);
        let shots: String = sample.profile.shots.iter().map(figure_of).collect();
        let strip = sample.strip.as_ref().map(|strip| strip.data_uri(&sample.profile.profiles));
        Self {
            strip: strip.unwrap_or_default(),
            before: format!(
                "<h3>{} ± {} mm</h3>\n{}<figure class=\"wide\">{}<figcaption>Profiles across the edge; bands are two \
                 standard errors, random ones only.</figcaption></figure>\n",
                escaped(&label),
                sample.about.thickness_std_error_mm,
                warnings(&sample.profile.warnings),
                figure(&sample.profile.profiles),
            ),
            after: format!(
                "<details><summary>Errors by source</summary>{}</details>\n<div class=\"row\">{shots}</div>\n",
                budget(sample)
            ),
            label,
        }
    }

    pub(super) fn section(&self) -> String {
        let caption = "10 × 2 mm of a photograph, in radiance factors.";
        format!(
            "{}<figure>{}<figcaption>{caption}</figcaption></figure>\n{}",
            self.before,
            self.strip(),
            self.after
        )
    }

    pub(super) fn strip(&self) -> String {
        format!("<img class=\"strip\" src=\"{}\" alt=\"strip across the edge, photograph\">", self.strip)
    }
}

/// The profiles of all channels, as SVG.
pub(super) fn figure(profiles: &[EdgeProfile]) -> String {
    let curve = |profile| {
        let EdgeProfile { colour, x_mm, values, std_errors, .. }: &EdgeProfile = profile;
        EdgeCurve { channel: colour.letter(), x_mm, values, std_errors }
    };
    let curves: Vec<EdgeCurve> = profiles.iter().map(curve).collect();
    edge_figure(&curves).svg()
}

fn budget(sample: &CapturedSample) -> String {
    let rows = sample.profile.budget.iter().map(|line| {
        let errors = line.std_error.iter().map(|e| format!("<td>{}</td>", significant(*e, 2)));
        format!(
            "<tr><td>{}</td>{}<td>{}</td></tr>",
            line.source.name().replace('_', " "),
            errors.collect::<String>(),
            line.source.unit()
        )
    });
    format!(
        "<div class=\"wide\"><table><tr><th>source</th><th>R</th><th>G</th><th>B</th><th>unit</th></tr>{}</table></div>",
        rows.collect::<String>()
    )
}
