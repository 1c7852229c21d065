//! Set-ups that differ from the scene `lab`.

use std::sync::OnceLock;

use farm_tests::statistics::Normal;
use optics_model::phase::PhaseShape;
use optics_model::scene::{Channel, RingLight, Scene, Scope};
use optics_tracer::SeenBase;

use crate::measure::SLABS_MM;

/// Indices of the priors of the scene `lab`.
const ROUGHNESS: usize = 0;
const COAT_ROUGHNESS: usize = 1;
const GEL_THICKNESS: usize = 3;
const GEL_INDEX: usize = 4;
pub(super) const SAMPLE_INDEX: usize = 5;
pub(super) const LOBE_WEIGHT: usize = 7;
const RING: usize = 8;
pub(super) const BASE_SPREAD: usize = 9;
const LIGHT_SIDE: usize = 10;
const DARK_SIDE: usize = 11;
pub(super) const HAZE: usize = 12;

/// The scene `lab` with the first channel alone.
pub(super) fn lab() -> Scene {
    let lab = Scene::lab();
    let first = lab.channels()[..1].to_vec();
    lab.with_channels(first).unwrap()
}

/// Differences of quantities from the scene's values.
#[derive(Debug, Clone)]
pub(super) struct ChangedSetUp {
    /// By material, slab and prior.
    differences: Vec<[Vec<f64>; 2]>,
    /// The ring light, if it differs from the scene's.
    ring: Option<RingLight>,
    /// Phase functions by material, if they are not those of the scene and its prior.
    phases: Option<Vec<PhaseShape>>,
    /// Rise of each slab's thickness over 10 mm, as a share.
    pub wedge: f64,
    /// Shift of the edge over the thickness of slab, slip and gel.
    pub shift: f64,
    /// Channels of the base: coat and lamps are the session's, so they are the same for all slabs.
    channels: OnceLock<Vec<Channel>>,
}

/// Changed set-ups: name, and priors with their differences.
const ROWS: [(&str, &[(usize, f64)]); 20] = [
    ("nominal", &[]),
    ("sample roughness 0.10", &[(ROUGHNESS, 0.05)]),
    ("sample roughness 0.02", &[(ROUGHNESS, -0.03)]),
    ("coat roughness 0.25", &[(COAT_ROUGHNESS, 0.10)]),
    ("gel 0.05 mm", &[(GEL_THICKNESS, 0.03)]),
    ("gel 0.10 mm", &[(GEL_THICKNESS, 0.08)]),
    ("sample index 1.56", &[(SAMPLE_INDEX, 0.03)]),
    ("gel index 1.38", &[(GEL_INDEX, 0.05)]),
    ("ring 2° off", &[(RING, 2.0)]),
    (WIDE_RING, &[]),
    ("base spread 0.05 mm", &[(BASE_SPREAD, 0.05)]),
    ("base spread 0.1 mm", &[(BASE_SPREAD, 0.1)]),
    ("base spread 0.3 mm", &[(BASE_SPREAD, 0.3)]),
    ("light side 2 % darker", &[(LIGHT_SIDE, -0.02)]),
    ("board with 3 % of gloss", &[(LIGHT_SIDE, -0.03), (DARK_SIDE, -0.03)]),
    ("haze 0.01", &[(HAZE, 0.01)]),
    (UNLIKE_G, &[]),
    (WEDGES[0].0, &[]),
    (WEDGES[1].0, &[]),
    (TILTED, &[]),
];
/// Slabs whose thickness rises by this share over 10 mm.
const WEDGES: [(&str, f64); 2] = [("wedge of ± 2 %", 0.04), ("wedge of ± 5 %", 0.1)];
/// A camera that looks 5° off across the edge: edges shift by this share of the path to the base.
const TILTED: &str = "camera 5° off";
const SHIFT: f64 = 0.057;
const WIDE_RING: &str = "ring 32–58°";
const UNLIKE_G: &str = "g of 0.28 to 0.48";

impl ChangedSetUp {
    fn new(differences: Vec<[Vec<f64>; 2]>) -> Self {
        Self { differences, ring: None, phases: None, wedge: 0.0, shift: 0.0, channels: OnceLock::new() }
    }

