//! Renders the set-up: board, grey patches, light, noise.

use farm_figures::numbers::{minus, significant};
use farm_figures::{EdgeCurve, sfr_figure};
use optics_capture::{Board, Calibration, Colour, EdgeSfr, Estimate};

use super::samples::figure;
use super::{shots, warnings};
use crate::capture::captured::{Captured, CapturedPart};
use crate::capture::picture::data_uri;
use crate::page::escaped;

/// Columns of the map of the light.
const COLUMNS: usize = 90;

/// Board, camera and light of red, green and blue.
pub(super) fn section(captured: &Captured, part: &CapturedPart) -> String {
    format!("<h2>Board</h2>\n{}<h2>Camera and light</h2>\n{}", board(captured, part), camera(captured, part))
}

fn board(captured: &Captured, part: &CapturedPart) -> String {
    let board = &part.board;
    let rows = Colour::ALL.iter().map(|colour| {
        let c = colour.index();
        let cells = [
            board.blur_mm[c].value * 1000.0,
            board.blur_mm[c].std_error * 1000.0,
            board.origin_mm[c].value * 1000.0,
        ];
        format!(
            "<tr><td class=\"{0}\">{0}</td><td>{1:.1} ± {2:.2}</td><td>{8}</td><td>{3}</td><td>{4}</td><td>{5}</td><td>{6}</td><td>{7}</td></tr>",
            colour.letter(),
            cells[0],
            cells[1],
            minus(&format!("{:+.2}", cells[2])),
            with_error(board.light[c]),
            with_error(board.dark[c]),
            with_error(part.rho[c].light),
            with_error(part.rho[c].dark),
            mtf50(board.sfr[c].as_ref(), board.mm_per_px.value),
        )
    });
    let figures: String = board.shots.iter().map(|shot| shots::figure(captured, part, shot)).collect();
    format!(
        "{}<p>{:.3} ± {:.3} px/mm; the edge is turned by {:.3} ± {:.3}° and bends by {:.3} px; its dark side is {}{}.</p>\n\
         <div class=\"wide\"><table><tr><th>channel</th><th>blur σ [µm]</th><th>MTF50 [1/mm] ([cycles/px])</th>\
         <th>edge against green [µm]</th><th>radiance factor, light</th><th>radiance factor, dark</th><th>ρ light</th><th>ρ dark</th></tr>{}</table></div>\n\
         <figure class=\"wide\">{}<figcaption>The bare edge.</figcaption></figure>\n{}<div class=\"row\">{figures}</div>\n",
        warnings(&board.warnings),
        1.0 / board.mm_per_px.value,
        board.mm_per_px.std_error / board.mm_per_px.value.powi(2),
        board.edge.angle_deg.value,
        board.edge.angle_deg.std_error,
        board.edge.bend_px.value,
        board.edge.dark_side,
        part.further().iter().map(|text| format!("; {}", escaped(text))).collect::<String>(),
        rows.collect::<String>(),
        figure(&board.profiles),
        sfr(board),
    )
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
fn sfr(board: &Board) -> String {
    let known = Colour::ALL.iter().filter_map(|c| Some((c.letter(), board.sfr[c.index()].as_ref()?)));
    let known: Vec<_> = known.map(|(letter, sfr)| (letter, sfr, vec![0.0; sfr.response.len()])).collect();
    let curves: Vec<EdgeCurve> = known
        .iter()
        .map(|(channel, sfr, none)| EdgeCurve {
            channel,
            x_mm: &sfr.cycles_per_mm,
            values: &sfr.response,
            std_errors: none,
        })
        .collect();
    if curves.is_empty() {
        return String::new();
    }
    format!(
        "<figure class=\"wide\">{}<figcaption>Spatial frequency response of lens and pixel from the bare edge (e-SFR, ISO \
         12233), up to one cycle per pixel; MTF50 is where it is a half.</figcaption></figure>\n",
        sfr_figure(&curves).svg()
    )
}

pub(super) fn with_error(estimate: Estimate) -> String {
    let error = significant(estimate.std_error, 2);
    let digits = error.split_once('.').map_or(0, |(_, after)| after.len()).min(6);
    format!("{:.digits$} ± {error}", estimate.value)
}

fn camera(captured: &Captured, part: &CapturedPart) -> String {
    let (calibration, first) = (&part.calibration, part.about.clone());
    let mut words: Vec<String> = first.camera.into_iter().collect();
    words.extend(first.exposure_s.map(exposure));
    words.extend(first.f_number.map(|n| format!("f/{n}")));
    words.extend(first.iso.map(|iso| format!("ISO {iso}")));
    format!(
        "{}<p>{}</p>\n{}{}{}",
        warnings(&calibration.warnings),
        escaped(&words.join(", ")),
        patches(calibration),
        constants(calibration),
        light(captured, part)
    )
}

/// An exposure time in s as cameras show it: as a fraction where it is nearly one.
pub(super) fn exposure(time_s: f64) -> String {
    let parts = 1.0 / time_s;
    let is_fraction = time_s < 0.9 && (parts / parts.round() - 1.0).abs() < 0.02;
    if is_fraction { format!("1/{parts:.0} s") } else { format!("{} s", significant(time_s, 3)) }
}

/// Grey patches against the line through them.
fn patches(calibration: &Calibration) -> String {
    let rows = calibration.patches.iter().map(|patch| {
        let area = patch.area;
        let place = [area.x, area.y, area.width, area.height].map(|v| format!("{v:.0}")).join(", ");
        let cells = [0, 1, 2].map(|c| {
            minus(&format!("<td>{:.4} ({:+.2} %)</td>", patch.value[c].value, 100.0 * patch.deviation[c]))
        });
        format!("<tr><td>{}</td>{}<td>{place}</td></tr>", patch.rho[1], cells.concat())
    });
    format!(
        "<h3>Grey patches</h3>\n<div class=\"wide\"><table><tr><th>ρ given</th><th>R measured</th><th>G measured</th><th>B measured</th><th>x, y, width, height in px</th></tr>{}</table></div>\n\
         <p class=\"faint\">In brackets: deviation from the straight line through all patches.</p>\n",
        rows.collect::<String>()
    )
}

fn constants(calibration: &Calibration) -> String {
    let rows = Colour::ALL.iter().map(|colour| {
        let c = colour.index();
        let sites = calibration.noise.iter().filter(|n| n.colour == *colour);
        let noise: Vec<String> =
            sites.map(|n| format!("{:.2} / {:.3}", n.read.value, n.gain.value)).collect();
        format!(
            "<tr><td class=\"{0}\">{0}</td><td>{1}</td><td>{2}</td><td>{3}</td><td>{4} %</td></tr>",
            colour.letter(),
            noise.join(", "),
            with_error(calibration.gain[c]),
            with_error(calibration.glare[c]),
            minus(&format!("{:.2}", 100.0 * calibration.drift[c])),
        )
    });
    format!(
        "<h3>Camera model</h3>\n<div class=\"wide\"><table><tr><th>channel</th><th>dark noise [DN] / system gain K [DN/e⁻]</th>\
         <th>responsivity [DN]</th><th>glare</th><th>drift</th></tr>{}</table></div>\n\
         <p class=\"faint\">Temporal dark noise and system gain as in EMVA 1288, by the photon transfer of repeated shots; the \
         responsivity is the signal of a radiance factor of 1; the glare is the share of the mean light that adds to every pixel; \
         the drift is that of the lamps between the first and the last shot of the patches.</p>\n",
        rows.collect::<String>()
    )
}

/// The light over the frame in green, as in Fig. 4 of the paper: grey is the mean, a step of colour 1 %.
fn light(captured: &Captured, part: &CapturedPart) -> String {
    let first = captured.inputs.first().and_then(|input| input.thumbnail.as_ref());
    let Some([width, height]) = first.map(|thumbnail| thumbnail.full) else { return String::new() };
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
    format!(
        "<h3>Light over the frame</h3>\n<figure><img class=\"strip\" style=\"max-width:24rem\" src=\"{}\" alt=\"map of the light\">\
         <figcaption>Green, from {} % (blue) to {:+.1} % (red) of the mean, in steps of 1 %.</figcaption></figure>\n",
        data_uri(COLUMNS, rows, &bytes),
        minus(&format!("{:.1}", 100.0 * (low - 1.0))),
        100.0 * (high - 1.0),
    )
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
