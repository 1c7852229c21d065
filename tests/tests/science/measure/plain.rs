//! The plain `farmctl measure`, with photographs as the only input.
//!
//! Sets of three materials with three channels each, all off the grid. Neither μ nor g is given: both are estimated for
//! the set, and their uncertainty is in every interval. With `FARM_TEST_EFFORT=8`, 25 sets: g = 0, 0.2, 0.4, 0.7, 0.8,
//! five of each, with the paper's whole dictionary.

use farm_tests::statistics::{Normal, effort, median};
use optics_fit::{MeasurePlan, Measured, measure};
use optics_model::fit::{FitOptions, Interval, MuRange, Refined};
use optics_model::{Measurement, Medium};

use super::{NOISE, dictionary, photograph};

/// Nine media: σ_t from 1.1 to 28 /mm and 1 − α from 0.001 to 0.7, both log-uniform.
fn media(seed: u64, g: f64) -> Vec<Medium> {
    let mut random = Normal::new(31_000 + seed);
    let mut medium = || {
        let log = |low: f64, high: f64, u: f64| low * (high / low).powf(u);
        let sigma_t = log(1.1, 28.0, random.uniform());
        Medium::new(sigma_t, 1.0 - log(1e-3, 0.7, random.uniform()), g).unwrap()
    };
    (0..9).map(|_| medium()).collect()
}

fn photographed(media: &[Medium], seed: u64, walks: u64) -> Vec<Measurement> {
    let material = |(m, media): (usize, &[Medium])| {
        let mut profiles = Vec::new();
        for (channel, medium) in media.iter().enumerate() {
            for thickness in [0.5, 1.0] {
                let seed = 5_000 + seed * 100 + (3 * m + channel) as u64;
                profiles.push(photograph(medium, channel, thickness, seed, walks, 1.0, NOISE).0);
            }
        }
        Measurement::new(format!("m{m}"), profiles).unwrap()
    };
    media.chunks(3).enumerate().map(material).collect()
}

/// An estimated quantity, with its interval and the truth.
#[derive(Clone, Copy)]
struct Found {
    value: f64,
    interval: Interval,
    truth: f64,
}

impl Found {
    fn error(&self) -> f64 {
        (self.value / self.truth - 1.0).abs()
    }

    fn holds(&self) -> bool {
        self.interval.contains(self.truth)
    }
}

/// σ_t, 1 − α, σ_s(1 − g), σ_a.
fn quantities(r: &Refined, truth: &Medium) -> [Found; 4] {
    let of = |m: &Medium| {
        let (s, a, g) = (m.sigma_t_per_mm(), m.albedo(), m.g());
        [s, 1.0 - a, s * a * (1.0 - g), s * (1.0 - a)]
    };
    let i = &r.albedo;
    let co_albedo =
        Interval { low: 1.0 - i.high, high: 1.0 - i.low, open_low: i.open_high, open_high: i.open_low };
    let intervals = [r.sigma_t_per_mm, co_albedo, r.reduced_scattering_per_mm, r.absorption_per_mm];
    let (values, truths) = (of(&r.best.medium), of(truth));
    std::array::from_fn(|k| Found { value: values[k], interval: intervals[k], truth: truths[k] })
}

fn measured(materials: &[Measurement]) -> Measured {
    let plan = MeasurePlan { search_mu: Some(MuRange::default()), ..MeasurePlan::default() };
    measure(dictionary(), materials, &FitOptions::default(), &plan).unwrap()
}

/// The g and μ of a set: their uncertainty is part of every interval.
#[test]
fn common_parameters_are_near_the_truth() {
    let long = effort() >= 8;
    let anisotropies: &[f64] = if long { &[0.0, 0.2, 0.4, 0.7, 0.8] } else { &[0.4] };
    let (sets, walks) = if long { (5, 4_000_000) } else { (2, 1_000_000) };
    let mut all: Vec<[Found; 4]> = Vec::new();
    let (mut g_held, mut mu_held, mut count) = (0, 0, 0);
    for (n, g) in anisotropies.iter().enumerate() {
        for k in 0..sets {
            let seed = (10 * n + k) as u64;
            let media = media(seed, *g);
            let found = measured(&photographed(&media, seed, walks));
            let common = &found.common;
            let interval = common.g_interval.unwrap();
            println!(
                "g {g}: found {:.3}, {:.3} to {:.3}; μ {:.4} ± {:.4}",
                common.g.unwrap(),
                interval.low,
                interval.high,
                common.mu,
                common.mu_std_error
            );
            count += 1;
            g_held += usize::from(interval.contains(*g));
            mu_held += usize::from(common.mu_interval.contains(1.0));
            let channels = found.materials.iter().flat_map(|m| &m.channels);
            all.extend(channels.zip(&media).map(|(c, truth)| quantities(c.refined.as_ref().unwrap(), truth)));
        }
    }
    let error = |k: usize| median(all.iter().map(|f| f[k].error()).collect());
    // Half of the media are bright, with errors of σ_a many times those of the others. The place of a median between
    // the two is random, so the geometric mean is bounded.
    let geometric =
        |k: usize| (all.iter().map(|f| f[k].error().max(1e-6).ln()).sum::<f64>() / all.len() as f64).exp();
    let held = |k: usize| all.iter().filter(|f| f[k].holds()).count() as f64 / all.len() as f64;
    println!("{count} sets, {} channels; g held in {g_held}, μ in {mu_held}", all.len());
    for (k, name) in ["σ_t", "1 − α", "σ_s(1 − g)", "σ_a"].into_iter().enumerate() {
        println!(
            "{name}: errors' median {:.4}, geometric mean {:.4}, intervals hold {:.3}",
            error(k),
            geometric(k),
            held(k)
        );
    }
    assert!(geometric(0) < 0.02 && geometric(1) < 0.04 && geometric(2) < 0.02 && geometric(3) < 0.05);
    // Fewer than 13 of 18 independent intervals of 95 % hold once in 10,000 times; but those of a set share the
    // estimated μ and g, so that a set may miss as a whole.
    let least = if long { 0.9 } else { 0.72 };
    (0..4).for_each(|k| assert!(held(k) >= least, "quantity {k}: {}", held(k)));
    assert!(g_held + 1 >= count * 9 / 10 && mu_held + 1 >= count * 9 / 10);
}

/// A single channel hardly determines μ: this is reported, and the intervals are wide, not wrong.
#[test]
fn undetermined_scale_factor_is_reported() {
    let truth = Medium::new(6.3, 0.9985, 0.4).unwrap();
    let profiles = [0.5, 1.0].map(|t| photograph(&truth, 0, t, 9_901, 1_000_000, 1.0, NOISE).0);
    let found = measured(&[Measurement::new("white", profiles.to_vec()).unwrap()]);
    let r = found.materials[0].channels[0].refined.as_ref().unwrap();
    println!("{:?}\n{r:?}", found.common);
    assert!(found.common.mu_interval.contains(1.0));
    assert!(r.sigma_t_per_mm.contains(6.3) && r.albedo.contains(0.9985), "{r:?}");
}
