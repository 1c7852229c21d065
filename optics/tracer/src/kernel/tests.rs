//! Compares every kernel with the scalar one, walk by walk and bit by bit.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use optics_model::TransportPoint;
use optics_model::phase::{PhaseShape, PhaseTable, SecondLobe};
use optics_model::scene::{Channel, Layer, RingLight, Scene, Sensor};

use super::Kernel;
use crate::exits::{Chunk, Exit, Exits};
use crate::light::Light;
use crate::stack::Stack;
use crate::walk::ROULETTE_BLOCKS;
use crate::wavefront::Places;

/// Everything about an exit, in bits.
#[derive(Debug, PartialEq)]
struct Bits {
    place: [u32; 3],
    counts: [u32; 3],
    length: u32,
    walk: u32,
    hits: Vec<[u32; 2]>,
}

/// The exits of a chunk, in order.
fn exits(kernel: Kernel, stack: &Stack, walks: u32) -> Vec<Bits> {
    let chunk = Chunk { key: [0x1234_5678, 0x9abc_def0], index: (7 << 32) + 5, walks };
    let (mut places, mut exits) = (Places::default(), Exits::default());
    kernel
        .run_chunk(stack, &Light::new(stack, true), chunk, &AtomicBool::new(false), &mut places, &mut exits)
        .expect("it is not stopped");
    let all_hits = exits.hits().to_vec();
    let bits = |Exit { pick, hits }: Exit| Bits {
        place: [pick.z, pick.u, pick.worth].map(f32::to_bits),
        counts: [pick.cuts, pick.scatterings, pick.hits],
        length: pick.length.to_bits(),
        walk: pick.walk,
        hits: all_hits[hits.start as usize..hits.end as usize]
            .iter()
            .map(|hit| [hit.free_paths, hit.mm].map(f32::to_bits))
            .collect(),
    };
    exits.in_order().map(bits).collect()
}

fn scene(layers: Vec<Layer>, ring: [f64; 2], polar_deg: f64) -> Scene {
    Scene::new(
        layers,
        vec![Channel::new("mono", 1.0, 1.0).expect("valid")],
        RingLight::new(ring[0], ring[1]).expect("valid"),
        Sensor::new(10.0, 8, polar_deg).expect("valid"),
        false,
    )
    .expect("valid")
}

fn sample(roughness: f64) -> Layer {
    Layer::sample("sample", roughness).expect("valid")
}

fn clear(ior: f64, thickness_mm: f64, roughness: f64) -> Layer {
    Layer::clear("clear", ior, thickness_mm, roughness).expect("valid")
}

/// The paper's scene with another phase function.
fn with_phase(phase: PhaseShape) -> Scene {
    Scene::paper().with_phase(phase)
}

fn two_lobes(weight: f64, g: f64) -> PhaseShape {
    PhaseShape::Lobes(SecondLobe::new(weight, g).expect("valid"))
}

/// Values at 0°, 60° and 180°.
fn table(values: [f64; 3]) -> PhaseTable {
    PhaseTable::new(vec![0.0, 60.0, 180.0], values.to_vec()).expect("valid")
}

/// The paper's scene at the corners of its grid; scenes of the exact cases; stacks that begin or end with the sample,
/// repeat rough faces, match indices, and follow rays on the microsurface; phase functions of two lobes and of a table.
fn cases() -> Vec<(Scene, [f64; 4])> {
    let everything = [0.0, 90.0];
    let table = Arc::new(table([5.0, 0.5, 1.0]));
    vec![
        (Scene::paper(), [1.0, 0.0, 0.25, 1.53]),
        (Scene::paper(), [20.0, 0.9, 1.0, 1.48]),
        (Scene::paper(), [100.0, 0.4, 0.5, 1.53]),
        (Scene::paper(), [0.01, -0.5, 0.1, 1.53]),
        (Scene::smooth(), [6.0, 0.4, 0.5, 1.53]),
        (Scene::paper().with_multiple_scattering(true), [6.0, 0.4, 0.5, 1.53]),
        (with_phase(two_lobes(0.1, -0.5)), [6.0, 0.4, 0.5, 1.53]),
        (with_phase(two_lobes(0.3, 0.6)), [20.0, -0.2, 1.0, 1.53]),
        (with_phase(PhaseShape::Table(Arc::clone(&table))), [6.0, table.mean_cosine(), 0.5, 1.53]),
        (scene(vec![sample(0.0)], everything, 0.0), [5.0, 0.8, 0.5, 1.5]),
        (scene(vec![sample(0.0)], everything, 45.0), [5.0, 0.8, 0.5, 1.0]),
        (scene(vec![sample(0.3), clear(1.0, 1.0, 0.0)], everything, 20.0), [2.0, 0.75, 1.0, 1.3]),
        (
            scene(vec![clear(1.3, 0.1, 0.2), clear(1.5, 0.1, 0.0), sample(0.5)], everything, 60.0),
            [3.0, -0.9, 0.3, 1.1],
        ),
    ]
}

