use optics_model::Measurement;
use optics_model::fit::{FitOptions, FitSettings, MuRange, Objective};

use crate::measure;
use crate::testing::{dense, noisy_profile, profile_value};
use optics_model::fit::{MeasurePlan, Measured};

/// Standard deviation of one pixel.
const NOISE: f64 = 0.002;

/// Channels R, G and B of slabs of these thicknesses, with noise as stated. Each channel prefers a g of its own.
pub(super) fn measured(thicknesses_mm: &[f64]) -> Measurement {
    let media = [("R", 2.2, 0.91, 0.27), ("G", 3.1, 0.93, 0.33), ("B", 4.4, 0.95, 0.39)];
    let profile = |(i, (name, sigma_t, albedo, g)): (usize, (&str, f64, f64, f64)), thickness_mm: f64| {
        let exact = |x| profile_value(x, sigma_t, albedo, g, thickness_mm, i as f64);
        let seed = (2 * i) as u64 + u64::from(thickness_mm > 0.75);
        noisy_profile((name, thickness_mm, 120), exact, |_| NOISE, seed * 120)
    };
    let profiles =
        media.into_iter().enumerate().flat_map(|c| thicknesses_mm.iter().map(move |t| profile(c, *t)));
    Measurement::new("m", profiles.collect()).unwrap()
}

fn found(thicknesses_mm: [f64; 2], objective: Option<Objective>) -> Result<Measured, optics_model::Invalid> {
    let dictionary = dense(120, 0.003);
    let settings = FitSettings { objective, ..FitSettings::default() };
    let plan = MeasurePlan { search_mu: Some(MuRange::default()), ..MeasurePlan::default() };
    measure(dictionary, &[measured(&thicknesses_mm)], &FitOptions::new(settings).unwrap(), &plan)
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
