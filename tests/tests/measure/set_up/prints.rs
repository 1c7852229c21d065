//! Prints of media that were measured in random set-ups: whether the intervals of their radiance factors hold.

use farm_tests::statistics::{Normal, effort, quantile};
use optics_layers::{Print, PrintedSlab, Uncertain, predict};
use optics_model::fit::{PhaseModel, Z};
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

/// Measured and true media of a session, and its mean difference of the samples' indices.
fn media(number: u64) -> (Vec<Uncertain>, Vec<Uncertain>, Vec<f64>) {
    let session = SetUpSession::random(number, 6, true);
    let found = session.fitted(dictionary(Nodes::Paper, true), PhaseModel::TwoLobes);
    let measured = |fit: &optics_model::fit::MaterialFit| {
        let r = fit.channels[0].refined.as_ref().unwrap();
        Uncertain {
            medium: r.best.medium,
            second_lobe: r.second_lobe.unwrap_or_default(),
            covariance: r.covariance,
        }
    };
    let truth = |m: usize| Uncertain {
        medium: session.medium(m),
        second_lobe: SecondLobe::new(0.05 + session.difference(m, LOBE_WEIGHT), -0.5).unwrap(),
        covariance: [[0.0; 3]; 3],
    };
    let iors = (0..6).map(|m| IOR + session.difference(m, SAMPLE_INDEX)).collect();
    (found.materials.iter().map(measured).collect(), (0..6).map(truth).collect(), iors)
}

/// Predicts prints of one medium and of mixtures of two, 0.2 to 3 mm thick, over black and white.
#[test]
#[ignore = "long form"]
fn predicted_prints_keep_their_coverage() {
    let scene = bare();
    let print = Print::new(&scene, IOR, 0.2);
    let (mut held, mut errors, mut widths) = (Vec::new(), Vec::new(), Vec::new());
    for number in 0..20 * effort() {
        let (measured, truth, iors) = media(number);
        let mut random = Normal::new(940_000 + number);
        let mut of_session = Vec::new();
        for _ in 0..PRINTS {
            let (a, b) = ((6.0 * random.uniform()) as usize, (6.0 * random.uniform()) as usize);
            let share = if a == b { 1.0 } else { random.uniform() };
            let shares = if a == b { vec![(a, 1.0)] } else { vec![(a, share), (b, 1.0 - share)] };
            let slab = [PrintedSlab { shares, thickness_mm: 0.2 * 15_f64.powf(random.uniform()) }];
            let own = Print::new(&scene, share * iors[a] + (1.0 - share) * iors[b], 0.2);
            let found = predict(&print, &measured, &slab, &RHO).unwrap();
            let exact = predict(&own, &truth, &slab, &RHO).unwrap();
            for (found, exact) in found.iter().zip(&exact) {
                let off = found.value - exact.value;
                of_session.push(off.abs() <= Z * found.std_error());
                errors.push(100.0 * (off / exact.value).abs());
                widths.push(100.0 * Z * found.std_error() / exact.value);
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
