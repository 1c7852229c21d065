//! Checks the tracer with exact values, an independent renderer, symmetries and conservation laws.
//!
//! Seeds are fixed. Each test states its number of walks and the largest error that it would not detect.

mod boards;
mod example;
mod measurement_checks;
mod noise;

use std::sync::atomic::AtomicBool;

use farm_tests::reference::{self, UniformRow};
use farm_tests::statistics::{Mean, chi2_per_pixel, effort, errors_of_neighbours};
use optics_layers::{Print, PrintLayer};
use optics_model::job::JobSpec;
use optics_model::profile::{Profile, Record};
use optics_model::scene::{Channel, RingLight, Scene, Sensor};
use optics_model::{Digest, Medium, TransportPoint, Walks};
use optics_tracer::{Kernel, trace, trace_with};

struct Run {
    scene: Scene,
    point: TransportPoint,
    albedo: Vec<f64>,
    walks: u64,
    derivatives: bool,
}

impl Run {
    fn new(scene: Scene, point: [f64; 4], albedo: &[f64], walks: u64) -> Self {
        let [sigma_t, g, thickness, ior] = point;
        let point = TransportPoint::new(sigma_t, g, thickness, ior).unwrap();
        Self { scene, point, albedo: albedo.to_vec(), walks, derivatives: false }
    }

    fn job(&self, seed: u64) -> JobSpec {
        let walks = Walks::new(self.walks).unwrap();
        let (scene, albedo) = (self.scene.clone(), self.albedo.clone());
        JobSpec::new(scene, self.point, albedo, walks, seed, self.derivatives).unwrap()
    }

    fn records(&self, seed: u64) -> Vec<Record> {
        trace(&self.job(seed), &AtomicBool::new(false)).unwrap()
    }

    /// Profile of the only albedo and channel.
    fn profile(&self, seed: u64) -> Profile {
        self.records(seed).remove(0).profiles.remove(0)
    }
}

fn channels(scene: Scene, rho: &[(f64, f64)]) -> Scene {
    let channel =
        |(i, &(light, dark)): (usize, &(f64, f64))| Channel::new(format!("c{i}"), light, dark).unwrap();
    scene.with_channels(rho.iter().enumerate().map(channel).collect()).unwrap()
}

fn pixels(scene: Scene, width_mm: f64, pixels: u32) -> Scene {
    scene.with_sensor(Sensor::new(width_mm, pixels, 0.0).unwrap())
}

fn values(profile: &Profile) -> Vec<f64> {
    profile.radiance_factor.values().iter().copied().map(f64::from).collect()
}

fn at(profile: &Profile, pixel: usize) -> Mean {
    Mean {
        mean: f64::from(profile.radiance_factor.values()[pixel]),
        std_error: f64::from(profile.radiance_factor.std_errors()[pixel]),
    }
}

/// 2 million walks per row: standard errors below 0.15 % of white.
fn check_uniform_bases(rows: &[UniformRow]) {
    let mut zs = Vec::new();
    for pair in rows.chunks(2) {
        let row = &pair[0];
        let rho: Vec<_> = pair.iter().map(|r| (r.rho, r.rho)).collect();
        let scene = channels(pixels(Scene::smooth(), 10.0, 1), &rho).with_phase(row.phase.clone());
        let point = [row.sigma_t_per_mm, row.g, row.thickness_mm, row.sample_ior];
        let record = Run::new(scene, point, &[row.albedo], effort() * 2_000_000).records(1).remove(0);
        for (row, profile) in pair.iter().zip(&record.profiles) {
            let found = at(profile, 0);
            let difference = found.mean - row.radiance_factor;
            let UniformRow { sigma_t_per_mm, albedo, g, rho, .. } = row;
            println!(
                "{sigma_t_per_mm} {albedo} {g} {rho}: {:.5} ± {:.5}, {:.5}",
                found.mean, found.std_error, row.radiance_factor
            );
            assert!(found.std_error < 1.5e-3, "{found:?} is too uncertain for this test");
            assert!(difference.abs() < 3.0 * found.std_error + 1e-4, "{row:?}: {found:?}");
            zs.push(difference / found.std_error);
        }
    }
    let mean_z = zs.iter().sum::<f64>() / zs.len() as f64;
    println!("mean z {mean_z:.2}");
    assert!(mean_z.abs() < 1.0, "mean z {mean_z}");
}

#[test]
fn uniform_bases_agree_with_adding_doubling() {
    check_uniform_bases(&reference::uniform().unwrap());
}

