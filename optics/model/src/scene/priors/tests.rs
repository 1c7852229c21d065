//! Checks steps, ranges and refusals of priors.

use super::*;

fn prior(kind: PriorKind, layers: &[usize], std_error: f64) -> Prior {
    Prior::new(kind, layers.to_vec(), std_error, Scope::Session).unwrap()
}

/// Steps are large where profiles are nearly linear, and stay among the possible values.
#[test]
fn steps_follow_value_and_prior() {
    let scene = Scene::paper();
    let steps = |kind, layers: &[usize], sd| prior(kind, layers, sd).steps(&scene);
    for (sd, step) in [(0.01, 0.04), (0.015, 0.05), (0.03, 0.075)] {
        assert_eq!(steps(PriorKind::Index, &[1, 3], sd), [-step, step]);
    }
    // The index of a layer is at least 1.
    let thin = Layer::clear("gel", 1.03, 0.02, 0.0).unwrap();
    let layers = vec![Layer::sample("sample", 0.05).unwrap(), thin];
    let airy = Scene { layers, ..Scene::paper() };
    let [low, high] = prior(PriorKind::Index, &[1], 0.01).steps(&airy)[..] else { panic!() };
    assert!((low + 0.03).abs() < 1e-12 && (high - 0.03).abs() < 1e-12, "{low} {high}");
    assert_eq!(steps(PriorKind::Thickness, &[0], 0.02), [-0.08, 0.08]);
    let gel = prior(PriorKind::Thickness, &[1, 3], 0.02);
    assert_eq!(gel.steps(&scene), [-0.015, 0.08]);
    let (low, high) = gel.range(&scene);
    assert!(low == -0.015 && (high - 0.088).abs() < 1e-12, "{low} {high}");
    // Two standard deviations down where there is room for them.
    assert_eq!(steps(PriorKind::Roughness, &[4], 0.05), [-0.1, 0.1]);
    assert_eq!(steps(PriorKind::Roughness, &[2], 0.03), [-0.037_500_000_000_000_006, 0.06]);
}

/// The ring moves both ways where it stays between the camera's mirror image and the horizon, otherwise to one side.
#[test]
fn ring_keeps_clear_of_the_mirror_image() {
    let steps = |[inner, outer]: [f64; 2], sensor: f64, sd: f64| {
        let light = RingLight::new(inner, outer).unwrap();
        let sensor = Sensor::new(10.0, 360, sensor).unwrap();
        let scene = Scene { light, sensor, ..Scene::paper() };
        prior(PriorKind::RingAngle, &[], sd).steps(&scene)
    };
    for (ring, sensor, sd, expected) in [
        ([40.0, 50.0], 0.0, 1.0, &[-4.0, 4.0][..]),
        ([4.0, 50.0], 0.0, 1.0, &[2.0]),
        ([8.0, 18.0], 5.0, 1.0, &[2.0]),
        ([10.0, 20.0], 5.0, 1.0, &[-4.0, 4.0]),
        ([40.0, 50.0], 53.0, 1.0, &[2.0]),
        ([10.0, 50.0], 0.0, 3.0, &[6.0]),
        ([40.0, 80.0], 0.0, 3.0, &[6.0]),
        ([40.0, 80.0], 0.0, 6.0, &[-12.0]),
    ] {
        assert_eq!(steps(ring, sensor, sd), expected, "{ring:?} {sensor} {sd}");
    }
}

/// Responses that were traced at one step of a thickness hold as far as those of any nearly linear quantity.
#[test]
fn ranges_follow_the_traced_steps() {
    let scene = Scene::paper();
    let slip = prior(PriorKind::Thickness, &[0], 0.02);
    assert_eq!(slip.range_of(&scene, &[0.04]), (-0.1, 0.1));
    assert_eq!(slip.range_of(&scene, &slip.steps(&scene)), slip.range(&scene));
    assert_eq!(slip.range(&scene).0, -0.08);
}

/// With the bend, differences of a roughness are proportional to those of its square.
#[test]
fn roughness_bends_with_its_square() {
    let scene = Scene::paper();
    let coat = prior(PriorKind::Roughness, &[4], 0.05);
    let square = |u: f64| ((0.15 + 0.05 * u).powi(2) - 0.15_f64.powi(2)) / (2.0 * 0.15 * 0.05);
    let bent = |u: f64| u * (1.0 + coat.bend(&scene) * u);
    assert!([-2.0, 0.7, 2.5].iter().all(|u| (square(*u) - bent(*u)).abs() < 1e-12));
    assert_eq!(prior(PriorKind::Index, &[4], 0.05).bend(&scene), 0.0);
}

