//! Phase functions that are not those of the dictionary: media with a second lobe, and with a tabulated function of Mie
//! spheres, are measured with the scene `lab`.

use std::sync::Arc;

use farm_tests::coverage::{Answer, Coverage, Estimate, QUANTITIES};
use farm_tests::reference;
use farm_tests::statistics::Normal;
use optics_model::fit::PhaseModel;
use optics_model::phase::{PhaseShape, SecondLobe};

use super::scenes::ChangedSetUp;
use super::session::{Nodes, SetUpSession, dictionary};
use super::{Sessions, of_quantity, print_compared};

fn lobes(weight: f64, g: f64) -> PhaseShape {
    PhaseShape::Lobes(SecondLobe::new(weight, g).unwrap())
}

/// Fits the six media of the table with a phase function and the mean cosine g, and prints errors and half-widths. Returns
/// the answers and the number of intervals that hold, of 30.
fn six_media(nodes: Nodes, name: &str, phase: &PhaseShape, g: f64) -> (Vec<Answer>, usize) {
    let set_up = ChangedSetUp::none(6).with_phases(vec![phase.clone(); 6]);
    let session = SetUpSession::of_row_at(set_up, [g; 6]);
    let found = session.fitted(dictionary(nodes, true), PhaseModel::TwoLobes);
    let answers = session.answers(&found);
    println!("{name}: μ {:.3}, g {:.3}", found.common.mu, 1.0 - answers[0].medium[4].found);
    for (q, quantity) in QUANTITIES.iter().enumerate() {
        let found = Coverage::of_media([&answers[..]], &[q]);
        let per_cent =
            |number: fn(&Estimate) -> f64| -> Vec<f64> { found.all().map(|e| 100.0 * number(e)).collect() };
        let (errors, widths) = (per_cent(Estimate::error), per_cent(Estimate::half_width));
        println!(
            "  {quantity}: {} of 6 hold; errors {errors:+.1?} %; half-widths {widths:.1?} %",
            found.count()
        );
    }
    let held = Coverage::of_media([&answers[..]], &[0, 1, 2, 3, 4]).count();
    (answers, held)
}

/// A second lobe of twice the expected weight does not mislead a fit that takes its weight as uncertain.
#[test]
fn heavier_second_lobe_is_absorbed() {
    let (_, held) = six_media(Nodes::Few, "0.10 of −0.5", &lobes(0.10, -0.5), 0.4);
    assert!(held >= 28, "{held} of 30 intervals hold");
}

/// Six media without a second lobe, with that of the scene, and with one of twice the weight; one of five times the weight
/// makes the answer doubt the scene.
#[test]
#[ignore = "long form"]
fn second_lobes_of_six_media_are_absorbed() {
    for (weight, g) in [(0.0, 0.0), (0.05, -0.5), (0.10, -0.5), (0.25, -0.65)] {
        let name = format!("{weight} of {g}");
        let (found, held) = six_media(Nodes::Lab, &name, &lobes(weight, g), 0.4);
        let doubted = found.iter().filter(|a| a.is_doubted()).count();
        println!("  {doubted} of {} answers doubt the scene", found.len());
        let is_honest = if weight > 0.2 { doubted >= 5 } else { held >= 28 && doubted == 0 };
        assert!(is_honest, "{name}: {held} of 30 intervals hold, {doubted} answers doubt the scene");
    }
}

/// 20 sets of six materials, each with a second lobe of its own: weights from 0 to 0.2, anisotropies from −0.7 to 0.
#[test]
#[ignore = "long form"]
fn random_second_lobes_keep_their_coverage() {
    let set = |number: u64, phase: PhaseModel| {
        let mut random = Normal::new(940_000 + number);
        let phases = (0..6).map(|_| lobes(0.2 * random.uniform(), -0.7 * random.uniform())).collect();
        let session = SetUpSession::of_phases(number, phases);
        session.answers(&session.fitted(dictionary(Nodes::Lab, true), phase))
    };
    let [found, plain] = [PhaseModel::TwoLobes, PhaseModel::HenyeyGreenstein]
        .map(|phase| (0..20).map(|number| set(number, phase)).collect::<Sessions>());
    print_compared("with Henyey–Greenstein", &found, &plain);
    for (q, quantity) in QUANTITIES.iter().enumerate() {
        let hold = of_quantity(&found, q).hold();
        assert!(hold.share >= 0.93 - 3.0 * hold.std_error, "{quantity}: {hold} %");
    }
}

/// Six media of spheres of rutile, and of carbon.
#[test]
#[ignore = "long form"]
fn spheres_of_a_pigment_are_absorbed() {
    for name in ["rutile", "carbon"] {
        let table = reference::phase_table(name).unwrap();
        let g = table.mean_cosine();
        let (_, held) = six_media(Nodes::Lab, name, &PhaseShape::Table(Arc::new(table)), g);
        assert!(held >= 28, "{name}: {held} of 30 intervals hold");
    }
}
