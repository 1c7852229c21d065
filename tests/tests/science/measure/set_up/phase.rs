//! Phase functions that are not those of the dictionary: media with a second lobe, and with a tabulated function of Mie
//! spheres, are measured with the scene `lab`.

use std::sync::Arc;

use farm_tests::reference;
use farm_tests::statistics::{Normal, Share, quantile};
use optics_model::fit::PhaseModel;
use optics_model::phase::{PhaseShape, SecondLobe};

use super::outcome::{QUANTITIES, SetUpOutcome};
use super::scenes::ChangedSetUp;
use super::session::{Nodes, SetUpSession, dictionary};
use super::{Sessions, coverage, print_scene};

fn lobes(weight: f64, g: f64) -> PhaseShape {
    PhaseShape::Lobes(SecondLobe::new(weight, g).unwrap())
}

/// The six media of the table with a phase function and the mean cosine g.
fn six_media(nodes: Nodes, phase: &PhaseShape, g: f64) -> Vec<SetUpOutcome> {
    let set_up = ChangedSetUp::none(6).with_phases(vec![phase.clone(); 6]);
    SetUpSession::of_row_at(set_up, g).measured(dictionary(nodes, true))
}

/// Prints how many intervals hold, errors and half-widths, and counts the intervals that hold.
fn print_row(name: &str, found: &[SetUpOutcome]) -> usize {
    let per_cent = |values: Vec<f64>| values.iter().map(|v| format!("{v:+.1}")).collect::<Vec<_>>().join(" ");
    println!("{name}: μ {:.3}, g {:.3}", found[0].mu, found[0].g);
    let mut all = 0;
    for (q, quantity) in QUANTITIES.iter().enumerate() {
        let holds = found.iter().filter(|o| o.holds(q)).count();
        let errors = per_cent(found.iter().map(|o| 100.0 * o.error(q)).collect());
        let widths = per_cent(found.iter().map(|o| 50.0 * o.width(q)).collect());
        println!("  {quantity}: {holds} of {} hold; errors {errors} %; half-widths {widths} %", found.len());
        all += holds;
    }
    all
}

/// A second lobe of twice the expected weight does not mislead a fit that takes its weight as uncertain.
#[test]
fn heavier_second_lobe_is_absorbed() {
    let held = print_row("0.10 of −0.5", &six_media(Nodes::Few, &lobes(0.10, -0.5), 0.4));
    assert!(held >= 28, "{held} of 30 intervals hold");
}

/// Six media without a second lobe, with that of the scene, and with one of twice the weight; one of five times the weight
/// makes the answer doubt the scene.
#[test]
#[ignore = "long form"]
fn second_lobes_of_six_media_are_absorbed() {
    for (weight, g) in [(0.0, 0.0), (0.05, -0.5), (0.10, -0.5), (0.25, -0.65)] {
        let found = six_media(Nodes::Paper, &lobes(weight, g), 0.4);
        let held = print_row(&format!("{weight} of {g}"), &found);
        let doubted = found.iter().filter(|o| o.is_doubted).count();
        println!("  {doubted} of {} answers doubt the scene", found.len());
        let is_honest = if weight > 0.2 { doubted >= 5 } else { held >= 28 && doubted == 0 };
        assert!(is_honest, "{weight} of {g}: {held} of 30 intervals hold, {doubted} answers doubt the scene");
    }
}

/// 20 sets of six materials, each with a second lobe of its own: weights from 0 to 0.2, anisotropies from −0.7 to 0.
#[test]
#[ignore = "long form"]
fn random_second_lobes_keep_their_coverage() {
    let set = |number: u64, phase: PhaseModel| {
        let mut random = Normal::new(940_000 + number);
        let phases = (0..6).map(|_| lobes(0.2 * random.uniform(), -0.7 * random.uniform())).collect();
        SetUpSession::of_phases(number, phases).measured_as(dictionary(Nodes::Paper, true), phase)
    };
    let [found, plain] = [PhaseModel::TwoLobes, PhaseModel::HenyeyGreenstein]
        .map(|phase| (0..20).map(|number| set(number, phase)).collect::<Sessions>());
    println!("| quantity | hold % | with Henyey–Greenstein | median width over that | median error % |");
    for (q, quantity) in QUANTITIES.iter().enumerate() {
        let share = |of| -> Share { coverage(of, |o| vec![o.holds(q)]) };
        let errors = found.iter().flatten().map(|o| 100.0 * o.error(q).abs()).collect();
        let pairs = found.iter().flatten().zip(plain.iter().flatten());
        let ratio = quantile(pairs.map(|(o, p)| o.width(q) / p.width(q)).collect(), 0.5);
        println!(
            "| {quantity} | {} | {} | {ratio:.2} | {:.2} |",
            share(&found),
            share(&plain),
            quantile(errors, 0.5)
        );
        let room = 3.0 * share(&found).std_error;
        assert!(share(&found).share >= 0.93 - room, "{quantity}: {} %", share(&found));
    }
    print_scene(&found);
}

/// Six media of spheres of rutile, and of carbon.
#[test]
#[ignore = "long form"]
fn spheres_of_a_pigment_are_absorbed() {
    for name in ["rutile", "carbon"] {
        let table = reference::phase_table(name).unwrap();
        let g = table.mean_cosine();
        let held = print_row(name, &six_media(Nodes::Paper, &PhaseShape::Table(Arc::new(table)), g));
        assert!(held >= 28, "{name}: {held} of 30 intervals hold");
    }
}
