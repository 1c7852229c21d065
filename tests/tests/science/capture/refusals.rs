//! Faulty sessions are refused for the right reason, and good ones are not.

use std::sync::OnceLock;

use farm_tests::photograph::{Board, Camera, Dust, Look, Random, Session, Slab, What};
use farm_tests::statistics::effort_or;
use optics_capture::{Frame, Refusal, Side, Source, Warning};

use super::stage::{Measured, PLAIN, board, calibrate, find, measure, slab};

/// A camera with fewer pixels, which suffice for checks.
fn small() -> Camera {
    let plain = Camera::default();
    Camera { width: 740, height: 420, px_per_mm: 24.0, origin_px: [6.3, -4.2], ..plain }
}

/// A good session, exposed once for all tests.
fn good() -> Session {
    static GOOD: OnceLock<Session> = OnceLock::new();
    GOOD.get_or_init(|| Session::new(small(), slab())).clone()
}

/// The good session with another camera that exposes the same, and differs in the numbers that it makes of them.
fn developed(camera: Camera) -> Session {
    let mut session = good();
    session.camera = camera;
    session
}

fn with_slab(camera: &Camera, slab: &Slab) -> Session {
    let mut session = good();
    session.lay(camera, slab);
    session
}

fn with_board(board: Board) -> Session {
    let mut session = with_slab(&small(), &Slab { board: board.clone(), ..slab() });
    session.show_bare(&small(), &board);
    session.board = board;
    session
}

fn either(random: &mut Random, amount: f64) -> f64 {
    amount * if random.even() < 0.5 { -1.0 } else { 1.0 }
}

/// A fault of a session, of a size from 0 to 1 that is random, and whether a refusal names it.
type Fault = (&'static str, fn(f64, &mut Random) -> Session, fn(&Refusal) -> bool);

const FAULTS: [Fault; 14] = [
    (
        "clipped",
        |size, _| {
            developed(Camera { clip: small().black + (0.55 + 0.15 * size) * small().full[1], ..small() })
        },
        |r| matches!(r, Refusal::Clipped { .. }),
    ),
    (
        "not linear",
        |size, _| developed(Camera { curve: 0.06 + 0.1 * size, ..small() }),
        |r| matches!(r, Refusal::NotLinear { .. }),
    ),
    (
        "black subtracted",
        |_, _| developed(Camera { black: 0.0, ..small() }),
        |r| matches!(r, Refusal::BlackSubtracted { .. }),
    ),
    (
        "gamma-coded",
        |size, _| developed(Camera { gamma: 0.42 + 0.3 * size, black: 64.0, ..small() }),
        |r| matches!(r, Refusal::GammaCoded { .. }),
    ),
    (
        "defocused",
        |size, _| {
            let lens_mm = small().lens_mm.map(|l| l * (1.6 + size));
            with_slab(&Camera { lens_mm, ..small() }, &slab())
        },
        |r| matches!(r, Refusal::Defocused { .. }),
    ),
    (
        "shaken",
        |size, _| {
            let mut session = good();
            session.show_bare(&Camera { shaken: 1.7 + size, ..small() }, &board());
            session
        },
        |r| matches!(r, Refusal::Shaken { .. }),
    ),
    (
        "moved",
        |size, random| {
            let (by, mut origin_px) = (either(random, 0.2 + size), small().origin_px);
            origin_px[usize::from(random.even() < 0.5)] += by;
            with_slab(&Camera { origin_px, ..small() }, &slab())
        },
        |r| matches!(r, Refusal::Moved { .. }),
    ),
    (
        "rim in the crop",
        |size, random| {
            let mut rim_mm = slab().rim_mm;
            let side = (random.even() * 4.0) as usize;
            let far = [4.7, 4.7, 4.5, 4.5][side] - 3.0 * size;
            rim_mm[side] = if side.is_multiple_of(2) { -far } else { far };
            with_slab(&small(), &Slab { rim_mm, ..slab() })
        },
        |r| matches!(r, Refusal::RimInCrop { .. }),
    ),
    (
        "border in the crop",
        |size, _| with_board(Board { square_mm: 9.0 + 2.5 * size, ..board() }),
        |r| matches!(r, Refusal::BorderInCrop { .. }),
    ),
    (
        "bubble",
        |size, random| {
            let at = [random.between(-4.0, 4.0), random.between(2.0, 4.0)];
            with_slab(&small(), &Slab { bubble: Some((at, 1.2 + size, 0.85 - 0.1 * size)), ..slab() })
        },
        |r| matches!(r, Refusal::ThirdsDisagree { .. }),
    ),
    (
        "edge bent",
        |size, random| with_board(Board { bow_per_mm: either(random, 4e-4 + 1e-3 * size), ..board() }),
        |r| matches!(r, Refusal::EdgeBent { .. }),
    ),
    (
        "light drifted",
        |size, random| {
            let change = either(random, 0.026 + 0.02 * size);
            let mut session = good();
            session.brightness = vec![(What::Chart, 1, 1.0 + change)];
            session
        },
        |r| matches!(r, Refusal::LightDrifted { .. }),
    ),
    (
        "stray light",
        |size, _| with_slab(&Camera { glare: 0.11 + 0.2 * size, ..small() }, &slab()),
        |r| matches!(r, Refusal::LightAdded { .. }),
    ),
    (
        "lamps turned",
        |size, random| {
            let slope = [small().slope[0] + either(random, 0.16 + 0.1 * size), small().slope[1]];
            with_slab(&Camera { slope, ..small() }, &slab())
        },
        |r| matches!(r, Refusal::LightTurned { .. } | Refusal::LightChanged { .. }),
    ),
];

/// A straight board cannot be binned: its edge crosses pixels at few phases only.
#[test]
fn edge_along_the_columns_is_refused() {
    let session = Session::new(Camera { turn_deg: 0.0, keystone: [0.0; 2], ..small() }, slab());
    let calibration = calibrate(&session, &PLAIN).unwrap();
    let refusal = find(&session, &calibration, &PLAIN).unwrap_err();
    assert!(matches!(refusal, Refusal::NotSlanted { .. }), "{refusal}");
}

/// Sessions of each kind.
fn rounds() -> u64 {
    effort_or(1, 5)
}

/// Bad sessions are refused for the right reason.
#[test]
fn bad_sessions_are_refused_for_their_reason() {
    let mut wrong = Vec::new();
    for (name, spoilt, is_right) in FAULTS {
        for seed in (0..rounds()).map(|round| 1000 + round) {
            let mut random = Random::new(seed);
            let size = random.even();
            let look = Look { seed, flicker: 0.001, ..PLAIN };
            let refusal = measure(&spoilt(size, &mut random), &look, 1).err();
            if !refusal.as_ref().is_some_and(is_right) {
                wrong.push(
                    refusal.map_or(format!("{name}: accepted"), |refusal| format!("{name}: {refusal}")),
                );
            }
        }
    }
    let total = FAULTS.len() as u64 * rounds();
    println!("{} of {total} not refused rightly: {wrong:#?}", wrong.len());
    assert!(wrong.len() as f64 <= 0.02 * total as f64, "{wrong:#?}");
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
        let dust = Some(Dust { specks: 20, scratches: 2 });
        let look = Look { seed: 500 + seed, flicker: 0.001, exact: false, dust };
        if let Err(refusal) = measure(&Session::new(camera, slab()), &look, 2) {
            refused.push(refusal.to_string());
        }
    }
    println!("{} of {count} good sessions refused: {refused:#?}", refused.len());
    assert!(refused.len() as f64 <= 0.01 * count as f64, "{refused:#?}");
}

