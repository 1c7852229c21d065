//! Bias, errors and geometry, compared with the exact truth.

use farm_tests::photograph::{Board, Camera, Look, Random, Session, Slab};
use farm_tests::statistics::effort_or;
use optics_capture::Warning;

use super::stage::{
    PLAIN, board as plain_board, calibrate, find, measure, mounted, session, slab, true_blur_mm, truth, white,
};

/// A session without noise gives the exact profile.
#[test]
fn noiseless_session_gives_the_exact_profile() {
    let session = session();
    let found = measure(session, &Look { exact: true, ..PLAIN }, 2).unwrap();
    for (c, profile) in found.sample.profiles.iter().enumerate() {
        let sigma = true_blur_mm(session, c);
        let contrast = white(c, 5.0) - white(c, -5.0);
        let (mut edge, mut tails) = (0.0_f64, 0.0_f64);
        for (x, value) in profile.x_mm.iter().zip(&profile.values) {
            let off = (value - truth(white, c, *x, sigma)) / contrast;
            let worst = if x.abs() < 0.5 { &mut edge } else { &mut tails };
            *worst = if off.abs() > worst.abs() { off } else { *worst };
        }
        println!("{c}: edge {:+.5} %, tails {:+.5} % of contrast", 100.0 * edge, 100.0 * tails);
        assert!(edge.abs() < 1e-3 && tails.abs() < 2e-4, "{c}: {edge} {tails}");
    }
}

/// The geometry and the constants of a session are recovered.
#[test]
fn geometry_and_constants_are_recovered() {
    let session = session();
    let found = measure(session, &PLAIN, 2).unwrap();
    check_geometry(session, &found.board);
    let camera = &session.camera;
    for c in 0..3 {
        assert!(
            (found.calibration.glare[c].value - camera.glare).abs() < 1e-3,
            "{:?}",
            found.calibration.glare
        );
    }
    for noise in &found.calibration.noise {
        assert!((noise.gain.value / camera.numbers_per_electron - 1.0).abs() < 0.03, "{noise:?}");
        assert!((noise.read.value / camera.read - 1.0).abs() < 0.03, "{noise:?}");
    }
}

/// Compares angle, origin, scale and blur with the camera's.
fn check_geometry(session: &Session, board: &optics_capture::Board) {
    let camera = &session.camera;
    let (from, to) = (camera.mm(board.edge.from_px), camera.mm(board.edge.to_px));
    let angle_deg = libm::atan((to[0] - from[0]) / (to[1] - from[1])).to_degrees();
    let origin_px = camera.px_per_mm * 0.5 * (from[0] + to[0]);
    let [a, b] = [[-4.0, 1.0], [4.0, 1.0]].map(|mm| camera.mm(board.to_px(mm[0], mm[1])));
    let scale = libm::hypot(b[0] - a[0], b[1] - a[1]) / 8.0 - 1.0;
    let stated = board.mm_per_px.std_error / board.mm_per_px.value;
    println!("angle off by {angle_deg:+.5}°, origin {origin_px:+.4} px, scale {scale:+.1e} ± {stated:.1e}");
    assert!(angle_deg.abs() < 0.02 && origin_px.abs() < 0.1 && scale.abs() < 1e-4);
    for c in 0..3 {
        let blur = board.blur_mm[c].value / true_blur_mm(session, c) - 1.0;
        assert!(blur.abs() < 0.03, "blur {c}: {blur:+.4}");
        assert!((board.origin_mm[c].value * camera.px_per_mm).abs() < 0.1, "origin {c}");
        let (light, dark) = (board.light[c].value / session.board.light[c], board.dark[c].value);
        assert!((light - 1.0).abs() < 0.005, "light side {c}: {light}");
        assert!((dark / session.board.dark[c] - 1.0).abs() < 0.05, "dark side {c}: {dark}");
    }
}

