//! One of three shots deviates from the others: the effect on the profile and on its stated errors.

use std::sync::OnceLock;

use farm_tests::photograph::{Camera, Edge, Look, Session, Slab, What};
use optics_capture::{
    Calibration, Contribution, Frame, Mountings, Photo, Refusal, SampleProfile, Source, Warning,
};

use super::stage::{PLAIN, calibrate, find, mounted, session, shots, slab};

/// The plain session up to its bare board.
struct SetUp {
    calibration: Calibration,
    board: optics_capture::Board,
}

fn set_up() -> &'static SetUp {
    static PLAIN_SET_UP: OnceLock<SetUp> = OnceLock::new();
    PLAIN_SET_UP.get_or_init(|| {
        let calibration = calibrate(session(), &PLAIN).expect("the plain session is valid");
        let board = find(session(), &calibration, &PLAIN).expect("its board is found");
        SetUp { calibration, board }
    })
}

/// One of three shots of the slab.
fn shot(i: usize) -> Photo {
    static SHOTS: OnceLock<Vec<Photo>> = OnceLock::new();
    SHOTS.get_or_init(|| shots(session(), What::Slab, 3, &PLAIN))[i].clone()
}

/// Three shots of the slab, one of which is modified.
fn slabs(spoil: impl Fn(Photo) -> Photo) -> Result<SampleProfile, Refusal> {
    measured([shot(0), spoil(shot(1)), shot(2)])
}

fn clean() -> &'static SampleProfile {
    static CLEAN: OnceLock<SampleProfile> = OnceLock::new();
    CLEAN.get_or_init(|| slabs(|photo| photo).expect("clean shots agree"))
}

fn measured(shots: impl IntoIterator<Item = Photo>) -> Result<SampleProfile, Refusal> {
    let mut sample = Mountings::new(&set_up().calibration, &set_up().board, "white");
    shots.into_iter().try_for_each(|photo| sample.add(photo))?;
    sample.finish()
}

/// The photograph with each sample's light scaled by a factor of its column and row.
fn dimmed(photo: Photo, factor: impl Fn(usize, usize) -> f64) -> Photo {
    relit(photo, |light, x, y| light * factor(x, y))
}

/// The photograph with the light of each sample, in numbers above black, changed by its column and row.
fn relit(photo: Photo, changed: impl Fn(f64, usize, usize) -> f64) -> Photo {
    let (width, black) = (photo.frame.width(), session().camera.black);
    let relit = |(i, s): (usize, &u16)| {
        let light = changed(f64::from(*s) - black, i % width, i / width);
        (black + light).round().clamp(0.0, 65_535.0) as u16
    };
    let samples = photo.frame.samples().iter().enumerate().map(relit).collect();
    with_samples(photo, samples)
}

/// The photograph with a share of the mean light of each of 2 × 2 pixels spread over the frame.
fn veiled(photo: Photo, share: f64) -> Photo {
    let (frame, black) = (&photo.frame, session().camera.black);
    let place = |i: usize| i % frame.width() % 2 + 2 * (i / frame.width() % 2);
    let mut sums = [0.0; 4];
    frame.samples().iter().enumerate().for_each(|(i, s)| sums[place(i)] += f64::from(*s) - black);
    let means = sums.map(|sum| 4.0 * sum / frame.samples().len() as f64);
    relit(photo, |light, x, y| light * (1.0 - share) + share * means[x % 2 + 2 * (y % 2)])
}

fn with_samples(photo: Photo, samples: Vec<u16>) -> Photo {
    let frame = Frame::new(photo.frame.width(), photo.frame.height(), photo.frame.pattern(), samples);
    Photo { frame: frame.expect("the size stays"), ..photo }
}

/// Relative mean and largest deviation of green from the clean session, and the stated error of the gain.
#[derive(Debug)]
struct Off {
    mean: f64,
    worst: f64,
    gain: f64,
}

impl Off {
    fn from_clean(found: &SampleProfile) -> Self {
        let pixels = found.profiles[1].values.iter().zip(&clean().profiles[1].values);
        let off: Vec<f64> = pixels.map(|(a, b)| a / b - 1.0).collect();
        let worst = off.iter().map(|off| off.abs()).fold(0.0, f64::max);
        Self { mean: off.iter().sum::<f64>() / off.len() as f64, worst, gain: gain(&found.budget) }
    }
}

