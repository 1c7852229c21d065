//! Makes examples/session: `cargo run -p farm-tests --example session -- examples/session`. The white of the paper's
//! Table 1 at g = 0.4, traced in the scene `lab` and photographed by the tests' simulated camera. Prints the true
//! values.

use std::path::PathBuf;

use farm_tests::dng::dng;
use farm_tests::photograph::{Board, Camera, Dust, Look, Session, Slab, What, traced};
use optics_model::{Invalid, Medium, Scene};
use optics_tracer::BareBoard;

/// σ_t in 1/mm and α of red, green and blue.
const MEDIA: [(f64, f64); 3] = [(6.0, 0.9991), (9.0, 0.9997), (24.0, 0.999)];
const G: f64 = 0.4;
const WALKS: u64 = 4_000_000;

/// Measured thicknesses, which differ from the nominal ones.
const THIN_MM: f64 = 0.512;
const THICK_MM: f64 = 1.006;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder: PathBuf = std::env::args_os().nth(1).ok_or("name a folder")?.into();
    std::fs::create_dir_all(&folder)?;
    let bare = BareBoard::of(&Scene::lab())?;
    let seen = |rho: [f64; 3]| rho.map(|r| bare.apparent(r));
    let board = Board {
        square_mm: 20.0,
        light: seen([0.985, 0.972, 0.971]),
        dark: seen([0.024, 0.023, 0.026]),
        sign: 1.0,
        bow_per_mm: 0.0,
        spread_mm: 0.0,
    };
    let slabs = [("white_05", THIN_MM, 3), ("white_10", THICK_MM, 4)];
    for (name, thickness_mm, seed) in slabs {
        let edge = traced(&Scene::lab(), white()?, thickness_mm, WALKS, 11);
        let slab = Slab { board: board.clone(), edge, rim_mm: [-13.0, 13.0, -9.0, 9.0], bubble: None };
        let session = Session::new(camera(), slab);
        let look = Look { seed, flicker: 0.0005, exact: false, dust: Some(Dust { specks: 8, scratches: 1 }) };
        let shoot = |what: What, file: &str, index: u64, seconds: f64| {
            let mut photo = session.shoot(what, index, &look);
            photo.seconds = Some(seconds);
            std::fs::write(folder.join(format!("{file}.dng")), dng(&photo))
        };
        if name == "white_05" {
            for i in 0..2 {
                let n = i + 1;
                let at = 60.0 * i as f64;
                shoot(What::Dark, &format!("dark_{n}"), i, at)?;
                shoot(What::Sheet, &format!("flat_{n}"), i, 200.0 + at)?;
                shoot(What::Bare, &format!("board_{n}"), i, 600.0 + at)?;
            }
            shoot(What::Chart, "chart_1", 0, 400.0)?;
            shoot(What::Chart, "chart_2", 1, 2400.0)?;
        }
        for i in 0..3 {
            shoot(
                What::Slab,
                &format!("{name}_{}", i + 1),
                i,
                900.0 + 500.0 * (seed - 3) as f64 + 120.0 * i as f64,
            )?;
        }
    }
    Ok(())
}

fn white() -> Result<[Medium; 3], Invalid> {
    let [red, green, blue] = MEDIA.map(|(sigma_t, albedo)| Medium::new(sigma_t, albedo, G));
    Ok([red?, green?, blue?])
}

/// A small camera: 28 × 22 mm at 26 pixels per millimetre, 10 bits.
fn camera() -> Camera {
    Camera {
        width: 720,
        height: 576,
        px_per_mm: 26.0,
        turn_deg: 2.1,
        lens_mm: [0.036, 0.032, 0.035],
        full: [430.0, 750.0, 530.0],
        numbers_per_electron: 0.03,
        read: 1.0,
        black: 64.0,
        clip: 1023.0,
        ..Camera::default()
    }
}