/// A board in which light spreads, as paper does, is no blurred camera; one that is clean has no spread.
#[test]
fn board_spread_is_separated_from_blur() {
    for spread_mm in [0.0, 0.03, 0.1, 0.3] {
        let spreading = Slab { board: Board { spread_mm, ..plain_board() }, ..slab() };
        let session = Session::new(Camera::default(), spreading);
        let calibration = calibrate(&session, &PLAIN).unwrap();
        let board = find(&session, &calibration, &PLAIN).unwrap();
        let (found, error) = (board.spread_mm.value, board.spread_mm.std_error);
        let blur = board.blur_mm[1].value / true_blur_mm(&session, 1) - 1.0;
        println!("{spread_mm}: {found:.4} ± {error:.4}; blur {blur:+.3}");
        assert!(
            (found - spread_mm).abs() < 2.0 * error && blur.abs() < 0.05,
            "{spread_mm}: {found} ± {error}, {blur}"
        );
        assert!(error < 0.01 + 0.12 * spread_mm, "{spread_mm}: ± {error}");
        let is_warned = board.warnings.iter().any(|w| matches!(w, Warning::SpreadingBoard { .. }));
        assert_eq!(is_warned, spread_mm > 0.0, "{spread_mm}: {found} ± {error}");
    }
}

/// Cameras are turned or oblique, with distortion, with the dark side left or right, and with a mosaic or three samples
/// per pixel.
#[test]
fn geometry_is_recovered_for_all_cameras() {
    for seed in 0..effort_or(40, 20) / 10 {
        let mut random = Random::new(40 + seed);
        let camera = Camera {
            width: 740,
            height: 420,
            px_per_mm: 24.0,
            turn_deg: random.between(0.6, 6.0) * if seed % 2 == 0 { -1.0 } else { 1.0 },
            keystone: [random.between(-0.02, 0.02), random.between(-0.02, 0.02)],
            radial: random.between(-0.004, 0.004),
            origin_px: [random.between(-9.0, 9.0), random.between(-6.0, 6.0)],
            rgb: seed % 4 == 3,
            ..Camera::default()
        };
        let mut slab = slab();
        slab.board.sign = if seed % 4 < 2 { 1.0 } else { -1.0 };
        let session = Session::new(camera, slab);
        let look = Look { seed, ..PLAIN };
        let calibration = calibrate(&session, &look).unwrap();
        let board = find(&session, &calibration, &look).unwrap();
        check_geometry(&session, &board);
    }
}

/// Over independent sessions (200 with `FARM_TEST_EFFORT=10`), the scatter of each bin equals its stated error, and
/// neighbours are uncorrelated.
#[test]
fn stated_errors_match_the_scatter() {
    let session = session();
    let count = effort_or(12, 20);
    let (mut stated, mut profiles): (_, Vec<Vec<Vec<f64>>>) = ([0.0; 3], Vec::new());
    let calibration = calibrate(session, &PLAIN).unwrap();
    let board = find(session, &calibration, &PLAIN).unwrap();
    for seed in 0..count {
        let look = Look { seed: 100 + seed, ..PLAIN };
        let sample = mounted(session, &calibration, &board, &look, 2).unwrap();
        for (c, p) in sample.profiles.iter().enumerate() {
            let square = p.std_errors.iter().map(|e| e * e).sum::<f64>();
            stated[c] += square / (p.values.len() as f64 * count as f64);
        }
        profiles.push(sample.profiles.into_iter().map(|p| p.values).collect());
    }
    for (c, stated) in stated.iter().enumerate() {
        let bins = profiles[0][c].len();
        let mean = |k: usize| profiles.iter().map(|p| p[c][k]).sum::<f64>() / count as f64;
        let means: Vec<f64> = (0..bins).map(mean).collect();
        let off = |p: &[Vec<f64>], k: usize| p[c][k] - means[k];
        let (mut squares, mut products) = (0.0, 0.0);
        for p in &profiles {
            for k in 1..bins {
                squares += off(p, k).powi(2);
                products += off(p, k) * off(p, k - 1);
            }
        }
        let found = (squares / ((count as f64 - 1.0) * (bins as f64 - 1.0))).sqrt();
        let (ratio, correlation) = (stated.sqrt() / found, products / squares);
        println!("{c}: stated over found {ratio:.4}, correlation of neighbours {correlation:+.4}");
        assert!((0.95..1.05).contains(&ratio), "{c}: {ratio}");
        assert!(correlation.abs() < 0.05, "{c}: {correlation}");
    }
}
