//! Recovery of media, one channel at a time: 25 media, 200 with `FARM_TEST_EFFORT=8`.

use farm_tests::coverage::{Answer, Coverage};
use farm_tests::statistics::{Normal, effort, median};
use optics_fit::fit;
use optics_model::fit::{Bounds, FitOptions, FitSettings};
use optics_model::{Measurement, Medium};

use super::{NOISE, SLABS_MM, dictionary, photograph};

/// The fits of random media whose g is one of the dictionary's, and the grid's best media.
fn trips(count: u64, walks: u64) -> (Vec<Answer>, Vec<Medium>) {
    let dictionary = dictionary();
    let anisotropies = dictionary.grid().g();
    let trip = |seed: u64| {
        let mut random = Normal::new(77_000 + seed);
        let m = random.medium(0.0);
        let g = anisotropies[(random.uniform() * anisotropies.len() as f64) as usize];
        let truth = Medium::new(m.sigma_t_per_mm(), m.albedo(), g).unwrap();
        let photographs = SLABS_MM.map(|mm| photograph(&truth, 0, mm, seed, walks, 1.0, NOISE));
        let settings = FitSettings {
            g: Bounds::fixed(g),
            gain_std_error: 0.5 * (photographs[0].1 + photographs[1].1),
            // Traced profiles have no stray light.
            offset_std_error: 0.0,
            refine: true,
            ..FitSettings::default()
        };
        let measurement = Measurement::new("m", photographs.map(|p| p.0).to_vec()).unwrap();
        let found = fit(dictionary, &measurement, &FitOptions::new(settings).unwrap()).unwrap();
        let channel = &found.channels[0];
        let answer = Answer::of_fit(seed.to_string(), &truth, channel.refined.as_ref().unwrap());
        (answer, channel.candidates[0].medium)
    };
    (0..count).map(trip).unzip()
}

fn estimates(trips: &[Answer], quantity: usize) -> Coverage {
    Coverage::of_media(trips.chunks(1), &[quantity])
}

/// Media whose measurements are traced with other seeds are recovered.
#[test]
fn retraced_media_are_recovered() {
    let count = 25 * effort();
    let (trips, grid) = trips(count, if effort() >= 8 { 4_000_000 } else { 1_000_000 });
    let [sigma_t, co_albedo] = [0, 1].map(|q| estimates(&trips, q));
    let off = |found: fn(&Medium) -> f64, q: usize| {
        let pairs = trips.iter().zip(&grid);
        median(pairs.map(|(t, m)| (found(m) / t.medium[q].truth - 1.0).abs()).collect())
    };
    let of_grid = [off(Medium::sigma_t_per_mm, 0), off(|m| 1.0 - m.albedo(), 1)];
    let errors = [sigma_t.error(0.5), co_albedo.error(0.5)];
    println!("{count} media: median errors of σ_t and 1 − α {errors:.4?}, of the grid {of_grid:.4?}");
    println!("intervals hold σ_t {} %, α {} %", sigma_t.hold(), co_albedo.hold());
    assert!(errors[0] < 0.02 && errors[1] < 0.03);
    assert!(errors.iter().zip(of_grid).all(|(refined, grid)| 3.0 * refined < grid));
    // Fewer than 20 of 25 intervals of 95 % contain the truth once in 800 times.
    let (least, most) = if count >= 200 { (0.90, 0.99) } else { (0.80, 1.0) };
    assert!([sigma_t, co_albedo].iter().all(|found| (least..=most).contains(&found.hold().share)));
}
