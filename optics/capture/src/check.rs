//! Checks a single photograph, so that it can be repeated while the slab still lies on the board.

use crate::black::{Black, Darks};
use crate::flat::Flat;
use crate::frame::{Colour, Frame, Photo, Site};
use crate::lattice::{FreeEdge, free_edges};
use crate::one_colour;
use crate::refusal::{Refusal, Warning};
use crate::saturation::{Saturation, saturation};
use crate::view::PhotoView;

/// The checks of one photograph without its session.
#[derive(Debug, Clone)]
pub struct ShotCheck {
    /// Share of clipped samples per channel within the middle half of the frame.
    pub clipped_share: Vec<f64>,
    /// Brightest hundredth per channel as a share of the sensor's range: 0.5 to 0.9 is well exposed.
    pub brightness_share: Vec<f64>,
    /// The longest free edges that run up and down, and across the frame.
    pub edges: [Option<FreeEdge>; 2],
    pub warnings: Vec<Warning>,
}

/// Share of clipped samples above which a photograph is refused.
const CLIPPED: f64 = 1e-3;

/// Brightest hundredth below which the noise is unnecessarily large.
const DIM: f64 = 0.15;
/// Largest brightness of a dark shot, as a share of the sensor's range.
const DARK: f64 = 0.005;

/// Checks a photograph by itself: clipping, black level, exposure, and sharpness of free edges. Without dark shots, the
/// black level is that of its file. [`crate::Mountings::add`] checks a shot
/// against its session.
pub fn check_shot(photo: &Photo, darks: Darks) -> Result<ShotCheck, Refusal> {
    let (columns, full) = (photo.frame.columns(), saturation(photo));
    let mut check = ShotCheck {
        clipped_share: vec![0.0; columns.len()],
        brightness_share: vec![0.0; columns.len()],
        edges: [None; 2],
        warnings: Vec::new(),
    };
    if photo.frame.samples().iter().all(|sample| *sample == 0) {
        check.warnings.push(Warning::DarkShot { label: photo.label.clone() });
        return Ok(check);
    }
    // A clipped photograph has to be repeated, so no other warning matters.
    for colour in columns.iter().copied() {
        let clipped = clipped_share(photo, colour, full);
        check.clipped_share[colour.index()] = clipped;
        if clipped > CLIPPED {
            let (label, place) = (photo.label.clone(), "the frame's middle".to_owned());
            let level = full.of_colour(&photo.frame, colour);
            return Err(Refusal::Clipped { label, colour, place, share: 100.0 * clipped, level });
        }
    }
    let black = darks.finish(photo)?;
    for colour in columns.iter().copied() {
        let brightest = brightness_share(photo, &black, colour, full);
        check.brightness_share[colour.index()] = brightest;
        if brightest < DIM {
            let (label, percent) = (photo.label.clone(), 100.0 * brightest);
            check.warnings.push(Warning::Dim { label, colour, percent });
        }
    }
    if check.brightness_share.iter().all(|share| *share < DARK) {
        check.warnings = vec![Warning::DarkShot { label: photo.label.clone() }];
        return Ok(check);
    }
    one_colour::check_unmixed(photo)?;
    one_colour::check_period(photo)?;
    if one_colour::are_one(&photo.frame, black.levels(), full) {
        check.warnings.push(Warning::OneColour { label: photo.label.clone() });
    }
    check.edges = free_edges(PhotoView { photo, black: &black, flat: &Flat::even() })?;
    if check.edges.iter().flatten().all(|edge| edge.blur_px.is_none()) {
        check.warnings.push(Warning::NoFreeEdge { label: photo.label.clone() });
    }
    Ok(check)
}

/// The longest edges between black and white that run up and down, and across the frame. Clipped samples are not
/// refused here: see [`check_shot`].
pub fn find_edges(photo: &Photo) -> Result<[Option<FreeEdge>; 2], Refusal> {
    free_edges(PhotoView { photo, black: &Black::from_file(photo)?, flat: &Flat::even() })
}

/// Share of clipped samples in the middle half of the frame.
fn clipped_share(photo: &Photo, colour: Colour, full: Saturation) -> f64 {
    let (mut clipped, mut total) = (0.0, 0.0);
    for_middle(&photo.frame, colour, |site, x, y| {
        clipped += f64::from(u8::from(full.is_at(&photo.frame, site, x, y)));
        total += 1.0;
    });
    clipped / f64::max(total, 1.0)
}

/// The brightest hundredth as a share of the full range, in the middle half of the frame.
fn brightness_share(photo: &Photo, black: &Black, colour: Colour, full: Saturation) -> f64 {
    let (mut signals, mut range) = (Vec::new(), 1.0);
    for_middle(&photo.frame, colour, |site, x, y| {
        range = full.of(site) - black.levels()[site.index].value;
        signals.push(black.signal(&photo.frame, site, x, y));
    });
    if signals.is_empty() {
        return 0.0;
    }
    let at = signals.len() * 99 / 100;
    *signals.select_nth_unstable_by(at, f64::total_cmp).1 / range.max(1.0)
}

/// Samples of a colour in the middle half of the frame, about a million if there are more.
fn for_middle(frame: &Frame, colour: Colour, mut each: impl FnMut(Site, usize, usize)) {
    let skip = (frame.width() * frame.height() / 1_000_000).isqrt().max(1);
    let middle = |at: usize, side: usize| (side / 4..side - side / 4).contains(&at);
    for site in frame.sites_of(colour) {
        let pixels = site.pixels(0..frame.width(), 0..frame.height(), skip);
        let inside = |(x, y): &(usize, usize)| middle(*x, frame.width()) && middle(*y, frame.height());
        pixels.filter(inside).for_each(|(x, y)| each(site, x, y));
    }
}
