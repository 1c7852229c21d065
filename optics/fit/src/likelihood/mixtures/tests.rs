//! Tests inks from mixtures, with a dictionary from a formula and noise of the pixels alone.

use optics_model::fit::{Bounds, FitOptions, FitSettings, Interval, Mixture, Mixtures, Unmixed};
use optics_model::{Invalid, Measurement};

use crate::testing::{dense, noisy_profile, profile_value};
use crate::{measure, unmix};
use optics_model::fit::MeasurePlan;

const G: f64 = 0.3;
/// σ_s and σ_a of the inks. The last one's σ_t lies beyond the dictionary's.
const INKS: [(&str, [f64; 2]); 3] = [("white", [3.0, 0.06]), ("grey", [1.2, 1.4]), ("black", [4.0, 9.0])];

/// A slab of inks in these volume fractions, in channel G, with 1 % of noise.
fn slabs(material: &str, parts: &[(&str, f64)], seed: u64) -> Measurement {
    let coefficients = |ink: &str| INKS.iter().find(|(name, _)| *name == ink).unwrap().1;
    let sum = |which: usize| parts.iter().map(|(ink, f)| f * coefficients(ink)[which]).sum::<f64>();
    let sigma_t = sum(0) + sum(1);
    let profile = |(k, thickness): (u64, f64)| {
        let exact = |x| profile_value(x, sigma_t, sum(0) / sigma_t, G, thickness, 1.0);
        noisy_profile(("G", thickness, 180), exact, |v| 0.01 * v, (seed * 2 + k) * 180 + 5_000_000)
    };
    Measurement::new(material, vec![profile((0, 0.5)), profile((1, 1.0))]).unwrap()
}

/// Name, stated fractions, and true ones.
type Recipe<'a> = (&'a str, &'a [(&'a str, f64)], &'a [(&'a str, f64)]);

fn unmixed(recipes: &[Recipe], seed: u64) -> Result<Unmixed, Invalid> {
    let dictionary = dense(180, 0.0);
    let settings = FitSettings { g: Bounds::fixed(G), ..FitSettings::default() };
    let options = FitOptions::new(settings).unwrap();
    let plan = MeasurePlan { search_mu: None, ..MeasurePlan::default() };
    let photographed = |(i, (name, _, truth)): (usize, &Recipe)| slabs(name, truth, 100 * seed + i as u64);
    let materials: Vec<Measurement> = recipes.iter().enumerate().map(photographed).collect();
    let several = recipes.iter().filter(|(_, told, _)| told.len() > 1);
    let mixture = |(name, told, _): &Recipe| {
        Mixture::new(*name, told.iter().map(|(ink, f)| ((*ink).to_owned(), *f))).unwrap()
    };
    let mixtures = Mixtures::new(several.map(mixture).collect()).unwrap();
    let measured = measure(dictionary, &materials, &options, &plan).unwrap();
    unmix(dictionary, &materials, &mixtures, &measured, &options, &plan)
}

const WHITE: Recipe = ("white", &[("white", 1.0)], &[("white", 1.0)]);
const GREY: Recipe = ("grey", &[("grey", 1.0)], &[("grey", 1.0)]);
const BLACK: Recipe = ("black", &[("black", 1.0)], &[("black", 1.0)]);
const HALF: &[(&str, f64)] = &[("white", 0.5), ("grey", 0.5)];
const LIGHT: &[(&str, f64)] = &[("white", 0.8), ("black", 0.2)];

/// σ_t, α, σ_s (1 − g) and σ_a, found and true, of every ink.
fn against_truth(found: &Unmixed) -> Vec<(String, Interval, f64)> {
    let quantities = |(name, [s, a]): &(&str, [f64; 2])| {
        let ink = found.inks.iter().find(|i| i.material == *name)?;
        let c = &ink.channels[0];
        let named = |what: &str, interval, truth| (format!("{name} {what}"), interval, truth);
        Some([
            named("sigma_t", c.sigma_t_per_mm, s + a),
            named("albedo", c.albedo, s / (s + a)),
            named("reduced", c.reduced_scattering_per_mm, s * (1.0 - G)),
            named("absorption", c.absorption_per_mm, *a),
        ])
    };
    INKS.iter().filter_map(quantities).flatten().collect()
}

