//! Tests uncertain quantities of the scene on a dictionary from a formula whose responses are known.

use optics_model::fit::SceneEstimate;

use super::*;
use crate::surrogate::Surrogate;
use crate::testing::{change, uncertain_dictionary};

/// Channel G at both thicknesses with 0.3 % of noise; the gel's quantity differs between the slabs.
fn measured(gel: [f64; 2], ring: f64, seed: u64) -> Measurement {
    let (s, a, g) = MEDIUM;
    let profile = |slab: usize, thickness: f64| {
        let exact = |x| profile_value(x, s, a, g, thickness, 1.0) + change(x, a, g, [gel[slab], ring]);
        noisy_profile(("G", thickness, 120), exact, |v| 0.003 * v, (seed * 2 + slab as u64) * 120)
    };
    Measurement::new("m", vec![profile(0, 0.5), profile(1, 1.0)]).unwrap()
}

fn scene_of(found: &Refined) -> &[SceneEstimate] {
    &found.likelihood.scene
}

/// Between the nodes responses are interpolated to 1 % of the effect of one standard deviation.
#[test]
fn responses_are_interpolated_between_nodes() {
    let dictionary = uncertain_dictionary(2);
    let surrogate = Surrogate::new(&dictionary, 1, 0);
    let medium = Medium::new(MEDIUM.0, MEDIUM.1, MEDIUM.2).unwrap();
    let near = Medium::new(1.01 * MEDIUM.0, MEDIUM.1 - 0.005, MEDIUM.2 + 0.01).unwrap();
    let local = surrogate.responses(0.5, coordinates(&medium)).unwrap();
    for quantities in [[1.0, 0.0], [0.0, 1.0], [-0.5, 0.0], [2.3, -1.7]] {
        let found = local.change(&[], &[], 0.5, coordinates(&near), &quantities);
        for (i, value) in found.values.iter().enumerate() {
            let x = dictionary.grid().scene().sensor().centre_mm(i);
            let expected = change(x, near.albedo(), near.g(), quantities);
            assert!((value - expected).abs() < 2e-4, "{quantities:?} {x}: {value} {expected}");
        }
        // Derivatives by the quantities, against differences.
        for k in 0..2 {
            let moved = |by: f64| {
                let mut there = quantities;
                there[k] += by;
                local.change(&[], &[], 0.5, coordinates(&near), &there).values
            };
            let (up, down) = (moved(1e-4), moved(-1e-4));
            for (i, slope) in found.by_quantity[k].iter().enumerate() {
                assert!((slope - (up[i] - down[i]) / 2e-4).abs() < 1e-8, "{k} {i}");
            }
        }
    }
}

/// The quantities are estimated together with the medium: the gel of each slab, the ring of the session. With an exact
/// scene the medium or the misfit is wrong.
#[test]
fn scene_is_estimated_with_the_medium() {
    let [uncertain, exact] = [2, 0].map(uncertain_dictionary);
    let with_g = FitSettings { g: Bounds::fixed(MEDIUM.2), ..settings() };
    let off = |found: f64, truth: f64, ends: &Interval| 2.0 * (found - truth).abs() / (ends.high - ends.low);
    for (seed, gel, ring) in [(1, [0.0, 0.0], 0.0), (2, [1.4, -0.2], 1.2), (3, [-0.1, 2.1], -1.5)] {
        let measured = measured(gel, ring, seed);
        let found = refined_with(&uncertain, &measured, with_g);
        let medium = found.best.medium;
        assert!(off(medium.sigma_t_per_mm(), MEDIUM.0, &found.sigma_t_per_mm) < 1.8, "{seed}: {medium:?}");
        assert!(off(medium.albedo(), MEDIUM.1, &found.albedo) < 1.8, "{seed}: {medium:?}");
        let named: Vec<_> = scene_of(&found).iter().map(|e| (e.quantity.as_str(), e.slab_mm)).collect();
        assert_eq!(named, [("gel thickness", Some(0.5)), ("gel thickness", Some(1.0)), ("ring angle", None)]);
        let truths = [0.02 + 0.02 * gel[0], 0.02 + 0.02 * gel[1], 45.0 + ring];
        for (estimate, truth) in scene_of(&found).iter().zip(truths) {
            assert!(
                (estimate.value - truth).abs() < 3.5 * estimate.std_error,
                "{seed}: {estimate:?} {truth}"
            );
            assert!(estimate.std_error < estimate.prior_std_error && !estimate.at_end, "{estimate:?}");
        }
        let shares = &found.likelihood.budget;
        assert!(shares.iter().any(|s| s.quantity.as_deref() == Some("gel thickness")), "{shares:?}");
        let wrong = refined_with(&exact, &measured, with_g);
        assert!(scene_of(&wrong).is_empty());
        let bad = off(wrong.best.medium.sigma_t_per_mm(), MEDIUM.0, &wrong.sigma_t_per_mm);
        assert!(seed == 1 || bad > 2.0 || wrong.misfit > 1.5, "{seed}: {bad} {}", wrong.misfit);
    }
}

/// Where the truth lies beyond the range of the responses, the estimate stops at its end and is marked.
#[test]
fn estimates_end_with_the_responses() {
    let measured = measured([6.0, 0.0], 0.0, 4);
    let found = refined_with(&uncertain_dictionary(2), &measured, settings());
    let gel = &scene_of(&found)[0];
    assert!(gel.at_end && gel.is_conflict(), "{gel:?}");
    assert!((gel.value - (0.02 + 0.088)).abs() < 1e-9, "{gel:?}");
}
