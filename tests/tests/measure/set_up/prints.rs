//! Prints of media that were measured in random set-ups: whether the intervals of their radiance factors hold.

use farm_tests::statistics::{Normal, effort, quantile};
use optics_layers::{Predicted, Print, PrintedSlab, SetUpChange, Uncertain, predict, radiance_factors};
use optics_model::fit::{MaterialFit, PhaseModel, SceneDifference, Z};
use optics_model::phase::SecondLobe;
use optics_model::scene::{Layer, Scene};

use super::coverage_of;
use super::scenes::{LOBE_WEIGHT, SAMPLE_INDEX, lab};
use super::session::{Nodes, SetUpSession, dictionary};

const IOR: f64 = 1.53;
const RHO: [f64; 2] = [0.03, 0.9];
const PRINTS: usize = 20;

/// A polished print in air, lit by the ring.
fn bare() -> Scene {
    let lab = lab();
    let layers = vec![Layer::sample("print", 0.0).unwrap(), Layer::clear("air", 1.0, 0.0, 0.0).unwrap()];
    Scene::new(layers, lab.channels().to_vec(), lab.light(), lab.sensor(), true).unwrap()
}

/// A difference of the samples' indices with its changes by source.
struct IndexDifference {
    value: f64,
    changes: Vec<f64>,
}

/// Media of a session, with the differences of the samples' indices from the scene's.
struct SessionMedia {
    measured: Vec<Uncertain>,
    indices: Vec<IndexDifference>,
    truth: Vec<Uncertain>,
    true_indices: Vec<f64>,
}

impl SessionMedia {
    fn of(number: u64) -> Self {
        let session = SetUpSession::random(number, 6, true);
        let found = session.fitted(dictionary(Nodes::Paper, true), PhaseModel::TwoLobes);
        let measured = |(i, fit): (usize, &MaterialFit)| {
            let r = fit.channels[0].refined.as_ref().unwrap();
            Uncertain {
                medium: r.best.medium,
                second_lobe: r.second_lobe.unwrap_or_default(),
                covariance: r.covariance,
                shared: found.shared_errors.of_channel(i).to_vec(),
            }
        };
        let index = |m: usize| {
            let of = |d: &&SceneDifference| d.prior == SAMPLE_INDEX && d.material == Some(m);
            let found = found.shared_errors.scene.iter().find(of).unwrap();
            IndexDifference { value: found.difference, changes: found.changes.clone() }
        };
        let truth = |m: usize| {
            let lobe = SecondLobe::new(0.05 + session.difference(m, LOBE_WEIGHT), -0.5).unwrap();
            Uncertain::exact(session.medium(m), lobe)
        };
        Self {
            measured: found.materials.iter().enumerate().map(measured).collect(),
            indices: (0..6).map(index).collect(),
            truth: (0..6).map(truth).collect(),
            true_indices: (0..6).map(|m| session.difference(m, SAMPLE_INDEX)).collect(),
        }
    }

    fn predicted(&self, scene: &Scene, slab: &PrintedSlab) -> Vec<Predicted> {
        const STEP: f64 = 0.005;
        let mean = |of: &dyn Fn(&IndexDifference) -> f64| -> f64 {
            slab.shares.iter().map(|(m, share)| share * of(&self.indices[*m])).sum()
        };
        let ior = IOR + mean(&|index| index.value);
        let [from, to] = [ior, ior + STEP].map(|ior| Print::new(scene, ior, 0.2));
        let sources = self.indices[0].changes.len();
        let shared: Vec<f64> = (0..sources).map(|k| mean(&|index| index.changes[k]) / STEP).collect();
        let by_index = SetUpChange { from: &from, to: &to, to_rho: &RHO, shared: &shared };
        predict(&from, &self.measured, &[by_index], std::slice::from_ref(slab), &RHO).unwrap()
    }

    fn exact(&self, scene: &Scene, slab: &PrintedSlab) -> Vec<f64> {
        let mean: f64 = slab.shares.iter().map(|(m, share)| share * self.true_indices[*m]).sum();
        let print = Print::new(scene, IOR + mean, 0.2);
        radiance_factors(&print, &self.truth, std::slice::from_ref(slab), &RHO).unwrap()
    }
}

/// Predicts prints of one medium and of mixtures of two, 0.2 to 3 mm thick, over black and white.
#[test]
#[ignore = "long form"]
fn predicted_prints_keep_their_coverage() {
    let scene = bare();
    let (mut held, mut errors, mut widths) = (Vec::new(), Vec::new(), Vec::new());
    for number in 0..20 * effort() {
        let media = SessionMedia::of(number);
        let mut random = Normal::new(940_000 + number);
        let mut of_session = Vec::new();
        for _ in 0..PRINTS {
            let (a, b) = ((6.0 * random.uniform()) as usize, (6.0 * random.uniform()) as usize);
            let share = if a == b { 1.0 } else { random.uniform() };
            let shares = if a == b { vec![(a, 1.0)] } else { vec![(a, share), (b, 1.0 - share)] };
            let slab = PrintedSlab { shares, thickness_mm: 0.2 * 15_f64.powf(random.uniform()) };
            let found = media.predicted(&scene, &slab);
            for (found, exact) in found.iter().zip(media.exact(&scene, &slab)) {
                let off = found.value - exact;
                of_session.push(off.abs() <= Z * found.std_error());
                errors.push(100.0 * (off / exact).abs());
                widths.push(100.0 * Z * found.std_error() / exact);
            }
        }
        held.push(of_session);
    }
    let share = coverage_of(&held);
    let [error, width] = [errors, widths].map(|all| quantile(all, 0.5));
    println!(
        "intervals of radiance factors hold {share} %; median error {error:.2} %, half-width {width:.2} %"
    );
    let room = 3.0 * share.std_error;
    assert!((0.93 - room..=0.97 + room).contains(&share.share), "{share}");
}