/// Standard error of green's gain, as in session files.
fn gain(budget: &[Contribution]) -> f64 {
    let sources = [Source::Drift, Source::Mounting, Source::Linearity];
    budget
        .iter()
        .filter(|line| sources.contains(&line.source))
        .map(|line| line.std_error[1])
        .fold(0.0, libm::hypot)
}

fn noted(found: &SampleProfile, is: impl Fn(&Warning) -> bool) -> bool {
    found.warnings.iter().any(is)
}

/// A change of the light in one shot is divided out.
#[test]
fn changed_light_is_divided_out() {
    assert!(clean().warnings.is_empty(), "{:?}", clean().warnings);
    for factor in [0.99, 0.95, 1.045] {
        let found = slabs(|photo| dimmed(photo, |_, _| factor)).unwrap();
        let off = Off::from_clean(&found);
        println!("light × {factor}: {off:?}");
        let light = found.shots[1].light.as_ref().unwrap()[1].factor;
        assert!((light.value / factor - 1.0).abs() < 3.0 * light.std_error + 2e-4, "{light:?}");
        assert!(light.std_error < 1e-3, "{light:?}");
        assert!(off.mean.abs() < 3e-4 && off.gain < 1e-3, "{off:?}");
        assert!(noted(&found, |w| matches!(w, Warning::LightCorrected { .. })), "{:?}", found.warnings);
        assert!(!noted(&found, |w| matches!(w, Warning::Unchecked { .. })), "{:?}", found.warnings);
    }
}

/// Standard error of a source in a column.
fn stated(found: &SampleProfile, source: Source, c: usize) -> f64 {
    found.budget.iter().find(|line| line.source == source).expect("all sources are listed").std_error[c]
}

/// Mean deviation of a column from the clean session, and its slope per 10 mm.
fn departure(found: &SampleProfile, c: usize) -> [f64; 2] {
    let (own, clean) = (&found.profiles[c], &clean().profiles[c]);
    let (mut mean, mut slope, mut squares) = (0.0, 0.0, 0.0);
    for ((x, a), b) in own.x_mm.iter().zip(&own.values).zip(&clean.values) {
        mean += (a - b) / own.x_mm.len() as f64;
        slope += x * (a / b - 1.0);
        squares += x * x;
    }
    [mean, 10.0 * slope / squares]
}

/// Black level that drifts and stray light, in all shots of a slab, are subtracted with an error that holds them.
#[test]
fn offsets_of_slabs_are_subtracted() {
    let drifted = |numbers: f64| move |photo: Photo| relit(photo, |light, _, _| light + numbers);
    let mut cases: Vec<(String, Result<SampleProfile, Refusal>)> = Vec::new();
    for numbers in [-40.0, 5.0, 10.0, 30.0, 60.0, 110.0] {
        let name = format!("{numbers} numbers");
        cases.push((name, measured((0..3).map(shot).map(drifted(numbers)))));
    }
    for share in [0.01, 0.02, 0.05] {
        cases.push((format!("glare of {share}"), measured((0..3).map(|i| veiled(shot(i), share)))));
    }
    for (name, found) in cases {
        let found = found.unwrap();
        for c in 0..3 {
            let [mean, _] = departure(&found, c);
            let error = stated(&found, Source::Black, c);
            println!("{name}, column {c}: {mean:+.5}, stated {error:.5}");
            assert!(mean.abs() < 2.0 * error && error < 3e-3, "{name}: {mean} ± {error}");
        }
        assert!(!noted(&found, |w| matches!(w, Warning::Unchecked { .. } | Warning::LightUnchecked { .. })));
    }
    let refused = measured((0..3).map(|i| veiled(shot(i), 0.12))).err();
    assert!(matches!(refused, Some(Refusal::LightAdded { .. })), "{refused:?}");
}

