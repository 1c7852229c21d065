//! Tests the likelihood on a dictionary from a formula: exact cases, limits, and descents from many media.

mod budget;
mod formula;
mod scene;

use optics_model::descent::DescentEnd;
use optics_model::fit::{Bounds, FitOptions, FitSettings, Interval, Nuisance, Objective, Refined};
use optics_model::scene::{Channel, DARKER_WHITE, Scene, Sensor};
use optics_model::{Grid, MeasuredProfile, Measurement, Medium, ProfileSetup, Walks};

use crate::dictionary::FitDictionary;
use crate::fit;
use crate::likelihood::answer::Found;
use crate::likelihood::point::SHARED;
use crate::likelihood::problem::ChannelData;
use crate::likelihood::problem::assembly::{Assembly, Sharing, assemble};
use crate::likelihood::problem::channel::{self, ChannelMinimum};
use crate::likelihood::problem::start::Start;
use crate::likelihood::system::unknowns::inverse_over_free;
use crate::likelihood::system::{COARSE, FINE};
use crate::surrogate::coordinates;
use crate::testing::{
    changed, dense, dense_axes, dictionary_of, exact_record, exact_set_up, noisy_profile, noisy_records,
    profile_value, remade, rounded_dictionary_of,
};

const MEDIUM: (f64, f64, f64) = (3.1, 0.93, 0.33);

fn dictionary() -> &'static FitDictionary {
    dense(120, 0.0)
}

/// Errors of a profile.
#[derive(Clone, Copy, Default)]
struct Flaws {
    gain: f64,
    zero: f64,
    dust: bool,
}

/// Channel G at both thicknesses with 0.3 % of noise, as its standard errors state.
fn measured((sigma_t, albedo, g): (f64, f64, f64), seed: u64, flaws: Flaws) -> Measurement {
    let profile = |(slab, thickness): (u64, f64)| {
        let at = |x: f64| profile_value(x, sigma_t, albedo, g, thickness, 1.0);
        let exact = |x: f64| at(x) * (1.0 + flaws.gain) + flaws.zero;
        let clean =
            noisy_profile(("G", thickness, 120), exact, |v| 0.003 * v, (seed * 2 + slab) * 120 + 5_000_000);
        let speck = |x: f64| flaws.dust && (12.0 * (x + 5.0)) as usize % 17 == 5;
        changed(&clean, |x, v, error| (if speck(x) { 0.8 * v } else { v }, Some(error)))
    };
    Measurement::new("m", vec![profile((0, 0.5)), profile((1, 1.0))]).unwrap()
}

fn settings() -> FitSettings {
    // The formula is no physics: its lengths do not scale with the thickness, and nothing blurs it.
    let (objective, refine) = (Some(Objective::Likelihood), true);
    FitSettings {
        objective,
        thickness_std_error_mm: 0.0,
        blur_std_error_mm: 0.0,
        refine,
        ..FitSettings::default()
    }
}

fn exact_settings() -> FitSettings {
    FitSettings { objective: Some(Objective::Likelihood), refine: true, ..exact_set_up() }
}

fn refined(measurement: &Measurement, settings: FitSettings) -> Refined {
    refined_with(dictionary(), measurement, settings)
}

fn refined_with(dictionary: &FitDictionary, measurement: &Measurement, settings: FitSettings) -> Refined {
    let found = fit(dictionary, measurement, &FitOptions::new(settings).unwrap()).unwrap();
    found.channels.into_iter().next().unwrap().refined.unwrap()
}

/// A large dictionary's rounding moves a medium, and half an interval, by less than 2 % of half an interval.
#[test]
fn rounded_values_give_the_exact_answer() {
    let (grid, record) = noisy_records(dense_axes(), 120, 0.003);
    let (exact, rounded) = (dictionary_of(&grid, &record), rounded_dictionary_of(&grid, &record));
    for (seed, medium) in [(1, MEDIUM), (2, (6.3, 0.45, 0.12))] {
        let measured = measured(medium, seed, Flaws::default());
        let [exact, rounded] = [&exact, &rounded].map(|d| refined_with(d, &measured, settings()));
        let half = |ends: &Interval| (ends.high - ends.low) / 2.0;
        let moved = |a: f64, b: f64, ends: &Interval| (a - b).abs() / half(ends);
        let (a, b) = (exact.best.medium, rounded.best.medium);
        let moves = [
            moved(a.sigma_t_per_mm(), b.sigma_t_per_mm(), &exact.sigma_t_per_mm),
            moved(a.albedo(), b.albedo(), &exact.albedo),
            moved(half(&exact.sigma_t_per_mm), half(&rounded.sigma_t_per_mm), &exact.sigma_t_per_mm),
        ];
        assert!(a != b && moves.iter().all(|moved| *moved < 0.02), "{moves:?}");
    }
}

