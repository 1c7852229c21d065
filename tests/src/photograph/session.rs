//! Simulates whole sessions: the photographs that a laboratory takes, in order.

use std::sync::{Arc, OnceLock};

use optics_capture::{Area, Neutral, Photo, Side, Target};

use super::camera::{Camera, Dust, Shot, develop, expose};
use super::noise::Random;
use super::subject::{Board, Slab, Subject};

/// A set-up whose subjects are exposed at their first shot; any number of shots can be developed from them.
#[derive(Debug, Clone)]
pub struct Session {
    pub camera: Camera,
    pub board: Board,
    /// Certified reflectances of the grey patches.
    pub rho: Vec<f64>,
    /// In the order of [`What`].
    exposures: [Exposure; 5],
    /// Brightness of the lamps in one shot.
    pub brightness: Vec<(What, u64, f64)>,
}

/// A subject before a camera, exposed once for all copies.
#[derive(Debug, Clone)]
struct Exposure {
    camera: Camera,
    subject: Subject,
    light: Arc<OnceLock<Vec<f64>>>,
}

impl Exposure {
    fn new(camera: &Camera, subject: Subject) -> Self {
        Self { camera: camera.clone(), subject, light: Arc::default() }
    }

    fn light(&self) -> &[f64] {
        self.light.get_or_init(|| expose(&self.camera, &self.subject))
    }
}

/// Patches of a grey card, in pixels: x, y, width, height.
#[must_use]
pub fn patches(camera: &Camera) -> Vec<[f64; 4]> {
    let (w, h) = (camera.width as f64, camera.height as f64);
    (0..6).map(|i| [w * (0.06 + 0.15 * f64::from(i)), 0.35 * h, 0.12 * w, 0.3 * h]).collect()
}

/// The Macbeth greys of the paper.
pub(super) const GREYS: [f64; 6] = [0.956, 0.594, 0.361, 0.193, 0.090, 0.032];

impl Session {
    #[must_use]
    pub fn new(camera: Camera, slab: Slab) -> Self {
        Self::with_certificate(camera, slab, 0.0)
    }

    /// A session whose grey patches are brighter than certified, by a relative error.
    #[must_use]
    pub fn with_certificate(camera: Camera, slab: Slab, error: f64) -> Self {
        let rho = GREYS.to_vec();
        let brighter = rho.iter().map(|rho| rho * (1.0 + error)).collect();
        let subjects = [
            Subject::Nothing,
            Subject::Sheet { slope: [0.0, 0.0] },
            Subject::Patches { areas: patches(&camera), rho: brighter },
            Subject::Board(slab.board.clone()),
            Subject::Slab(slab.clone()),
        ];
        let exposures = subjects.map(|subject| Exposure::new(&camera, subject));
        Self { exposures, camera, board: slab.board, rho, brightness: Vec::new() }
    }

    /// Sets slab and camera of later shots of samples.
    pub fn lay(&mut self, camera: &Camera, slab: &Slab) {
        self.exposures[What::Slab as usize] = Exposure::new(camera, Subject::Slab(slab.clone()));
    }

    /// Sets board and camera of later shots of the bare board.
    pub fn show_bare(&mut self, camera: &Camera, board: &Board) {
        self.exposures[What::Bare as usize] = Exposure::new(camera, Subject::Board(board.clone()));
    }

    /// Areas well within the patches: x, y, width, height in pixels.
    #[must_use]
    pub fn areas_px(&self) -> Vec<[f64; 4]> {
        let inner = |[x, y, w, h]: [f64; 4]| [x + 8.0, y + 8.0, w - 16.0, h - 16.0];
        patches(&self.camera).into_iter().map(inner).collect()
    }

    #[must_use]
    pub fn neutral(&self) -> Neutral {
        let area = |[x, y, width, height]: [f64; 4]| Area { x, y, width, height };
        let areas = self.areas_px().into_iter().map(area).collect();
        Neutral::new(self.rho.iter().map(|r| vec![*r; 3]).collect(), 0.005, Some(areas)).unwrap()
    }

    #[must_use]
    pub fn target(&self) -> Target {
        Target {
            square_mm: self.board.square_mm,
            square_std_error_mm: 0.0,
            dark_side: Some(if self.board.sign > 0.0 { Side::Left } else { Side::Right }),
        }
    }

    fn lamps(&self, what: What, index: u64) -> f64 {
        let same = |b: &&(What, u64, f64)| b.0 == what && b.1 == index;
        self.brightness.iter().find(same).map_or(1.0, |b| b.2)
    }

    /// One shot; `flicker` is the standard deviation of the lamps.
    #[must_use]
    pub fn shoot(&self, what: What, index: u64, look: &Look) -> Photo {
        let seed = look.seed.wrapping_mul(1000) + index + 100 * what as u64;
        let mut random = Random::new(seed ^ 0xABCD);
        let label = ["dark", "flat", "chart", "board", "slab"][what as usize];
        let shot = Shot {
            label: format!("{label}_{}", index + 1),
            seed,
            brightness: self.lamps(what, index) * (1.0 + look.flicker * random.normal()),
            seconds: Some(60.0 * (100 * what as u64 + index) as f64),
            exact: look.exact,
            dust: look.dust.filter(|_| what == What::Slab),
        };
        develop(&self.camera, self.exposures[what as usize].light(), &shot)
    }
}

/// The subject of a shot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum What {
    Dark,
    Sheet,
    Chart,
    Bare,
    Slab,
}

/// Conditions of a shot.
#[derive(Debug, Clone, Copy)]
pub struct Look {
    pub seed: u64,
    pub flicker: f64,
    pub exact: bool,
    pub dust: Option<Dust>,
}
