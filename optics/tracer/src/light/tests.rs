//! Compares the light with sums over its rays, and with exact cases.

use std::sync::Arc;

use optics_model::Scene;
use optics_model::phase::{PhaseShape, PhaseTable, SecondLobe};

use super::*;
use crate::testing::stack;

/// C by its definition.
fn exact(stack: &Stack, arrivals: &Arrivals, z: f64, u: f64) -> f64 {
    let (thickness, phase) = (f64::from(stack.thickness[stack.sample]), stack.phase.function());
    let term = |beam: &Beam| {
        let (d, u) = if beam.down { (thickness - z, u) } else { (z, -u) };
        let length = d / beam.cosine + thickness * beam.passed;
        beam.flux / beam.cosine * phase.azimuthal_mean(u, beam.cosine) * libm::exp(-length)
    };
    let n2 = stack.iors[stack.sample].powi(2);
    let [inner, outer] = stack.ring_sin2.map(f64::from);
    PI * (outer - inner) / n2 * arrivals.sample.iter().map(term).sum::<f64>()
}

/// The table gives the sum of the rays.
#[test]
fn table_matches_the_sum_of_rays() {
    let table = PhaseTable::new(vec![0.0, 30.0, 60.0, 180.0], vec![9.0, 2.0, 0.5, 1.0]).unwrap();
    let mean = table.mean_cosine();
    let table = PhaseShape::Table(Arc::new(table));
    let lobes = |weight, g| PhaseShape::Lobes(SecondLobe::new(weight, g).unwrap());
    for (phase, point) in [
        (PhaseShape::default(), [1.0, 0.0, 0.25, 1.53]),
        (PhaseShape::default(), [6.0, 0.4, 0.5, 1.53]),
        (PhaseShape::default(), [20.0, 0.9, 1.0, 1.48]),
        (PhaseShape::default(), [600.0, -0.5, 0.5, 1.53]),
        (PhaseShape::default(), [2.0, 0.97, 0.5, 1.53]),
        (lobes(0.1, -0.5), [6.0, 0.4, 0.5, 1.53]),
        (lobes(0.25, -0.65), [6.0, 0.4, 0.5, 1.53]),
        (lobes(0.12, -0.5), [20.0, 0.8, 0.5, 1.53]),
        (table, [6.0, mean, 0.5, 1.53]),
    ] {
        let stack = stack(&Scene::paper().with_phase(phase), point);
        let (light, arrivals) = (Light::new(&stack, false), Arrivals::of(&stack));
        let thickness = point[0] * point[2];
        let brightest = exact(&stack, &arrivals, thickness, 1.0);
        let mut worst = 0.0_f64;
        for i in 0..200 {
            for k in 0..200 {
                // Evenly spaced in the square root of the depth, since light is near the top.
                let depth = thickness * ((f64::from(i) + 0.37) / 200.0).powi(2);
                let (z, u) = (thickness - depth, -1.0 + 2.0 * (f64::from(k) + 0.41) / 200.0);
                let c = exact(&stack, &arrivals, z, u);
                let found = light.at(z as f32, u as f32).0;
                // Grazing light at the lower face is too faint to matter.
                worst = worst.max((found - c).abs() / (c + 1e-3 * brightest));
            }
        }
        assert!(worst < 1e-3, "{point:?}: {worst}");
    }
}
