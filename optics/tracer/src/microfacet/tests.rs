//! Tests visible normals against quadratures, and rays on the microsurface against the plain model.

use super::*;
use crate::testing::chi_square;
use std::f64::consts::PI;

/// D(m) = α² / (π ((α² − 1) cos² θ + 1)²), in 1/sr.
fn density(cos: f64, alpha: f64) -> f64 {
    let a2 = alpha * alpha;
    a2 / (PI * ((a2 - 1.0) * cos * cos + 1.0).powi(2))
}

fn g1(cos: f64, alpha: f64) -> f64 {
    2.0 / (1.0 + (1.0 + alpha * alpha * (1.0 - cos * cos) / (cos * cos)).sqrt())
}

fn direction(theta: f64) -> Vec3 {
    Vec3::new(libm::sin(theta) as f32, 0.0, libm::cos(theta) as f32)
}

/// Cells: 10 of θ_m up to the angle that holds most of the surface, by 8 of azimuth, and the rest.
fn probabilities(theta: f64, alpha: f64) -> Vec<f64> {
    let wi = [libm::sin(theta), 0.0, libm::cos(theta)];
    let limit = 3.0 * alpha;
    let mut cells = vec![0.0; 81];
    let (n, k) = (400, 400);
    for i in 0..10 * n {
        let tan = (f64::from(i) + 0.5) / f64::from(10 * n) * limit;
        let cos = 1.0 / (1.0 + tan * tan).sqrt();
        let sin = tan * cos;
        // dω = sin θ dθ dφ, dθ = cos² θ d tan θ.
        let d_theta = limit / f64::from(10 * n) * cos * cos;
        for j in 0..8 * k {
            let phi = (f64::from(j) + 0.5) / f64::from(8 * k) * 2.0 * PI;
            let visible = (wi[0] * sin * libm::cos(phi) + wi[2] * cos).max(0.0);
            let d_omega = sin * d_theta * 2.0 * PI / f64::from(8 * k);
            let cell = (i / n * 8 + j / k) as usize;
            cells[cell] += g1(wi[2], alpha) * visible * density(cos, alpha) / wi[2] * d_omega;
        }
    }
    cells[80] = 1.0 - cells[..80].iter().sum::<f64>();
    cells
}

/// χ² over 81 cells with 300,000 samples at the 1e-4 level; a roughness wrong by 3 % fails it.
#[test]
fn sampled_normals_follow_the_visible_distribution() {
    for (theta, alpha) in [(0.0, 0.15), (0.7, 0.15), (1.4, 0.5)] {
        let p_value = |sampled_alpha: f64| {
            let mut counts = vec![0_u64; 81];
            for walk in 0..300_000 {
                let words = Stream::new([13, 17], 0, walk).words();
                let m = sample_visible_normal(
                    direction(theta),
                    sampled_alpha as f32,
                    uniform(words[1]),
                    words[2],
                );
                let tan = f64::from(libm::hypotf(m.x, m.y) / m.z) / (3.0 * alpha);
                let phi = libm::atan2(f64::from(m.y), f64::from(m.x)).rem_euclid(2.0 * PI);
                let cell = if tan < 1.0 {
                    (tan * 10.0) as usize * 8 + ((phi / (2.0 * PI) * 8.0) as usize).min(7)
                } else {
                    80
                };
                counts[cell] += 1;
            }
            chi_square(&counts, &probabilities(theta, alpha))
        };
        assert!(p_value(alpha) > 1e-4, "theta {theta}, alpha {alpha}: p = {}", p_value(alpha));
        assert!(p_value(alpha * 1.03) < 1e-4, "a wrong roughness must be noticed");
    }
}

/// Visible normals from below: their mean must be the average of D max(0, wi·m) m, by quadrature.
#[test]
fn visible_normals_have_the_right_mean() {
    let (theta, alpha) = (1.8_f64, 0.5);
    let wi = [libm::sin(theta), 0.0, libm::cos(theta)];
    let (mut weight, mut mean_z, mut mean_x) = (0.0, 0.0, 0.0);
    for i in 0..2000 {
        let cos = (f64::from(i) + 0.5) / 2000.0;
        let sin = (1.0 - cos * cos).sqrt();
        for j in 0..1000 {
            let phi = (f64::from(j) + 0.5) / 1000.0 * 2.0 * PI;
            let w = (wi[0] * sin * libm::cos(phi) + wi[2] * cos).max(0.0) * density(cos, alpha);
            weight += w;
            mean_z += w * cos;
            mean_x += w * sin * libm::cos(phi);
        }
    }
    let n = 400_000;
    let (mut z, mut x) = (0.0, 0.0);
    for walk in 0..n {
        let words = Stream::new([19, 23], 0, walk).words();
        let m = sample_visible_normal(direction(theta), alpha as f32, uniform(words[1]), words[2]);
        assert!(m.dot(direction(theta)) > -1e-6);
        z += f64::from(m.z) / f64::from(n);
        x += f64::from(m.x) / f64::from(n);
    }
    // Standard deviations are below 0.25: 5 standard errors of 400,000 samples.
    assert!((z - mean_z / weight).abs() < 2e-3, "{z} {}", mean_z / weight);
    assert!((x - mean_x / weight).abs() < 2e-3, "{x} {}", mean_x / weight);
}

