//! Compares every kernel with the scalar one, walk by walk and bit by bit.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use optics_model::phase::{PhaseShape, PhaseTable, SecondLobe};
use optics_model::scene::Scene;

use super::Kernel;
use crate::exits::{Chunk, Exit, Exits};
use crate::light::Light;
use crate::stack::Stack;
use crate::testing::{clear, sample, scene, stack};
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

fn two_lobes(weight: f64, g: f64) -> PhaseShape {
    PhaseShape::Lobes(SecondLobe::new(weight, g).unwrap())
}

/// The paper's scene at the corners of its grid; scenes of the exact cases; stacks that begin or end with the sample,
/// repeat rough faces, match indices, and follow rays on the microsurface; phase functions of two lobes and of a table.
fn cases() -> Vec<(Scene, [f64; 4])> {
    let (paper, everything) = (Scene::paper, [0.0, 90.0]);
    let table = Arc::new(PhaseTable::new(vec![0.0, 60.0, 180.0], vec![5.0, 0.5, 1.0]).unwrap());
    let mean_cosine = table.mean_cosine();
    let three = vec![clear(1.3, 0.1, 0.2), clear(1.5, 0.1, 0.0), sample(0.5)];
    vec![
        (paper(), [1.0, 0.0, 0.25, 1.53]),
        (paper(), [20.0, 0.9, 1.0, 1.48]),
        (paper(), [100.0, 0.4, 0.5, 1.53]),
        (paper(), [0.01, -0.5, 0.1, 1.53]),
        (Scene::smooth(), [6.0, 0.4, 0.5, 1.53]),
        (paper().with_multiple_scattering(true), [6.0, 0.4, 0.5, 1.53]),
        (paper().with_phase(two_lobes(0.1, -0.5)), [6.0, 0.4, 0.5, 1.53]),
        (paper().with_phase(two_lobes(0.3, 0.6)), [20.0, -0.2, 1.0, 1.53]),
        (paper().with_phase(PhaseShape::Table(table)), [6.0, mean_cosine, 0.5, 1.53]),
        (scene(vec![sample(0.0)], everything, 0.0), [5.0, 0.8, 0.5, 1.5]),
        (scene(vec![sample(0.0)], everything, 45.0), [5.0, 0.8, 0.5, 1.0]),
        (scene(vec![sample(0.3), clear(1.0, 1.0, 0.0)], everything, 20.0), [2.0, 0.75, 1.0, 1.3]),
        (scene(three, everything, 60.0), [3.0, -0.9, 0.3, 1.1]),
    ]
}

/// All kernels run the same walks, to the last bit; the last ones are in a slab of 300 mean free paths, so that they reach
/// roulette.
#[test]
fn all_kernels_agree_bit_by_bit() {
    let thick = (scene(vec![sample(0.0)], [0.0, 90.0], 0.0), [600.0, 0.0, 0.5, 1.5]);
    let mut survived = false;
    for (scene, point) in cases().into_iter().chain([thick]) {
        let stack = stack(&scene, point);
        // Not a multiple of any vector, more than the pool.
        let expected = exits(Kernel::SCALAR, &stack, 2_501);
        assert!(expected.len() > 100, "{point:?} must score often enough for this test");
        // Two scatterings a block at most.
        survived |= expected.iter().any(|exit| exit.counts[1] > 2 * ROULETTE_BLOCKS);
        for kernel in Kernel::all() {
            let found = exits(kernel, &stack, 2_501);
            for (found, expected) in found.iter().zip(&expected) {
                assert_eq!(found, expected, "{kernel} at {point:?}");
            }
            assert_eq!(found.len(), expected.len(), "{kernel} at {point:?}");
        }
    }
    assert!(survived, "no walk has met the light after roulette");
}

/// Fewer walks than lanes, and than two vectors.
#[test]
fn small_chunks_are_run_in_full() {
    let stack = stack(&scene(vec![sample(0.0)], [0.0, 90.0], 0.0), [2.0, 0.0, 0.5, 1.53]);
    let picked =
        |kernel, walks| exits(kernel, &stack, walks).iter().map(|exit| exit.walk).collect::<BTreeSet<_>>();
    let walks_of_many = picked(Kernel::SCALAR, 17);
    for walks in [1, 15, 16, 17] {
        let expected = walks_of_many.iter().copied().filter(|walk| *walk < walks).collect();
        for kernel in Kernel::all() {
            assert_eq!(picked(kernel, walks), expected, "{kernel}");
        }
    }
    assert!(walks_of_many.len() > 8, "{walks_of_many:?}");
}

/// Rounding may trap a ray between two faces that both reflect totally. Here it is made to happen: the walks must end
/// nevertheless.
#[test]
fn caught_rays_end_by_roulette() {
    let mut stack = stack(&Scene::paper(), [2.0, 0.0, 0.5, 1.53]);
    stack.interfaces[0].from_below.complement = -10.0;
    stack.interfaces[1].from_above.complement = -10.0;
    for kernel in Kernel::all() {
        assert_eq!(exits(kernel, &stack, 32).len(), 0, "{kernel}");
    }
}

/// Each kernel has a unique name and is found by it.
#[test]
fn kernel_names_are_unique() {
    let names: BTreeSet<_> = Kernel::all().into_iter().map(Kernel::name).collect();
    assert_eq!(names.len(), Kernel::all().len());
    assert!(names.contains(Kernel::fastest().name()) && names.len() > 1);
    assert!(names.iter().all(|name| Kernel::named(name).is_some_and(|kernel| kernel.name() == *name)));
    assert!(Kernel::named("abacus").is_none());
}

/// A stopped chunk ends at once, whichever kernel runs it.
#[test]
fn every_kernel_can_be_stopped() {
    let stack = stack(&Scene::paper(), [2.0, 0.0, 0.5, 1.53]);
    let chunk = Chunk { key: [1, 2], index: 0, walks: 25_000 };
    let light = Light::new(&stack, false);
    for kernel in Kernel::all() {
        let (mut places, mut exits) = (Places::default(), Exits::default());
        let stopped = AtomicBool::new(true);
        assert!(kernel.run_chunk(&stack, &light, chunk, &stopped, &mut places, &mut exits).is_err());
    }
}
