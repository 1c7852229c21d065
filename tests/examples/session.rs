//! Makes examples/session: `cargo run -p farm-tests --example session -- examples/session`. The white of the paper's
//! Table 1 at g = 0.4, traced in the scene `paper` and photographed by the maker of the tests. Prints the truth.

use std::path::PathBuf;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use farm_tests::dng::dng;
use farm_tests::photograph::{Board, Camera, Dust, Look, Session, Slab, What};
use optics_model::job::JobSpec;
use optics_model::scene::Sensor;
use optics_model::{Scene, TransportPoint, Walks};
use optics_tracer::BareBoard;

/// σ_t in 1/mm and α of red, green and blue.
const MEDIA: [(f64, f64); 3] = [(6.0, 0.9991), (9.0, 0.9997), (24.0, 0.999)];
const G: f64 = 0.4;
const SAMPLE_IOR: f64 = 1.53;
const WALKS: u64 = 4_000_000;

/// Pixels of the traced profiles, over 12 mm.
const WIDTH_MM: f64 = 12.0;
const PIXELS: u32 = 480;

/// Measured thicknesses, which are not the nominal ones.
const THIN_MM: f64 = 0.512;
const THICK_MM: f64 = 1.006;

type Profiles = [Vec<f64>; 3];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder: PathBuf = std::env::args_os().nth(1).ok_or("name a folder")?.into();
    std::fs::create_dir_all(&folder)?;
    let bare = BareBoard::of(&Scene::paper())?;
    let seen = |rho: [f64; 3]| rho.map(|r| bare.apparent(r));
    let board = Board {
        square_mm: 20.0,
        light: seen([0.985, 0.972, 0.971]),
        dark: seen([0.024, 0.023, 0.026]),
        sign: 1.0,
        bow_per_mm: 0.0,
    };
    let slabs = [("white_05", thin as fn(usize, f64) -> f64, 3), ("white_10", thick, 4)];
    for (name, edge, seed) in slabs {
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

/// A small camera: 28 × 22 mm at 26 pixels a millimetre, 10 bits.
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

fn thin(channel: usize, x_mm: f64) -> f64 {
    static TRACED: OnceLock<Profiles> = OnceLock::new();
    at(&TRACED.get_or_init(|| traced(THIN_MM))[channel], x_mm)
}

fn thick(channel: usize, x_mm: f64) -> f64 {
    static TRACED: OnceLock<Profiles> = OnceLock::new();
    at(&TRACED.get_or_init(|| traced(THICK_MM))[channel], x_mm)
}

/// Linear between the pixels' centres, constant beyond them.
fn at(values: &[f64], x_mm: f64) -> f64 {
    let place = ((x_mm / WIDTH_MM + 0.5) * f64::from(PIXELS) - 0.5).clamp(0.0, f64::from(PIXELS - 1));
    let (i, share) = (place as usize, place.fract());
    let next = values[(i + 1).min(values.len() - 1)];
    values[i] + share * (next - values[i])
}

fn traced(thickness_mm: f64) -> Profiles {
    let profile = |c: usize| {
        let (sigma_t, albedo) = MEDIA[c];
        let build = || {
            let scene = Scene::paper().with_sensor(Sensor::new(WIDTH_MM, PIXELS, 0.0)?);
            let point = TransportPoint::new(sigma_t, G, thickness_mm, SAMPLE_IOR)?;
            JobSpec::new(scene, point, vec![albedo], Walks::new(WALKS)?, 11, false)
        };
        let job = build().expect("the job is valid");
        let records = optics_tracer::trace(&job, &AtomicBool::new(false)).expect("nobody stops it");
        records[0].profiles[c].radiance_factor.values().iter().map(|v| f64::from(*v)).collect()
    };
    [0, 1, 2].map(profile)
}
