//! Runs whole sessions, and provides set-ups for them.

use farm_tests::photograph::{Board, Camera, Edge, Look, Session, Slab, What};
use optics_capture::{
    BareShots, Calibration, Darks, Flats, Mountings, Neutral, Patches, Photo, Refusal, SampleProfile,
};

/// The results of a session.
pub struct Measured {
    pub calibration: Calibration,
    pub board: optics_capture::Board,
    pub sample: SampleProfile,
}

pub const PLAIN: Look = Look { seed: 1, flicker: 0.0, exact: false, dust: None };

/// A white resin's edge: light that leaks from side to side over 1 mm, with a step where the board is visible.
pub fn white(channel: usize, x_mm: f64) -> f64 {
    let (step, reach) = ([0.30, 0.26, 0.20][channel], [0.9, 0.7, 0.5][channel]);
    let (low, high) = ([0.34, 0.38, 0.44][channel], [0.76, 0.75, 0.74][channel]);
    leaking(x_mm, low, high, step, reach)
}

fn leaking(x: f64, low: f64, high: f64, step: f64, reach: f64) -> f64 {
    let rest = 0.5 * (high - low - step);
    if x < 0.0 { low + rest * libm::exp(x / reach) } else { high - rest * libm::exp(-x / reach) }
}

pub fn board() -> Board {
    Board {
        square_mm: 14.0,
        light: [0.838, 0.816, 0.814],
        dark: [0.0213, 0.0209, 0.0222],
        sign: 1.0,
        bow_per_mm: 0.0,
        spread_mm: 0.0,
    }
}

pub fn slab() -> Slab {
    Slab { board: board(), edge: Edge::new(white), rim_mm: [-12.0, 12.0, -8.2, 8.2], bubble: None }
}

/// The plain session, exposed once for all tests.
pub fn session() -> &'static Session {
    static PLAIN: std::sync::OnceLock<Session> = std::sync::OnceLock::new();
    PLAIN.get_or_init(|| Session::new(Camera::default(), slab()))
}

/// All shots of one subject.
pub fn shots(session: &Session, what: What, count: u64, look: &Look) -> Vec<Photo> {
    (0..count).map(|i| session.shoot(what, i, look)).collect()
}

/// Calibration from dark shots, flats and patches.
pub fn calibrate(session: &Session, look: &Look) -> Result<Calibration, Refusal> {
    calibrate_by(session, session.neutral(), What::Chart, look)
}

/// Calibration with shots of any subject as patches.
pub fn calibrate_by(
    session: &Session,
    neutral: Neutral,
    subject: What,
    look: &Look,
) -> Result<Calibration, Refusal> {
    calibrate_after(|photo| photo, session, neutral, subject, look)
}

/// Calibration with every photograph modified.
pub fn calibrate_after(
    retouch: impl Fn(Photo) -> Photo,
    session: &Session,
    neutral: Neutral,
    subject: What,
    look: &Look,
) -> Result<Calibration, Refusal> {
    let shots = |what| shots(session, what, 2, look).into_iter().map(&retouch);
    let mut darks = Darks::new();
    shots(What::Dark).try_for_each(|photo| darks.add(photo))?;
    let black = darks.finish(&retouch(session.shoot(What::Bare, 0, look)))?;
    let mut flats = Flats::new(&black);
    shots(What::Sheet).try_for_each(|photo| flats.add(photo))?;
    let mut patches = Patches::new(black, flats.finish()?, neutral);
    shots(subject).try_for_each(|photo| patches.add(photo))?;
    patches.finish()
}

pub fn find(
    session: &Session,
    calibration: &Calibration,
    look: &Look,
) -> Result<optics_capture::Board, Refusal> {
    let mut bare = BareShots::new(calibration, session.target())?;
    shots(session, What::Bare, 2, look).into_iter().try_for_each(|photo| bare.add(photo))?;
    bare.finish()
}

/// The profile of the slab from several shots.
pub fn mounted(
    session: &Session,
    calibration: &Calibration,
    board: &optics_capture::Board,
    look: &Look,
    count: u64,
) -> Result<SampleProfile, Refusal> {
    let mut sample = Mountings::new(calibration, board, "white");
    shots(session, What::Slab, count, look).into_iter().try_for_each(|photo| sample.add(photo))?;
    sample.finish()
}

pub fn measure(session: &Session, look: &Look, mountings: u64) -> Result<Measured, Refusal> {
    let calibration = calibrate(session, look)?;
    let board = find(session, &calibration, look)?;
    let sample = mounted(session, &calibration, &board, look, mountings)?;
    Ok(Measured { calibration, board, sample })
}

/// The exact edge convolved with a Gaussian of `sigma_mm`, averaged over a bin around `x_mm`.
pub fn truth(edge: fn(usize, f64) -> f64, channel: usize, x_mm: f64, sigma_mm: f64) -> f64 {
    const NODES: i32 = 400;
    const PARTS: i32 = 16;
    let (mut sum, mut total) = (0.0, 0.0);
    for k in -NODES..=NODES {
        let u = (f64::from(k) + 0.5) * 6.0 / f64::from(NODES);
        let weight = libm::exp(-0.5 * u * u);
        for part in 0..PARTS {
            let within = (f64::from(part) + 0.5) / f64::from(PARTS) - 0.5;
            sum += weight * edge(channel, x_mm + u * sigma_mm + within * optics_capture::BIN_MM);
            total += weight;
        }
    }
    sum / total
}

/// σ as defined for profiles: the lens, and the pixel's aperture.
pub fn true_blur_mm(session: &Session, channel: usize) -> f64 {
    let pixel_mm = 1.0 / session.camera.px_per_mm;
    libm::hypot(session.camera.lens_mm[channel], pixel_mm / 12.0_f64.sqrt())
}
