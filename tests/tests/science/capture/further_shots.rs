//! Further shots of a session: another edge, a light trap, one panel at several exposures, lamps without blue.

use farm_tests::photograph::{Camera, Edge, Session, Slab, What};
use optics_capture::{
    BareShots, BlueCutShots, Calibration, Darks, Estimate, Flats, Frame, HazeShots, Neutral, Patches, Photo,
    Refusal, Warning,
};

use super::stage::{PLAIN, board, calibrate, find, mounted, shots, slab, true_blur_mm, white};

fn is_within(found: Estimate, truth: f64, errors: f64) -> bool {
    (found.value - truth).abs() < errors * found.std_error
}

/// The edge of a board in which a part of the light spreads by 0.02 mm and the rest by 0.15 mm.
fn twofold(channel: usize, x_mm: f64) -> f64 {
    let (light, dark) = (board().light[channel], board().dark[channel]);
    let own = if x_mm > 0.0 { light } else { dark };
    let far = 0.5 * (libm::exp(-x_mm.abs() / 0.02) + libm::exp(-x_mm.abs() / 0.15));
    own + 0.5 * ((light * dark).sqrt() - own) * far
}

/// Where light spreads in another way than assumed, the bare edge alone gives another blur, within its error; a sharp edge
/// off the board's, with its light side on either side, gives the blur of the camera. A sheet is no edge.
#[test]
fn another_edge_gives_the_cameras_blur() {
    // It covers two squares.
    let spreading = Slab { edge: Edge::new(twofold), rim_mm: [-13.9, 13.9, -6.9, 6.9], ..slab() };
    let session = Session::new(Camera::default(), spreading);
    let calibration = calibrate(&session, &PLAIN).unwrap();
    let bare = shots(&session, What::Slab, 2, &PLAIN);
    let with_edges = |edges: Vec<Photo>| {
        let mut shots = BareShots::new(&calibration, session.target()).unwrap();
        bare.iter().cloned().try_for_each(|photo| shots.add(photo)).unwrap();
        edges.into_iter().try_for_each(|photo| shots.add_edge(photo))?;
        shots.finish()
    };
    let off =
        |found: &optics_capture::Board, c: usize| found.blur_mm[c].value / true_blur_mm(&session, c) - 1.0;
    let alone = with_edges(Vec::new()).unwrap();
    println!("alone {:+.3} {:?}", off(&alone, 1), alone.spread_mm);
    let stated = alone.blur_mm[1].std_error / alone.blur_mm[1].value;
    assert!((0.1..1.5 * stated).contains(&off(&alone, 1).abs()), "{:+.4} ± {stated:.4}", off(&alone, 1));
    for (at_mm, levels) in [(0.4, [0.03, 0.8]), (-1.3, [0.6, 0.05])] {
        let mut other = session.clone();
        let step = Edge::new(move |_, x| levels[usize::from(x > at_mm)]);
        other.lay(&session.camera, &Slab { edge: step, ..slab() });
        let found = with_edges(shots(&other, What::Slab, 2, &PLAIN)).unwrap();
        println!("{at_mm} {:+.4} {:?}", off(&found, 1), found.spread_mm);
        assert!((0..3).all(|c| off(&found, c).abs() < 0.015), "{:?}", found.blur_mm);
    }
    let even = with_edges(vec![session.shoot(What::Sheet, 0, &PLAIN)]).unwrap_err();
    assert!(matches!(even, Refusal::NoOwnEdge { .. }), "{even}");
}

