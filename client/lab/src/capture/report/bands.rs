//! Renders the bands of a session: where they show the board, how sharp, and their profiles.

use farm_figures::numbers::fixed;
use farm_figures::{EdgeCurve, edge_figure};
use optics_capture::EdgeProfile;

use super::set_up::{exposure, mtf50, with_error};
use super::warnings;
use crate::capture::band_optics::BandOptics;
use crate::capture::captured::{Captured, CapturedPart};
use crate::capture::channels::CapturedChannel;
use crate::page::escaped;

/// The sections of all bands; empty for red, green and blue.
pub(super) fn section(captured: &Captured) -> String {
    let optics = BandOptics::of(&captured.parts);
    if optics.is_empty() {
        return String::new();
    }
    let rows = optics.iter().zip(&captured.parts).map(|(optics, part)| row(optics, part));
    let each = captured.parts.iter().map(band);
    format!(
        "<h2>Bands</h2>\n<div class=\"wide\"><table>\n<tr><th>band</th><th>nm</th><th>exposure</th><th>blur σ [µm]</th><th>MTF50 [1/mm] ([cycles/px])</th>\
         <th>shift [px]</th><th>magnification</th><th>left [px]</th><th>ρ light</th><th>ρ dark</th></tr>\n{}</table></div>\n\
         <p class=\"faint\">Shift and magnification of the board's corners against the sharpest band (*): lateral colour. \
         Each band is measured with its own edge, scale and blur.</p>\n{}",
        rows.collect::<String>(),
        each.collect::<String>()
    )
}

fn row(optics: &BandOptics, part: &CapturedPart) -> String {
    let channel = &part.channels()[0];
    let (blur, rho) = (channel.blur_mm(), channel.rho());
    let cells = [
        format!("{}{}", escaped(&optics.band), if optics.is_reference { " *" } else { "" }),
        optics.wavelength_nm.to_string(),
        part.about.exposure_s.map_or_else(String::new, exposure),
        format!("{:.1} ± {:.2}", 1000.0 * blur.value, 1000.0 * blur.std_error),
        mtf50(channel.sfr(), part.board.mm_per_px.value),
        optics.shift_px.map(|px| fixed(px, 2)).join(", "),
        format!("{:+.3} %", 100.0 * optics.magnification),
        format!("{:.2}", optics.left_px),
        with_error(rho.light),
        with_error(rho.dark),
    ];
    format!("<tr>{}</tr>\n", cells.map(|cell| format!("<td>{cell}</td>")).concat())
}

/// Warnings and profiles of one band.
fn band(part: &CapturedPart) -> String {
    let Some(channel) = part.channels().into_iter().next() else { return String::new() };
    let of_samples: String = part.samples.iter().map(|sample| warnings(&sample.profile.warnings)).collect();
    format!(
        "<details><summary>{} nm</summary>\n{}{}{of_samples}<figure class=\"wide\">{}<figcaption>The bare edge and all slabs; \
         bands are two standard errors, random ones only.</figcaption></figure></details>\n",
        escaped(&channel.name),
        warnings(&part.calibration.warnings),
        warnings(&part.board.warnings),
        figure(&channel),
    )
}

fn figure(channel: &CapturedChannel) -> String {
    let samples = channel.part.samples.iter().map(|s| (s.about.label(), channel.profile(s)));
    let all: Vec<_> =
        std::iter::once(("bare board".to_owned(), channel.bare_profile())).chain(samples).collect();
    let curve = |(label, profile)| {
        let EdgeProfile { x_mm, values, std_errors, .. }: &EdgeProfile = profile;
        EdgeCurve { channel: label, x_mm, values, std_errors }
    };
    let curves: Vec<EdgeCurve> =
        all.iter().map(|(label, profile)| curve((label.as_str(), *profile))).collect();
    edge_figure(&curves).svg()
}
