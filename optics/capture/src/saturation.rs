//! Where a sensor is full.

use crate::frame::Photo;

/// Samples from this number on are clipped: the lower one of what the file tells and what the picture shows. A full
/// sensor piles up samples at the highest number that occurs.
pub(crate) fn saturation(photo: &Photo) -> f64 {
    let samples = photo.frame.samples();
    let told = photo.levels.white.unwrap_or(f64::from(u16::MAX));
    let highest = samples.iter().copied().max().unwrap_or(0);
    let near = f64::from(highest) * 0.998;
    let piled = samples.iter().filter(|s| f64::from(**s) >= near).count();
    let range =
        samples.iter().filter(|s| (0.985 * f64::from(highest)..near).contains(&f64::from(**s))).count();
    // Above any brightness there are fewer samples than below, but where they pile up.
    let full = piled > 20.max(samples.len() / 20_000) && piled > 2 * range;
    if full { told.min(near) } else { told }
}
