//! The bands of a session: where they show the board, how sharp, and their profiles.

use farm_figures::numbers::{fixed, with_error};
use farm_figures::{EdgeCurve, edge_figure};
use optics_capture::EdgeProfile;

use super::remarks;
use super::set_up::{exposure, mtf50, number};
use crate::capture::band_optics::BandOptics;
use crate::capture::captured::{Captured, CapturedPart};
use crate::capture::channels::CapturedChannel;
use crate::document::{Block, ValueTable};

const HEAD: &str = "band | >nm | >exposure | >blur σ\n[µm] | >MTF50 [1/mm]\n([cycles/px]) | >shift\n[px] | >magnification | \
                    >left\n[px] | >ρ light | >ρ dark";

/// The sections of all bands; empty for red, green and blue.
pub(super) fn blocks(captured: &Captured) -> Vec<Block> {
    let optics = BandOptics::of(&captured.parts);
    if optics.is_empty() {
        return Vec::new();
    }
    let rows = optics.iter().zip(&captured.parts).map(|(optics, part)| row(optics, part));
    let note = "Shift and magnification of the board's corners against the sharpest band (*): lateral colour. Each band is \
                measured with its own edge, scale and blur.";
    let mut blocks =
        vec![Block::heading(2, "Bands"), ValueTable::new(HEAD, rows).block(), Block::aside(note)];
    blocks.extend(captured.parts.iter().filter_map(band));
    blocks
}

fn row(optics: &BandOptics, part: &CapturedPart) -> Vec<String> {
    let channel = &part.channels()[0];
    let (blur, rho) = (channel.blur_mm(), channel.rho());
    vec![
        format!("{}{}", optics.band, if optics.is_reference { " *" } else { "" }),
        optics.wavelength_nm.to_string(),
        part.about.exposure_s.map_or_else(String::new, exposure),
        with_error(1000.0 * blur.value, 1000.0 * blur.std_error),
        mtf50(channel.sfr(), part.board.mm_per_px.value),
        optics.shift_px.map(|px| fixed(px, 2)).join(", "),
        format!("{:+.3} %", 100.0 * optics.magnification),
        format!("{:.2}", optics.left_px),
        number(rho.light),
        number(rho.dark),
    ]
}

/// Remarks and profiles of one band.
fn band(part: &CapturedPart) -> Option<Block> {
    let channel = part.channels().into_iter().next()?;
    let mut blocks = vec![remarks(&part.calibration.warnings), remarks(&part.board.warnings)];
    blocks.extend(part.samples.iter().map(|sample| remarks(&sample.profile.warnings)));
    let caption = "The bare edge and all slabs; bands are two standard errors, random ones only.";
    blocks.push(Block::chart(chart(&channel), caption));
    Some(Block::Folded(format!("{} nm", channel.name), blocks))
}

fn chart(channel: &CapturedChannel) -> String {
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
