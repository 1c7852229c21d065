//! A simulated laboratory: the media of its slabs, the defects of its set-up, and its photographs as files.

use std::path::Path;

use farm_tests::dng::dng;
use farm_tests::photograph::{
    Board, Camera, Dust, Edge, Look, Random, Session, SessionValues, Slab, What, session_file, traced,
};
use optics_model::scene::{Channel, Prior, PriorKind, Scope};
use optics_model::{Medium, Scene};
use optics_tracer::BareBoard;

/// Thicknesses in the session file.
pub(super) const STATED_MM: [f64; 2] = [0.512, 1.006];
/// Standard errors in the session file: of a slab's thickness, of a square, of the white reference.
const THICKNESS_MM: f64 = 0.005;
const SQUARE_MM: f64 = 0.01;
const WHITE: f64 = 0.005;

const STATED_SQUARE_MM: f64 = 20.0;
/// Standard deviation of the lamps between exposures.
const FLICKER: f64 = 0.001;
const MOUNTINGS: u64 = 3;
/// Largest haze.
const HAZE: f64 = 0.01;

/// One session: three media, one for each channel, in two thicknesses.
#[derive(Debug)]
pub(super) struct Laboratory {
    pub media: [Medium; 3],
    thickness_mm: [f64; 2],
    /// The scene of each slab.
    set_ups: [Scene; 2],
    /// Names of the scene's uncertain quantities, with their true values for each slab where the scene has one.
    pub scene: Vec<(String, [Option<f64>; 2])>,
    board: Board,
    camera: Camera,
    /// Radiance factor that slip and gel add everywhere.
    haze: f64,
    /// Relative error of the white reference.
    pub white: f64,
    /// Relative change of the lamps from the first shot to the last.
    drift: f64,
    seed: u64,
}

impl Laboratory {
    /// Media as in the tests of imperfect measurements: σ_t from 1.1 to 28 /mm and 1 − α from 0.001 to 0.7,
    /// log-uniform; one anisotropy for all, between two of the dictionary's. Defects have the size that the session
    /// file states.
    pub(super) fn draw(number: u64, (g_min, g_max): (f64, f64)) -> Self {
        let mut random = Random::new(810_000 + number);
        let g = random.between(g_min, g_max);
        let mut log = |low: f64, high: f64| low * libm::pow(high / low, random.even());
        let media = [0; 3].map(|_| Medium::new(log(1.1, 28.0), 1.0 - log(1e-3, 0.7), g).unwrap());
        let thickness_mm = STATED_MM.map(|t| t + THICKNESS_MM * random.normal());
        let square_mm = STATED_SQUARE_MM + SQUARE_MM * random.normal();
        let white = WHITE * random.normal();
        let scene = scene(&mut random);
        let set_ups = set_ups(&scene, &mut Random::new(830_000 + number));
        let haze = Random::new(840_000 + number).between(0.0, HAZE);
        let value = |prior: &Prior| {
            let value = |slab: usize| match prior.kind() {
                PriorKind::Haze => Some(haze),
                _ => set_ups[slab].value_of(prior),
            };
            (scene.name_of(prior), [0, 1].map(value))
        };
        Self {
            media,
            thickness_mm,
            board: board(&set_ups[0], square_mm),
            scene: scene.priors().iter().map(value).collect(),
            set_ups,
            haze,
            camera: camera(&mut random),
            white,
            drift: random.between(-0.002, 0.002),
            seed: 820_000 + 10 * number,
        }
    }