/// Lamps that fade by up to 2 % between the shots of the patches make an error of the gain that holds the change.
#[test]
fn drift_of_lamps_widens_the_gain() {
    for change in [0.985, 0.993, 1.015] {
        let mut session = good();
        let last = [(What::Chart, 1), (What::Bare, 0), (What::Bare, 1), (What::Slab, 0), (What::Slab, 1)];
        session.brightness = last.map(|(what, index)| (what, index, change)).to_vec();
        let [steady, drifted] = [&good(), &session].map(|s| measure(s, &PLAIN, 2).unwrap());
        let level = |found: &Measured| found.sample.profiles[1].values.iter().sum::<f64>();
        let off = level(&drifted) / level(&steady) - 1.0;
        let budget = drifted.sample.budget.iter().find(|line| line.source == Source::Drift).unwrap();
        let error = budget.std_error[1];
        println!("{change}: {off:+.4}, stated {error:.4}");
        assert!(off.abs() < 2.0 * error && error < (change - 1.0_f64).abs(), "{off} ± {error}");
        let warnings = &drifted.calibration.warnings;
        assert!(warnings.iter().any(|w| matches!(w, Warning::Drifted { .. })), "{warnings:?}");
    }
}

/// A dark side that is given wrongly is noticed.
#[test]
fn wrong_dark_side_is_noticed() {
    let session = good();
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
    let session = developed(Camera { has_black_level: false, ..small() });
    let any = session.shoot(What::Bare, 0, &PLAIN);
    let refusal = optics_capture::Darks::new().finish(&any).unwrap_err();
    assert!(matches!(refusal, Refusal::BlackUnknown { .. }), "{refusal}");
}

/// A session with too few shots gets a warning.
#[test]
fn too_few_shots_are_noted() {
    let found = measure(&good(), &PLAIN, 1).unwrap();
    assert!(found.sample.warnings.iter().any(|w| matches!(w, Warning::FewShots { count: 1, .. })));
}

/// Any file content is answered without a panic.
#[test]
fn nonsense_is_refused_without_a_panic() {
    let session = good();
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
        let checked = optics_capture::check_shot(&photo, optics_capture::Darks::new());
        if k == 0 {
            let warnings = checked.unwrap().warnings;
            assert!(matches!(&warnings[..], [optics_capture::Warning::DarkShot { .. }]), "{warnings:?}");
        }
    }
}