/// A medium without absorption, in a dictionary whose greatest albedo is 0.99: where α is open, so is σ_a, and its
/// interval contains 0.
#[test]
fn absorption_is_open_where_the_dictionary_ends() {
    for seed in 1..=3 {
        let measured = measured((3.1, 1.0, 0.33), seed, Flaws::default());
        let found = refined(&measured, FitSettings { g: Bounds::fixed(0.33), ..settings() });
        assert!(found.albedo.open_high && found.absorption_per_mm.open_low, "{found:?}");
        assert!(found.absorption_per_mm.contains(0.0));
    }
    let inside =
        refined(&measured(MEDIUM, 1, Flaws::default()), FitSettings { g: Bounds::fixed(0.33), ..settings() });
    assert!(!inside.absorption_per_mm.open_low && inside.absorption_per_mm.low > 0.0, "{inside:?}");
}

/// Exact data have no noise at all: it is estimated.
#[test]
fn noise_of_exact_data_is_estimated() {
    let exact = remade(&measured(MEDIUM, 1, Flaws::default()), |p| changed(p, |_, v, _| (v, Some(0.0))));
    let options = FitOptions::new(FitSettings { objective: None, ..settings() }).unwrap();
    assert!(fit(dictionary(), &exact, &options).unwrap().channels[0].refined.is_some());
}

/// A quantity with a standard error of 0 is no nuisance, and a large standard error of the gain widens the interval.
#[test]
fn exactly_given_quantities_are_no_nuisances() {
    let exact = FitSettings { g: Bounds::fixed(0.33), ..exact_settings() };
    let measured = measured(MEDIUM, 2, Flaws::default());
    let sure = refined(&measured, exact);
    assert!(sure.likelihood.nuisances.is_empty());
    assert!(sure.sigma_t_per_mm.contains(MEDIUM.0));
    let loose = refined(&measured, FitSettings { gain_std_error: 0.05, ..exact });
    let width = |r: &Refined| r.albedo.high - r.albedo.low;
    assert!(width(&loose) > 3.0 * width(&sure), "{} {}", width(&loose), width(&sure));
}

/// No descent from any fifth medium of the dictionary ends lower than the chosen one.
#[test]
fn descent_finds_the_global_minimum() {
    let dictionary = dictionary();
    let options = FitOptions::new(settings()).unwrap();
    for (seed, medium) in [(4, MEDIUM), (5, (1.6, 0.35, 0.05)), (6, (6.4, 0.985, 0.55))] {
        let flaws = Flaws { gain: 0.002, zero: 0.001, ..Flaws::default() };
        let measurement = measured(medium, seed, flaws);
        let data = ChannelData::new(dictionary, &measurement, 0, "G", &options).unwrap();
        let surrogates = data.surrogates();
        let scan = data.scan(&surrogates, 0.0).unwrap();
        let starts = channel::starts(&scan, &surrogates);
        let chosen = channel::lowest(&data, &surrogates, &starts).state;
        let (grid, mut lowest) = (dictionary.grid(), f64::INFINITY);
        // Records of two thicknesses.
        for record in (0..grid.record_count()).step_by(10) {
            let start = Start { medium: coordinates(&grid.parameters(record).1), ior: 0, cost: 0.0 };
            lowest = channel::lowest(&data, &surrogates, &[start]).state.cost.min(lowest);
        }
        assert!(chosen.cost <= lowest + 1.0, "{medium:?}: {} against {lowest}", chosen.cost);
    }
}

