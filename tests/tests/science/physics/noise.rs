//! The noise of records, compared with that of the paper's dictionary.

use std::sync::atomic::AtomicBool;

use farm_tests::reference;
use optics_model::grid::{Effort, NoiseLevel};
use optics_model::job::JobSpec;
use optics_model::phase::PhaseShape;
use optics_model::scene::Channel;
use optics_model::{Grid, Scene, TransportPoint, Walks};
use optics_tracer::trace;

/// Samples per pixel of the paper's dictionary.
const SAMPLES: f64 = 250_000.0;

/// Per pixel, for every albedo: the profile's variance with this number of walks, and that of one sample of a path
/// tracer, which scores the weight α^n ρ^m over the ring's measure Δ where a path comes into the ring, or nothing:
/// F(α², ρ²)/Δ − F(α, ρ)².
fn variances(
    phase: PhaseShape,
    point: TransportPoint,
    rho: (f64, f64),
    albedos: &[f64],
    walks: Walks,
    seed: u64,
) -> Vec<Vec<[f64; 2]>> {
    let squared = |(light, dark): (f64, f64)| (light * light, dark * dark);
    let channel = |name: &str, (light, dark)| Channel::new(name, light, dark).unwrap();
    let channels = vec![channel("first power", rho), channel("second power", squared(rho))];
    let scene = Scene::paper().with_channels(channels).unwrap().with_phase(phase);
    let mut all: Vec<f64> = albedos.iter().flat_map(|albedo| [*albedo, albedo * albedo]).collect();
    all.sort_by(f64::total_cmp);
    all.dedup();
    let measure = scene.light().measure();
    let job = JobSpec::new(scene, point, all.clone(), walks, seed, false).unwrap();
    let records = trace(&job, &AtomicBool::new(false)).unwrap();
    let record = |albedo: f64| &records[all.binary_search_by(|a| a.total_cmp(&albedo)).unwrap()];
    let albedo_variances = |albedo: &f64| {
        let profile = &record(*albedo).profiles[0].radiance_factor;
        let squares = record(albedo * albedo).profiles[1].radiance_factor.values();
        let pixels = profile.values().iter().zip(profile.std_errors()).zip(squares);
        let pixel_variances = |((value, error), square): ((&f32, &f32), &f32)| {
            let [value, error, square] = [*value, *error, *square].map(f64::from);
            [error * error, square / measure - value * value]
        };
        pixels.map(pixel_variances).collect()
    };
    albedos.iter().map(albedo_variances).collect()
}

/// With 40 pixels per side, Mitsuba's standard errors are accurate to a few per cent.
#[test]
fn path_tracer_noise_is_stated_exactly() {
    let mut ratios = Vec::new();
    for theirs in reference::mitsuba().unwrap() {
        let point =
            TransportPoint::new(theirs.sigma_t_per_mm, theirs.g, theirs.thickness_mm, theirs.sample_ior)
                .unwrap();
        let rho = (theirs.rho_light, theirs.rho_dark);
        let walks = Walks::new(200_000).unwrap();
        let ours = variances(theirs.phase, point, rho, &[theirs.albedo], walks, 1).remove(0);
        let pitch = theirs.width_mm / theirs.values.len() as f64;
        let (mut found, mut expected) = (0.0, 0.0);
        for (pixel, error) in theirs.std_errors.iter().enumerate() {
            let x = (pixel as f64 + 0.5) * pitch - 0.5 * theirs.width_mm;
            // Near the edge, pixels of the two profiles differ.
            if x.abs() > 0.5 {
                found += error * error * theirs.samples;
                expected += ours[((x + 5.0) * 36.0) as usize][1];
            }
        }
        println!("{}: {:.3}", theirs.name, found / expected);
        ratios.push(found / expected);
    }
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    assert!((mean - 1.0).abs() < 0.05, "{mean}");
    assert!(ratios.iter().all(|ratio| (ratio - 1.0).abs() < 0.15), "{ratios:?}");
}

/// The brightest albedo needs the most walks. Eight seeds of some hundred batches determine a variance to 4 %.
#[test]
fn records_are_no_noisier_than_the_paper() {
    let grid = Grid::paper();
    assert_eq!(grid.effort(), Effort::Noise(NoiseLevel::Paper));
    let albedos = [0.05, 0.5, 0.95, 0.999, 0.99999];
    for (sigma_t, g, thickness) in [(1.0, 0.0, 0.5), (2.5, 0.4, 1.0), (10.0, 0.8, 0.5), (20.0, 0.2, 1.0)] {
        let point = TransportPoint::new(sigma_t, g, thickness, 1.53).unwrap();
        let walks = NoiseLevel::Paper.walks(&point);
        // Ratios per albedo and side.
        let mut sums = vec![[[0.0; 2]; 2]; albedos.len()];
        for seed in 1..=8 {
            for (sums, pixels) in sums.iter_mut().zip(variances(
                PhaseShape::default(),
                point,
                (0.985, 0.024),
                &albedos,
                walks,
                seed,
            )) {
                let half = pixels.len() / 2;
                for (sums, side) in sums.iter_mut().zip(pixels.chunks(half)) {
                    for [ours, sample] in side {
                        sums[0] += ours;
                        sums[1] += sample / SAMPLES;
                    }
                }
            }
        }
        let ratios: Vec<_> = sums.iter().map(|sides| sides.map(|[ours, papers]| ours / papers)).collect();
        println!("{point:?}, {} walks: {ratios:.3?}", walks.get());
        let worst = ratios.iter().flatten().copied().fold(0.0, f64::max);
        assert!(worst < 1.06, "{worst} of the paper's variance at {point:?}");
        assert!(worst > 0.75, "more walks than needed at {point:?}: {worst}");
    }
}
