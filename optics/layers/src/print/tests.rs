use std::sync::atomic::AtomicBool;

use optics_model::job::JobSpec;
use optics_model::scene::{Channel, Layer, RingLight, Sensor};
use optics_model::{TransportPoint, Walks};

use super::*;

const IOR: f64 = 1.53;

fn plain(sigma_t: f64, albedo: f64, g: f64, thickness_mm: f64) -> PrintLayer {
    let medium = Medium::new(sigma_t, albedo, g).unwrap();
    PrintLayer { medium, phase: PhaseShape::default(), thickness_mm }
}

/// Radiance factor and standard error by the Monte Carlo tracer, over uniform bases.
fn traced(scene: &Scene, slab: &PrintLayer, rho: &[f64], walks: u64) -> Vec<(f64, f64)> {
    let channel = |rho: &f64| Channel::new(rho.to_string(), *rho, *rho).unwrap();
    let scene = scene.clone().with_phase(slab.phase.clone()).with_priors(Vec::new()).unwrap();
    let scene = scene.with_channels(rho.iter().map(channel).collect()).unwrap();
    let polar_deg = scene.sensor().polar_deg();
    let scene = scene.with_sensor(Sensor::new(10.0, 1, polar_deg).unwrap());
    let medium = slab.medium;
    let point = TransportPoint::new(medium.sigma_t_per_mm(), medium.g(), slab.thickness_mm, IOR).unwrap();
    let walks = Walks::new(walks).unwrap();
    let job = JobSpec::new(scene, point, vec![medium.albedo()], walks, 1, false).unwrap();
    let record = optics_tracer::trace(&job, &AtomicBool::new(false)).unwrap().remove(0);
    let of = |profile: &optics_model::Profile| {
        let estimate = &profile.radiance_factor;
        (f64::from(estimate.values()[0]), f64::from(estimate.std_errors()[0]))
    };
    record.profiles.iter().map(of).collect()
}

/// A closed white furnace: whatever scatters without absorbing returns all light of the whole hemisphere.
#[test]
fn white_furnace_loses_no_light() {
    for scene in [Scene::smooth(), Scene::lab()] {
        let furnace = scene.with_multiple_scattering(true).with_light(RingLight::new(0.0, 90.0).unwrap());
        let print = Print::new(&furnace, IOR);
        for g in [0.0, 0.8] {
            let found = print.radiance_factors(&[plain(5.0, 1.0, g, 1.0)], &[1.0]).unwrap();
            assert!((found[0] - 1.0).abs() < 1e-6, "{g}: {found:?}");
        }
    }
}

/// Without slab, faces and coat the radiance factor is ρ.
#[test]
fn thin_clear_slab_shows_its_base() {
    let layers = vec![Layer::sample("sample", 0.0).unwrap()];
    let paper = Scene::paper();
    let scene = Scene::new(layers, paper.channels().to_vec(), paper.light(), paper.sensor(), true).unwrap();
    let print = Print::new(&scene, 1.0);
    let found = print.radiance_factors(&[plain(1e-4, 0.0, 0.0, 1e-4)], &[0.5]).unwrap();
    assert!((found[0] - 0.5).abs() < 1e-6, "{found:?}");
}

/// The tracer's radiance factors agree within four standard errors and 0.1 %.
#[test]
fn radiance_factors_agree_with_walks() {
    let lab = Scene::lab();
    for scene in [Scene::smooth(), Scene::paper(), lab.clone()] {
        let print = Print::new(&scene, IOR);
        for slab in [plain(6.0, 0.9991, 0.4, 0.5), plain(5.5, 0.35, 0.4, 1.0), plain(12.0, 0.98, 0.8, 0.5)] {
            let slab = PrintLayer { phase: scene.phase().clone(), ..slab };
            let rho = [0.03, 0.95];
            let found = print.radiance_factors(std::slice::from_ref(&slab), &rho).unwrap();
            for (found, (walked, std_error)) in found.iter().zip(traced(&scene, &slab, &rho, 400_000)) {
                let off = (found - walked).abs();
                println!(
                    "{found:.5} {walked:.5} ± {std_error:.5}: {:.2} σ, {:.3} %",
                    off / std_error,
                    100.0 * off / walked
                );
                assert!(off < 4.0 * std_error + 1e-3 * walked, "{found} {walked} {std_error}");
            }
        }
    }
}

/// Two slabs of one medium are one of their thicknesses together.
#[test]
fn slabs_of_one_medium_add_up() {
    let print = Print::new(&Scene::smooth(), IOR);
    let part = |mm: f64| plain(6.0, 0.99, 0.4, mm);
    let one = print.radiance_factors(&[part(0.7)], &[0.2]).unwrap();
    let two = print.radiance_factors(&[part(0.3), part(0.4)], &[0.2]).unwrap();
    assert!((one[0] / two[0] - 1.0).abs() < 1e-5, "{one:?} {two:?}");
}

/// Light that does not come back passes, where nothing absorbs; Beer's law holds where nothing scatters.
#[test]
fn light_passes_or_comes_back() {
    let furnace = Scene::smooth().with_light(RingLight::new(0.0, 90.0).unwrap());
    let print = Print::new(&furnace, IOR);
    let white = plain(6.0, 1.0, 0.4, 0.5);
    let reflected = print.radiance_factors(std::slice::from_ref(&white), &[0.0]).unwrap()[0];
    // The base without reflectance takes what enters it; between air and the lowest layer nothing is reflected.
    let layers = vec![Layer::sample("sample", 0.0).unwrap()];
    let bare =
        Scene::new(layers, furnace.channels().to_vec(), furnace.light(), furnace.sensor(), true).unwrap();
    let matched = Print::new(&bare, 1.0);
    let back = matched.radiance_factors(std::slice::from_ref(&white), &[0.0]).unwrap()[0];
    let passed = matched.transmittance(std::slice::from_ref(&white)).unwrap();
    assert!((back + passed - 1.0).abs() < 1e-6 && reflected > 0.2, "{back} {passed} {reflected}");
    let black = plain(2.0, 0.0, 0.0, 1.0);
    let beer = matched.transmittance(std::slice::from_ref(&black)).unwrap();
    assert!((beer / (-2.0_f64).exp() - 1.0).abs() < 1e-4, "{beer}");
}
