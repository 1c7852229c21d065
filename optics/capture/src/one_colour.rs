//! Detects photographs whose colours are one channel, from a monochrome camera or grey stored as RGB, and those whose
//! colours are mixed by a matrix, or lie in another mosaic.

use crate::estimate::Estimate;
use crate::frame::{Colour, Frame, Pattern, Photo, Site};
use crate::least_squares::median;
use crate::noise::{NoiseBlock, block, corners, single};
use crate::refusal::Refusal;
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

/// Largest correlation of the noise of two colours, opposite in sign, of which nothing but a matrix is the cause: sharing of
/// details when a mosaic is interpolated gives positive ones.
const OPPOSITE: f64 = 0.12;

/// Fewest places that determine it.
const FEWEST: i32 = 2000;

/// Refuses three samples per pixel whose noise is of opposite sign: a matrix to another colour space, whose weights are
/// partly negative, mixes the channels.
pub(crate) fn check_unmixed(photo: &Photo) -> Result<(), Refusal> {
    let frame = &photo.frame;
    if frame.pattern() != Pattern::Rgb {
        return Ok(());
    }
    let sites = frame.sites();
    let correlation = |a: usize, b: usize| {
        let bend = |site: Site, x: usize, y: usize| {
            let [left, own, right] = [x - 1, x, x + 1].map(|x| i32::from(frame.at(site, x, y)));
            (left + right - 2 * own).signum()
        };
        let (mut sum, mut count) = (0, 0);
        for y in (0..frame.height()).step_by((frame.height() / ROWS).max(1)) {
            for x in 1..frame.width() - 1 {
                let product = bend(sites[a], x, y) * bend(sites[b], x, y);
                (sum, count) = (sum + product, count + product.abs());
            }
        }
        if count < FEWEST {
            return 0.0;
        }
        // The correlation of normal variables whose signs agree this often: edges hardly change it.
        libm::sin(0.5 * std::f64::consts::PI * f64::from(sum) / f64::from(count))
    };
    let pairs = [(0, 1), (1, 2), (0, 2)].map(|(a, b)| (sites[a].colour, sites[b].colour, correlation(a, b)));
    let (one, other, correlation) =
        pairs.into_iter().fold(pairs[0], |least, p| if p.2 < least.2 { p } else { least });
    if correlation < -OPPOSITE {
        return Err(Refusal::MixedColours { label: photo.label.clone(), one, other, correlation });
    }
    Ok(())
}

/// Refuses a mosaic whose samples repeat after four rows or columns instead of two.
pub(crate) fn check_period(photo: &Photo) -> Result<(), Refusal> {
    let frame = &photo.frame;
    let Pattern::Bayer(_) = frame.pattern() else { return Ok(()) };
    let (width, height) = (frame.width(), frame.height());
    let skip = 4 * (width * height / (16 * PAIRS)).isqrt().max(1);
    let at = |x: usize, y: usize| f64::from(frame.samples()[y * width + x]).max(1.0);
    // The median ratio to the sample two columns or rows on, of each place among four by four: scenes hardly change it.
    let ratio = |place: usize, [right, down]: [usize; 2]| {
        let (columns, rows) = ((place % 4..width - 2).step_by(skip), (place / 4..height - 2).step_by(skip));
        let ratios = rows.flat_map(|y| columns.clone().map(move |x| at(x, y) / at(x + right, y + down)));
        median(&mut ratios.collect::<Vec<_>>())
    };
    let differs = |step: [usize; 2]| (0..16).any(|place| (ratio(place, step) - 1.0).abs() > PERIOD);
    if differs([2, 0]) || differs([0, 2]) {
        return Err(Refusal::FourPixels { label: photo.label.clone() });
    }
    Ok(())
}

/// Deviation of a ratio from 1 beyond which samples two places apart differ, and pairs of samples for each.
const PERIOD: f64 = 0.03;
const PAIRS: usize = 20_000;

/// Rows that are compared.
const ROWS: usize = 200;

/// Difference of two blocks, in standard errors.
fn difference(a: NoiseBlock, b: NoiseBlock) -> f64 {
    let variance = (a.variance + b.variance) / BLOCK_SAMPLES;
    (a.signal - b.signal).abs() / variance.sqrt().max(LEAST * b.signal.abs()).max(1e-6)
}

const BLOCK_SAMPLES: f64 = (crate::noise::SIDE * crate::noise::SIDE) as f64;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Levels;
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

    /// A matrix between colour spaces is found by the noise, whatever the light; three channels of their own are not.
    #[test]
    fn colour_matrices_are_refused() {
        let plain = frame(Pattern::Rgb, [0.6, 1.0, 0.7], false);
        let mixed = |matrix: [[f64; 3]; 3]| {
            let pixels = plain.samples().chunks(3).flat_map(|rgb| {
                matrix.map(|row| {
                    let sum: f64 = row.iter().zip(rgb).map(|(m, v)| m * f64::from(*v)).sum();
                    (500.0 + sum).clamp(0.0, 65_535.0) as u16
                })
            });
            let frame = Frame::new(400, 300, Pattern::Rgb, pixels.collect()).unwrap();
            let label = "it".to_owned();
            check_unmixed(&Photo { label, frame, levels: Levels::default(), seconds: None, exposure: None })
        };
        let srgb = [[1.9, -0.7, -0.2], [-0.25, 1.6, -0.35], [0.05, -0.55, 1.5]];
        let refusal = mixed(srgb).unwrap_err();
        assert!(
            matches!(refusal, Refusal::MixedColours { correlation, .. } if correlation < -0.4),
            "{refusal}"
        );
        let balanced = [[1.75, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.4]];
        let shared = [[1.0, 0.2, 0.0], [0.2, 1.0, 0.2], [0.0, 0.2, 1.0]];
        assert_eq!([mixed(balanced), mixed(shared)], [Ok(()), Ok(())]);
    }

    /// Two by two pixels of one colour, and rows of two sensitivities, are refused; a mosaic is not.
    #[test]
    fn mosaics_of_four_pixels_are_refused() {
        let plain = frame(RGGB, [0.6, 1.0, 0.7], false);
        let scaled = |factor: fn(usize, usize) -> f64| {
            let samples = plain.samples().iter().enumerate();
            let samples = samples.map(|(i, s)| (f64::from(*s) * factor(i % 400, i / 400)) as u16).collect();
            let frame = Frame::new(400, 300, plain.pattern(), samples).unwrap();
            let label = "it".to_owned();
            check_period(&Photo { label, frame, levels: Levels::default(), seconds: None, exposure: None })
        };
        assert_eq!(scaled(|_, _| 1.0), Ok(()));
        for factor in [
            |x: usize, y: usize| if (x / 2 + y / 2).is_multiple_of(2) { 1.0 } else { 0.8 },
            |_: usize, y: usize| if (y / 2).is_multiple_of(2) { 1.0 } else { 0.25 },
        ] {
            assert!(matches!(scaled(factor), Err(Refusal::FourPixels { .. })));
        }
    }
}
