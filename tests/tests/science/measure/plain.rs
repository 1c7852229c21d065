//! The plain `farmctl measure`, with photographs as the only input.
//!
//! Sets of three materials with three channels each, all off the grid. Neither μ nor g is given: both are estimated for
//! the set, and their uncertainty is in every interval. With `FARM_TEST_EFFORT=8`, 25 sets: g = 0, 0.2, 0.4, 0.7, 0.8,
//! five of each, with the paper's whole dictionary.

use farm_tests::coverage::{Answer, Coverage, Estimate, QUANTITIES, table};
use farm_tests::statistics::{Normal, effort};
use optics_fit::{Measured, measure};
use optics_model::fit::FitOptions;
use optics_model::{Measurement, Medium};

use super::{NOISE, SLABS_MM, dictionary, materials, photograph, print_common, unknown_factor};

fn measured(materials: &[Measurement]) -> Measured {
    measure(dictionary(), materials, &FitOptions::default(), &unknown_factor()).unwrap()
}

/// Largest geometric means of the errors of σ_t, 1 − α, σ_s(1 − g), σ_a. Half of the media are bright, with errors of σ_a
/// many times those of the others: the place of a median between the two is random.
const ERRORS: [f64; 4] = [0.02, 0.04, 0.02, 0.05];

/// The g and μ of a set: their uncertainty is part of every interval.
#[test]
fn common_parameters_are_near_the_truth() {
    let long = effort() >= 8;
    let anisotropies: &[f64] = if long { &[0.0, 0.2, 0.4, 0.7, 0.8] } else { &[0.4] };
    let (sets, walks) = if long { (5, 4_000_000) } else { (2, 1_000_000) };
    let (mut sessions, mut held) = (Vec::new(), [0, 0]);
    for (n, g) in (0..).zip(anisotropies) {
        for seed in (0..sets).map(|k| 10 * n + k) {
            let mut random = Normal::new(31_000 + seed);
            let media: [[Medium; 3]; 3] = [(); 3].map(|()| [(); 3].map(|()| random.medium(*g)));
            let slabs = materials(["m0", "m1", "m2"].into_iter().zip(media), 5_000 + seed * 100, walks, 1.0);
            let found = measured(&slabs);
            print!("g {g}: ");
            print_common(&found.common);
            held[0] += usize::from(found.common.g_interval.unwrap().contains(*g));
            held[1] += usize::from(found.common.mu_interval.contains(1.0));
            sessions.push(Answer::all(&found.materials, media.as_flattened()));
        }
    }
    println!("{} sets; of g and μ hold {held:?}", sessions.len());
    let estimates = |q: usize| Coverage::of_media(sessions.iter().map(Vec::as_slice), &[q]);
    let row = |q: usize| {
        let (found, name) = (estimates(q), QUANTITIES[q].to_owned());
        vec![
            name,
            format!("{:.4}", found.error(0.5)),
            format!("{:.4}", found.geometric_error()),
            found.hold().to_string(),
        ]
    };
    println!("{}", table("quantity | median error | geometric mean | hold %", (0..4).map(row)));
    // Fewer than 13 of 18 independent intervals of 95 % hold once in 10,000 times; but those of a set share the
    // estimated μ and g, so that a set may miss as a whole.
    let least = if long { 0.9 } else { 0.72 };
    for (q, most) in ERRORS.into_iter().enumerate() {
        let (found, name) = (estimates(q), QUANTITIES[q]);
        assert!(found.geometric_error() < most && found.hold().share >= least, "{name}: {}", found.hold());
    }
    assert!(held.iter().all(|held| held + 1 >= sessions.len() * 9 / 10), "{held:?}");
}

/// A single channel hardly determines μ: this is reported, and the intervals are wide, not wrong.
#[test]
fn undetermined_scale_factor_is_reported() {
    let truth = Medium::new(6.3, 0.9985, 0.4).unwrap();
    let profiles = SLABS_MM.map(|t| photograph(&truth, 0, t, 9_901, 1_000_000, 1.0, NOISE).0);
    let found = measured(&[Measurement::new("white", profiles.to_vec()).unwrap()]);
    print_common(&found.common);
    assert!(found.common.mu_interval.contains(1.0));
    let answer = &Answer::all(&found.materials, [&truth])[0];
    assert!(answer.medium[..2].iter().all(Estimate::holds), "{answer:?}");
}
