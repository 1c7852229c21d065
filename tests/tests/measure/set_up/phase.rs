//! Phase functions that are not those of the dictionary: media with a second lobe, and with a tabulated function of Mie
//! spheres, are measured with the scene `lab`.

use std::sync::Arc;

use farm_tests::statistics::Normal;
use optics_model::phase::{PhaseShape, SecondLobe};

use super::outcome::{QUANTITIES, SetUpOutcome};
use super::scenes::ChangedSetUp;
use super::session::{Nodes, SetUpSession, dictionary};
use super::{Sessions, coverage, print_scene, quantile};

fn lobes(weight: f64, g: f64) -> PhaseShape {
    PhaseShape::Lobes(SecondLobe::new(weight, g).unwrap())
}

fn print_rows(name: &str, found: &[SetUpOutcome]) {
    println!("{name}: μ {:.3}, g {:.3}", found[0].mu, found[0].g);
    for (q, quantity) in QUANTITIES.iter().enumerate() {
        let holds = found.iter().filter(|o| o.holds(q)).count();
        let errors: Vec<String> = found.iter().map(|o| format!("{:+.1}", 100.0 * o.error(q))).collect();
        let widths: Vec<String> = found.iter().map(|o| format!("{:.1}", 50.0 * o.width(q))).collect();
        println!(
            "  {quantity} holds {holds} of {}; errors {} %; half-widths {} %",
            found.len(),
            errors.join(" "),
            widths.join(" ")
        );
    }
    for scene in found.iter().flat_map(|o| &o.scene).filter(|s| s.name.contains("lobe")) {
        println!(
            "  {}: z {:+.2}, posterior over prior {:.2}, at end {}",
            scene.name,
            scene.z(),
            scene.share_of_prior,
            scene.at_end
        );
    }
    println!("  p {:?}", found.iter().map(|o| (1e3 * o.probability).round() / 1e3).collect::<Vec<_>>());
}

/// Six media with a second lobe: of the weight 0.10 and the anisotropy −0.5, and of 0.25 and −0.65.
#[test]
#[ignore = "long form"]
fn second_lobes_of_six_media_are_absorbed() {
    for (weight, g) in [(0.05, -0.5), (0.0, 0.0), (0.10, -0.5), (0.25, -0.65)] {
        let set_up = ChangedSetUp::none(6).with_phases(vec![lobes(weight, g); 6]);
        let found = SetUpSession::of_row_at(set_up, 0.4).measured(dictionary(Nodes::Paper, true));
        print_rows(&format!("{weight} of {g}"), &found);
    }
}

/// 20 sets of six materials, each with a second lobe of its own: weights from 0 to 0.2, anisotropies from −0.7 to 0.
#[test]
#[ignore = "long form"]
fn random_second_lobes_keep_their_coverage() {
    let set = |number: u64| {
        let mut random = Normal::new(940_000 + number);
        let phases = (0..6).map(|_| lobes(0.2 * random.uniform(), -0.7 * random.uniform())).collect();
        SetUpSession::of_phases(number, phases).measured(dictionary(Nodes::Paper, true))
    };
    let found: Sessions = (0..20).map(set).collect();
    let of_q = |q: usize| coverage(&found, |o| vec![o.holds(q)]);
    for (q, quantity) in QUANTITIES.iter().enumerate() {
        let all = || found.iter().flatten();
        let error = quantile(all().map(|o| 100.0 * o.error(q).abs()).collect(), 0.5);
        let width = quantile(all().map(|o| 50.0 * o.width(q)).collect(), 0.5);
        println!("| {quantity} | {} | {error:.2} | {width:.2} |", of_q(q));
    }
    print_scene(&found);
}

/// Six media of rutile spheres.
#[test]
#[ignore = "long form"]
fn spheres_of_a_pigment_are_absorbed() {
    for name in ["tio2", "carbon"] {
        let table = farm_tests::reference::phase_table(name).unwrap();
        let g = table.mean_cosine();
        let set_up = ChangedSetUp::none(6).with_phases(vec![PhaseShape::Table(Arc::new(table)); 6]);
        let found = SetUpSession::of_row_at(set_up, g).measured(dictionary(Nodes::Paper, true));
        print_rows(name, &found);
    }
}
