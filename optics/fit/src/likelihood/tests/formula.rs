//! Tests intervals on a dictionary that is computed from a formula.

use optics_model::fit::{Bounds, ChannelFit, FitOptions, FitSettings, Objective, Refined};

use crate::testing::{
    changed, coarse_axes, dense, noisy_dictionary, noisy_measurement, normal, profile_value, remade,
};
use crate::{FitDictionary, fit};

fn options(g: Option<f64>) -> FitOptions {
    let g = g.map_or(Bounds::FREE, Bounds::fixed);
    FitOptions::new(FitSettings {
        objective: Some(Objective::Likelihood),
        g,
        refine: true,
        gain_std_error: 0.0,
        offset_std_error: 0.0,
        ..FitSettings::default()
    })
    .unwrap()
}

fn answer(dictionary: &FitDictionary, medium: (f64, f64, f64), seed: u64, g: Option<f64>) -> ChannelFit {
    fit(dictionary, &noisy_measurement(medium, seed, true), &options(g)).unwrap().channels.remove(0)
}

fn refined(dictionary: &FitDictionary, medium: (f64, f64, f64), seed: u64, g: Option<f64>) -> Refined {
    answer(dictionary, medium, seed, g).refined.unwrap()
}

/// A medium within the dense grid that is hardly ever on a node.
fn medium(seed: u64) -> (f64, f64, f64) {
    let unit = |n: u64| (normal(seed * 3 + n) * 0.3).clamp(-1.0, 1.0);
    (3.5 * libm::exp(0.5 * unit(0)), 0.65 + 0.25 * unit(1), 0.3)
}

/// 60 media, noise of 1 % in the measurement's pixels and of 1 % in the records' levels. Of 60 intervals of 95 % at least
/// 51 must contain the truth (the binomial probability of fewer is 0.3 %), and the errors must be well below the grid's.
#[test]
fn intervals_cover_the_truth_as_claimed() {
    let dictionary = dense(360, 0.01);
    let (mut sigma_t_held, mut albedo_held, mut better) = (0, 0, 0);
    let mut widths = Vec::new();
    for seed in 0..60 {
        let (sigma_t, albedo, g) = medium(seed);
        let answer = answer(dictionary, (sigma_t, albedo, g), seed, Some(g));
        let (r, grid) = (answer.refined.unwrap(), answer.candidates[0].medium);
        sigma_t_held += u32::from(r.sigma_t_per_mm.contains(sigma_t));
        albedo_held += u32::from(r.albedo.contains(albedo));
        let off = |v: f64| libm::log(v / sigma_t).abs();
        better += u32::from(off(r.best.medium.sigma_t_per_mm()) < off(grid.sigma_t_per_mm()));
        widths.push(r.sigma_t_per_mm.high / r.sigma_t_per_mm.low - 1.0);
        assert!(r.resolved && !r.valley && r.misfit < 2.0, "{r:?}");
        assert_eq!((r.g.low, r.g.high), (g, g));
    }
    widths.sort_by(f64::total_cmp);
    assert!(sigma_t_held >= 51 && albedo_held >= 51, "{sigma_t_held} {albedo_held} of 60");
    assert!(better >= 50, "{better} of 60");
    // Intervals must not be useless either: the grid's steps are 12 %.
    assert!(widths[30] < 0.06, "{}", widths[30]);
}

/// The formula depends on σ_t and g through σ_t (1 − g) alone: a valley without end. σ_s(1 − g), which is invariant under
/// similarity, is determined nevertheless: at least 17 of 20 intervals of 95 % contain the truth (the binomial
/// probability of fewer is 1.6 %).
#[test]
fn extinction_anisotropy_valley_is_reported() {
    let dictionary = dense(360, 0.003);
    let mut held = 0;
    for seed in 0..20 {
        let (sigma_t, albedo, g) = medium(seed);
        let r = refined(dictionary, (sigma_t, albedo, g), seed, None);
        assert!(r.valley && r.resolved_at_g, "{r:?}");
        let ends = &r.sigma_t_per_mm;
        let narrow = ends.high <= 2.0 * ends.low && !ends.open_low && !ends.open_high;
        assert_eq!(r.resolved, narrow, "{r:?}");
        assert!(r.correlation < -0.9, "{}", r.correlation);
        assert!(r.g.high - r.g.low > 0.4, "{:?}", r.g);
        assert!(r.sigma_t_per_mm.contains(sigma_t) && r.sigma_t_per_mm.high > 1.5 * r.sigma_t_per_mm.low);
        let reduced = r.reduced_scattering_per_mm;
        held += u32::from(reduced.contains(albedo * sigma_t * (1.0 - g)));
        assert!(reduced.high < 1.2 * reduced.low, "{reduced:?}");
    }
    assert!(held >= 17, "{held} of 20");
}

