use optics_model::fit::{FitOptions, FitSettings, MuRange, Objective};
use optics_model::{MeasuredProfile, Measurement};

use crate::measure;
use crate::testing::{dense_axes, noisy_dictionary, normal, profile_value};
use optics_model::fit::{MeasurePlan, Measured};

/// Standard deviation of one pixel.
const NOISE: f64 = 0.002;

/// Channels R, G and B of slabs of these thicknesses, with noise as stated. Each channel prefers a g of its own.
fn measured(thicknesses_mm: [f64; 2]) -> Measurement {
    let x: Vec<f64> = (0..120).map(|i| (f64::from(i) + 0.5) / 12.0 - 5.0).collect();
    let profile = |(i, name): (usize, &str), thickness_mm: f64| {
        let (sigma_t, albedo, g) = [(2.2, 0.91, 0.27), (3.1, 0.93, 0.33), (4.4, 0.95, 0.39)][i];
        let exact: Vec<f64> =
            x.iter().map(|x| profile_value(*x, sigma_t, albedo, g, thickness_mm, i as f64)).collect();
        let seed = (2 * i) as u64 + u64::from(thickness_mm > 0.75);
        let noise = |(k, v): (usize, &f64)| v + NOISE * normal(seed * 120 + k as u64);
        let values = exact.iter().enumerate().map(noise).collect();
        let std_errors = vec![NOISE; x.len()];
        MeasuredProfile::new(name, thickness_mm, x.clone(), values, Some(std_errors)).unwrap()
    };
    let profiles = ["R", "G", "B"].into_iter().enumerate();
    Measurement::new("m", profiles.flat_map(|c| thicknesses_mm.map(|t| profile(c, t))).collect()).unwrap()
}

fn found(thicknesses_mm: [f64; 2], objective: Option<Objective>) -> Result<Measured, optics_model::Invalid> {
    let dictionary = noisy_dictionary(dense_axes(), 120, 0.003);
    let settings = FitSettings { objective, ..FitSettings::default() };
    let plan = MeasurePlan { search_mu: Some(MuRange::default()), ..MeasurePlan::default() };
    measure(&dictionary, &[measured(thicknesses_mm)], &FitOptions::new(settings).unwrap(), &plan)
}

/// A common g is the same number in all channels, to the last bit: renderers make one medium of such channels.
#[test]
fn common_g_is_identical_in_every_channel() {
    let found = found([0.5, 1.0], None).unwrap();
    let g = found.common.g.unwrap();
    let channels = &found.materials[0].channels;
    let refined = channels.iter().map(|c| c.refined.as_ref().unwrap());
    let all: Vec<f64> = refined.clone().map(|r| r.best.medium.g()).collect();
    assert_eq!(all, [g; 3]);
    for r in refined {
        let interval = &r.sigma_t_per_mm;
        let sigma_t = r.best.medium.sigma_t_per_mm();
        assert!(interval.low <= sigma_t && sigma_t <= interval.high, "{r:?}");
    }
}

/// The search of Eq. 3 compares with records, which have the dictionary's thicknesses; the likelihood needs no such search.
#[test]
fn measured_thicknesses_need_no_search_by_records() {
    let likelihood = found([0.512, 1.006], None).unwrap();
    assert!(likelihood.scale.is_none() && likelihood.common.mu_chosen);
    let refused = found([0.512, 1.006], Some(Objective::Paper)).unwrap_err();
    assert!(refused.to_string().contains("0.512"), "{refused}");
    assert!(found([0.5, 1.0], Some(Objective::Paper)).unwrap().scale.is_some());
}