/// Haze is found over a light trap, with the error of stray light; a white sheet is no trap.
#[test]
fn haze_is_measured_over_a_light_trap() {
    let mut session = Session::new(Camera::default(), slab());
    let calibration = calibrate(&session, &PLAIN).unwrap();
    let board = find(&session, &calibration, &PLAIN).unwrap();
    for haze in [0.0, 0.004, 0.01] {
        let trap = Slab { edge: Edge::new(move |_, _| haze), rim_mm: [-60.0, 60.0, -60.0, 60.0], ..slab() };
        session.lay(&session.camera.clone(), &trap);
        let mut shots_of_trap = HazeShots::new(&calibration, &board);
        shots(&session, What::Slab, 2, &PLAIN).into_iter().try_for_each(|p| shots_of_trap.add(p)).unwrap();
        let found = shots_of_trap.finish().unwrap();
        println!("{haze}: {found:?}");
        assert!(is_within(found, haze, 3.0) && found.std_error < 3e-3, "{haze}: {found:?}");
    }
    let mut sheet = HazeShots::new(&calibration, &board);
    let refused = sheet.add(session.shoot(What::Sheet, 0, &PLAIN)).unwrap_err();
    assert!(matches!(refused, Refusal::NoTrap { .. }), "{refused}");
    // Velvet under the gel is no trap.
    let velvet = Slab { edge: Edge::new(|_, _| 0.018), rim_mm: [-60.0, 60.0, -60.0, 60.0], ..slab() };
    session.lay(&session.camera.clone(), &velvet);
    let refused = sheet.add(session.shoot(What::Slab, 0, &PLAIN)).unwrap_err();
    assert!(matches!(refused, Refusal::NoTrap { .. }), "{refused}");
}

/// Calibration with the white sheet as the only patch, and shots of it under these shares of the exposure.
fn with_panel(camera: Camera, exposures: &[f64]) -> Result<Calibration, Refusal> {
    let mut session = Session::new(camera, slab());
    let mut darks = Darks::new();
    shots(&session, What::Dark, 2, &PLAIN).into_iter().try_for_each(|photo| darks.add(photo))?;
    let black = darks.finish(&session.shoot(What::Bare, 0, &PLAIN))?;
    let mut flats = Flats::new(&black);
    shots(&session, What::Sheet, 2, &PLAIN).into_iter().try_for_each(|photo| flats.add(photo))?;
    let neutral = Neutral::new(vec![vec![0.9; 3]], 0.005, None)?;
    let mut patches = Patches::new(black, flats.finish()?, neutral);
    for i in 10..12 {
        patches.add(session.shoot(What::Sheet, i, &PLAIN))?;
    }
    session.brightness = (20..).zip(exposures).map(|(i, share)| (What::Sheet, i, *share)).collect();
    for (i, share) in (20..).zip(exposures) {
        let mut photo = session.shoot(What::Sheet, i, &PLAIN);
        photo.exposure.as_mut().unwrap().time_s *= share;
        patches.add_exposure(photo)?;
    }
    patches.finish()
}

/// One panel gives the white reference; exposures show linearity, without which 1 % is allowed for; a curve is refused.
#[test]
fn one_panel_and_exposures_replace_patches() {
    let shares = [0.25, 0.5, 1.0];
    let found = with_panel(Camera::default(), &shares).unwrap();
    let by_patches = calibrate(&Session::new(Camera::default(), slab()), &PLAIN).unwrap();
    for c in 0..3 {
        assert!(is_within(found.gain[c], by_patches.gain[c].value, 2.0), "{c}: {:?}", found.gain);
        assert!(found.gain[c].std_error < 0.01 * found.gain[c].value, "{c}: {:?}", found.gain);
        assert!(found.linearity[c] < 2e-3, "{:?}", found.linearity);
    }
    assert!(!found.warnings.iter().any(|w| matches!(w, Warning::LinearityUnknown { .. })));
    assert!(found.warnings.iter().any(|w| matches!(w, Warning::GlareUnknown { .. })), "{:?}", found.warnings);
    let alone = with_panel(Camera::default(), &[]).unwrap();
    assert_eq!(alone.linearity, [0.01; 3]);
    assert!(alone.warnings.iter().any(|w| matches!(w, Warning::LinearityUnknown { .. })));
    // The lowest sixteenth of the numbers shows little: the session's own exposure counts too.
    let low = with_panel(Camera { curve: 0.06, ..Camera::default() }, &[0.0625, 0.05, 0.03]).unwrap_err();
    assert!(matches!(low, Refusal::NotProportional { .. }), "{low}");
    let curved = with_panel(Camera { curve: 0.06, ..Camera::default() }, &shares).unwrap_err();
    assert!(matches!(curved, Refusal::NotProportional { .. }), "{curved}");
}

