//! Detects photographs whose colours are one channel: from a monochrome camera, or grey stored as RGB.

use crate::estimate::Estimate;
use crate::frame::{Colour, Frame, Site};
use crate::least_squares::median;
use crate::noise::{NoiseBlock, block, corners, single};
use crate::saturation::Saturation;

/// Smallest relative error of a block's mean: pixels differ in their response.
const LEAST: f64 = 1e-3;

/// Largest median difference of blocks, in standard errors; that of noise is 0.67.
const AGREE: f64 = 1.5;

/// Whether the colours of a camera agree within noise in the brighter half of a frame.
pub(crate) fn are_one(frame: &Frame, black: &[Estimate], saturation: Saturation) -> bool {
    let sites = frame.sites();
    let scale = |colour: Colour| sites.iter().find(|site| site.colour == colour).copied();
    let (Some(red), Some(green), Some(blue)) =
        (scale(Colour::Red), scale(Colour::Green), scale(Colour::Blue))
    else {
        return false;
    };
    // The last place of a mosaic has the fewest rows and columns.
    let smallest = sites.last().copied().unwrap_or(blue);
    let mut blocks: Vec<[NoiseBlock; 3]> = corners(frame, smallest)
        .filter_map(|(i, j)| {
            let values = [red, green, blue].map(|site| (site, block(frame, site, i, j)));
            let clipped =
                |(site, scale): &(Site, Vec<f64>)| scale.iter().any(|v| saturation.holds(*site, *v));
            let blocks = values.each_ref().map(|(site, scale)| single(scale, black[site.index].value));
            (!values.iter().any(clipped)).then_some(blocks)
        })
        .collect();
    blocks.sort_by(|a, b| b[1].signal.total_cmp(&a[1].signal));
    blocks.truncate(blocks.len().div_ceil(2));
    let differs = |k: usize| {
        let mut z: Vec<f64> = blocks.iter().map(|b| difference(b[k], b[1])).collect();
        z.is_empty() || median(&mut z) > AGREE
    };
    !differs(0) && !differs(2)
}

/// Difference of two blocks, in standard errors.
fn difference(a: NoiseBlock, b: NoiseBlock) -> f64 {
    let variance = (a.variance + b.variance) / BLOCK_SAMPLES;
    (a.signal - b.signal).abs() / variance.sqrt().max(LEAST * b.signal.abs()).max(1e-6)
}

const BLOCK_SAMPLES: f64 = (crate::noise::SIDE * crate::noise::SIDE) as f64;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Pattern;
    use crate::testing::{RGGB, normal};

    /// Light that falls off to one side, with noise; `scale` multiplies the colours.
    fn frame(pattern: Pattern, scale: [f64; 3], grey: bool) -> Frame {
        let mut state = 7_u64;
        let planes = if pattern == Pattern::Rgb { 3 } else { 1 };
        let mut last = 0.0;
        let samples = (0..400 * 300 * planes).map(|i| {
            let (x, y, plane) = (i / planes % 400, i / planes / 400, i % planes);
            let colour = match pattern {
                Pattern::Bayer(colours) => colours[2 * (y % 2) + x % 2].index(),
                Pattern::Rgb | Pattern::One(_) => plane,
            };
            if plane == 0 || !grey {
                last = normal(&mut state);
            }
            // Half of it is a dark square.
            let light = if x < 190 { 5000.0 - 2.0 * x as f64 } else { 100.0 };
            (64.0 + scale[colour] * light + 58.0 * last).max(0.0) as u16
        });
        Frame::new(400, 300, pattern, samples.collect()).unwrap()
    }

    /// Three colours that agree within noise count as one.
    #[test]
    fn equal_colours_count_as_one() {
        let mosaic = RGGB;
        let black = [Estimate::new(64.0, 0.0); 4];
        let one =
            |pattern, scale, grey| are_one(&frame(pattern, scale, grey), &black, Saturation::all(65_535.0));
        assert!(one(mosaic, [1.0; 3], false), "a monochrome camera");
        assert!(one(Pattern::Rgb, [1.0; 3], true), "grey as RGB");
        assert!(!one(mosaic, [0.6, 1.0, 0.7], false), "a camera");
        // White-balanced, before a board that is nearly grey.
        assert!(!one(mosaic, [1.0, 1.0, 0.99], false), "balanced");
        assert!(!one(Pattern::Rgb, [1.01, 1.0, 1.0], false), "balanced");
    }
}
