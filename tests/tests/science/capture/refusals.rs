//! Faulty sessions are refused for the right reason, and good ones are not.

use farm_tests::photograph::{Board, Camera, Dust, Look, Random, Session, Slab, What};
use optics_capture::{Frame, Refusal, Side, Warning};

use super::stage::{PLAIN, board, calibrate, find, measure, slab};

/// Faults of a session, each of a varying size.
const KINDS: [&str; 12] = [
    "clipped",
    "not linear",
    "black subtracted",
    "gamma-coded",
    "defocused",
    "shaken",
    "moved",
    "rim in the crop",
    "border in the crop",
    "bubble",
    "edge bent",
    "light drifted",
];

/// A camera with fewer pixels, which suffice for checks.
fn small() -> Camera {
    let plain = Camera::default();
    Camera { width: 740, height: 420, px_per_mm: 24.0, origin_px: [6.3, -4.2], ..plain }
}

/// Evaluates a good session after adding a fault.
fn spoiled(kind: &str, good: &Session, seed: u64) -> Result<(), Refusal> {
    let mut random = Random::new(seed);
    let look = Look { seed, flicker: 0.001, exact: false, dust: None };
    let camera = small();
    let amount = random.even();
    let session = match kind {
        "clipped" => {
            let clip = camera.black + (0.55 + 0.15 * amount) * camera.full[1];
            Session::new(Camera { clip, ..camera }, slab())
        }
        "not linear" => Session::new(Camera { curve: 0.06 + 0.1 * amount, ..camera }, slab()),
        "black subtracted" => Session::new(Camera { black: 0.0, ..camera }, slab()),
        "gamma-coded" => Session::new(Camera { gamma: 0.42 + 0.3 * amount, black: 64.0, ..camera }, slab()),
        "defocused" => {
            let times = 1.6 + amount;
            let lens_mm = camera.lens_mm.map(|l| l * times);
            with_slab(good.clone(), &Camera { lens_mm, ..camera }, &slab())
        }
        "shaken" => {
            let mut session = good.clone();
            session.show_bare(&Camera { shaken: 1.7 + amount, ..camera }, &board());
            session
        }
        "moved" => {
            let by = (0.2 + amount) * if random.even() < 0.5 { -1.0 } else { 1.0 };
            let mut origin_px = camera.origin_px;
            origin_px[usize::from(random.even() < 0.5)] += by;
            with_slab(good.clone(), &Camera { origin_px, ..camera }, &slab())
        }
        "rim in the crop" => {
            let mut rim_mm = slab().rim_mm;
            match (random.even() * 4.0) as usize {
                0 => rim_mm[0] = -4.7 + 3.0 * amount,
                1 => rim_mm[1] = 4.7 - 3.0 * amount,
                2 => rim_mm[2] = -4.5 + 3.0 * amount,
                _ => rim_mm[3] = 4.5 - 3.0 * amount,
            }
            with_slab(good.clone(), &camera, &Slab { rim_mm, ..slab() })
        }
        "border in the crop" => {
            let board = Board { square_mm: 9.0 + 2.5 * amount, ..board() };
            Session::new(camera, Slab { board, ..slab() })
        }
        "bubble" => {
            let at = [random.between(-4.0, 4.0), random.between(2.0, 4.0)];
            let bubble = Some((at, 1.2 + amount, 0.85 - 0.1 * amount));
            with_slab(good.clone(), &camera, &Slab { bubble, ..slab() })
        }
        "edge bent" => {
            let bow_per_mm = (4e-4 + 1e-3 * amount) * if random.even() < 0.5 { -1.0 } else { 1.0 };
            Session::new(camera, Slab { board: Board { bow_per_mm, ..board() }, ..slab() })
        }
        "light drifted" => {
            let mut session = good.clone();
            let change = (0.009 + 0.02 * amount) * if random.even() < 0.5 { -1.0 } else { 1.0 };
            session.brightness = vec![(What::Chart, 1, 1.0 + change)];
            session
        }
        other => panic!("{other}"),
    };
    measure(&session, &look, 1).map(|_| ())
}

fn with_slab(mut session: Session, camera: &Camera, slab: &Slab) -> Session {
    session.lay(camera, slab);
    session
}

fn is_right(kind: &str, refusal: &Refusal) -> bool {
    match kind {
        "clipped" => matches!(refusal, Refusal::Clipped { .. }),
        "not linear" => matches!(refusal, Refusal::NotLinear { .. }),
        "black subtracted" => matches!(refusal, Refusal::BlackSubtracted { .. }),
        "gamma-coded" => matches!(refusal, Refusal::GammaCoded { .. }),
        "defocused" => matches!(refusal, Refusal::Defocused { .. }),
        "shaken" => matches!(refusal, Refusal::Shaken { .. }),
        "moved" => matches!(refusal, Refusal::Moved { .. }),
        "rim in the crop" => matches!(refusal, Refusal::RimInCrop { .. }),
        "border in the crop" => matches!(refusal, Refusal::BorderInCrop { .. }),
        "bubble" => matches!(refusal, Refusal::ThirdsDisagree { .. }),
        "edge bent" => matches!(refusal, Refusal::EdgeBent { .. }),
        "light drifted" => matches!(refusal, Refusal::LightDrifted { .. }),
        _ => false,
    }
}

/// A straight board cannot be binned: its edge crosses pixels at few phases only.
#[test]
fn edge_along_the_columns_is_refused() {
    let session = Session::new(Camera { turn_deg: 0.0, keystone: [0.0; 2], ..small() }, slab());
    let calibration = calibrate(&session, &PLAIN).unwrap();
    let refusal = find(&session, &calibration, &PLAIN).unwrap_err();
    assert!(matches!(refusal, Refusal::NotSlanted { .. }), "{refusal}");
}