/// All kernels run the same walks, to the last bit.
#[test]
fn all_kernels_agree_bit_by_bit() {
    for (scene, [sigma_t, g, thickness, ior]) in cases() {
        let point = TransportPoint::new(sigma_t, g, thickness, ior).expect("valid");
        let stack = Stack::new(&scene, &point);
        // Not a multiple of any vector, more than the pool.
        let expected = exits(Kernel::SCALAR, &stack, 2_501);
        assert!(expected.len() > 100, "{point:?} must score often enough for this test");
        for kernel in Kernel::all() {
            let found = exits(kernel, &stack, 2_501);
            for (found, expected) in found.iter().zip(&expected) {
                assert_eq!(found, expected, "{kernel} at {point:?}");
            }
            assert_eq!(found.len(), expected.len(), "{kernel} at {point:?}");
        }
    }
}

/// Fewer walks than lanes, and than two vectors.
#[test]
fn small_chunks_are_run_in_full() {
    let point = TransportPoint::new(2.0, 0.0, 0.5, 1.53).expect("valid");
    let stack = Stack::new(&scene(vec![sample(0.0)], [0.0, 90.0], 0.0), &point);
    let picked =
        |exits: &[Bits]| exits.iter().map(|exit| exit.walk).collect::<std::collections::BTreeSet<_>>();
    let walks_of_many = picked(&exits(Kernel::SCALAR, &stack, 17));
    for walks in [1, 15, 16, 17] {
        let expected = walks_of_many.iter().copied().filter(|walk| *walk < walks).collect();
        for kernel in Kernel::all() {
            assert_eq!(picked(&exits(kernel, &stack, walks)), expected, "{kernel}");
        }
    }
    assert!(walks_of_many.len() > 8, "{walks_of_many:?}");
}

/// A slab of 300 mean free paths, so that walks reach roulette.
#[test]
fn kernels_agree_about_roulette() {
    let point = TransportPoint::new(600.0, 0.0, 0.5, 1.5).expect("valid");
    let stack = Stack::new(&scene(vec![sample(0.0)], [0.0, 90.0], 0.0), &point);
    let expected = exits(Kernel::SCALAR, &stack, 2_000);
    // Two scatterings a block at most.
    let survived = expected.iter().any(|exit| exit.counts[1] > 2 * ROULETTE_BLOCKS);
    assert!(survived, "no walk has met the light after roulette");
    for kernel in Kernel::all() {
        assert!(exits(kernel, &stack, 2_000) == expected, "{kernel}");
    }
}

/// Rounding may trap a ray between two faces that both reflect totally. Here it is made to happen: the walks must end
/// nevertheless.
#[test]
fn caught_rays_end_by_roulette() {
    let point = TransportPoint::new(2.0, 0.0, 0.5, 1.53).expect("valid");
    let mut stack = Stack::new(&Scene::paper(), &point);
    stack.interfaces[0].from_below.complement = -10.0;
    stack.interfaces[1].from_above.complement = -10.0;
    for kernel in Kernel::all() {
        assert_eq!(exits(kernel, &stack, 32).len(), 0, "{kernel}");
    }
}

/// Each kernel has a unique name and is found by it.
#[test]
fn kernel_names_are_unique() {
    let mut names: Vec<_> = Kernel::all().into_iter().map(Kernel::name).collect();
    assert!(names.contains(&Kernel::fastest().name()) && names.len() > 1);
    assert!(names.iter().all(|name| Kernel::named(name).is_some_and(|kernel| kernel.name() == *name)));
    assert!(Kernel::named("abacus").is_none());
    let count = names.len();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), count);
}

/// A stopped chunk ends at once, whichever kernel runs it.
#[test]
fn every_kernel_can_be_stopped() {
    let point = TransportPoint::new(2.0, 0.0, 0.5, 1.53).expect("valid");
    let stack = Stack::new(&Scene::paper(), &point);
    let chunk = Chunk { key: [1, 2], index: 0, walks: 25_000 };
    let light = Light::new(&stack, false);
    for kernel in Kernel::all() {
        let (mut places, mut exits) = (Places::default(), Exits::default());
        let stopped = AtomicBool::new(true);
        assert!(kernel.run_chunk(&stack, &light, chunk, &stopped, &mut places, &mut exits).is_err());
    }
}