/// Lamps that turn after the flats, or after the bare board, are seen by the board's light squares.
#[test]
fn turned_lamps_are_divided_out() {
    let width = session().camera.width as f64;
    let turned =
        |share: f64| move |photo: Photo| dimmed(photo, move |x, _| 1.0 + share * (x as f64 / width - 0.5));
    let bent = |share: f64| {
        move |photo: Photo| dimmed(photo, move |x, _| 1.0 + share * (2.0 * x as f64 / width - 1.0).powi(2))
    };
    let later = |lamps: &dyn Fn(Photo) -> Photo| {
        let bare = shots(session(), What::Bare, 2, &PLAIN).into_iter().map(lamps);
        let mut board = optics_capture::BareShots::new(&set_up().calibration, session().target())?;
        bare.into_iter().try_for_each(|photo| board.add(photo))?;
        let board = board.finish()?;
        let mut sample = Mountings::new(&set_up().calibration, &board, "white");
        (0..3).map(|i| lamps(shot(i))).try_for_each(|photo| sample.add(photo))?;
        sample.finish()
    };
    let mut cases = Vec::new();
    for share in [0.005, 0.01, 0.02, 0.05, -0.05] {
        cases.push((format!("{share} after the flats"), later(&turned(share))));
        cases.push((format!("{share} after the board"), measured((0..3).map(shot).map(turned(share)))));
    }
    cases.push(("bent by 0.04".to_owned(), later(&bent(0.04))));
    for (name, found) in cases {
        let found = found.unwrap();
        for c in 0..3 {
            let [mean, slope] = departure(&found, c);
            let errors = [Source::Drift, Source::Slope].map(|source| stated(&found, source, c));
            println!("{name}, column {c}: mean {mean:+.5}, slope {slope:+.5}, stated {errors:?}");
            assert!(slope.abs() < 2.0 * errors[1] && errors[1] < 4e-3, "{name}: {slope} ± {}", errors[1]);
            assert!(mean.abs() < 2e-3, "{name}: {mean}");
        }
    }
    let refused = measured((0..3).map(shot).map(turned(0.2))).err();
    let is_light = matches!(refused, Some(Refusal::LightTurned { .. } | Refusal::LightChanged { .. }));
    assert!(is_light, "{refused:?}");
}

/// Under a slab that covers all of the board no part is taken for free, whatever is added to its light.
#[test]
fn covered_board_shows_no_light() {
    let mut all = session().clone();
    for (dimmed, raised) in [(0.98, 0.004), (0.95, 0.015), (0.9, 0.04), (0.8, 0.03)] {
        let edge = move |_: usize, x: f64| if x < 0.0 { 0.021 + raised } else { dimmed * 0.82 };
        let slab = Slab { edge: Edge::new(edge), rim_mm: [-60.0, 60.0, -60.0, 60.0], ..slab() };
        all.lay(&session().camera.clone(), &slab);
        let mut sample = Mountings::new(&set_up().calibration, &set_up().board, "clear");
        shots(&all, What::Slab, 2, &PLAIN).into_iter().try_for_each(|photo| sample.add(photo)).unwrap();
        let found = sample.finish().unwrap();
        assert!(
            found.shots.iter().all(|shot| shot.light.is_none()),
            "{dimmed} {raised}: {:?}",
            found.warnings
        );
        assert!(noted(&found, |w| matches!(w, Warning::LightUnchecked { .. } | Warning::Unchecked { .. })));
    }
}

/// A large change of the light is refused.
#[test]
fn large_light_change_is_refused() {
    for factor in [0.5, 0.7, 0.8, 0.92, 1.2] {
        let refusal = slabs(|photo| dimmed(photo, |_, _| factor)).unwrap_err();
        let Refusal::LightChanged { label, percent, .. } = &refusal else { panic!("{factor}: {refusal}") };
        assert_eq!(label, "slab_2");
        assert!((percent / (100.0 * (factor - 1.0)) - 1.0).abs() < 0.03, "{factor}: {refusal}");
    }
}

/// Lamps that flicker during a rolling shutter: the part of a band in the crop is random.
#[test]
fn flicker_bands_are_part_of_the_gain() {
    let banded = |phase: f64| move |_: usize, y: usize| 1.0 + 0.01 * libm::sin(y as f64 / 40.0 + phase);
    let found = measured((0..3).map(|i| dimmed(shot(i), banded(i as f64)))).unwrap();
    let off = Off::from_clean(&found);
    println!("bands of 1 %: {off:?}");
    // A band's standard deviation is 0.7 %, the mean of three 0.4 %.
    assert!((0.003..0.008).contains(&off.gain), "{off:?}");
    assert!(off.mean.abs() < 2.0 * off.gain, "{off:?}");
}

/// A grain on the slab, blurred by the lens only.
fn with_speck(photo: Photo, at_mm: [f64; 2], diameter_mm: f64) -> Photo {
    let board = &set_up().board;
    dimmed(photo, |x, y| {
        let [dx, dy] = board.to_mm(x as f64 + 0.5, y as f64 + 0.5);
        let beyond_mm = libm::hypot(dx - at_mm[0], dy - at_mm[1]) - 0.5 * diameter_mm;
        1.0 - 0.4 * libm::erfc(beyond_mm / (0.025 * std::f64::consts::SQRT_2))
    })
}

