//! The set-up: board, grey patches, light, noise.

use farm_figures::numbers::{fixed, significant, with_error};
use farm_figures::{EdgeCurve, sfr_figure};
use optics_capture::{Board, Calibration, Colour, EdgeSfr, Estimate};

use super::samples::chart;
use super::{remarks, shots};
use crate::capture::captured::{Captured, CapturedPart};
use crate::capture::picture::data_uri;
use crate::document::{Block, Figure, PagePicture, ValueTable};

/// Columns of the map of the light.
const COLUMNS: usize = 90;

const MODEL: &str = "Temporal dark noise and system gain as in EMVA 1288, by the photon transfer of repeated shots; the \
                     responsivity is the signal of a radiance factor of 1; the glare is the share of the mean light that \
                     adds to every pixel; the drift is that of the lamps between the first and the last shot of the patches.";

/// Board, camera and light of red, green and blue.
pub(super) fn blocks(captured: &Captured, part: &CapturedPart) -> Vec<Block> {
    let (about, calibration) = (&part.about, &part.calibration);
    let words = about.camera.clone().into_iter().chain(about.exposure_s.map(exposure));
    let words = words
        .chain(about.f_number.map(|n| format!("f/{n}")))
        .chain(about.iso.map(|iso| format!("ISO {iso}")));
    let mut blocks = vec![Block::heading(2, "Board")];
    blocks.extend(board(captured, part));
    blocks.extend([
        Block::heading(2, "Camera and light"),
        remarks(&calibration.warnings),
        Block::Paragraph(words.collect::<Vec<_>>().join(", ")),
        Block::heading(3, "Grey patches"),
        patches(calibration),
        Block::aside("In brackets: deviation from the straight line through all patches."),
        Block::heading(3, "Camera model"),
        constants(calibration),
        Block::aside(MODEL),
    ]);
    blocks.extend(light(captured, part).into_iter().flatten());
    blocks
}

fn board(captured: &Captured, part: &CapturedPart) -> Vec<Block> {
    let board = &part.board;
    let head = "channel | >blur σ\n[µm] | >MTF50 [1/mm]\n([cycles/px]) | >edge against\ngreen [µm] | \
                >light side\nseen | >dark side\nseen | >ρ light | >ρ dark";
    let rows = Colour::ALL.iter().map(|colour| {
        let c = colour.index();
        let (blur, rho) = (board.blur_mm[c], part.rho[c]);
        vec![
            colour.letter().to_owned(),
            with_error(1000.0 * blur.value, 1000.0 * blur.std_error),
            mtf50(board.sfr[c].as_ref(), board.mm_per_px.value),
            fixed(1000.0 * board.origin_mm[c].value, 2),
            number(board.light[c]),
            number(board.dark[c]),
            number(rho.light),
            number(rho.dark),
        ]
    });
    let (scale, edge) = (board.mm_per_px, &board.edge);
    let geometry = format!(
        "{} px/mm; the edge is turned by {}° and bends by {:.3} px; its dark side is {}",
        with_error(1.0 / scale.value, scale.std_error / scale.value.powi(2)),
        number(edge.angle_deg),
        edge.bend_px.value,
        edge.dark_side,
    );
    let sentence = std::iter::once(geometry).chain(part.further()).collect::<Vec<_>>().join("; ");
    let mut blocks = vec![
        remarks(&board.warnings),
        Block::Paragraph(sentence + "."),
        ValueTable::new(head, rows).block(),
        Block::chart(chart(&board.profiles), "The bare edge."),
    ];
    blocks.extend(sfr(board));
    blocks.push(shots::row(captured, part, &board.shots));
    blocks
}

/// The frequency at which the response is a half, in cycles per mm and per pixel.
pub(super) fn mtf50(sfr: Option<&EdgeSfr>, mm_per_px: f64) -> String {
    let Some(sfr) = sfr else { return "–".to_owned() };
    match sfr.mtf50_per_mm() {
        Some(f) => format!("{} ({})", significant(f, 3), significant(f * mm_per_px, 2)),
        None => format!("above {}", significant(1.0 / mm_per_px, 3)),
    }
}

/// The response of the camera to spatial frequencies.
fn sfr(board: &Board) -> Option<Block> {
    let known = Colour::ALL.iter().filter_map(|c| Some((c.letter(), board.sfr[c.index()].as_ref()?)));
    let known: Vec<_> = known.map(|(letter, sfr)| (letter, sfr, vec![0.0; sfr.response.len()])).collect();
    let caption = "Spatial frequency response of lens and pixel from the bare edge (e-SFR, ISO 12233), up to one cycle per \
                   pixel; MTF50 is where it is a half.";
    let curves: Vec<EdgeCurve> = known
        .iter()
        .map(|(channel, sfr, none)| EdgeCurve {
            channel,
            x_mm: &sfr.cycles_per_mm,
            values: &sfr.response,
            std_errors: none,
        })
        .collect();
    (!curves.is_empty()).then(|| Block::chart(sfr_figure(&curves).svg(), caption))
}

