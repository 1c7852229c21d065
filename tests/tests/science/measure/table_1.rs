//! The paper's five materials, photographed with a wrong exposure.

use optics_fit::{MeasurePlan, measure, scale};
use optics_model::fit::{FitOptions, MuRange};
use optics_model::{Measurement, Medium};

use super::{NOISE, dictionary, photograph};

/// A material and its σ_t and α in R, G, B.
pub(super) type Row = (&'static str, [(f64, f64); 3]);

/// The paper's Table 1, at g = 0.4.
pub(super) const TABLE_1: [Row; 5] = [
    ("cyan", [(9.0, 0.05), (4.5, 0.7), (7.5, 0.98)]),
    ("magenta", [(2.5, 0.98), (3.0, 0.1), (10.0, 0.9)]),
    ("yellow", [(2.25, 0.997), (3.75, 0.995), (19.0, 0.15)]),
    ("black", [(5.0, 0.35), (5.5, 0.35), (6.5, 0.35)]),
    ("white", [(6.0, 0.9991), (9.0, 0.9997), (24.0, 0.999)]),
];

fn table_1(mu: f64, seed: u64) -> Vec<Measurement> {
    let material = |(m, (name, media)): (usize, &Row)| {
        let mut profiles = Vec::new();
        for (channel, (sigma_t, albedo)) in media.iter().enumerate() {
            let medium = Medium::new(*sigma_t, *albedo, 0.4).unwrap();
            for thickness in [0.5, 1.0] {
                let seed = seed * 100 + (m * 3 + channel) as u64;
                profiles.push(photograph(&medium, channel, thickness, seed, 1_000_000, mu, NOISE).0);
            }
        }
        Measurement::new(*name, profiles).unwrap()
    };
    TABLE_1.iter().enumerate().map(material).collect()
}

/// Table 1 of the paper is measured with a scale factor that the fit does not get.
#[test]
fn table_1_is_measured_without_its_factor() {
    let dictionary = dictionary();
    let (mut held, mut count) = (0, 0);
    for (hidden, seed) in [(0.86, 1), (0.913, 2), (0.98, 3)] {
        let materials = table_1(hidden, seed);
        let (options, range) = (FitOptions::default(), MuRange::default());
        let plan = MeasurePlan { search_mu: Some(range), ..MeasurePlan::default() };
        let found = measure(dictionary, &materials, &options, &plan).unwrap();
        let common = &found.common;
        println!(
            "hidden {hidden}: μ = {:.4} ± {:.4}, g = {:?} {:?}",
            common.mu, common.mu_std_error, common.g, common.g_interval
        );
        // The truth lies on the grid here, where the best records have no error except noise. Refined errors do not
        // assume that, so they are checked against their own standard error.
        let off = (common.mu - hidden).abs();
        assert!(off <= 3.0 * common.mu_std_error && off <= 0.015, "{common:?}");
        let by_records = scale(dictionary, &materials, &options, &range).unwrap().best.mu;
        assert!((by_records - hidden).abs() <= 0.005, "{by_records}");
        let g = common.g.unwrap();
        assert!((g - 0.4).abs() < 0.06 && common.g_interval.unwrap().contains(0.4), "{common:?}");
        for (material, (name, media)) in found.materials.iter().zip(&TABLE_1) {
            for (i, (channel, (sigma_t, albedo))) in material.channels.iter().zip(media).enumerate() {
                let best = &channel.candidates[0].medium;
                let r = channel.refined.as_ref().unwrap();
                let unresolved = matches!((*name, i), ("cyan", 0) | ("yellow", 2));
                // With relative noise, magenta's green can be measured, although it is dark.
                let either = (*name, i) == ("magenta", 1);
                println!(
                    "{name} {i}: {sigma_t} {albedo}: grid {} {}, refined {:.3} {:.5}, σ_t {:?}, α {:?} {}",
                    best.sigma_t_per_mm(),
                    best.albedo(),
                    r.best.medium.sigma_t_per_mm(),
                    r.best.medium.albedo(),
                    r.sigma_t_per_mm,
                    r.albedo,
                    if r.resolved_at_g { "" } else { "unresolved" }
                );
                assert!(either || r.resolved_at_g != unresolved, "{name}, channel {i}: {r:?}");
                if r.resolved_at_g {
                    let off = (r.best.medium.sigma_t_per_mm() / sigma_t - 1.0).abs();
                    assert!(off < 0.1, "{name}, channel {i}: {r:?}");
                }
                let holds = [r.sigma_t_per_mm.contains(*sigma_t), r.albedo.contains(*albedo)];
                held += holds.into_iter().filter(|holds| *holds).count();
                count += holds.len();
            }
        }
    }
    // Some 90 intervals of 95 %, those of one factor with the same μ and g; unresolved media must have the same
    // coverage.
    println!("{held} of {count} intervals hold");
    assert!(held * 10 >= count * 9, "{held} of {count}");
}
