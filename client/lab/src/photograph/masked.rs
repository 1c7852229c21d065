//! Measures the black level in the margins of a sensor that no light reaches (DNG 1.4, MaskedAreas). They refine the
//! level in the file; alone they could not be distinguished from margins that light reaches.

use super::directory::Tag;
use super::unreadable::UnreadablePhotograph;
use super::{Photograph, SampleLayout};

/// Fewest samples per position of the mosaic that determine a level: to a sixteenth of the noise.
const FEWEST: usize = 256;
/// Share of samples that are left out at either end, as defects of the sensor.
const ODD: f64 = 0.05;
/// Largest difference between the margins and the level in the file, as a share of its range: beyond it, light reaches
/// them.
const LIT: f64 = 0.005;
/// Largest difference between the halves of a margin nearer to the picture and farther from it, likewise: light that leaks
/// falls off.
const UNEVEN: f64 = 0.0005;
/// Largest number of rectangles.
const MOST_AREAS: usize = 16;

/// The black level by row and column modulo 2, from the corner of the active area; `None` where the margins do not
/// determine it.
pub(super) fn black(
    whole: &Photograph,
    areas: &[u64],
    active: &[u64],
) -> Result<Option<[f64; 4]>, UnreadablePhotograph> {
    let Some(stated) = whole.black.filter(|_| whole.layout != SampleLayout::Rgb && !areas.is_empty()) else {
        return Ok(None);
    };
    let refused = || {
        let allowed = format!(
            "must be at most {MOST_AREAS} rectangles within {} × {} pixels",
            whole.width, whole.height
        );
        UnreadablePhotograph::tag(Tag::MASKED_AREAS.name, format_args!("{areas:?}"), allowed)
    };
    let corner = [0, 1].map(|i| active.get(i).copied().unwrap_or(0) as usize);
    let range = whole.white.unwrap_or([65_535.0; 4]);
    let mut found: [Vec<u16>; 4] = Default::default();
    if areas.len() > 4 * MOST_AREAS {
        return Err(refused());
    }
    for area in areas.chunks(4) {
        let area = <[u64; 4]>::try_from(area).map_err(|_| refused())?;
        let [top, left, bottom, right] = within(area, whole).ok_or_else(refused)?;
        // Halves across the shorter side, by place of the mosaic.
        let mut halves: [[Vec<u16>; 4]; 2] = Default::default();
        for y in top..bottom {
            for x in left..right {
                let is_wide = right - left > bottom - top;
                let second = if is_wide { 2 * y >= top + bottom } else { 2 * x >= left + right };
                let place = (y + corner[0]) % 2 * 2 + (x + corner[1]) % 2;
                halves[usize::from(second)][place].push(whole.samples[y * whole.width + x]);
            }
        }
        let uneven = |i: usize| {
            if halves.iter().any(|half| half[i].len() < FEWEST / 4) {
                return false;
            }
            let [one, other] = halves.each_ref().map(|half| middle(half[i].clone()));
            (one - other).abs() > UNEVEN * (range[i] - stated[i])
        };
        if (0..4).any(uneven) {
            return Ok(None);
        }
        for (place, samples) in halves.into_iter().flat_map(|half| half.into_iter().enumerate()) {
            found[place].extend(samples);
        }
    }
    if found.iter().any(|samples| samples.len() < FEWEST) {
        return Ok(None);
    }
    let levels = found.map(middle);
    let dark = (0..4).all(|i| (levels[i] - stated[i]).abs() < LIT * (range[i] - stated[i]).max(1.0));
    Ok(dark.then_some(levels))
}

/// Mean of the samples without defects.
fn middle(mut samples: Vec<u16>) -> f64 {
    samples.sort_unstable();
    let out = (ODD * samples.len() as f64) as usize;
    let kept = &samples[out..samples.len() - out];
    kept.iter().map(|v| f64::from(*v)).sum::<f64>() / kept.len() as f64
}

/// The part of a rectangle within the picture: top, left, bottom, right. `None` if it extends beyond by more than a
/// fiftieth; rectangles in cameras' files are a few pixels off.
pub(super) fn within([top, left, bottom, right]: [u64; 4], picture: &Photograph) -> Option<[usize; 4]> {
    let (width, height) = (picture.width as u64, picture.height as u64);
    let near =
        bottom <= height + height / 50 && right <= width + width / 50 && top <= bottom && left <= right;
    near.then(|| [top.min(height), left.min(width), bottom.min(height), right.min(width)].map(|v| v as usize))
}
