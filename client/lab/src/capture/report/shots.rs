//! Photographs with board, edge, crop and rejected samples drawn into them.

use farm_figures::numbers::fixed;
use optics_capture::{Board, ShotReport};

use crate::capture::captured::{Captured, CapturedPart};
use crate::document::{Block, Figure, PagePicture, escaped};

/// Shots of the board next to each other.
pub(super) fn row(captured: &Captured, part: &CapturedPart, shots: &[ShotReport]) -> Block {
    Block::Row(shots.iter().filter_map(|shot| figure(captured, part, shot)).collect())
}

/// One shot of the board: edge, crop, corners, rejected samples.
fn figure(captured: &Captured, part: &CapturedPart, shot: &ShotReport) -> Option<Figure> {
    let input = captured.inputs.iter().find(|input| input.label == shot.label);
    let thumbnail = input.and_then(|input| input.thumbnail.as_ref())?;
    let [width, height] = thumbnail.full;
    let mut words = vec![shot.label.clone()];
    words.extend(shot.blur_px.map(|blur| format!("blur {:.2} px", blur.value)));
    if shot.moved_px.iter().any(Option::is_some) {
        let moved = shot.moved_px.map(|moved| moved.map_or("?".to_owned(), |m| format!("{:+.3}", m.value)));
        words.push(format!("moved {} px", moved.join(", ")));
    }
    words.extend(shot.light.as_ref().map(|light| {
        let percent = light.iter().map(|l| fixed(100.0 * (l.factor.value - 1.0), 2));
        format!("light {} %", percent.collect::<Vec<_>>().join(", "))
    }));
    words.push(format!("rejected {}", shot.rejected_px.len()));
    let drawing = format!(
        "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\"><image href=\"{}\" width=\"{width}\" \
         height=\"{height}\" preserveAspectRatio=\"none\"/>{}{}</svg>",
        escaped(&shot.label),
        thumbnail.data_uri(black(part)),
        overlay(&part.board),
        dust(shot, width),
    );
    Some(Figure { pictures: vec![PagePicture::Drawing(drawing)], caption: words.join(", ") })
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

/// Crop, edge, and a cross at each corner of the squares.
fn overlay(board: &Board) -> String {
    let [x0, y0] = board.edge.from_px;
    let [x1, y1] = board.edge.to_px;
    let crop = board.crop_px.map(|[x, y]| format!("{x:.1},{y:.1}")).join(" ");
    let cross = |[x, y]: &[f64; 2]| format!("M{:.1} {y:.1}h24M{x:.1} {:.1}v24", x - 12.0, y - 12.0);
    format!(
        "<polygon class=\"overlay crop\" points=\"{crop}\"/>\
         <path class=\"overlay\" d=\"M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}{}\"/>",
        board.corners_px.iter().map(cross).collect::<String>()
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
