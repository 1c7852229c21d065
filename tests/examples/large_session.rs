//! Makes a session of twenty photographs of 18 megapixels, to measure time and memory of `farmctl capture`:
//! `cargo run --release -p farm-tests --example large_session -- FOLDER`.

use std::path::PathBuf;

use farm_tests::dng::dng;
use farm_tests::photograph::{Board, Camera, Edge, Look, Session, SessionValues, Slab, What, session_file};

const SQUARE_MM: f64 = 20.0;
const THICKNESS_MM: [f64; 2] = [0.512, 1.006];
const MOUNTINGS: u64 = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder: PathBuf = std::env::args_os().nth(1).ok_or("name a folder")?.into();
    std::fs::create_dir_all(&folder)?;
    let camera = Camera { width: 5184, height: 3456, px_per_mm: 36.0, turn_deg: 1.1, ..Camera::default() };
    let slab = |reach_mm: f64| Slab {
        board: Board {
            square_mm: SQUARE_MM,
            light: [0.838, 0.816, 0.814],
            dark: [0.0213, 0.0209, 0.0222],
            sign: 1.0,
            bow_per_mm: 0.0,
            spread_mm: 0.0,
        },
        edge: Edge::new(move |_, x| white(x, reach_mm)),
        rim_mm: [-25.0, 25.0, -20.0, 20.0],
        bubble: None,
    };
    let mut session = Session::new(camera.clone(), slab(0.5));
    let look = Look { seed: 1, flicker: 0.001, exact: false, dust: None };
    let shoot = |session: &Session, what: What, file: &str, index: u64, seconds: f64| {
        let mut photo = session.shoot(what, index, &look);
        photo.seconds = Some(seconds);
        std::fs::write(folder.join(format!("{file}_{}.dng", index + 1)), dng(&photo))
    };
    for (what, file, from, count) in
        [(What::Dark, "dark", 0.0, 2), (What::Sheet, "flat", 200.0, 3), (What::Bare, "board", 600.0, 3)]
    {
        for i in 0..count {
            shoot(&session, what, file, i, from + 60.0 * i as f64)?;
        }
    }
    shoot(&session, What::Chart, "chart", 0, 400.0)?;
    shoot(&session, What::Chart, "chart", 1, 2400.0)?;
    for (n, reach_mm) in [0.5, 0.9].into_iter().enumerate() {
        session.lay(&camera, &slab(reach_mm));
        for i in 0..MOUNTINGS {
            let index = MOUNTINGS * n as u64 + i;
            let mut photo = session.shoot(What::Slab, index, &look);
            photo.seconds = Some(900.0 + 60.0 * index as f64);
            std::fs::write(folder.join(format!("slab{n}_{}.dng", i + 1)), dng(&photo))?;
        }
    }
    let values = SessionValues {
        square_mm: SQUARE_MM,
        square_std_error_mm: 0.01,
        white_std_error: 0.005,
        thickness_mm: &THICKNESS_MM,
        thickness_std_error_mm: 0.005,
    };
    std::fs::write(folder.join("session.toml"), session_file(&session, &values))?;
    Ok(())
}

/// An approximate edge profile of a white resin.
fn white(x_mm: f64, reach_mm: f64) -> f64 {
    let leak = 0.12 * libm::exp(-x_mm.abs() / reach_mm);
    if x_mm < 0.0 { 0.38 + leak } else { 0.75 - leak }
}
