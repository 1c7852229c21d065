//! Recovery of media, one channel at a time: 25 media, 200 with `FARM_TEST_EFFORT=8`.

use farm_tests::statistics::{Normal, effort, median};
use optics_fit::fit;
use optics_model::fit::{Bounds, ChannelFit, FitOptions, FitSettings};
use optics_model::{Measurement, Medium};

use super::{NOISE, dictionary, photograph};

/// A medium and its fit.
struct Trip {
    truth: Medium,
    found: ChannelFit,
}

/// Media with σ_t from 1.1 to 28 /mm and 1 − α from 0.001 to 0.7, both log-uniform; g is one of the dictionary's.
fn trips(count: u64, walks: u64, hold_g: bool) -> Vec<Trip> {
    let dictionary = dictionary();
    let anisotropies = dictionary.grid().g();
    let trip = |seed: u64| {
        let mut random = Normal::new(77_000 + seed);
        let (s, a) = (random.uniform(), random.uniform());
        let g = anisotropies[(random.uniform() * anisotropies.len() as f64) as usize];
        let log = |low: f64, high: f64, u: f64| low * (high / low).powf(u);
        let truth = Medium::new(log(1.1, 28.0, s), 1.0 - log(1e-3, 0.7, a), g).unwrap();
        let (thin, thin_level) = photograph(&truth, 0, 0.5, seed, walks, 1.0, NOISE);
        let (thick, thick_level) = photograph(&truth, 0, 1.0, seed, walks, 1.0, NOISE);
        let measurement = Measurement::new("m", vec![thin, thick]).unwrap();
        let settings = FitSettings {
            g: if hold_g { Bounds::fixed(g) } else { Bounds::FREE },
            gain_std_error: 0.5 * (thin_level + thick_level),
            // Traced profiles have no stray light.
            offset_std_error: 0.0,
            refine: true,
            ..FitSettings::default()
        };
        let found = fit(dictionary, &measurement, &FitOptions::new(settings).unwrap()).unwrap();
        Trip { truth, found: found.channels.into_iter().next().unwrap() }
    };
    (0..count).map(trip).collect()
}

/// Relative errors of σ_t and 1 − α.
fn errors(truth: &Medium, found: &Medium) -> (f64, f64) {
    let off = |a: f64, b: f64| (a / b - 1.0).abs();
    (off(found.sigma_t_per_mm(), truth.sigma_t_per_mm()), off(1.0 - found.albedo(), 1.0 - truth.albedo()))
}

/// Media whose measurements are traced with other seeds are recovered.
#[test]
fn retraced_media_are_recovered() {
    let count = 25 * effort();
    let trips = trips(count, if effort() >= 8 { 4_000_000 } else { 1_000_000 }, true);
    let refined: Vec<(f64, f64)> =
        trips.iter().map(|t| errors(&t.truth, &t.found.refined.as_ref().unwrap().best.medium)).collect();
    let grid: Vec<(f64, f64)> =
        trips.iter().map(|t| errors(&t.truth, &t.found.candidates[0].medium)).collect();
    let median_of = |e: &[(f64, f64)], pick: fn(&(f64, f64)) -> f64| median(e.iter().map(pick).collect());
    let (sigma_t, co_albedo) = (median_of(&refined, |e| e.0), median_of(&refined, |e| e.1));
    let (grid_sigma_t, grid_co_albedo) = (median_of(&grid, |e| e.0), median_of(&grid, |e| e.1));
    let held =
        |contains: fn(&Trip) -> bool| trips.iter().filter(|t| contains(t)).count() as f64 / count as f64;
    let sigma_t_held =
        held(|t| t.found.refined.as_ref().unwrap().sigma_t_per_mm.contains(t.truth.sigma_t_per_mm()));
    let albedo_held = held(|t| t.found.refined.as_ref().unwrap().albedo.contains(t.truth.albedo()));
    println!("{count} media: median error of σ_t {sigma_t:.4}, of 1 − α {co_albedo:.4}");
    println!(
        "grid: {grid_sigma_t:.4}, {grid_co_albedo:.4}; intervals hold σ_t {sigma_t_held:.3}, α {albedo_held:.3}"
    );
    assert!(sigma_t < 0.02 && co_albedo < 0.03);
    assert!(3.0 * sigma_t < grid_sigma_t && 3.0 * co_albedo < grid_co_albedo);
    // Fewer than 20 of 25 intervals of 95 % contain the truth once in 800 times.
    let (least, most) = if count >= 200 { (0.90, 0.99) } else { (0.80, 1.0) };
    assert!((least..=most).contains(&sigma_t_held) && (least..=most).contains(&albedo_held));
}

/// With g free, the estimate lies in the valley of similar media, and this is reported.
#[test]
fn free_anisotropy_reports_its_trade_off() {
    let count = 10 * effort();
    let trips = trips(count, 1_000_000, false);
    let share = |ok: fn(&Trip) -> bool| trips.iter().filter(|t| ok(t)).count() as f64 / count as f64;
    let valley = share(|t| t.found.refined.as_ref().unwrap().valley);
    let sigma_t =
        share(|t| t.found.refined.as_ref().unwrap().sigma_t_per_mm.contains(t.truth.sigma_t_per_mm()));
    let g = share(|t| t.found.refined.as_ref().unwrap().g.contains(t.truth.g()));
    let reduced = |m: &Medium| m.albedo() * m.sigma_t_per_mm() * (1.0 - m.g());
    let off = trips.iter().map(|t| {
        let found = &t.found.refined.as_ref().unwrap().best.medium;
        (reduced(found) / reduced(&t.truth) - 1.0).abs()
    });
    let off = median(off.collect());
    println!(
        "{count} media: valley reported {valley:.2}; intervals hold σ_t {sigma_t:.2}, g {g:.2}; σ_s' off {off:.4}"
    );
    assert!(valley >= 0.8 && sigma_t >= 0.7 && g >= 0.7 && off < 0.03);
}
