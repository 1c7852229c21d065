//! Grey patches whose places are not in the session file.

use farm_tests::photograph::{Camera, Look, Session, What};
use optics_capture::{Area, Calibration, Frame, Neutral, Pattern, Photo, Refusal};

use super::stage::{PLAIN, calibrate, calibrate_after, calibrate_by, session, slab};

/// Greys whose places have to be found.
fn greys(rho: &[f64]) -> Neutral {
    Neutral::new(rho.iter().map(|r| vec![*r; 3]).collect(), 0.005, None).expect("greys of a chart are valid")
}

/// The calibration with shots of this subject as patches.
fn found(session: &Session, rho: &[f64], subject: What, look: &Look) -> Result<Calibration, Refusal> {
    calibrate_by(session, greys(rho), subject, look)
}

/// The areas that are found in modified photographs.
fn found_after(retouch: fn(Photo) -> Photo) -> Result<Vec<Area>, Refusal> {
    let session = session();
    let calibration = calibrate_after(retouch, session, greys(&session.rho), What::Chart, &PLAIN)?;
    Ok(areas(&calibration))
}

/// A frame with other samples, which `sample` returns for a column and a row.
fn redrawn(photo: Photo, size: [usize; 2], pattern: Pattern, sample: impl Fn(&Frame, usize) -> u16) -> Photo {
    let planes = if pattern == Pattern::Rgb { 3 } else { 1 };
    let samples = (0..size[0] * size[1] * planes).map(|i| sample(&photo.frame, i)).collect();
    let frame = Frame::new(size[0], size[1], pattern, samples).expect("the frame is valid");
    Photo { frame, ..photo }
}

/// The photograph of a camera on its side; the mosaic's greens are on the diagonal that stays.
fn on_its_side(photo: Photo) -> Photo {
    let (w, h, pattern) = (photo.frame.width(), photo.frame.height(), photo.frame.pattern());
    assert!(matches!(pattern, Pattern::Bayer([_, a, b, _]) if a == b), "{pattern:?}");
    redrawn(photo, [h, w], pattern, |frame, i| frame.samples()[(i % h) * w + i / h])
}

/// One RGB pixel for each cell of the mosaic.
fn in_colours(photo: Photo) -> Photo {
    let (w, h) = (photo.frame.width(), photo.frame.height());
    redrawn(photo, [w / 2, h / 2], Pattern::Rgb, |frame, i| {
        let (pixel, colour) = (i / 3, i % 3);
        let corner = 2 * (pixel / (w / 2)) * w + 2 * (pixel % (w / 2));
        frame.samples()[corner + [0, 1, w + 1][colour]]
    })
}

/// The photograph with its middle copied above it.
fn twice(photo: Photo) -> Photo {
    let (w, h, pattern) = (photo.frame.width(), photo.frame.height(), photo.frame.pattern());
    let up = h / 6 * 2;
    let upper = 10..up - 10;
    redrawn(photo, [w, h], pattern, |frame, i| {
        frame.samples()[if upper.contains(&(i / w)) { i + up * w } else { i }]
    })
}

/// Whether areas are equal, within a number of pixels on every side.
fn same(areas: &[Area], others: &[Area], within_px: f64) -> bool {
    let off = |a: &Area, b: &Area| {
        let sides = [a.x - b.x, a.y - b.y, a.width - b.width, a.height - b.height];
        sides.into_iter().map(f64::abs).fold(0.0, f64::max)
    };
    areas.len() == others.len() && areas.iter().zip(others).all(|(a, b)| off(a, b) <= within_px)
}

/// Rows of patches are found if they are upright or coloured.
#[test]
fn upright_and_coloured_patches_are_found() {
    let session = session();
    let lying = areas(&found(session, &session.rho, What::Chart, &PLAIN).unwrap());
    let turned: Vec<Area> =
        lying.iter().map(|a| Area { x: a.y, y: a.x, width: a.height, height: a.width }).collect();
    let upright = found_after(on_its_side).unwrap();
    assert!(same(&upright, &turned, 2.0), "{upright:?} {turned:?}");
    let halved: Vec<Area> = lying
        .iter()
        .map(|a| Area { x: a.x / 2.0, y: a.y / 2.0, width: a.width / 2.0, height: a.height / 2.0 })
        .collect();
    let coloured = found_after(in_colours).unwrap();
    assert!(same(&coloured, &halved, 4.0), "{coloured:?} {halved:?}");
}

/// If two rows could be the patches, none is taken.
#[test]
fn ambiguous_patch_rows_are_refused() {
    let refused = found_after(twice).unwrap_err();
    assert!(matches!(refused, Refusal::NoPatches { .. }), "{refused}");
    let message = refused.to_string();
    assert!(message.contains("two rows fit") && message.contains("`areas_px`"), "{message}");
}

fn areas(calibration: &Calibration) -> Vec<Area> {
    calibration.patches.iter().map(|patch| patch.area).collect()
}

/// The found areas lie within the true patches, clear of the margins, and give the same gains.
#[test]
fn found_patches_calibrate_like_given_areas() {
    let session = session();
    let given = calibrate(session, &PLAIN).unwrap();
    let found = found(session, &session.rho, What::Chart, &PLAIN).unwrap();
    for (area, [x, y, width, height]) in areas(&found).iter().zip(session.areas_px()) {
        // A margin of a fifth of the patch is left on every side.
        assert!(area.x > x && area.x + area.width < x + width, "{area:?} {x} {width}");
        assert!(area.y > y && area.y + area.height < y + height, "{area:?} {y} {height}");
        assert!(area.width > 0.5 * width && area.height > 0.5 * height, "{area:?}");
    }
    for c in 0..3 {
        let (a, b) = (given.gain[c], found.gain[c]);
        assert!((a.value - b.value).abs() < 4.0 * libm::hypot(a.std_error, b.std_error), "{a:?} {b:?}");
        assert!(b.std_error < 3e-4 * b.value, "{b:?}");
    }
}

/// Light falls off by a quarter, and lamps flicker; patches run from left to right, and from right to left.
#[test]
fn patches_are_found_in_uneven_light() {
    let camera = Camera { vignetting: 0.25, ..Camera::default() };
    let session = Session::new(camera, slab());
    let look = Look { seed: 3, flicker: 0.004, ..PLAIN };
    let forwards = areas(&found(&session, &session.rho, What::Chart, &look).unwrap());
    assert!((1..6).all(|i| forwards[i].x > forwards[i - 1].x), "{forwards:?}");
    let reversed: Vec<f64> = session.rho.iter().rev().copied().collect();
    let mut backwards = areas(&found(&session, &reversed, What::Chart, &look).unwrap());
    backwards.reverse();
    let off = |(a, b): (&Area, &Area)| (a.x - b.x).abs() + (a.y - b.y).abs();
    assert!(forwards.iter().zip(&backwards).all(|pair| off(pair) < 1e-6), "{forwards:?} {backwards:?}");
}

/// The refusal suggests `areas_px`.
#[test]
fn missing_or_misordered_patches_are_refused() {
    let session = session();
    let swapped = [0.594, 0.956, 0.361, 0.193, 0.09, 0.032];
    for (rho, subject) in [(session.rho.as_slice(), What::Bare), (&swapped, What::Chart)] {
        let refused = found(session, rho, subject, &PLAIN).unwrap_err();
        assert!(matches!(refused, Refusal::NoPatches { .. }), "{refused}");
        assert!(refused.to_string().contains("`areas_px`"), "{refused}");
    }
}
