//! Tests that jobs that share their walks are given out together.

use std::sync::Arc;

use farm_proto::ids::DictionaryId;
use farm_proto::lease::Lease;
use optics_model::grid::Axes;
use optics_model::{Digest, Grid, Scene, Walks};

use super::{Bench, job_of, seconds, stored, worker};
use crate::dispatch::{Dictionary, LeaseRequest};

/// A dictionary whose jobs 0 to 3 have the optical thicknesses 1, 2, 2 and 4.
fn bench(walks: u64) -> Bench {
    let mut two_thick = stored();
    let axes = Axes {
        sigma_t_per_mm: vec![2.0, 4.0],
        albedo: vec![0.5],
        g: vec![0.0],
        thickness_mm: vec![0.5, 1.0],
        sample_ior: vec![1.5],
    };
    let grid = Grid::new(Scene::paper(), axes, Walks::new(walks).unwrap(), 1, false).unwrap();
    two_thick.grid_digest = Digest::of_grid(&grid);
    two_thick.grid = Arc::new(grid);
    let mut bench = Bench::new(&[]);
    bench.farm.remove_dictionary(DictionaryId(1));
    bench.farm.add_dictionary(Dictionary::new(two_thick, &[]));
    bench
}

fn sets(bench: &mut Bench, at: u64, name: &str, parts: usize) -> Vec<Lease> {
    let request = LeaseRequest { parts, whole_sets: true };
    bench.farm.acquire(seconds(at), &worker(name), request, &mut bench.chance).unwrap().leases
}

/// Jobs that share walks are leased together, on top of the requested number.
#[test]
fn shared_walks_come_on_top() {
    let mut bench = bench(5000);
    assert_eq!(job_of(&sets(&mut bench, 0, "a", 1)), [3]);
    assert_eq!(job_of(&sets(&mut bench, 0, "a", 1)), [1, 2], "both are 2 thick");
    assert_eq!(job_of(&sets(&mut bench, 0, "b", 9)), [0]);
    assert!(sets(&mut bench, 0, "c", 9).is_empty());
}

/// A worker that does not request sets gets exactly the number of jobs that it requests.
#[test]
fn sets_are_leased_only_on_request() {
    let mut bench = bench(5000);
    assert_eq!(job_of(&bench.acquire(0, "a", 2)), [3, 1]);
    assert_eq!(job_of(&sets(&mut bench, 0, "b", 1)), [2], "the other of its set is out");
}

/// A failed job is retried alone: one that kills its worker must not drag others down a second time.
#[test]
fn failed_job_is_retried_alone() {
    let mut bench = bench(5000);
    sets(&mut bench, 0, "b", 1);
    let both = sets(&mut bench, 0, "a", 1);
    for lease in &both {
        bench.fail(1, "a", lease);
    }
    assert_eq!(job_of(&sets(&mut bench, 2, "c", 1)), [1]);
    let other = sets(&mut bench, 2, "c", 1);
    assert_eq!((job_of(&other), other[0].key.attempt), (vec![2], 2), "by which a worker knows");
}

/// A machine on trial gets one job at a time, and no set.
#[test]
fn machine_on_trial_gets_no_set() {
    let mut bench = bench(5000);
    for at in 0..3 {
        let lease = bench.acquire(at, "a", 1);
        bench.fail(at, "a", &lease[0]);
    }
    assert!(sets(&mut bench, 4, "a", 1).is_empty(), "it has a pause");
    assert_eq!(sets(&mut bench, 14, "a", 1).len(), 1);
}

/// Divided jobs of a set are leased with the same block.
#[test]
fn set_blocks_are_leased_one_by_one() {
    let mut bench = bench(2_000_000);
    let of = |leases: Vec<Lease>| leases.iter().map(|l| (l.key.job, l.key.part)).collect::<Vec<_>>();
    sets(&mut bench, 0, "b", 2);
    assert_eq!(of(sets(&mut bench, 0, "a", 1)), [(1, 0), (2, 0)]);
    assert_eq!(of(sets(&mut bench, 0, "a", 1)), [(1, 1), (2, 1)]);
    assert_eq!(of(sets(&mut bench, 0, "a", 1)), [(0, 0)]);
}

/// Jobs that were handed back once are leased alone, since one of them may have been the reason.
#[test]
fn returned_jobs_are_leased_alone() {
    let mut bench = bench(5000);
    sets(&mut bench, 0, "b", 1);
    let both = sets(&mut bench, 0, "a", 1);
    bench.farm.hand_back(&[both[0].key, both[1].key]);
    assert_eq!(job_of(&sets(&mut bench, 1, "c", 1)), [1]);
    assert_eq!(job_of(&sets(&mut bench, 1, "c", 1)), [2]);
}