/// A microsurface of index 1 changes nothing: all rays go straight through.
#[test]
fn surface_between_equal_media_is_invisible() {
    let wi = direction(0.6);
    for walk in 0..1000 {
        let mut stream = Stream::new([29, 31], 0, walk);
        let index = RelativeIndex::new(1.0, 1.0);
        let words = stream.words();
        let out = scatter_until_out(wi, 0.3, [index; 2], words, &mut stream);
        assert!((out + wi).length() < 1e-5);
        let single = scatter_once(wi, 0.3, index, stream.words()).unwrap();
        assert!((single.direction + wi).length() < 1e-5);
    }
}

/// Detailed balance between the sides: light that goes n₁ → n₂ into all directions from a Lambertian source
/// equals, up to η², the light that comes back. Total transmittance of diffuse light obeys n₁² T₁₂ = n₂² T₂₁. Standard
/// error of each T: below 0.0008 at 400,000 rays.
#[test]
fn diffuse_transmittances_of_both_sides_obey_reciprocity() {
    let transmittance = |indices: [RelativeIndex; 2], alpha: f32, key: u32| {
        let n = 400_000;
        let through = (0..n).filter(|&walk| {
            let mut stream = Stream::new([37, key], 0, walk);
            let words = stream.words();
            let (u, (c, s)) = (uniform(words[0]), unit_vector(words[1]));
            let wi = Vec3::new(u.sqrt() * c, u.sqrt() * s, (1.0 - u).sqrt());
            let words = stream.words();
            scatter_until_out(wi, alpha, indices, words, &mut stream).z < 0.0
        });
        through.count() as f64 / f64::from(n)
    };
    for alpha in [0.15, 0.6] {
        let (above, below) = (RelativeIndex::new(1.0, 1.5), RelativeIndex::new(1.5, 1.0));
        let (down, up) = (transmittance([above, below], alpha, 1), transmittance([below, above], alpha, 2));
        assert!((down - 2.25 * up).abs() < 5.0 * 0.0008 * (1.0 + 2.25), "{down} {}", 2.25 * up);
    }
}

/// The model of Heitz et al. 2016 without shortcuts: a random height at every event, and the power as the probability
/// that the ray leaves.
fn scatter_plainly(wi: Vec3, alpha: f32, indices: [RelativeIndex; 2], stream: &mut Stream) -> Vec3 {
    let (mut ray, mut c, mut side) = (-wi, 1.0_f64, 0);
    loop {
        let words = stream.words();
        let d = ray.as_dvec3();
        let tan2 = (1.0 - d.z * d.z).max(0.0) / (d.z * d.z);
        let lambda = 0.5 * ((1.0 + f64::from(alpha * alpha) * tan2).sqrt() - 1.0);
        let u = f64::from(uniform(words[0]));
        if d.z <= 0.0 {
            c *= libm::pow(u, 1.0 / (1.0 + lambda));
        } else if u < libm::pow(c, lambda) {
            return Vec3::new(ray.x, ray.y, if side == 0 { ray.z } else { -ray.z });
        } else {
            c /= libm::pow(u, 1.0 / lambda);
        }
        let m = sample_visible_normal(-ray, alpha, uniform(words[1]), words[2]);
        let cos_i = m.dot(-ray);
        let facet = Facet::new(cos_i, indices[side]);
        if facet.reflects(uniform(words[3])) {
            ray = unit(reflect(-ray, m, cos_i));
        } else {
            let t = unit(refract(-ray, m, cos_i, facet.cos_t, indices[side].eta));
            (ray, c, side) = (Vec3::new(t.x, t.y, -t.z), 1.0 - c, 1 - side);
        }
    }
}

/// Deciding by a bound first, and splitting the first event, sample the same distribution: in 40 cells of the cosine
/// 400,000 rays agree with four times as many plain ones within 4.5 standard errors.
#[test]
fn quick_and_split_rays_follow_the_model() {
    let (above, below) = (RelativeIndex::new(1.0, 1.5), RelativeIndex::new(1.5, 1.0));
    for (theta, alpha, indices) in [
        (0.5, 0.15, [above, below]),
        (1.45, 0.3, [above, below]),
        (0.3, 0.5, [below, above]),
        (1.3, 0.8, [below, above]),
    ] {
        let (n, wi) = (400_000, direction(theta));
        let cell = |wo: Vec3| ((20.0 * wo.z + 20.0) as usize).min(39);
        let (mut plain, mut quick, mut split) = ([0.0; 40], [0; 40], [0.0; 40]);
        for walk in 0..4 * n {
            let stream = &mut Stream::new([53, 59], 0, walk);
            plain[cell(scatter_plainly(wi, alpha, indices, stream))] += 0.25 / f64::from(n);
        }
        for walk in 0..n {
            let stream = &mut Stream::new([61, 67], 0, walk);
            let words = stream.words();
            quick[cell(scatter_until_out(wi, alpha, indices, words, stream))] += 1;
            let m = sample_visible_normal(wi, alpha, uniform(words[0]), words[1]);
            for (wo, share) in split_until_out(wi, m, alpha, indices, 0.05, stream) {
                split[cell(wo)] += share / f64::from(n);
            }
        }
        for ((p, quick), split) in plain.iter().zip(quick).zip(split) {
            // Standard errors of both counts, of which the plain one has a quarter of the variance.
            let error = (1.25 * p / f64::from(n)).sqrt() + 1e-6;
            let quick = f64::from(quick) / f64::from(n);
            assert!((quick - p).abs() < 4.5 * error, "{theta} {alpha}: {quick} {p}");
            assert!((split - p).abs() < 4.5 * error, "{theta} {alpha}: {split} {p}");
        }
        let all: f64 = split.iter().sum();
        assert!((all - 1.0).abs() < 1e-3, "{all}");
    }
}