/// Second lobes behind and ahead, with little and with much weight.
#[test]
fn two_lobes_agree_with_adding_doubling() {
    check_uniform_bases(&reference::two_lobes().unwrap());
}

/// Phase functions of spheres of rutile, and of carbon.
#[test]
fn tables_agree_with_adding_doubling() {
    check_uniform_bases(&reference::tabulated().unwrap());
}

/// Layers as matrices give the exact radiance factors of all three files within 1e-4 of white, of which 5e-5 is the files'.
#[test]
fn layers_agree_with_exact_radiance_factors() {
    let rows = [reference::uniform(), reference::two_lobes(), reference::tabulated()];
    for row in rows.into_iter().flat_map(Result::unwrap) {
        let peak = row.phase.function_near(row.g).peak_width();
        let medium = Medium::new(row.sigma_t_per_mm, row.albedo, row.g).unwrap();
        let slab = PrintLayer { medium, phase: row.phase.clone(), thickness_mm: row.thickness_mm };
        let found =
            Print::new(&Scene::smooth(), row.sample_ior, peak).radiance_factors(&[slab], &[row.rho])[0];
        assert!((found - row.radiance_factor).abs() < 1e-4, "{row:?}: {found}");
    }
}

/// 16 × 125,000 walks and 16,384 samples per pixel, so that most noise is the reference's, whose pixels are
/// independent: χ²/n is 1 ± 0.14. Pixels of the tracer's profile share their walks, so the error of a side's mean comes
/// from the spread between the 16 seeds.
#[test]
fn edge_profiles_agree_with_mitsuba() {
    const SEEDS: u64 = 16;
    for reference in reference::mitsuba().unwrap() {
        let n = reference.values.len();
        let scene = pixels(Scene::paper(), reference.width_mm, n as u32).with_phase(reference.phase.clone());
        let scene = channels(scene, &[(reference.rho_light, reference.rho_dark)]);
        let point = [reference.sigma_t_per_mm, reference.g, reference.thickness_mm, reference.sample_ior];
        let run = Run::new(scene, point, &[reference.albedo], effort() * 125_000);
        let profiles: Vec<_> = (0..SEEDS).map(|seed| values(&run.profile(seed))).collect();
        let ours: Vec<_> =
            (0..n).map(|pixel| Mean::of(&profiles.iter().map(|p| p[pixel]).collect::<Vec<_>>())).collect();
        let theirs: Vec<_> = std::iter::zip(&reference.values, errors_of_neighbours(&reference.std_errors))
            .map(|(&mean, std_error)| Mean { mean, std_error })
            .collect();
        let chi2 = chi2_per_pixel(&ours, &theirs);
        let side = |range: std::ops::Range<usize>| {
            let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
            let ours: Vec<_> = profiles.iter().map(|p| mean(&p[range.clone()])).collect();
            let squares: f64 = reference.std_errors[range.clone()].iter().map(|e| e * e).sum();
            let std_error = squares.sqrt() / range.len() as f64;
            Mean::of(&ours).z(Mean { mean: mean(&reference.values[range.clone()]), std_error })
        };
        let (dark, light) = (side(0..n / 2 - 8), side(n / 2 + 8..n));
        println!("{}: chi2/n {chi2:.2}, dark side z {dark:.2}, light side z {light:.2}", reference.name);
        assert!(chi2 < 1.5, "{}: chi2/n {chi2}", reference.name);
        assert!(dark.abs() < 3.5 && light.abs() < 3.5, "{}: z {dark} {light}", reference.name);
    }
}

/// Without an edge the profile is flat to the last bit.
#[test]
fn profile_without_edge_is_exactly_flat() {
    let scene = channels(pixels(Scene::paper(), 10.0, 90), &[(0.5, 0.5), (0.985, 0.985)]);
    for record in Run::new(scene, [6.0, 0.4, 0.5, 1.53], &[0.3, 0.9991], 25_000).records(1) {
        for profile in &record.profiles {
            let values = profile.radiance_factor.values();
            assert!(values[0] > 0.0 && values.iter().all(|v| v == &values[0]));
        }
    }
}

/// Every walk is scored with its mirror image, so exchanging dark and light mirrors the profile, to the rounding of
/// the sums and of single precision.
#[test]
fn exchanging_the_sides_mirrors_the_profile() {
    let scene = channels(pixels(Scene::paper(), 8.0, 81), &[(0.9, 0.1), (0.1, 0.9)]);
    let record = Run::new(scene, [2.5, 0.4, 0.5, 1.53], &[0.99], 25_000).records(1).remove(0);
    let (profile, exchanged) = (values(&record.profiles[0]), values(&record.profiles[1]));
    assert!(profile[80] > 1.5 * profile[0], "there must be an edge");
    for (a, b) in profile.iter().zip(exchanged.iter().rev()) {
        assert!((a - b).abs() < 1e-6 * a, "{a} {b}");
    }
}