/// Measurements for which there is no likelihood are refused with the field.
#[test]
fn unweighable_measurements_are_refused() {
    let good = measured(MEDIUM, 8, Flaws::default());
    let field = |change: &dyn Fn(&MeasuredProfile) -> MeasuredProfile| {
        let [chosen, given] = [None, Some(Objective::Likelihood)].map(|objective| {
            let options = FitOptions::new(FitSettings { objective, ..settings() }).unwrap();
            fit(dictionary(), &remade(&good, change), &options).unwrap_err().field().to_owned()
        });
        assert_eq!(chosen, given);
        given
    };
    let zero = |x: f64, v, e| (v, Some(if (12.0 * (x + 5.0)) as usize == 7 { 0.0 } else { e }));
    assert_eq!(field(&|p| changed(p, zero)), "std_errors[7]");
    let thicker = |p: &MeasuredProfile| {
        let (x, values, errors) =
            (p.x_mm().to_vec(), p.values().to_vec(), p.std_errors().map(<[f64]>::to_vec));
        MeasuredProfile::new("G", 4.0 * p.thickness_mm(), x, values, errors).unwrap()
    };
    assert_eq!(field(&thicker), "thickness_mm");
    let setup = ProfileSetup { origin_mm: Some(9.9), ..ProfileSetup::default() };
    assert_eq!(field(&|p| p.clone().with_setup(setup).unwrap()), "x_mm");
}

/// The response of a profile of the formula to a brighter white reference through ρ: light comes from the bright side
/// alone.
fn by_white(x: f64, value: f64) -> f64 {
    0.8 * value * 0.5 * (1.0 + libm::tanh(x / 0.6))
}

/// A dictionary of one channel and, with `knows_white`, of that channel under a darker white reference.
fn dictionary_with_white(knows_white: bool) -> FitDictionary {
    let names = ["G".to_owned(), Channel::darker_white("G")];
    let names = &names[..=usize::from(knows_white)];
    let channels = names.iter().map(|name| Channel::new(name, 0.9, 0.02).unwrap()).collect();
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, 120, 0.0).unwrap());
    let scene = scene.with_channels(channels).unwrap();
    let grid = Grid::new(scene, dense_axes(), Walks::PAPER, 1, false).unwrap();
    let at = |x: f64, m: &Medium, thickness: f64, channel: usize| {
        let value = profile_value(x, m.sigma_t_per_mm(), m.albedo(), m.g(), thickness, 1.0);
        value + channel as f64 * libm::log(DARKER_WHITE) * by_white(x, value)
    };
    dictionary_of(&grid, |index| exact_record(&grid, index, names.len(), at))
}

/// Every column is the derivative of the model, that by the scale with its part through ρ; blur, origin and gain are not
/// at their defaults.
#[test]
fn derivatives_match_the_model() {
    let (dictionary, measurement) = (dictionary_with_white(true), measured(MEDIUM, 3, Flaws::default()));
    let given = FitSettings { mu: 0.98, mu_std_error: 0.01, blur_mm: 0.08, ..settings() };
    let options = FitOptions::new(given).unwrap();
    let data = ChannelData::new(&dictionary, &measurement, 0, "G", &options).unwrap();
    let surrogates = data.surrogates();
    let medium = coordinates(&Medium::new(MEDIUM.0, MEDIUM.1, MEDIUM.2).unwrap());
    let (one, media) = (std::slice::from_ref(&data), [medium]);
    let (mut assembly, state) = assemble(one, &[&surrogates[0]], &media, 0.01, Sharing::default());
    assembly.system.terms[0].share_flaws(0.7);
    let term = &assembly.system.terms[0];
    let at = |moved: usize, by: f64| {
        let (mut point, mut own) = (assembly.system.point(0, &state.x), vec![0.3; term.own_count()]);
        if moved < SHARED {
            point.0[moved] += by;
        } else {
            own[moved - SHARED] += by;
        }
        term.linear(&surrogates[0], &point, &own)
    };
    let (step, here) = (1e-5, at(0, 0.0));
    for (i, column) in here.columns.iter().enumerate() {
        let (above, below) = (at(i, step), at(i, -step));
        let greatest = column.iter().fold(1.0, |most: f64, v| most.max(v.abs()));
        for (pixel, by) in column.iter().enumerate() {
            // Residuals fall as the model rises.
            let quotient = (below.residuals[pixel] - above.residuals[pixel]) / (2.0 * step);
            assert!((by - quotient).abs() < 2e-4 * greatest, "{i}, {pixel}: {by} {quotient}");
        }
    }
}