    pub(super) fn names() -> [&'static str; 20] {
        ROWS.map(|row| row.0)
    }

    /// Anisotropies of the six media in the set-up of a name.
    pub(super) fn anisotropies(name: &str) -> [f64; 6] {
        if name == UNLIKE_G { [0.48, 0.36, 0.44, 0.28, 0.40, 0.32] } else { [0.4; 6] }
    }

    /// # Panics
    /// If there is no set-up of this name.
    pub(super) fn named(name: &str) -> Self {
        let (_, differences) = ROWS.iter().find(|row| row.0 == name).unwrap();
        let mut set_up = Self::none(6);
        for slab in set_up.differences.as_flattened_mut() {
            differences.iter().for_each(|(prior, difference)| slab[*prior] = *difference);
        }
        let ring = (name == WIDE_RING).then(|| RingLight::new(32.0, 58.0).unwrap());
        let wedge = WEDGES.into_iter().find(|row| row.0 == name).map_or(0.0, |row| row.1);
        let shift = if name == TILTED { SHIFT } else { 0.0 };
        Self { ring, wedge, shift, ..set_up }
    }

    /// A set-up without differences.
    pub(super) fn none(materials: usize) -> Self {
        let zero = vec![0.0; lab().priors().len()];
        Self::new(vec![[zero.clone(), zero]; materials])
    }

    /// All quantities from their priors, within the ranges of the responses.
    pub(super) fn random(random: &mut Normal, materials: usize) -> Self {
        let scene = lab();
        let priors = scene.priors();
        let mut set_up = Self::none(materials);
        for (p, prior) in priors.iter().enumerate() {
            let (low, high) = prior.range(&scene);
            // A base reflects no more than all light.
            let high = if p == LIGHT_SIDE { 1.0 / scene.channels()[0].rho_light() - 1.0 } else { high };
            let mut draw = || loop {
                let difference = prior.std_error() * random.normal();
                if (low..=high).contains(&difference) {
                    return difference;
                }
            };
            let of_session = draw();
            for slabs in &mut set_up.differences {
                let of_material = draw();
                for slab in slabs {
                    slab[p] = match prior.scope() {
                        Scope::Session => of_session,
                        Scope::Material | Scope::Channel => of_material,
                        Scope::Slab => draw(),
                    };
                }
            }
        }
        set_up
    }

    /// This set-up with these phase functions of the materials.
    pub(super) fn with_phases(self, phases: Vec<PhaseShape>) -> Self {
        Self { phases: Some(phases), ..self }
    }

    /// None for the weight of a second lobe whose anisotropy is not the scene's, and of none.
    pub(super) fn difference(&self, material: usize, slab_mm: Option<f64>, prior: usize) -> Option<f64> {
        let scene = lab();
        if let Some(phases) = self.phases.as_ref().filter(|_| scene.priors()[prior].kind().is_of_phase()) {
            let (own, of_scene) = (phases[material].second_lobe()?, scene.phase().second_lobe()?);
            return (own.g() == of_scene.g()).then(|| own.weight() - of_scene.weight());
        }
        let slab = slab_mm.map_or(0, |mm| SLABS_MM.iter().position(|t| *t == mm).unwrap());
        Some(self.differences[material][slab][prior])
    }

    /// The scene of a slab; the bare board looks the same in all.
    pub(super) fn scene(&self, material: usize, slab: usize) -> Scene {
        let lab = lab();
        let mut scene = lab.clone().with_priors(Vec::new()).unwrap();
        for (prior, difference) in lab.priors().iter().zip(&self.differences[material][slab]) {
            if *difference != 0.0 {
                let channels = scene.channels().to_vec();
                scene = scene.varied(prior, *difference, channels).unwrap();
            }
        }
        if let Some(ring) = self.ring {
            scene = scene.with_light(ring);
        }
        if let Some(phases) = &self.phases {
            scene = scene.with_phase(phases[material].clone());
        }
        let channels = self.channels.get_or_init(|| SeenBase::of(&lab).through(&scene).unwrap());
        scene.with_channels(channels.clone()).unwrap()
    }
}