pub(super) fn number(estimate: Estimate) -> String {
    with_error(estimate.value, estimate.std_error)
}

/// An exposure time in s as cameras show it: as a fraction where it is nearly one.
pub(super) fn exposure(time_s: f64) -> String {
    let parts = 1.0 / time_s;
    let is_fraction = time_s < 0.9 && (parts / parts.round() - 1.0).abs() < 0.02;
    if is_fraction { format!("1/{parts:.0} s") } else { format!("{} s", significant(time_s, 3)) }
}

/// Grey patches against the line through them.
fn patches(calibration: &Calibration) -> Block {
    let rows = calibration.patches.iter().map(|patch| {
        let area = patch.area;
        let place = [area.x, area.y, area.width, area.height].map(|v| format!("{v:.0}")).join(", ");
        let [red, green, blue] = [0, 1, 2]
            .map(|c| format!("{:.4} ({} %)", patch.value[c].value, fixed(100.0 * patch.deviation[c], 2)));
        vec![patch.rho[1].to_string(), red, green, blue, place]
    });
    let head = "ρ given | >R measured | >G measured | >B measured | >x, y, width, height\nin px";
    ValueTable::new(head, rows).block()
}

fn constants(calibration: &Calibration) -> Block {
    let head = "channel | >dark noise [DN] /\nsystem gain K [DN/e⁻] | >responsivity\n[DN] | >glare | >drift";
    let rows = Colour::ALL.iter().map(|colour| {
        let c = colour.index();
        let sites = calibration.noise.iter().filter(|n| n.colour == *colour);
        let noise: Vec<String> =
            sites.map(|n| format!("{:.2} / {:.3}", n.read.value, n.gain.value)).collect();
        vec![
            colour.letter().to_owned(),
            noise.join(", "),
            number(calibration.gain[c]),
            number(calibration.glare[c]),
            format!("{} %", fixed(100.0 * calibration.drift[c], 2)),
        ]
    });
    ValueTable::new(head, rows).block()
}

/// The light over the frame in green, as in Fig. 4 of the paper: grey is the mean, a step of colour 1 %.
fn light(captured: &Captured, part: &CapturedPart) -> Option<[Block; 2]> {
    let [width, height] = captured.inputs.first()?.thumbnail.as_ref()?.full;
    let rows = (COLUMNS * height).div_ceil(width.max(1)).clamp(1, 4 * COLUMNS);
    let flat = part.calibration.flat();
    let at = |row: usize, column: usize| {
        let place = |i: usize, n: usize, side: usize| (i as f64 + 0.5) / n as f64 * side as f64;
        flat.at(Colour::Green, place(column, COLUMNS, width), place(row, rows, height))
    };
    let values: Vec<f64> =
        (0..rows).flat_map(|r| (0..COLUMNS).map(move |c| (r, c))).map(|(r, c)| at(r, c)).collect();
    let [low, high] = values.iter().fold([f64::INFINITY, 0.0], |[a, b], v| [v.min(a), v.max(b)]);
    let bytes: Vec<u8> = values.iter().flat_map(|v| departure_colour(v - 1.0)).collect();
    let (uri, alt) = (data_uri(COLUMNS, rows, &bytes), "map of the light".to_owned());
    let [low, high] = [low, high].map(|v| fixed(100.0 * (v - 1.0), 1));
    let caption = format!("Green, from {low} % (blue) to {high} % (red) of the mean, in steps of 1 %.");
    let figure = Figure { pictures: vec![PagePicture::Strip { uri, alt }], caption };
    Some([Block::heading(3, "Light over the frame"), Block::Row(vec![figure])])
}

/// Grey at 0, redder above and bluer below, full at 10 %.
fn departure_colour(departure: f64) -> [u8; 3] {
    let step = (100.0 * departure).round() / 10.0;
    let part = step.abs().min(1.0);
    let mixed = |from: f64, to: f64| (from + part * (to - from)).round() as u8;
    if step >= 0.0 {
        [mixed(200.0, 190.0), mixed(200.0, 40.0), mixed(200.0, 30.0)]
    } else {
        [mixed(200.0, 30.0), mixed(200.0, 70.0), mixed(200.0, 190.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times that are no part of a second are decimal numbers, as on cameras.
    #[test]
    fn exposures_are_shown_as_by_cameras() {
        let shown = [0.6, 0.8, 0.4, 0.5, 1.0 / 3.0, 0.0166, 1.0 / 8000.0, 1.0, 1.3, 30.0].map(exposure);
        let expected =
            ["0.6 s", "0.8 s", "0.4 s", "1/2 s", "1/3 s", "1/60 s", "1/8000 s", "1 s", "1.3 s", "30 s"];
        assert_eq!(shown, expected);
    }
}
