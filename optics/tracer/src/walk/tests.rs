//! Tests exact cases for single walks, without a tally between the physics and the check.

use glam::Vec3;
use optics_model::scene::{RingLight, Scene};
use rayon::prelude::*;

use super::{Walk, WalkEvent};
use crate::light::Light;
use crate::math::unit_vector;
use crate::rng::{Stream, uniform};
use crate::stack::Stack;
use crate::testing::{clear, sample, scene, stack};

/// Mean and standard error.
fn statistics(samples: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for s in samples {
        n += 1.0;
        sum += s;
        squares += s * s;
    }
    let mean: f64 = sum / n;
    (mean, ((squares / n - mean * mean) / (n - 1.0)).sqrt())
}

fn assert_close((mean, error): (f64, f64), expected: f64, tolerance: f64, most_error: f64) {
    assert!(error < most_error, "standard error {error} is above the stated {most_error}");
    let z = (mean - expected) / libm::hypot(error, tolerance);
    assert!(z.abs() < 3.5, "{mean} ± {error}, expected {expected}: z = {z:.2}");
}

fn sample_over_air() -> Scene {
    scene(vec![sample(0.0), clear(1.0, 1.0, 0.0)], [0.0, 90.0], 0.0)
}

/// Runs walks with the given directions to their first event of a kind at which `end` holds.
fn walks<'a>(
    stack: &'a Stack,
    n: u32,
    key: u32,
    direction: impl Fn([u32; 4]) -> Vec3 + 'a,
    end: impl Fn(WalkEvent) -> bool + 'a,
) -> impl Iterator<Item = (Walk<'a>, WalkEvent)> {
    (0..n).map(move |index| {
        let mut stream = Stream::new([41, key], 0, index);
        let entry = direction(stream.words());
        let (mut walk, mut event) = Walk::enter(stack, entry, stream);
        while !end(event) {
            event = walk.step();
        }
        (walk, event)
    })
}

fn down(_: [u32; 4]) -> Vec3 {
    Vec3::NEG_Z
}

fn lambertian(words: [u32; 4]) -> Vec3 {
    let (u, (c, s)) = (uniform(words[0]), unit_vector(words[1]));
    Vec3::new(u.sqrt() * c, u.sqrt() * s, -(1.0 - u).sqrt())
}

fn left_or_through(event: WalkEvent) -> bool {
    matches!(event, WalkEvent::Left | WalkEvent::Base | WalkEvent::Lost)
}

fn left(event: WalkEvent) -> bool {
    matches!(event, WalkEvent::Left | WalkEvent::Lost)
}

/// Shares of the light that ends so, at an albedo of 0.9.
fn fate(stack: &Stack, n: u32, key: u32, wanted: WalkEvent) -> (f64, f64) {
    let weight = |(walk, event): (Walk, WalkEvent)| {
        if event == wanted { 0.9_f64.powi(walk.scatterings as i32) } else { 0.0 }
    };
    statistics(walks(stack, n, key, down, left_or_through).map(weight))
}

/// van de Hulst 1980, "Multiple light scattering", table 35: R 0.09739, T 0.66096.
#[test]
fn matched_slab_reflects_and_transmits_as_tabulated() {
    let stack = stack(&sample_over_air(), [2.0, 0.75, 1.0, 1.0]);
    assert_close(fate(&stack, 1_000_000, 1, WalkEvent::Left), 0.09739, 1e-5, 3e-4);
    assert_close(fate(&stack, 1_000_000, 1, WalkEvent::Base), 0.66096, 1e-5, 5e-4);
}

/// Giovanelli 1955: albedo 0.9, isotropic, n = 1.5, normal incidence, R 0.2600 with the specular part. A slab of 40
/// mean free paths represents the half space: the loss below is less than exp(−20).
#[test]
fn half_space_reflects_as_tabulated() {
    let stack = stack(&sample_over_air(), [40.0, 0.0, 1.0, 1.5]);
    assert_close(fate(&stack, 400_000, 2, WalkEvent::Left), 0.2600, 5e-5, 6e-4);
}

/// Mean path length of diffuse light in a slab, whatever σ_t and g (Blanco and Fournier 2003, with the factor n² of
/// the denser medium): 2 t n² between two open faces, 4 t n² over a white base.
#[test]
fn mean_path_depends_on_thickness_and_index() {
    for (sigma_t, g) in [(0.5, 0.0), (5.0, 0.8), (20.0, 0.4)] {
        let closed = scene(vec![sample(0.0)], [0.0, 90.0], 0.0);
        for (scene, key, end, factor, most_error) in [
            (sample_over_air(), 3, left_or_through as fn(WalkEvent) -> bool, 2.0, 0.02),
            (closed, 4, left, 4.0, 0.05),
        ] {
            let stack = stack(&scene, [sigma_t, g, 0.5, 1.5]);
            let lengths =
                walks(&stack, 300_000, key, lambertian, end).map(|(w, _)| f64::from(w.length) / sigma_t);
            assert_close(statistics(lengths), factor * 0.5 * 2.25, 0.0, most_error);
        }
    }
}