/// A varied scene differs in the quantity alone, in all layers that share it.
#[test]
fn varied_scene_differs_in_one_quantity() {
    let scene = Scene::paper();
    let rough = prior(PriorKind::Roughness, &[2, 3], 0.03);
    let varied = scene.varied(&rough, 0.03, scene.channels().to_vec()).unwrap();
    let roughness = |s: &Scene| s.layers().iter().map(Layer::roughness).collect::<Vec<_>>();
    assert_eq!(roughness(&varied), [0.0, 0.0, 0.08, 0.08, 0.15]);
    assert_eq!((varied.light(), varied.sensor()), (scene.light(), scene.sensor()));
    let index = prior(PriorKind::Index, &[2], 0.01);
    assert!(index.is_sample_index(&scene));
    let varied = scene.varied(&index, 0.01, scene.channels().to_vec()).unwrap();
    assert_eq!((varied.sample_ior_offset(), varied.layers()), (0.01, scene.layers()));
}

/// Refusals name the prior and the allowed values.
#[test]
fn impossible_priors_are_refused() {
    let refused = |priors: Vec<Prior>| Scene::paper().with_priors(priors).unwrap_err().to_string();
    for (bad, expected) in [
        (prior(PriorKind::Thickness, &[2], 0.1), "priors[0].layers = the thickness of the sample"),
        (prior(PriorKind::Roughness, &[1, 3], 0.1), "priors[0].layers = gel, gel"),
        (prior(PriorKind::Roughness, &[9], 0.1), "priors[0].layers = 9"),
        (prior(PriorKind::Roughness, &[0], 0.02), "priors[0].std_error = 0.02 for glass slip roughness"),
        (prior(PriorKind::RingAngle, &[1], 0.1), "priors[0].layers = 1 layers for a ring angle"),
        (prior(PriorKind::Index, &[0], 3.0), "priors[0].std_error = 3"),
        (prior(PriorKind::RingAngle, &[], 60.0), "priors[0].std_error = 60"),
    ] {
        let error = refused(vec![bad]);
        assert!(error.starts_with(expected), "{error}");
    }
    let twice = prior(PriorKind::Index, &[1, 3], 0.01);
    assert!(refused(vec![twice.clone(), twice]).starts_with("priors[1].kind = index"));
    assert!(Prior::new(PriorKind::Index, vec![0], 0.0, Scope::Slab).is_err());
}

/// Steps of the base follow the spread's prior and go down in ρ; haze has none, and needs another quantity.
#[test]
fn base_and_haze_have_their_steps() {
    let scene = Scene::paper();
    let quantity = |kind, sd| prior(kind, &[], sd);
    assert_eq!(
        quantity(PriorKind::BaseSpread, 0.1).steps(&scene),
        [0.025, 0.06, 0.13, 0.300_000_000_000_000_04]
    );
    assert_eq!(quantity(PriorKind::LightSide, 0.015).steps(&scene), [-0.03]);
    let haze = quantity(PriorKind::Haze, 0.01);
    assert_eq!((haze.steps(&scene), haze.range(&scene)), (Vec::new(), (-0.02, 0.05)));
    let darker =
        scene.varied(&quantity(PriorKind::LightSide, 0.015), -0.1, scene.channels().to_vec()).unwrap();
    let blacker =
        darker.varied(&quantity(PriorKind::DarkSide, 0.01), 0.01, darker.channels().to_vec()).unwrap();
    for (channel, own) in blacker.channels().iter().zip(scene.channels()) {
        assert_eq!(channel.rho_light(), 0.9 * own.rho_light());
        assert_eq!(channel.rho_dark(), own.rho_dark() + 0.01);
    }
    let error = Scene::paper().with_priors(vec![haze]).unwrap_err().to_string();
    assert!(error.contains("haze needs another quantity"), "{error}");
    let spread =
        scene.varied(&quantity(PriorKind::BaseSpread, 0.1), 0.05, scene.channels().to_vec()).unwrap();
    assert_eq!(spread.base_spread_mm(), 0.05);
    assert!(Scene::paper().with_base_spread(-0.1).is_err());
}
