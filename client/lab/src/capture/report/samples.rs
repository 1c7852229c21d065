//! The samples: a table of all, and each with profiles, budget and photographs.

use optics_capture::{EdgeProfile, Source};

use super::super::budget::sum;
use super::super::stage::{Captured, CapturedSample};
use super::plot::{Curve, plot};
use super::{escaped, shots, slot, warnings};

/// Micrometres of millimetres.
const MICROMETRES: f64 = 1000.0;

/// What was found, as a sentence and a table.
pub(super) fn summary(captured: &Captured) -> String {
    let rows = captured.samples.iter().flat_map(|sample| {
        sample.profile.profiles.iter().enumerate().map(|(c, profile)| row(captured, sample, c, profile))
    });
    let count = captured.samples.iter().map(|s| s.profile.warnings.len()).sum::<usize>()
        + captured.calibration.warnings.len()
        + captured.board.warnings.len();
    let doubtful = match count {
        0 => "Nothing is doubtful.".to_owned(),
        1 => "One thing is doubtful and told below.".to_owned(),
        n => format!("{n} things are doubtful and told below."),
    };
    format!(
        "<p>{} photographs, {} slabs. {doubtful}</p>\n<div class=\"wide\"><table>\n<tr><th>sample</th><th>channel</th><th>shots</th>\
         <th>dark</th><th>light</th><th>noise a bin</th><th>rejected</th><th>blur σ [µm]</th><th>origin [µm]</th></tr>\n{}</table></div>\n",
        captured.inputs.len(),
        captured.samples.len(),
        rows.collect::<String>()
    )
}

fn row(captured: &Captured, sample: &CapturedSample, c: usize, profile: &EdgeProfile) -> String {
    let blur = captured.board.blur_mm[c];
    let origin = sum(&sample.profile.budget, &[Source::Origin], c);
    let ends = ends(profile);
    let cells = [
        escaped(&sample.about.label()),
        format!("<span class=\"{0}\">{0}</span>", profile.colour.letter()),
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

/// Radiance factors at both ends of a profile: the means of a tenth of it.
pub fn ends(profile: &EdgeProfile) -> [f64; 2] {
    let n = profile.values.len();
    let tenth = n.div_ceil(10).min(n);
    [mean(&profile.values[..tenth]), mean(&profile.values[n - tenth..])]
}

pub fn mean(values: &[f64]) -> f64 {
    let finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    finite.iter().sum::<f64>() / finite.len().max(1) as f64
}

/// One slab.
pub(super) fn section(captured: &Captured, sample: &CapturedSample) -> String {
    let label = sample.about.label();
    let strip = sample.strip.data_uri(&sample.profile.profiles);
    let strip = format!("<img class=\"strip\" src=\"{strip}\" alt=\"strip across the edge, photograph\">");
    let shots: String = sample.profile.shots.iter().map(|shot| shots::figure(captured, shot)).collect();
    format!(
        "<h3>{} ± {} mm</h3>\n{}<figure>{}<figcaption>Profiles across the edge; bands are two standard errors, random ones only.\
         </figcaption></figure>\n<figure>{}<figcaption>10 × 2 mm of a photograph, in radiance factors.</figcaption></figure>\n\
         <details><summary>Errors by source</summary>{}</details>\n<div class=\"row\">{shots}</div>\n",
        escaped(&label),
        sample.about.thickness_std_error_mm,
        warnings(&sample.profile.warnings),
        plot(&profiles(&sample.profile.profiles), ["x [mm]", "radiance factor"], [0.0, 0.0]),
        slot(&format!("strip {label}"), &strip),
        budget(sample),
    )
}

pub(super) fn profiles(profiles: &[EdgeProfile; 3]) -> Vec<Curve<'_>> {
    let curve = |p| {
        let EdgeProfile { colour, x_mm, values, std_errors, .. }: &EdgeProfile = p;
        let band = std_errors.iter().map(|e| 2.0 * e).collect();
        Curve { class: colour.letter(), x: x_mm, y: values.clone(), band }
    };
    profiles.iter().map(curve).collect()
}

fn budget(sample: &CapturedSample) -> String {
    let rows = sample.profile.budget.iter().map(|line| {
        let errors = line.std_error.map(|e| format!("<td>{}</td>", significant(e)));
        format!(
            "<tr><td>{}</td>{}<td>{}</td></tr>",
            line.source.name().replace('_', " "),
            errors.concat(),
            line.source.unit()
        )
    });
    format!(
        "<div class=\"wide\"><table><tr><th>source</th><th>R</th><th>G</th><th>B</th><th>unit</th></tr>{}</table></div>",
        rows.collect::<String>()
    )
}

/// Two digits that count.
pub(super) fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let digits = (1.0 - value.abs().log10().floor()).clamp(0.0, 9.0);
    format!("{value:.*}", digits as usize)
}