    /// Writes photographs and session file.
    pub(super) fn photograph(&self, folder: &Path, walks: u64) {
        let haze = self.haze;
        let board = self.board.clone();
        let covered = |edge, rim_mm| Slab { board: board.clone(), edge, rim_mm, bubble: None };
        let slab = |i: usize| {
            let clear =
                traced(&self.set_ups[i], self.media, self.thickness_mm[i], walks, self.seed + i as u64);
            covered(Edge::new(move |c, x| clear.at(c, x) + haze), [-13.0, 13.0, -9.0, 9.0])
        };
        let mut session = Session::with_certificate(self.camera.clone(), slab(0), self.white);
        let shoot = |session: &mut Session, what: What, (file, seed): (&str, u64), shots: &[(u64, f64)]| {
            for (index, seconds) in shots {
                let brightness = 1.0 + self.drift * (seconds / LAST_S - 0.5);
                session.brightness = vec![(what, *index, brightness)];
                let dust = Some(Dust { specks: 20, scratches: 2 });
                let look = Look { seed, flicker: FLICKER, exact: false, dust };
                let mut photo = session.shoot(what, *index, &look);
                photo.seconds = Some(*seconds);
                std::fs::write(folder.join(format!("{file}_{}.dng", index + 1)), dng(&photo)).unwrap();
            }
        };
        let after =
            |from: f64, count: u64| (0..count).map(|i| (i, from + 60.0 * i as f64)).collect::<Vec<_>>();
        shoot(&mut session, What::Dark, ("dark", self.seed), &after(0.0, 3));
        shoot(&mut session, What::Sheet, ("flat", self.seed), &after(200.0, 3));
        shoot(&mut session, What::Chart, ("chart", self.seed), &[(0, 400.0), (1, LAST_S)]);
        shoot(&mut session, What::Bare, ("board", self.seed), &after(600.0, 3));
        session.lay(&self.camera, &covered(Edge::new(move |_, _| haze), [-40.0, 40.0, -40.0, 40.0]));
        shoot(&mut session, What::Slab, ("haze", self.seed + 7), &after(800.0, 2));
        for (i, from) in [900.0, 1500.0].into_iter().enumerate() {
            session.lay(&self.camera, &slab(i));
            let file = format!("slab{i}");
            shoot(&mut session, What::Slab, (&file, self.seed + i as u64), &after(from, MOUNTINGS));
        }
        let values = SessionValues {
            square_mm: STATED_SQUARE_MM,
            square_std_error_mm: SQUARE_MM,
            white_std_error: WHITE,
            thickness_mm: &STATED_MM,
            thickness_std_error_mm: THICKNESS_MM,
        };
        let file = session_file(&session, &values).replace("[target]\n", "[target]\nhaze = [\"haze_*\"]\n");
        std::fs::write(folder.join("session.toml"), file).unwrap();
    }
}

/// Time of the last photograph.
const LAST_S: f64 = 2400.0;

/// The scene of each slab: uncertain quantities but those of the base, which photographs show as it is, are off by their
/// standard errors at random, within the range of the responses.
fn set_ups(scene: &Scene, random: &mut Random) -> [Scene; 2] {
    let exact = scene.clone().with_priors(Vec::new()).unwrap();
    let mut set_ups = [exact.clone(), exact];
    for prior in scene.priors().iter().filter(|prior| !prior.kind().is_of_base()) {
        let (low, high) = prior.range(scene);
        let mut draw = || loop {
            let difference = prior.std_error() * random.normal();
            if (low..=high).contains(&difference) {
                return difference;
            }
        };
        let first = draw();
        let second = if prior.scope() == Scope::Slab { draw() } else { first };
        for (set_up, difference) in set_ups.iter_mut().zip([first, second]) {
            *set_up = set_up.clone().varied(prior, difference, scene.channels().to_vec()).unwrap();
        }
    }
    set_ups
}

/// The scene `lab` with the reflectances of another print.
fn scene(random: &mut Random) -> Scene {
    let channel = |name| Channel::new(name, random.between(0.93, 0.985), random.between(0.02, 0.03)).unwrap();
    Scene::lab().with_channels(["R", "G", "B"].map(channel).to_vec()).unwrap()
}

fn board(scene: &Scene, square_mm: f64) -> Board {
    let bare = BareBoard::of(scene).unwrap();
    let seen = |rho: &dyn Fn(&Channel) -> f64| [0, 1, 2].map(|c| bare.apparent(rho(&scene.channels()[c])));
    let (light, dark) = (seen(&|c| c.rho_light()), seen(&|c| c.rho_dark()));
    Board { square_mm, light, dark, sign: 1.0, bow_per_mm: 0.0, spread_mm: 0.0 }
}

fn camera(random: &mut Random) -> Camera {
    let lens = random.between(0.02, 0.035);
    Camera {
        width: 1040,
        height: 800,
        turn_deg: random.between(0.6, 3.0) * if random.even() < 0.5 { -1.0 } else { 1.0 },
        keystone: [random.between(-0.006, 0.006), random.between(-0.006, 0.006)],
        radial: random.between(-0.001, 0.001),
        origin_px: [random.between(-12.0, 12.0), random.between(-12.0, 12.0)],
        lens_mm: [lens, lens * random.between(0.85, 1.0), lens * random.between(0.9, 1.1)],
        vignetting: random.between(0.02, 0.08),
        slope: [random.between(-0.04, 0.04), random.between(-0.04, 0.04)],
        glare: random.between(0.001, 0.005),
        fixed_pattern: random.between(0.0, 2.0),
        ..Camera::default()
    }
}