/// Conservation: α = 1 over a white base returns all light, whatever the roughness, if nothing is lost on the
/// microsurface.
#[test]
fn without_absorption_all_light_returns() {
    let everywhere = RingLight::new(0.0, 90.0).unwrap();
    for scene in [Scene::smooth(), Scene::paper().with_multiple_scattering(true)] {
        let scene = channels(pixels(scene, 10.0, 1), &[(1.0, 1.0)]).with_light(everywhere);
        let profile = Run::new(scene, [3.0, 0.6, 1.0, 1.53], &[1.0], 2_000_000).profile(1);
        let all = at(&profile, 0);
        println!("returned: {all:?}");
        assert!(all.std_error < 1e-3 && ((all.mean - 1.0) / all.std_error).abs() < 3.0, "{all:?}");
    }
}

/// Light at 45°, sensor at 0° against light at 0°, sensor at 45°. The light from the zenith must have some extent;
/// at 5° it changes the value by less than 0.2 %. Standard errors near 0.5 % reveal a missing η² or cosine.
#[test]
fn swapping_light_and_sensor_changes_nothing() {
    let base = || channels(pixels(Scene::smooth(), 10.0, 1), &[(0.9, 0.9)]);
    let point = [4.0, 0.5, 0.5, 1.53];
    let ring = base().with_light(RingLight::new(44.0, 46.0).unwrap());
    let tilted =
        base().with_sensor(Sensor::new(10.0, 1, 45.0).unwrap()).with_light(RingLight::new(0.0, 5.0).unwrap());
    let forth = at(&Run::new(ring, point, &[0.98], 2_000_000).profile(1), 0);
    let back = at(&Run::new(tilted, point, &[0.98], 4_000_000).profile(2), 0);
    println!("{forth:?} {back:?}");
    assert!(forth.std_error < 0.005 * forth.mean && back.std_error < 0.008 * back.mean);
    assert!(forth.z(back).abs() < 3.0, "{forth:?} {back:?}");
}

/// The box filter is exact: fine pixels averaged are coarse pixels, from the same walks.
#[test]
fn averaged_fine_pixels_are_coarse_pixels() {
    let run =
        |n| Run::new(pixels(Scene::paper(), 6.0, n), [6.0, 0.4, 0.5, 1.53], &[0.999], 25_000).profile(3);
    let (fine, coarse) = (values(&run(120)), values(&run(24)));
    for (i, coarse) in coarse.iter().enumerate() {
        let mean = fine[5 * i..5 * i + 5].iter().sum::<f64>() / 5.0;
        assert!((mean - coarse).abs() < 1e-6, "pixel {i}: {mean} {coarse}");
    }
    assert!(coarse[23] - coarse[0] > 0.1, "the test needs an edge");
}

/// The standard errors are those of the results: over 60 seeds the spread of each of three pixels agrees with the
/// stated errors. χ² with 59 degrees of freedom stays within [0.55, 1.6] of its mean with 99.8 %.
#[test]
fn standard_errors_match_the_spread_of_seeds() {
    let scene = channels(pixels(Scene::paper(), 4.0, 20), &[(0.985, 0.024)]);
    let run = Run::new(scene, [6.0, 0.4, 0.5, 1.53], &[0.9991], 25_000);
    let profiles: Vec<_> = (100..160).map(|seed| run.profile(seed)).collect();
    for pixel in [0, 10, 19] {
        let results: Vec<_> = profiles.iter().map(|p| at(p, pixel)).collect();
        let spread = Mean::of(&results.iter().map(|r| r.mean).collect::<Vec<_>>());
        let found = spread.std_error.powi(2) * results.len() as f64;
        let stated = results.iter().map(|r| r.std_error.powi(2)).sum::<f64>() / results.len() as f64;
        println!("pixel {pixel}: variance found over stated {:.2}", found / stated);
        assert!((0.55..1.6).contains(&(found / stated)), "pixel {pixel}: {found:e} {stated:e}");
    }
}