/// Nothing is lost where nothing may be: every walk leaves with weight exactly 1.
#[test]
fn without_absorption_every_walk_comes_back() {
    for scene in [Scene::smooth(), Scene::paper().with_multiple_scattering(true)] {
        let stack = stack(&scene, [6.0, 0.4, 0.5, 1.53]);
        for (walk, event) in walks(&stack, 20_000, 5, down, left) {
            assert_eq!((event, walk.weight), (WalkEvent::Left, 1.0));
        }
    }
}

/// Single scattering at rough interfaces loses some energy, but little: the check that the test above can fail.
#[test]
fn single_scattering_on_rough_interfaces_loses_energy() {
    let stack = stack(&Scene::paper(), [6.0, 0.4, 0.5, 1.53]);
    let (mean, _) = statistics(
        walks(&stack, 20_000, 6, down, left)
            .map(|(walk, event)| if event == WalkEvent::Left { f64::from(walk.weight) } else { 0.0 }),
    );
    assert!((0.5..0.99).contains(&mean), "{mean}");
}

/// A slab of 300 mean free paths with walks of some 10⁵ events: roulette must not change the mean. Without
/// absorption and over a white base all weight comes back.
#[test]
fn roulette_in_very_thick_slabs_is_unbiased() {
    let stack = stack(&scene(vec![sample(0.0)], [0.0, 90.0], 0.0), [600.0, 0.0, 0.5, 1.5]);
    let mut long = 0;
    let weights = walks(&stack, 20_000, 7, lambertian, left).map(|(walk, event)| {
        long += u32::from(walk.weight > 1.0);
        if event == WalkEvent::Left { f64::from(walk.weight) } else { 0.0 }
    });
    let (mean, error) = statistics(weights);
    assert!(long > 50, "the test must reach roulette, {long} walks did");
    assert!(((mean - 1.0) / error).abs() < 3.5, "{mean} ± {error}");
}

/// Compares light that meets interfaces only with walks that end where they scatter, where no light is lost on rough
/// faces: 10 million from the sensor into a wide ring, and 1 million from there to the base.
#[test]
fn light_without_vertex_agrees_with_walks() {
    let ring = RingLight::new(20.0, 80.0).unwrap();
    let scene = Scene::paper().with_light(ring).with_multiple_scattering(true);
    let stack = stack(&scene, [1.0, 0.0, 0.5, 1.53]);
    let light = Light::new(&stack, false);
    let [inner, outer] = stack.ring_sin2;
    let ended = |event| event != WalkEvent::Crossed;
    let share = |n: u32,
                 key: u32,
                 direction: &(dyn Fn([u32; 4]) -> Vec3 + Sync),
                 counts: &(dyn Fn(&Walk<'_>, WalkEvent) -> bool + Sync)| {
        const PARTS: u32 = 16;
        let parts = (0..PARTS).into_par_iter().map(|part| {
            walks(&stack, n / PARTS, 100 * key + part, direction, ended)
                .filter(|(walk, event)| counts(walk, *event))
                .count()
        });
        let p = parts.sum::<usize>() as f64 / f64::from(n);
        (p, (p / f64::from(n)).sqrt())
    };
    let in_ring = |walk: &Walk<'_>, event| {
        let d = walk.direction;
        event == WalkEvent::Left && (inner..=outer).contains(&(d.x * d.x + d.y * d.y))
    };
    let from_ring = |words: [u32; 4]| {
        let sin2 = inner + (outer - inner) * uniform(words[0]);
        Vec3::new(sin2.sqrt(), 0.0, -(1.0 - sin2).sqrt())
    };
    let straight = share(10_000_000, 1, &down, &in_ring);
    assert_close(straight, light.straight, 0.003 * light.straight, 2e-5);
    let base = share(1_000_000, 2, &from_ring, &|_, event| event == WalkEvent::Base);
    let n_c = stack.iors[stack.iors.len() - 1];
    let expected = f64::from(light.base) * n_c * n_c / f64::from(outer - inner);
    assert_close(base, expected, 2e-4 * expected, 1e-3);
}
