//! Where a sensor is full.

use rayon::prelude::*;

use crate::frame::Photo;

/// Samples from this number on are clipped: the lower one of what the file tells and what the picture shows. A full
/// sensor piles up samples at the highest number that occurs.
pub(crate) fn saturation(photo: &Photo) -> f64 {
    let told = photo.levels.white.unwrap_or(f64::from(u16::MAX));
    let count = |chunk: &[u16]| {
        let mut counts = vec![0_u32; 1 << 16];
        for s in chunk {
            counts[usize::from(*s)] += 1;
        }
        counts
    };
    let samples = photo.frame.samples();
    let parts: Vec<Vec<u32>> = samples.par_chunks(samples.len() / 4 + 1).map(count).collect();
    let counts: Vec<u32> = (0..1 << 16).map(|k| parts.iter().map(|p| p[k]).sum()).collect();
    let highest = counts.iter().rposition(|n| *n > 0).unwrap_or(0) as f64;
    let between =
        |from: f64, to: f64| counts[from.ceil() as usize..to.ceil() as usize].iter().sum::<u32>() as usize;
    let near = 0.998 * highest;
    let (piled, below) = (between(near, highest + 1.0), between(0.985 * highest, near));
    // Above any brightness there are fewer samples than below, but where they pile up.
    let full = piled > 20.max(samples.len() / 20_000) && piled > 2 * below;
    if full { told.min(near) } else { told }
}
