//! A single photograph, while the slab still lies there.

use crate::black::Black;
use crate::board::{Sharpness, sharpness};
use crate::estimate::Estimate;
use crate::flat::Flat;
use crate::frame::{Colour, Photo};
use crate::refusal::{Refusal, Warning};
use crate::saturation::saturation;
use crate::view::View;

/// What one photograph shows without its session.
#[derive(Debug, Clone)]
pub struct ShotCheck {
    /// Share of clipped samples per channel within the middle half of the frame.
    pub clipped_share: [f64; 3],
    /// Brightest hundredth per channel as a share of what the sensor holds: 0.5 to 0.9 is well exposed.
    pub brightness_share: [f64; 3],
    /// σ of lens and pixel across edges that run up and down, and across the frame, where any is free.
    pub blur_px: [Option<Estimate>; 2],
    pub warnings: Vec<Warning>,
}

/// Share of clipped samples that refuses.
const CLIPPED: f64 = 1e-3;

/// Brightest hundredth below which noise is needlessly large.
const DIM: f64 = 0.15;

/// Checks what a photograph shows by itself: clipping, black level, exposure, and sharpness of free edges.
/// Against its session a shot is checked by [`crate::Mountings::add`].
pub fn check_shot(photo: &Photo) -> Result<ShotCheck, Refusal> {
    let black = Black::told(photo)?;
    let full = saturation(photo);
    let mut check = ShotCheck {
        clipped_share: [0.0; 3],
        brightness_share: [0.0; 3],
        blur_px: [None; 2],
        warnings: Vec::new(),
    };
    for colour in Colour::ALL {
        let c = colour.index();
        let (clipped, brightest) = levels(photo, &black, colour, full);
        check.clipped_share[c] = clipped;
        check.brightness_share[c] = brightest;
        if clipped > CLIPPED {
            let (label, place) = (photo.label.clone(), "the frame's middle".to_owned());
            return Err(Refusal::Clipped { label, colour, place, share: 100.0 * clipped, level: full });
        }
        if brightest < DIM {
            let (label, percent) = (photo.label.clone(), 100.0 * brightest);
            check.warnings.push(Warning::Dim { label, colour, percent });
        }
    }
    let Sharpness { blur_px } = sharpness(View { photo, black: &black, flat: &Flat::even() })?;
    check.blur_px = blur_px;
    if blur_px.iter().all(Option::is_none) {
        check.warnings.push(Warning::NoFreeEdge { label: photo.label.clone() });
    }
    Ok(check)
}

/// Share of clipped samples, and the brightest hundredth over the full range, in the middle half of the frame.
fn levels(photo: &Photo, black: &Black, colour: Colour, full: f64) -> (f64, f64) {
    let frame = &photo.frame;
    let skip = (frame.width() * frame.height() / 1_000_000).isqrt().max(1);
    let (mut signals, mut clipped) = (Vec::new(), 0.0);
    let mut range = full;
    for site in frame.sites().into_iter().filter(|s| s.colour == colour) {
        range = full - black.levels()[site.index].value;
        for y in (site.row..frame.height()).step_by(site.step * skip) {
            for x in (site.column..frame.width()).step_by(site.step * skip) {
                let middle = |at: usize, side: usize| (side / 4..side - side / 4).contains(&at);
                if middle(x, frame.width()) && middle(y, frame.height()) {
                    clipped += f64::from(u8::from(f64::from(frame.at(site, x, y)) >= full));
                    signals.push(black.signal(frame, site, x, y));
                }
            }
        }
    }
    if signals.is_empty() {
        return (0.0, 0.0);
    }
    let at = signals.len() * 99 / 100;
    let brightest = *signals.select_nth_unstable_by(at, f64::total_cmp).1;
    (clipped / signals.len() as f64, brightest / range.max(1.0))
}
