//! Grey patches that the session file does not say the place of.

use farm_tests::photograph::{Camera, Look, Session, What};
use optics_capture::{Area, Calibration, Neutral, Refusal};

use crate::stage::{PLAIN, calibrate, calibrate_by, session, slab};

/// The calibration by shots of this subject for the patches, whose places are looked for.
fn found(session: &Session, rho: &[f64], subject: What, look: &Look) -> Result<Calibration, Refusal> {
    let neutral = Neutral::new(rho.iter().map(|r| [*r; 3]).collect(), 0.005, None);
    calibrate_by(session, neutral.expect("greys of a chart are valid"), subject, look)
}

fn areas(calibration: &Calibration) -> Vec<Area> {
    calibration.patches.iter().map(|patch| patch.area).collect()
}

#[test]
fn patches_are_found_where_they_are_and_tell_what_they_told_with_areas() {
    let session = session();
    let told = calibrate(session, &PLAIN).unwrap();
    let found = found(session, &session.rho, What::Chart, &PLAIN).unwrap();
    for (area, [x, y, width, height]) in areas(&found).iter().zip(session.areas_px()) {
        // A fifth of the patch is kept clear of on every side.
        assert!(area.x > x && area.x + area.width < x + width, "{area:?} {x} {width}");
        assert!(area.y > y && area.y + area.height < y + height, "{area:?} {y} {height}");
        assert!(area.width > 0.5 * width && area.height > 0.5 * height, "{area:?}");
    }
    for c in 0..3 {
        let (a, b) = (told.gain[c], found.gain[c]);
        assert!((a.value - b.value).abs() < 4.0 * a.std_error.hypot(b.std_error), "{a:?} {b:?}");
        assert!(b.std_error < 3e-4 * b.value, "{b:?}");
    }
}

/// Light that falls off by a quarter, and lamps that flicker; and from right to left.
#[test]
fn patches_are_found_in_uneven_light_and_in_the_order_that_is_told() {
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

#[test]
fn what_is_not_there_or_in_another_order_is_not_found_and_the_refusal_says_what_helps() {
    let session = session();
    let swapped = [0.594, 0.956, 0.361, 0.193, 0.09, 0.032];
    for (rho, subject) in [(session.rho.as_slice(), What::Bare), (&swapped, What::Chart)] {
        let refused = found(session, rho, subject, &PLAIN).unwrap_err();
        assert!(matches!(refused, Refusal::NoPatches { .. }), "{refused}");
        assert!(refused.to_string().contains("`areas_px`"), "{refused}");
    }
}
