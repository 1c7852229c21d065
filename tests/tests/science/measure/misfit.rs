//! Faulty photographs cause a misfit, which is reported with its most likely cause.

use std::sync::OnceLock;

use optics_fit::fit;
use optics_model::fit::{Bounds, Cause, FitOptions, FitSettings, MISFIT, Nuisance, Refined};
use optics_model::{MeasuredProfile, Measurement, Medium};

use super::{SLABS_MM, dictionary, photograph};

/// Maps x in mm, value, thickness and the profile itself to the value that is photographed.
type Spoil = fn(f64, f64, f64, &dyn Fn(f64) -> f64) -> f64;

/// The photographs without faults, traced once.
fn clean(thickness_mm: f64) -> &'static MeasuredProfile {
    static CLEAN: OnceLock<[MeasuredProfile; 2]> = OnceLock::new();
    let clean = CLEAN.get_or_init(|| {
        let truth = Medium::new(4.3, 0.965, 0.4).unwrap();
        SLABS_MM.map(|t| photograph(&truth, 1, t, 9_500, 4_000_000, 1.0, 0.004).0)
    });
    &clean[usize::from(thickness_mm > 0.75)]
}

fn found(spoil: Spoil, swap: bool) -> Refined {
    let profile = |thickness_mm: f64| {
        let clean = clean(thickness_mm);
        let (x, values) = (clean.x_mm().to_vec(), clean.values());
        let pitch = clean.pitch_mm();
        let at = |x_mm: f64| {
            let place = ((x_mm - x[0]) / pitch).clamp(0.0, (x.len() - 1) as f64);
            let below = (place as usize).min(x.len() - 2);
            values[below] + (place - below as f64) * (values[below + 1] - values[below])
        };
        let spoilt = x.iter().zip(values).map(|(x, v)| spoil(*x, *v, thickness_mm, &at)).collect();
        let errors = clean.std_errors().unwrap().to_vec();
        let stated_mm = if swap { 1.5 - thickness_mm } else { thickness_mm };
        MeasuredProfile::new("G", stated_mm, x.clone(), spoilt, Some(errors)).unwrap()
    };
    let measurement = Measurement::new("m", vec![profile(0.5), profile(1.0)]).unwrap();
    let settings = FitSettings { g: Bounds::fixed(0.4), refine: true, ..FitSettings::default() };
    let fit = fit(dictionary(), &measurement, &FitOptions::new(settings).unwrap()).unwrap();
    fit.channels[0].refined.clone().unwrap()
}

/// Spoilt photographs are reported with the most likely reason; where no nuisance explains them, there is a misfit. An
/// exposure that differs between two slabs is not among them: another medium explains it.
#[test]
fn spoilt_photographs_get_the_likeliest_reason() {
    let cases: [(&str, Spoil, bool, Cause); 4] = [
        ("edge 0.3 mm off", |x, _, _, at| at(x - 0.3), false, Cause::EdgeOffset),
        ("light rises by 5 % to the edge", |x, v, _, _| v * (1.0 + 0.05 * x / 5.0), false, Cause::Slope),
        ("sRGB", |_, v, _, _| 1.055 * libm::pow(v, 1.0 / 2.4) - 0.055, false, Cause::GammaCoded),
        ("thicknesses exchanged", |_, v, _, _| v, true, Cause::ThicknessesSwapped),
    ];
    for (what, spoil, swap, cause) in cases {
        let r = found(spoil, swap);
        println!("{what}: misfit {:.2}, {:?}", r.misfit, r.suspicion);
        assert_eq!(r.suspicion.map(|s| s.cause), Some(cause), "{what}");
        if matches!(cause, Cause::GammaCoded | Cause::ThicknessesSwapped) {
            let likelihood = &r.likelihood;
            assert!(r.misfit > MISFIT && likelihood.probability < 1e-6, "{r:?}");
            assert!(!likelihood.stretches.is_empty());
        }
    }
}

fn estimate(r: &Refined, nuisance: Nuisance, profile_mm: f64) -> (f64, f64) {
    let all = &r.likelihood.nuisances;
    let found = all.iter().find(|n| n.nuisance == nuisance && n.profile_mm == Some(profile_mm)).unwrap();
    (found.value, found.std_error)
}

/// Dust, and shifts within the uncertainty of the edge, are estimated, and the intervals hold the medium.
#[test]
fn likelihood_corrects_shifts_and_dust() {
    let clean = found(|_, v, _, _| v, false);
    let shifted = found(|x, _, _, at| at(x - 0.1), false);
    let dusty = |x: f64, v: f64, _: f64, _: &dyn Fn(f64) -> f64| {
        if (x * 36.0).floor().rem_euclid(23.0) < 1.0 { 0.7 * v } else { v }
    };
    let dusty = found(dusty, false);
    for r in [&clean, &shifted, &dusty] {
        let likelihood = &r.likelihood;
        assert!(r.misfit < 1.2 && likelihood.probability > 1e-3 && r.suspicion.is_none(), "{r:?}");
        assert!(r.sigma_t_per_mm.contains(4.3) && r.albedo.contains(0.965), "{r:?}");
    }
    for profile_mm in [0.5, 1.0] {
        let (origin, std_error) = estimate(&shifted, Nuisance::Origin, profile_mm);
        // With a wedge of unknown size an edge is known to 6 µm.
        assert!((origin - 0.1).abs() < 4.0 * std_error && std_error < 0.006, "{origin} ± {std_error}");
    }
    assert!(clean.likelihood.outliers.is_empty());
    let left_out = dusty.likelihood.outliers.len();
    // For some of the 32 specks, neighbouring pixels are left out too.
    assert!((30..=80).contains(&left_out), "{left_out} pixels for 32 specks of dust");
}
