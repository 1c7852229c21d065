//! Checks densities and azimuthal means with integrals.

use super::*;

const GS: [f64; 8] = [-0.9, -0.3, 0.0, 1e-4, 0.4, 0.8, 0.95, 0.97];

/// Plain lobes of these anisotropies, and two with a second lobe.
fn functions() -> Vec<PhaseFunction> {
    let plain = GS.into_iter().map(|g| PhaseFunction::henyey_greenstein(g).unwrap());
    let two = [(0.4, 0.1, -0.5), (0.7, 0.25, 0.3)];
    let two = two.map(|(g, b, g2)| PhaseShape::Lobes(SecondLobe::new(b, g2).unwrap()).function(g).unwrap());
    plain.chain(two).collect()
}

/// The integral of the density is 1, and that of its cosine the mean cosine.
#[test]
fn density_integrates_to_one_over_the_sphere() {
    for phase in functions() {
        let n = 2_000_000;
        let cosine = |i: i32| -1.0 + (f64::from(i) + 0.5) * 2.0 / f64::from(n);
        let (mut sum, mut cosines) = (0.0, 0.0);
        for c in (0..n).map(cosine) {
            let density = phase.density(c);
            (sum, cosines) = (sum + density, cosines + c * density);
        }
        let [integral, mean] = [sum, cosines].map(|s| s * 2.0 / f64::from(n) * std::f64::consts::TAU);
        assert!((integral - 1.0).abs() < 1e-6, "{phase:?}: {integral}");
        assert!((mean - phase.mean_cosine()).abs() < 1e-6, "{phase:?}: {mean}");
    }
}

/// The trapezoidal rule over the azimuth converges faster than any power.
#[test]
fn azimuthal_mean_matches_the_density() {
    for phase in functions().into_iter().filter(|p| p.peak_width() > 0.04) {
        for u in [-1.0, -0.7, -0.1, 0.3, 0.9, 1.0] {
            for mu in [0.05, 0.5, 0.88, 1.0_f64] {
                let n = 20_000;
                let at = |i: i32| {
                    let phi = 2.0 * PI * f64::from(i) / f64::from(n);
                    let across = ((1.0 - u * u) * (1.0 - mu * mu)).sqrt();
                    phase.density(u * mu + across * libm::cos(phi))
                };
                let mean = (0..n).map(at).sum::<f64>() / f64::from(n);
                let found = phase.azimuthal_mean(u, mu);
                assert!((found / mean - 1.0).abs() < 1e-10, "{phase:?}, u {u}, μ {mu}: {found}, not {mean}");
            }
        }
    }
}

/// A weight that walks can have differs by less than 1e-5, and the mean cosine stays.
#[test]
fn weight_of_walks_keeps_the_mean_cosine() {
    for (g, b, g2) in [(0.4, 0.1, -0.5), (0.77, 0.13, -0.3), (0.0, 1e-6, 0.9)] {
        let shape = PhaseShape::Lobes(SecondLobe::new(b, g2).unwrap());
        let walked = shape.function(g).unwrap().with_walk_weight();
        let PhaseFunction::Lobes { second, .. } = walked else { panic!("lobes stay lobes") };
        assert!((second.weight() - b).abs() < 1e-5);
        assert!((walked.mean_cosine() - g).abs() < 1e-15, "{}", walked.mean_cosine());
        assert!((walked.in_single_precision().mean_cosine() - g).abs() < 1e-7);
    }
}

/// Where the first lobe would need an anisotropy beyond 1, the message names the allowed mean cosines.
#[test]
fn mean_cosine_beyond_both_lobes_is_refused() {
    let shape = PhaseShape::Lobes(SecondLobe::new(0.2, -0.5).unwrap());
    assert!(shape.function(0.69).is_ok());
    let message = shape.function(0.8).unwrap_err().to_string();
    assert_eq!(
        message,
        "g = 0.8 is not valid: with a second lobe of weight 0.2 and anisotropy -0.5, allowed are -0.899 to 0.699; \
         without it -0.999 to 0.999"
    );
    assert!(shape.function_near(0.8).mean_cosine() < 0.7);
    let limited = SecondLobe::new(0.2, -0.5).unwrap().limited_to(0.8);
    assert!((limited.weight() - 0.199 / 1.499).abs() < 1e-12);
    assert!((limited.first(0.8) - 0.999).abs() < 1e-9);
    assert_eq!(SecondLobe::new(0.2, -0.5).unwrap().limited_to(0.6).weight(), 0.2);
    assert_eq!(SecondLobe::new(0.6, 0.0).unwrap_err().field(), "second_lobe_weight");
    assert_eq!(SecondLobe::new(0.1, 1.0).unwrap_err().field(), "second_lobe_g");
}