/// Where the profile no longer depends on σ_t, the data give a bound on one side at best.
#[test]
fn flat_profile_is_unresolved() {
    let flat = remade(&noisy_measurement((3.0, 0.5, 0.3), 1, true), |p| {
        let level = profile_value(-5.0, 3.0, 0.5, 0.3, 1.0, 1.0);
        let value = |x: f64| level * (1.0 + 0.3 * normal((36.0 * (x + 5.0)) as u64));
        changed(p, |x, _, _| (value(x), Some(0.05)))
    });
    let r = fit(dense(360, 0.003), &flat, &options(Some(0.3))).unwrap().channels.remove(0).refined.unwrap();
    assert!(!r.resolved, "{r:?}");
    let ends = r.sigma_t_per_mm;
    assert!(ends.open_low || ends.open_high || ends.high > 2.0 * ends.low, "{ends:?}");
}

/// Noise is estimated where no standard errors are given.
#[test]
fn missing_noise_is_estimated() {
    let dictionary = dense(360, 0.003);
    let m = (3.1, 0.62, 0.3);
    let told = refined(dictionary, m, 7, Some(0.3));
    let silent = fit(dictionary, &noisy_measurement(m, 7, false), &options(Some(0.3))).unwrap();
    let silent = silent.channels[0].refined.clone().unwrap();
    assert!(silent.sigma_t_per_mm.contains(told.best.medium.sigma_t_per_mm()), "{silent:?}");
    let ratio = silent.measurement_noise / told.measurement_noise;
    // 360 pixels determine a standard deviation to 6 %; one number represents a noise that is a share of the value.
    assert!((0.75..1.25).contains(&ratio), "{ratio}");
    let width = |r: &Refined| libm::log(r.sigma_t_per_mm.high / r.sigma_t_per_mm.low);
    assert!((0.7..1.4).contains(&(width(&silent) / width(&told))));
}

/// The bounds of parameters also hold between the nodes.
#[test]
fn bounds_hold_between_nodes() {
    let dictionary = dense(360, 0.003);
    let measured = noisy_measurement((3.1, 0.62, 0.3), 7, true);
    let mut settings = *options(Some(0.27)).settings();
    settings.sigma_t_per_mm = Bounds::new("sigma_t_per_mm", Some(3.3), None).unwrap();
    let found = fit(dictionary, &measured, &FitOptions::new(settings).unwrap()).unwrap();
    let r = found.channels[0].refined.as_ref().unwrap();
    assert!((r.best.medium.g() - 0.27).abs() < 1e-12);
    assert!(r.best.medium.sigma_t_per_mm() >= 3.3 - 1e-12, "{r:?}");
    assert!(r.sigma_t_per_mm.open_low, "{r:?}");
}

/// Axes too short for local fits are interpolated; the only medium of a dictionary is held.
#[test]
fn short_axes_are_interpolated_or_held() {
    let dictionary = noisy_dictionary(coarse_axes(), 360, 0.0);
    let found = refined(&dictionary, (3.0, 0.7, 0.4), 1, Some(0.4));
    assert!((found.best.medium.albedo() - 0.7).abs() < 0.02, "{found:?}");
    assert!((found.best.medium.sigma_t_per_mm() - 3.0).abs() < 0.4, "{found:?}");
    let mut axes = coarse_axes();
    (axes.sigma_t_per_mm, axes.albedo, axes.g) = (vec![4.0], vec![0.6], vec![0.4]);
    let alone = refined(&noisy_dictionary(axes, 360, 0.0), (3.0, 0.7, 0.4), 1, None);
    assert_eq!(alone.best.medium, optics_model::Medium::new(4.0, 0.6, 0.4).unwrap());
}