/// A descent to a thousandth of the tolerance moves no estimate by more than 1 % of its standard error, also at the end of
/// the dictionary and in the valley of σ_t and g.
#[test]
fn estimates_do_not_depend_on_the_tolerance() {
    let dictionary = dictionary();
    for (seed, (medium, g)) in [
        (MEDIUM, Bounds::fixed(0.33)),
        (MEDIUM, Bounds::FREE),
        ((3.1, 1.0, 0.33), Bounds::FREE),
        ((1.2, 0.45, 0.12), Bounds::FREE),
    ]
    .into_iter()
    .enumerate()
    {
        let measurement = measured(medium, seed as u64, Flaws { dust: seed == 0, ..Flaws::default() });
        let options = FitOptions::new(FitSettings { g, ..settings() }).unwrap();
        let data = ChannelData::new(dictionary, &measurement, 0, "G", &options).unwrap();
        let surrogates = data.surrogates();
        let scan = data.scan(&surrogates, 0.0).unwrap();
        let ChannelMinimum { system, state, .. } = channel::minimum(&data, &surrogates, &scan);
        let linear = system.linear(&state.x, &state.own);
        let normal = system.normal(&state.x, &state.own, &linear);
        let covariance = inverse_over_free(&system.unknowns, &normal.information, 1e-9).unwrap();
        let further = system.descend(state.clone(), None, 1e-3 * FINE);
        for i in system.free() {
            let moved = (further.x[i] - state.x[i]).abs() / covariance[(i, i)].sqrt();
            assert!(moved < 0.01, "{medium:?}: unknown {i} moves by {moved} standard errors");
        }
    }
}

/// A descent with too few steps is marked as such, and its medium counts as undetermined; one with enough is not.
#[test]
fn unfinished_descents_are_marked() {
    let measurement = measured(MEDIUM, 3, Flaws::default());
    let options = FitOptions::new(FitSettings { g: Bounds::fixed(MEDIUM.2), ..settings() }).unwrap();
    let data = ChannelData::new(dictionary(), &measurement, 0, "G", &options).unwrap();
    let surrogates = data.surrogates();
    let medium = coordinates(&Medium::new(MEDIUM.0, MEDIUM.1, MEDIUM.2).unwrap());
    let refined = |most_steps: Option<usize>| {
        let (one, media) = (std::slice::from_ref(&data), [medium]);
        let (Assembly { mut system, .. }, state) =
            assemble(one, &[&surrogates[0]], &media, 0.0, Sharing::default());
        system.most_steps = most_steps.unwrap_or(system.most_steps);
        let state = system.approach(state, COARSE);
        let state = system.settle(state);
        let found = Found { data: &data, system: &system, state: &state, sample_ior: 1.5, common_g: None };
        found.refined()
    };
    let (whole, short) = (refined(None), refined(Some(0)));
    assert!(whole.descent.is_minimum() && whole.resolved, "{:?}", whole.descent);
    assert_eq!(short.descent, DescentEnd::OutOfSteps);
    assert!(!short.resolved && !short.resolved_at_g);
}

/// The reference is stated 1.5 % too bright: levels are too high, and so is the dictionary's ρ.
#[test]
fn white_reference_errors_propagate_to_reflectance() {
    let error = 0.015;
    let spoilt = remade(&measured(MEDIUM, 3, Flaws::default()), |p| {
        let (sigma_t, albedo, g) = MEDIUM;
        let at = |x: f64| by_white(x, profile_value(x, sigma_t, albedo, g, p.thickness_mm(), 1.0));
        changed(p, |x, v, e| ((1.0 + error) * (v - error * at(x)), Some(e)))
    });
    // No other nuisance can take its place.
    let told = FitSettings { mu_std_error: 0.01, g: Bounds::fixed(MEDIUM.2), ..exact_settings() };
    let [knowing, ignorant] =
        [true, false].map(|knows_white| refined_with(&dictionary_with_white(knows_white), &spoilt, told));
    assert!(knowing.misfit < 1.3 && knowing.sigma_t_per_mm.contains(MEDIUM.0), "{knowing:?}");
    assert!(knowing.albedo.contains(MEDIUM.1), "{knowing:?}");
    let nuisances = &knowing.likelihood.nuisances;
    let scale = nuisances.iter().find(|n| n.nuisance == Nuisance::Scale).unwrap();
    assert!((scale.value - (1.0 + error)).abs() < 3.0 * scale.std_error, "{scale:?}");
    assert!(scale.std_error < 0.005, "{scale:?}");
    assert!(ignorant.misfit > 1.3 || !ignorant.sigma_t_per_mm.contains(MEDIUM.0), "{ignorant:?}");
}