/// Common walks at α ± h give the difference quotient without noise; its own error is of order h².
#[test]
fn albedo_derivative_matches_differences() {
    let (albedo, h) = (0.9, 1e-3);
    let scene = channels(pixels(Scene::paper(), 6.0, 12), &[(0.985, 0.024)]);
    let mut run = Run::new(scene, [6.0, 0.4, 0.5, 1.53], &[albedo - h, albedo, albedo + h], 25_000);
    run.derivatives = true;
    let records = run.records(1);
    let value = |i: usize| values(&records[i].profiles[0]);
    let derivative = &records[1].profiles[0].derivatives.as_ref().unwrap().albedo;
    for (pixel, &d) in derivative.values().iter().enumerate() {
        let quotient = (value(2)[pixel] - value(0)[pixel]) / (2.0 * h);
        assert!((f64::from(d) / quotient - 1.0).abs() < 1e-3, "pixel {pixel}: {d} {quotient}");
    }
}

/// Independent walks at σ_t ± 0.25 against the derivative at σ_t, 24 seeds × 100,000 walks each; the error of the
/// difference is below 12 % of the derivative where it matters, on the light side. The third-order term of the
/// quotient is below 1 %.
#[test]
fn sigma_t_derivative_agrees_with_difference_quotients() {
    let h = 0.25;
    let run = |sigma_t: f64, derivatives| {
        let scene = channels(pixels(Scene::paper(), 6.0, 2), &[(0.985, 0.024)]);
        Run { derivatives, ..Run::new(scene, [sigma_t, 0.4, 0.5, 1.53], &[0.8], 100_000) }
    };
    let sample = |run: &Run, first: u64, pick: &dyn Fn(&Profile) -> Vec<f64>| -> Vec<Vec<f64>> {
        (first..first + 24).map(|seed| pick(&run.profile(seed))).collect()
    };
    let derivative = sample(&run(3.0, true), 0, &|p| {
        let d = &p.derivatives.as_ref().unwrap().sigma_t;
        d.values().iter().copied().map(f64::from).collect()
    });
    let (low, high) = (sample(&run(3.0 - h, false), 50, &values), sample(&run(3.0 + h, false), 100, &values));
    for side in [0, 1] {
        let exact = Mean::of(&derivative.iter().map(|d| d[side]).collect::<Vec<_>>());
        let quotients: Vec<_> =
            std::iter::zip(&low, &high).map(|(l, r)| (r[side] - l[side]) / (2.0 * h)).collect();
        let quotient = Mean::of(&quotients);
        println!("side {side}: derivative {exact:?}, quotient {quotient:?}");
        assert!(exact.z(quotient).abs() < 3.5, "side {side}: {exact:?} {quotient:?}");
        if side == 1 {
            assert!(libm::hypot(exact.std_error, quotient.std_error) < 0.12 * exact.mean.abs());
        }
    }
}

/// Any number of threads and any instructions give the same bits, the same on every machine. If they change
/// on purpose, raise `PHYSICS_VERSION` with the new digests.
#[test]
fn results_are_bitwise_reproducible() {
    // By walks alone, and with exact levels.
    let cases = [
        (
            Scene::paper(),
            "fc5d2a4255df82ee6e8846d8ebcbc2281a2334b62ad9ac0d640c1db605a73201",
            "29401daa52b8a7c53a3b2a4770b4dd8ba204b6fa83aa356961dfbc2166bcb226",
        ),
        (
            Scene::smooth(),
            "34c73adf66cf234080572ab8b6e98e6d4e85f61a392999149155e0ccd5225b70",
            "22149003bee2bbb5d547b8713c108ea6c3570db37a74553c634e85d67bc0f119",
        ),
        (
            Scene::paper().with_multiple_scattering(true),
            "5d87abd2be1d4a5742156e2cdff507296beefd9093f45e8b69b3938aae9c8575",
            "10c77b41a054d4c501ca33b3d640b5dee7c425c56d9e8bb5ecec9728e54357e9",
        ),
    ];
    for (scene, expected, corrected) in cases {
        let mut run = Run::new(pixels(scene, 10.0, 60), [6.0, 0.4, 0.5, 1.53], &[0.05, 0.9991], 65_000);
        run.derivatives = true;
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let digest = Digest::of_records(&pool.install(|| run.records(1)));
            assert_eq!(digest.to_string(), expected, "{threads} threads");
            let records = pool.install(|| optics_layers::records(&run.job(1), &AtomicBool::new(false)));
            assert_eq!(Digest::of_records(&records.unwrap()).to_string(), corrected, "{threads} threads");
        }
        for kernel in Kernel::all() {
            let digest =
                Digest::of_records(&trace_with(kernel, &run.job(1), &AtomicBool::new(false)).unwrap());
            assert_eq!(digest.to_string(), expected, "{kernel}");
        }
    }
}