/// A photograph whose samples are scaled by colour, as by a filter before the lamps.
fn filtered(photo: Photo, factors: [f64; 3], black: f64) -> Photo {
    let width = photo.frame.width();
    let sample = |(i, s): (usize, &u16)| {
        let colour = (i % width % 2) + (i / width % 2);
        (black + (f64::from(*s) - black) * factors[colour]).round().clamp(0.0, 65_535.0) as u16
    };
    let samples = photo.frame.samples().iter().enumerate().map(sample).collect();
    let (width, height) = (photo.frame.width(), photo.frame.height());
    Photo { frame: Frame::new(width, height, photo.frame.pattern(), samples).unwrap(), ..photo }
}

/// Three per cent of red that blue excites are found where blue is blocked, and none in green, although the filter takes a
/// part of both; a shot that still has blue is refused.
#[test]
fn excited_light_ends_without_blue() {
    let mut session = Session::new(Camera::default(), slab());
    let calibration = calibrate(&session, &PLAIN).unwrap();
    let board = find(&session, &calibration, &PLAIN).unwrap();
    let whole = mounted(&session, &calibration, &board, &PLAIN, 3).unwrap();
    let cut = Edge::new(|c, x| if c == 0 { 0.97 * white(c, x) } else { white(c, x) });
    session.lay(&session.camera.clone(), &Slab { edge: cut, ..slab() });
    let black = session.camera.black;
    let shot = |i: u64, factors| filtered(session.shoot(What::Slab, 10 + i, &PLAIN), factors, black);
    let mut without = BlueCutShots::new(&calibration, &board, &whole);
    (0..2).try_for_each(|i| without.add(shot(i, [0.9, 0.85, 0.02]))).unwrap();
    let [red, green] = without.finish().unwrap().map(Option::unwrap);
    println!("red {red:?}, green {green:?}");
    assert!(is_within(red, 0.03, 3.0) && is_within(green, 0.0, 3.0), "{red:?} {green:?}");
    assert!(red.std_error < 3e-3 && green.std_error < 0.03, "{red:?} {green:?}");
    let refused = BlueCutShots::new(&calibration, &board, &whole).add(shot(3, [0.9, 0.9, 0.8])).unwrap_err();
    assert!(matches!(refused, Refusal::NoBlueCut { .. }), "{refused}");
    // Neither a thinner slab nor a black one shows anything.
    let mut other = BlueCutShots::new(&calibration, &board, &whole);
    let bright = Edge::new(|c, x| 1.1 * white(c, x));
    session.lay(&session.camera.clone(), &Slab { edge: bright, ..slab() });
    other.add(filtered(session.shoot(What::Slab, 20, &PLAIN), [0.9, 0.85, 0.0], black)).unwrap();
    let refused = other.finish().unwrap_err();
    assert!(matches!(refused, Refusal::BrighterWithoutBlue { .. }), "{refused}");
    session.lay(&session.camera.clone(), &Slab { edge: Edge::new(|_, _| 0.01), ..slab() });
    let black_slab = mounted(&session, &calibration, &board, &PLAIN, 3).unwrap();
    let mut dark = BlueCutShots::new(&calibration, &board, &black_slab);
    dark.add(filtered(session.shoot(What::Slab, 30, &PLAIN), [0.9, 0.85, 0.02], black)).unwrap();
    assert_eq!(dark.finish().unwrap(), [None; 2]);
}
