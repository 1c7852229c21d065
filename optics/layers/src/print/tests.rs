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
    let value_and_error = |profile: &optics_model::Profile| {
        let estimate = &profile.radiance_factor;
        (f64::from(estimate.values()[0]), f64::from(estimate.std_errors()[0]))
    };
    record.profiles.iter().map(value_and_error).collect()
}

/// A closed white furnace: whatever scatters without absorbing returns all light of the whole hemisphere.
#[test]
fn white_furnace_loses_no_light() {
    for scene in [Scene::smooth(), Scene::lab()] {
        let furnace = scene.with_multiple_scattering(true).with_light(RingLight::new(0.0, 90.0).unwrap());
        let print = Print::new(&furnace, IOR, 0.2);
        for g in [0.0, 0.8] {
            let found = print.radiance_factors(&[plain(5.0, 1.0, g, 1.0)], &[1.0]);
            assert!((found[0] - 1.0).abs() < 1e-6, "{g}: {found:?}");
        }
    }
}

/// Without slab, faces and coat the radiance factor is ρ.
#[test]
fn thin_clear_slab_shows_its_base() {
    let print = Print::new(&stack(vec![Layer::sample("sample", 0.0).unwrap()], [40.0, 50.0], 0.0), 1.0, 0.2);
    let found = print.radiance_factors(&[plain(1e-4, 0.0, 0.0, 1e-4)], &[0.5]);
    assert!((found[0] - 0.5).abs() < 1e-6, "{found:?}");
}

/// Layers whose rough faces lose no light, in this ring and seen from this angle.
fn stack(layers: Vec<Layer>, [inner, outer]: [f64; 2], polar_deg: f64) -> Scene {
    let light = RingLight::new(inner, outer).unwrap();
    let sensor = Sensor::new(10.0, 1, polar_deg).unwrap();
    Scene::new(layers, Scene::smooth().channels().to_vec(), light, sensor, true).unwrap()
}

fn check(scene: &Scene, slab: &PrintLayer) {
    let rho = [0.03, 0.95];
    let peak = slab.phase.function(slab.medium.g()).unwrap().peak_width();
    let found = Print::new(scene, IOR, peak).radiance_factors(std::slice::from_ref(slab), &rho);
    for (found, (walked, std_error)) in found.iter().zip(traced(scene, slab, &rho, 400_000)) {
        let off = (found - walked).abs();
        let ring = (scene.light().inner_deg(), scene.light().outer_deg());
        assert!(off < 4.0 * std_error + 1e-3 * walked, "{ring:?} {slab:?}: {found} {walked} ± {std_error}");
    }
}

/// The tracer's radiance factors agree within four standard errors and 0.1 %.
#[test]
fn radiance_factors_agree_with_walks() {
    for scene in [Scene::smooth(), Scene::paper(), Scene::lab()] {
        for slab in [plain(6.0, 0.9991, 0.4, 0.5), plain(5.5, 0.35, 0.4, 1.0), plain(12.0, 0.98, 0.8, 0.5)] {
            check(&scene, &PrintLayer { phase: scene.phase().clone(), ..slab });
        }
    }
}

/// They agree through very rough faces, in rings near the normal and of one degree, and with narrow peaks of both
/// directions.
#[test]
fn hard_geometries_agree_with_walks() {
    for (roughness, ring) in
        [(0.3, [40.0, 50.0]), (1.0, [40.0, 50.0]), (0.05, [0.0, 5.0]), (0.1, [44.0, 45.0])]
    {
        let air = Layer::clear("air", 1.0, 0.0, roughness).unwrap();
        let layers = vec![Layer::sample("print", roughness).unwrap(), air];
        check(&stack(layers, ring, Scene::lab().sensor().polar_deg()), &plain(7.0, 0.99, 0.4, 0.5));
    }
    for g in [0.9, -0.9, Print::MOST_G] {
        check(&Scene::smooth(), &plain(7.0, 0.99, g, 0.5));
    }
}

/// Two slabs of one medium are one of their thicknesses together.
#[test]
fn slabs_of_one_medium_add_up() {
    let print = Print::new(&Scene::smooth(), IOR, 0.2);
    let part = |mm: f64| plain(6.0, 0.99, 0.4, mm);
    let one = print.radiance_factors(&[part(0.7)], &[0.2]);
    let two = print.radiance_factors(&[part(0.3), part(0.4)], &[0.2]);
    assert!((one[0] / two[0] - 1.0).abs() < 1e-5, "{one:?} {two:?}");
}

/// Light that does not come back passes, where nothing absorbs; Beer's law holds where nothing scatters.
#[test]
fn light_passes_or_comes_back() {
    let furnace = Scene::smooth().with_light(RingLight::new(0.0, 90.0).unwrap());
    let print = Print::new(&furnace, IOR, 0.2);
    let white = plain(6.0, 1.0, 0.4, 0.5);
    let reflected = print.radiance_factors(std::slice::from_ref(&white), &[0.0])[0];
    // The base without reflectance takes what enters it; between air and the lowest layer nothing is reflected.
    let bare = stack(vec![Layer::sample("sample", 0.0).unwrap()], [0.0, 90.0], 0.0);
    let matched = Print::new(&bare, 1.0, 0.2);
    let back = matched.radiance_factors(std::slice::from_ref(&white), &[0.0])[0];
    let passed = matched.transmittance(std::slice::from_ref(&white));
    assert!((back + passed - 1.0).abs() < 1e-6 && reflected > 0.2, "{back} {passed} {reflected}");
    let black = plain(2.0, 0.0, 0.0, 1.0);
    let beer = matched.transmittance(std::slice::from_ref(&black));
    assert!((beer / libm::exp(-2.0_f64) - 1.0).abs() < 1e-4, "{beer}");
}

/// Reflectances and transmittances of light from one direction and of even light are those of Prahl's adding–doubling
/// program (github.com/scottprahl/iad, version 4.0.0): albedo 0.9, optical depth 1, g 0.8; without interfaces at 0° and
/// 45° (`ad -m -a 0.9 -b 1 -g 0.8 -q 32`, `-i 45`), and with an index of 1.4 between glass slides of 1.5 (`-n 1.4 -s 1.5 -t
/// 1.5 -q 64`). Its last digit is 1e-5.
#[test]
fn slabs_agree_with_another_adding_doubling() {
    let slab = [plain(1.0, 0.9, 0.8, 1.0)];
    let glass = |name| Layer::clear(name, 1.5, 1.0, 0.0).unwrap();
    let bare = || vec![Layer::sample("slab", 0.0).unwrap()];
    let slides = || {
        let air = Layer::clear("air", 1.0, 0.0, 0.0).unwrap();
        vec![glass("upper"), Layer::sample("slab", 0.0).unwrap(), glass("lower"), air]
    };
    let cases = [
        (bare(), 1.0, 0.0, [0.042_36, 0.845_38, 0.116_62]),
        (bare(), 1.0, 45.0, [0.082_98, 0.759_31, 0.116_62]),
        (slides(), 1.4, 0.0, [0.106_39, 0.719_00, 0.181_15]),
    ];
    for (layers, ior, polar_deg, expected) in cases {
        let print = Print::new(&stack(layers, [0.0, 90.0], polar_deg), ior, 0.2);
        let found = [
            print.radiance_factors(&slab, &[0.0])[0],
            print.transmittance(&slab),
            print.reflectances(&slab, &[0.0])[0],
        ];
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 3e-5, "{ior} {polar_deg}: {found} {expected}");
        }
    }
}