/// Sessions of each kind: one, or five times the effort.
fn rounds() -> u64 {
    let effort = std::env::var("FARM_TEST_EFFORT").ok().and_then(|e| e.parse::<u64>().ok());
    effort.map_or(1, |e| 5 * e)
}

/// Bad sessions are refused for the right reason.
#[test]
fn bad_sessions_are_refused_for_their_reason() {
    let good = Session::new(small(), slab());
    let (mut right, mut total) = (0, 0);
    for kind in KINDS {
        let mut wrong = Vec::new();
        for seed in 0..rounds() {
            total += 1;
            match spoiled(kind, &good, 1000 + seed) {
                Err(refusal) if is_right(kind, &refusal) => right += 1,
                Err(refusal) => wrong.push(refusal.to_string()),
                Ok(()) => wrong.push("accepted".to_owned()),
            }
        }
        println!("{kind}: {} of {} refused rightly; {wrong:#?}", rounds() - wrong.len() as u64, rounds());
    }
    assert!(f64::from(right) >= 0.98 * f64::from(total), "{right} of {total}");
}

/// Good sessions with many kinds of cameras, with dust and lamps that flicker by 0.1 %.
#[test]
fn good_sessions_are_not_refused() {
    let count = 3 * rounds();
    let mut refused = Vec::new();
    for seed in 0..count {
        let mut random = Random::new(7000 + seed);
        let lens = random.between(0.02, 0.04);
        let camera = Camera {
            turn_deg: random.between(0.5, 3.0) * if random.even() < 0.5 { -1.0 } else { 1.0 },
            keystone: [random.between(-0.01, 0.01), random.between(-0.01, 0.01)],
            radial: random.between(-0.002, 0.002),
            origin_px: [random.between(-15.0, 15.0), random.between(-15.0, 15.0)],
            lens_mm: [lens, 0.9 * lens, lens],
            fixed_pattern: random.between(0.0, 2.0),
            ..small()
        };
        let look = Look {
            seed: 500 + seed,
            flicker: 0.001,
            exact: false,
            dust: Some(Dust { specks: 20, scratches: 2 }),
        };
        if let Err(refusal) = measure(&Session::new(camera, slab()), &look, 2) {
            refused.push(refusal.to_string());
        }
    }
    println!("{} of {count} good sessions refused: {refused:#?}", refused.len());
    assert!(refused.len() as f64 <= 0.01 * count as f64, "{refused:#?}");
}

/// A dark side that is given wrongly is noticed.
#[test]
fn wrong_dark_side_is_noticed() {
    let session = Session::new(small(), slab());
    let calibration = calibrate(&session, &PLAIN).unwrap();
    let target = optics_capture::Target { dark_side: Some(Side::Right), ..session.target() };
    let mut bare = optics_capture::BareShots::new(&calibration, target).unwrap();
    let refusal = bare.add(session.shoot(What::Bare, 0, &PLAIN)).unwrap_err();
    assert!(
        matches!(refusal, Refusal::SidesSwapped { found: Side::Left, expected: Side::Right, .. }),
        "{refusal}"
    );
}

#[test]
fn unknown_black_level_is_refused() {
    let session = Session::new(Camera { has_black_level: false, ..small() }, slab());
    let any = session.shoot(What::Bare, 0, &PLAIN);
    let refusal = optics_capture::Darks::new().finish(&any).unwrap_err();
    assert!(matches!(refusal, Refusal::BlackUnknown { .. }), "{refusal}");
}

/// A session with too few shots gets a warning.
#[test]
fn too_few_shots_are_noted() {
    let found = measure(&Session::new(small(), slab()), &PLAIN, 1).unwrap();
    assert!(found.sample.warnings.iter().any(|w| matches!(w, Warning::FewShots { count: 1, .. })));
}

/// Any file content is answered without a panic.
#[test]
fn nonsense_is_refused_without_a_panic() {
    let session = Session::new(small(), slab());
    let calibration = calibrate(&session, &PLAIN).unwrap();
    let board = find(&session, &calibration, &PLAIN).unwrap();
    let mut random = Random::new(5);
    let mut noise = || (random.even() * 65_536.0) as u16;
    let fills: [&mut dyn FnMut(usize) -> u16; 6] = [
        &mut |_| 0,
        &mut |_| u16::MAX,
        &mut |_| noise(),
        &mut |i| if i % 2 == 0 { 0 } else { u16::MAX },
        &mut |i| (i % 740 * 20) as u16,
        &mut |i| if i % 740 < 370 { 600 } else { 9000 },
    ];
    for (k, fill) in fills.into_iter().enumerate() {
        let mut photo = session.shoot(What::Bare, 0, &PLAIN);
        let samples = (0..photo.frame.samples().len()).map(fill).collect();
        photo.frame = Frame::new(740, 420, photo.frame.pattern(), samples).unwrap();
        let mut bare = optics_capture::BareShots::new(&calibration, session.target()).unwrap();
        assert!(bare.add(photo.clone()).is_err(), "as a board: {k}");
        let mut sample = optics_capture::Mountings::new(&calibration, &board, "nonsense");
        println!("{k}: as a sample {:?}", sample.add(photo.clone()).err());
        let mut patches = optics_capture::Patches::new(
            calibration.black().clone(),
            calibration.flat().clone(),
            session.neutral(),
        );
        let refused = patches.add(photo.clone()).is_err() || patches.finish().is_err();
        assert!(refused, "as patches: {k}");
        let mut flats = optics_capture::Flats::new(calibration.black());
        let _ = flats.add(photo.clone()).and_then(|()| flats.finish().map(|_| ()));
        let _ = optics_capture::check_shot(&photo, optics_capture::Darks::new());
    }
}
