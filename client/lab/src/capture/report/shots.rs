//! Draws board, edge, crop and rejected samples into the photographs.

use optics_capture::{Board, ShotReport};

use crate::capture::captured::{Captured, CapturedPart};
use crate::page::escaped;

/// One shot of the board: edge, crop, corners, rejected samples.
pub(super) fn figure(captured: &Captured, part: &CapturedPart, shot: &ShotReport) -> String {
    let input = captured.inputs.iter().find(|input| input.label == shot.label);
    let Some(thumbnail) = input.and_then(|input| input.thumbnail.as_ref()) else { return String::new() };
    let [width, height] = thumbnail.full;
    let picture = thumbnail.data_uri(black(part));
    let named = |what: &str, value: String| format!("{what} {value}");
    let mut words = vec![escaped(&shot.label)];
    words.extend(shot.blur_px.map(|blur| named("blur", format!("{:.2} px", blur.value))));
    let moved = shot.moved_px.map(|moved| moved.map_or("?".to_owned(), |m| format!("{:+.3}", m.value)));
    if shot.moved_px.iter().any(Option::is_some) {
        words.push(named("moved", format!("{} px", moved.join(", "))));
    }
    words.extend(shot.light.as_ref().map(|light| {
        let percent = light.iter().map(|l| format!("{:+.2}", 100.0 * (l.value - 1.0)));
        named("light", format!("{} %", percent.collect::<Vec<_>>().join(", ")))
    }));
    words.push(named("rejected", shot.rejected_px.len().to_string()));
    format!(
        "<figure><div class=\"shot\"><img src=\"{picture}\" alt=\"{}\" width=\"{}\" height=\"{}\">\
         <svg viewBox=\"0 0 {width} {height}\" preserveAspectRatio=\"none\">{}{}</svg></div><figcaption>{}</figcaption></figure>\n",
        escaped(&shot.label),
        thumbnail.width,
        thumbnail.height,
        overlay(&part.board),
        dust(shot, width),
        words.join(", ")
    )
}

/// Black level of each colour, in numbers of the sensor.
fn black(part: &CapturedPart) -> [f64; 3] {
    let (mut sums, mut counts) = ([0.0; 3], [0.0; 3]);
    let levels = part.calibration.black().levels();
    for (noise, level) in part.calibration.noise.iter().zip(levels) {
        sums[noise.colour.index()] += level.value;
        counts[noise.colour.index()] += 1.0;
    }
    std::array::from_fn(|c| sums[c] / f64::max(counts[c], 1.0))
}

fn overlay(board: &Board) -> String {
    let [x0, y0] = board.edge.from_px;
    let [x1, y1] = board.edge.to_px;
    let crop = board.crop_px.map(|[x, y]| format!("{x:.1},{y:.1}")).join(" ");
    let corners = board.corners_px.iter().map(|[x, y]| {
        let r = 12.0;
        format!(
            "<path class=\"overlay\" d=\"M{:.1} {y:.1}h{:.1}M{x:.1} {:.1}v{:.1}\"/>",
            x - r,
            2.0 * r,
            y - r,
            2.0 * r
        )
    });
    format!(
        "<polygon class=\"overlay crop\" points=\"{crop}\"/><path class=\"overlay\" d=\"M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}\"/>{}",
        corners.collect::<String>()
    )
}

/// Largest number of dots.
const MOST_DOTS: usize = 2000;

fn dust(shot: &ShotReport, width: usize) -> String {
    // A dot that is visible in a picture of 360 pixels.
    let side = (width as f64 / 240.0).max(2.0);
    let step = shot.rejected_px.len().div_ceil(MOST_DOTS).max(1);
    let dots = shot.rejected_px.iter().step_by(step).map(|[x, y]| {
        let (x, y) = (f64::from(*x) - 0.5 * side, f64::from(*y) - 0.5 * side);
        format!("M{x:.0} {y:.0}h{side:.0}v{side:.0}h-{side:.0}z")
    });
    format!("<path class=\"overlay dust\" d=\"{}\"/>", dots.collect::<String>())
}