fn is_masked(found: &SampleProfile) -> bool {
    noted(found, |w| matches!(w, Warning::Masked { label, .. } if label == "slab_2"))
}

/// A speck in one shot is masked, and the session continues; nothing is masked without one.
#[test]
fn speck_in_one_shot_is_masked() {
    assert!(!noted(clean(), |w| matches!(w, Warning::Masked { .. })), "{:?}", clean().warnings);
    assert!(clean().shots.iter().all(|shot| shot.rejected_share() < 1e-3));
    for (diameter_mm, x_mm) in [(0.2, 2.0), (0.5, 2.0), (1.0, 2.0), (1.0, -3.0), (0.5, 0.1)] {
        let found = slabs(|photo| with_speck(photo, [x_mm, 0.7], diameter_mm)).unwrap();
        let off = Off::from_clean(&found);
        println!("speck of {diameter_mm} mm at {x_mm} mm: {off:?}; {:?}", found.warnings);
        assert!(is_masked(&found) && found.shots.len() == 3);
        assert!(off.mean.abs() < 2e-4, "{off:?}");
        let departures = found.profiles.iter().zip(&clean().profiles).flat_map(|(found, clean)| {
            found.values.iter().zip(&clean.values).zip(&clean.std_errors).map(|((a, b), e)| (a - b) / e)
        });
        let worst = departures.map(f64::abs).fold(0.0, f64::max);
        assert!(worst < 1.0, "{worst} standard errors");
    }
}

#[test]
fn scratch_across_the_edge_is_masked() {
    let board = &set_up().board;
    let scratched = |photo| {
        dimmed(photo, |x, y| {
            let [dx, dy] = board.to_mm(x as f64 + 0.5, y as f64 + 0.5);
            if (dy - 0.3 * dx + 1.0).abs() < 0.08 { 1.25 } else { 1.0 }
        })
    };
    let found = slabs(scratched).unwrap();
    let off = Off::from_clean(&found);
    assert!(is_masked(&found), "{:?}", found.warnings);
    assert!(off.mean.abs() < 2e-4 && off.worst < 3e-3, "{off:?}");
}

/// A shot with a feature too broad for dust is left out; with too few shots left, the sample is refused.
#[test]
fn shot_with_a_bubble_is_left_out() {
    let bubble = |photo| with_speck(photo, [2.5, 3.0], 3.0);
    let found = slabs(bubble).unwrap();
    assert_eq!(found.shots.iter().map(|s| s.label.as_str()).collect::<Vec<_>>(), ["slab_1", "slab_3"]);
    let messages: Vec<String> = found.warnings.iter().map(ToString::to_string).collect();
    assert!(
        messages.iter().any(|t| t.starts_with("left out: slab_2: thirds of the crop disagree")),
        "{messages:?}"
    );
    assert!(Off::from_clean(&found).mean.abs() < 5e-4);
    let refusal = measured([bubble(shot(0)), bubble(shot(1)), shot(2)]).unwrap_err();
    assert!(matches!(refusal, Refusal::ThirdsDisagree { .. }), "{refusal}");
}

/// A session that uneven light spoils is refused, and the message mentions the missing flat shots.
#[test]
fn missing_flats_explain_a_refusal() {
    let thirds = |session: &Session| {
        let black = optics_capture::Darks::new().finish(&session.shoot(What::Bare, 0, &PLAIN))?;
        let flat = optics_capture::Flats::new(&black).finish()?;
        let mut patches = optics_capture::Patches::new(black, flat, session.neutral());
        patches.add(session.shoot(What::Chart, 0, &PLAIN))?;
        patches.add(session.shoot(What::Chart, 1, &PLAIN))?;
        let calibration = patches.finish()?;
        let board = find(session, &calibration, &PLAIN)?;
        mounted(session, &calibration, &board, &PLAIN, 2)
    };
    let camera = Camera { slope: [0.0, 0.16], vignetting: 0.0, ..Camera::default() };
    let refusal = thirds(&Session::new(camera, slab())).unwrap_err();
    let text = refusal.to_string();
    assert!(
        matches!(refusal, Refusal::LightTurned { .. }) && text.contains("there are no flat shots"),
        "{text}"
    );
}

