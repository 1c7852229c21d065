//! Tests that jobs that share their walks are given out together.

use farm_proto::lease::Lease;
use optics_model::grid::Axes;
use optics_model::{Grid, Scene, Walks};

use super::{Bench, job_of, seconds, worker};
use crate::dispatch::LeaseRequest;
use crate::testing::axes;

/// A dictionary whose jobs 0 to 3 have the optical thicknesses 1, 2, 2 and 4.
fn bench(walks: u64) -> Bench {
    let axes = Axes { thickness_mm: vec![0.5, 1.0], ..axes(&[2.0, 4.0], &[0.5]) };
    Bench::of_grid(Grid::new(Scene::paper(), axes, Walks::new(walks).unwrap(), 1, false).unwrap(), 0.0)
}

fn sets(bench: &mut Bench, at: u64, name: &str, parts: usize) -> Vec<Lease> {
    let request = LeaseRequest { parts, whole_sets: true };
    bench.farm.acquire(seconds(at), &worker(name), request, &mut bench.chance).unwrap().leases
}

fn set_jobs(bench: &mut Bench, at: u64, name: &str, parts: usize) -> Vec<u32> {
    job_of(&sets(bench, at, name, parts))
}

/// Jobs that share walks are leased together, on top of the requested number, and only on request.
#[test]
fn shared_walks_come_on_top() {
    let mut bench = bench(5000);
    assert_eq!(set_jobs(&mut bench, 0, "a", 1), [3]);
    assert_eq!(set_jobs(&mut bench, 0, "a", 1), [1, 2], "both are 2 thick");
    assert_eq!(set_jobs(&mut bench, 0, "b", 9), [0]);
    assert!(sets(&mut bench, 0, "c", 9).is_empty());
    let mut bench = self::bench(5000);
    assert_eq!(bench.jobs(0, "a", 2), [3, 1]);
    assert_eq!(set_jobs(&mut bench, 0, "b", 1), [2], "the other of its set is out");
}

/// Jobs that failed, or were handed back, are leased alone: one that kills its worker must not drag others down again.
#[test]
fn failed_or_returned_jobs_go_alone() {
    for failed in [true, false] {
        let mut bench = bench(5000);
        sets(&mut bench, 0, "b", 1);
        for lease in sets(&mut bench, 0, "a", 1) {
            if failed {
                bench.fail(1, "a", &lease);
            } else {
                bench.farm.hand_back(&[lease.key]);
            }
        }
        assert_eq!(set_jobs(&mut bench, 2, "c", 1), [1], "failed: {failed}");
        let other = sets(&mut bench, 2, "c", 1);
        assert_eq!((job_of(&other), other[0].key.attempt), (vec![2], 2), "by which a worker knows: {failed}");
    }
}

/// A machine on trial gets one job at a time, and no set.
#[test]
fn machine_on_trial_gets_no_set() {
    let mut bench = bench(5000);
    for at in 0..3 {
        let lease = bench.one(at, "a");
        bench.fail(at, "a", &lease);
    }
    assert!(sets(&mut bench, 4, "a", 1).is_empty(), "it has a pause");
    assert_eq!(sets(&mut bench, 14, "a", 1).len(), 1);
}

/// Divided jobs of a set are leased with the same block.
#[test]
fn set_blocks_are_leased_one_by_one() {
    let mut bench = bench(2_000_000);
    sets(&mut bench, 0, "b", 2);
    for expected in [&[(1, 0), (2, 0)][..], &[(1, 1), (2, 1)], &[(0, 0)]] {
        let leases = sets(&mut bench, 0, "a", 1);
        assert_eq!(leases.iter().map(|l| (l.key.job, l.key.part)).collect::<Vec<_>>(), expected);
    }
}