/// The intervals of inks contain the truth as often as they should.
#[test]
fn ink_intervals_cover_the_truth_as_claimed() {
    let (mut held, mut count) = (0, 0);
    for seed in 0..25 {
        let found = unmixed(&[WHITE, GREY, ("half", HALF, HALF), ("light", LIGHT, LIGHT)], seed).unwrap();
        for (_, interval, truth) in against_truth(&found) {
            held += u32::from(interval.contains(truth));
            count += 1;
        }
    }
    // 300 intervals of 95 %, some two in three of them independent: 285 ± 5.
    assert!((270..=298).contains(&held), "{held} of {count}");
}

/// An ink that was never measured pure is found from its mixtures with white.
#[test]
fn unmeasured_ink_is_found_from_its_mixtures() {
    let found = unmixed(&[WHITE, ("light", LIGHT, LIGHT)], 1).unwrap();
    let black = &found.inks[1].channels[0];
    assert!(found.inks[1].material == "black" && black.from_mixtures && black.resolved, "{black:?}");
    assert!(!found.inks[0].channels[0].from_mixtures);
    for (what, interval, truth) in against_truth(&found) {
        assert!(interval.contains(truth), "{what}: {interval:?} misses {truth}");
    }
    let told = found.mixtures.iter().map(|m| m.agreement.unwrap().pull);
    assert!(told.fold(0.0, f64::max) < 2.0, "{:?}", found.mixtures);
}

/// Slabs beyond the dictionary are left out, and the answer gives the reason.
#[test]
fn slabs_beyond_the_dictionary_are_excluded() {
    let found = unmixed(&[WHITE, BLACK, ("light", LIGHT, LIGHT)], 2).unwrap();
    let black = found.mixtures.iter().find(|m| m.material == "black").unwrap();
    let why = black.left_out.as_ref().unwrap();
    assert!(
        black.agreement.is_none() && why.contains("sigma_t_per_mm = ") && why.contains("submit"),
        "{why}"
    );
    for (what, interval, truth) in against_truth(&found) {
        assert!(interval.contains(truth), "{what}: {interval:?} misses {truth}");
    }
}

#[test]
fn wrong_fraction_shows_and_widens_intervals() {
    let wrong: Recipe = ("half", HALF, &[("white", 0.65), ("grey", 0.35)]);
    let good = unmixed(&[WHITE, GREY, ("half", HALF, HALF)], 3).unwrap();
    let bad = unmixed(&[WHITE, GREY, wrong], 3).unwrap();
    let pull = |found: &Unmixed| found.mixtures.iter().map(|m| m.agreement.unwrap().pull).fold(0.0, f64::max);
    assert!(pull(&good) < 2.5 && pull(&bad) > 5.0, "{} {}", pull(&good), pull(&bad));
    let width = |found: &Unmixed| {
        let i = &found.inks[1].channels[0].sigma_t_per_mm;
        i.high - i.low
    };
    assert!(width(&bad) > 2.0 * width(&good), "{} {}", width(&bad), width(&good));
}

/// Mixtures that do not separate their inks are refused.
#[test]
fn inseparable_mixtures_are_refused() {
    let error = unmixed(&[("half", HALF, HALF)], 4).unwrap_err();
    assert!(error.to_string().contains("distinguish only 1 of white, grey"), "{error}");
    let error = unmixed(&[WHITE, ("half", HALF, HALF), ("light", LIGHT, LIGHT), BLACK], 4);
    assert!(error.is_ok(), "{error:?}");
}