/// The photograph turned by 180° by a viewer, which does not change the mosaic's name in the file.
fn turned(photo: Photo) -> Photo {
    let samples = photo.frame.samples().iter().rev().copied().collect();
    with_samples(photo, samples)
}

fn is_turned(refusal: &Refusal, of: &str) -> bool {
    matches!(refusal, Refusal::Unlike { label, .. } if label == of) && refusal.to_string().contains("turned")
}

/// A shot with a turned slab is left out, or refused if too few are left.
#[test]
fn turned_slab_is_left_out_or_refused() {
    let found = slabs(turned).unwrap();
    let off = Off::from_clean(&found);
    println!("one shot turned: {off:?}; {:?}", found.warnings);
    assert_eq!(found.shots.len(), 2);
    assert!(off.mean.abs() < 5e-4 && off.gain < 1e-3, "{off:?}");
    let left_out = |w: &Warning| matches!(w, Warning::LeftOut { why } if is_turned(why, "slab_2"));
    assert!(noted(&found, left_out), "{:?}", found.warnings);
    let refusal = measured([shot(0), turned(shot(1))]).unwrap_err();
    assert!(is_turned(&refusal, "slab_2"), "{refusal}");
}

/// Another slab was photographed: of three shots it is left out, with two shots the sample is refused.
#[test]
fn shot_of_another_slab_is_left_out() {
    let mut others = session().clone();
    let edge = Edge::new(|c, x| 0.8 * super::stage::white(c, x));
    others.lay(&session().camera.clone(), &Slab { edge, ..slab() });
    let other = |i: u64| others.shoot(What::Slab, i, &PLAIN);
    let found = slabs(|_| other(1)).unwrap();
    let left_out = |w: &Warning| w.to_string().starts_with("left out: slab_2: the profile differs");
    assert!(noted(&found, left_out) && found.shots.len() == 2, "{:?}", found.warnings);
    let refusal = measured([shot(0), other(1)]).unwrap_err();
    assert!(matches!(refusal, Refusal::Unlike { .. }), "{refusal}");
}

/// Turned bare shots, flats and patches are detected.
#[test]
fn turned_calibration_shots_are_detected() {
    let shoot = |what, i| session().shoot(what, i, &PLAIN);
    let target = optics_capture::Target { dark_side: None, ..session().target() };
    let mut bare = optics_capture::BareShots::new(&set_up().calibration, target).unwrap();
    bare.add(shoot(What::Bare, 0)).unwrap();
    let refusal = bare.add(turned(shoot(What::Bare, 1))).unwrap_err();
    assert!(
        refusal.to_string().starts_with("board_2: ") && refusal.to_string().contains("turned"),
        "{refusal}"
    );

    let black = set_up().calibration.black();
    let flats = |count: u64| {
        let mut flats = optics_capture::Flats::new(black);
        for i in 0..count {
            let photo = shoot(What::Sheet, i);
            flats.add(if i == 1 { turned(photo) } else { photo }).unwrap();
        }
        flats
    };
    let refusal = flats(2).finish().unwrap_err();
    assert!(refusal.to_string().contains("turned"), "{refusal}");
    flats(4).finish().unwrap();

    let mut patches =
        optics_capture::Patches::new(black.clone(), set_up().calibration.flat().clone(), session().neutral());
    patches.add(shoot(What::Chart, 0)).unwrap();
    patches.add(turned(shoot(What::Chart, 1))).unwrap();
    let refusal = patches.finish().unwrap_err();
    assert!(is_turned(&refusal, "chart_2"), "{refusal}");
}

#[test]
fn bare_shots_under_other_light_are_refused() {
    let spoilt = |factor: f64| {
        let mut session: Session = session().clone();
        session.brightness = vec![(What::Bare, 1, factor)];
        find(&session, &set_up().calibration, &PLAIN)
    };
    let refusal = spoilt(0.9).unwrap_err();
    assert!(matches!(&refusal, Refusal::LightChanged { label, .. } if label == "board_2"), "{refusal}");
    // With a difference of 2 %, each is 1 % off the mean, whose standard error is 1 %.
    let board = spoilt(0.98).unwrap();
    let look = Look { seed: 9, ..PLAIN };
    let sample = mounted(session(), &set_up().calibration, &board, &look, 3).unwrap();
    let gain = gain(&sample.budget);
    assert!((0.008..0.012).contains(&gain), "{gain}");
}
