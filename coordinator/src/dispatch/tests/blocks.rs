//! Tests divided jobs, and jobs that continue to a target error.

use std::sync::Arc;

use farm_proto::ids::DictionaryId;
use farm_proto::lease::Lease;
use farm_proto::status::DictionaryState;
use optics_model::grid::Axes;
use optics_model::{Digest, Grid, Scene, Walks};

use super::{Bench, arrive, job_of, seconds, stored};
use crate::dispatch::part::PartId;
use crate::dispatch::{Admission, Dictionary};

/// A farm with one job in three blocks.
pub(super) fn divided(check_share: f64) -> Bench {
    let mut divided = stored();
    let axes = Axes {
        sigma_t_per_mm: vec![1.0],
        albedo: vec![0.5],
        g: vec![0.0],
        thickness_mm: vec![1.0],
        sample_ior: vec![1.5],
    };
    let grid = Grid::new(Scene::paper(), axes, Walks::new(2_500_000).unwrap(), 1, false).unwrap();
    divided.grid_digest = Digest::of_grid(&grid);
    divided.grid = Arc::new(grid);
    let mut bench = Bench::with_checks(&[], check_share);
    bench.farm.remove_dictionary(DictionaryId(1));
    bench.farm.add_dictionary(Dictionary::new(divided, &[]));
    bench
}

/// A divided job is leased block by block.
#[test]
fn divided_job_is_leased_by_blocks() {
    let mut bench = divided(0.0);
    let leases = bench.acquire(0, "a", 2);
    assert_eq!(leases.iter().map(|l| l.job.block()).collect::<Vec<_>>(), [Some(0), Some(1)]);
    let last = bench.acquire(0, "b", 5);
    assert_eq!(last.iter().map(|l| l.job.block()).collect::<Vec<_>>(), [Some(2)]);
    arrive("b", &last[0], |arrived| bench.farm.part_finished(seconds(1), arrived));
    assert!(matches!(bench.admit("b", &last[0]), Ok(Admission::Repeated { .. })));
    bench.farm.look_over(seconds(4));
    bench.farm.hand_back(&[leases[0].key]);
    assert_eq!(bench.acquire(5, "c", 5)[0].job.block(), Some(0));
    bench.finish(6, "c", &leases[0]);
    assert_eq!(bench.state(), DictionaryState::Done);
}

/// The blocks of a divided job cost as much together as the job: the limit for late parts depends on it.
#[test]
fn blocks_share_the_cost_of_their_job() {
    let bench = divided(0.0);
    let dictionary = bench.farm.schedule.dictionaries().next().unwrap();
    let job = dictionary.job(PartId { dictionary: dictionary.id(), job: 0, part: 0 }).unwrap();
    assert!((3.0 * job.part_cost() / job.cost - 1.0).abs() < 1e-12, "{job:?}");
}

/// A job that needs more walks is leased again with the new number.
#[test]
fn more_walks_restart_the_job() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    let more = Walks::new(500_000).unwrap();
    arrive("a", &lease[0], |arrived| bench.farm.prolong(seconds(1), arrived, more));
    assert!(bench.admit("a", &lease[0]).is_err(), "a result with fewer walks is refused");
    let again = bench.acquire(2, "b", 1);
    assert_eq!((again[0].key.job, again[0].job.walks().get()), (lease[0].key.job, 500_000));
}

/// Two workers compute the same job and both results need more walks: the second result changes nothing.
#[test]
fn only_the_first_copy_adds_walks() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    let more = Walks::new(500_000).unwrap();
    arrive("a", &lease[0], |arrived| bench.farm.prolong(seconds(1), arrived, more));
    let again = bench.acquire(2, "b", 1);
    arrive("a", &lease[0], |arrived| bench.farm.prolong(seconds(3), arrived, more));
    assert!(bench.renew(4, "b", &again[0], true));
    assert!(!job_of(&bench.acquire(5, "c", 9)).contains(&again[0].key.job));
}

/// Blocks that the store no longer has are computed again.
#[test]
fn blocks_lost_by_the_store_are_recomputed() {
    let mut bench = divided(0.0);
    let leases = bench.acquire(0, "a", 2);
    arrive("a", &leases[0], |arrived| bench.farm.part_finished(seconds(1), arrived));
    bench.farm.parts_stored((DictionaryId(1), 0), leases[0].job.walks(), &[2].into());
    let left: Vec<_> = bench.acquire(2, "b", 9).iter().map(|l| l.key.part).collect();
    assert_eq!(left, [0], "block 1 is held, block 2 is there");
}

/// Blocks shared with another dictionary are gone once it has merged them; a job that still needs them computes them.
#[test]
fn missing_shared_blocks_are_computed_again() {
    let mut bench = divided(0.0);
    let blocks = |left: &[Lease]| left.iter().map(|l| l.key.part).collect::<Vec<_>>();
    // Blocks 0 and 1 were stored by the other dictionary; its job has ended, and they are gone with it.
    let walks = bench.farm.schedule.by_id(DictionaryId(1)).unwrap().spec(0, 0).walks();
    bench.farm.parts_stored((DictionaryId(1), 0), walks, &[0, 1].into());
    let last = bench.acquire(0, "a", 9);
    assert_eq!(blocks(&last), [2]);
    assert!(!bench.farm.schedule.waits_for_nothing((DictionaryId(1), 0)));
    arrive("a", &last[0], |arrived| bench.farm.part_finished(seconds(1), arrived));
    assert!(bench.farm.schedule.waits_for_nothing((DictionaryId(1), 0)));
    bench.farm.parts_stored((DictionaryId(1), 0), walks, &[2].into());
    assert_eq!(blocks(&bench.acquire(2, "b", 9)), [0, 1]);
}

/// Stored blocks are reported as a change only if they are of the job's number of walks.
#[test]
fn stored_blocks_count_for_their_walks_only() {
    let mut bench = divided(0.0);
    let walks = bench.farm.schedule.by_id(DictionaryId(1)).unwrap().spec(0, 0).walks();
    bench.farm.take_outbox();
    bench.farm.parts_stored((DictionaryId(1), 0), Walks::new(3_500_000).unwrap(), &[0].into());
    assert!(!bench.farm.take_outbox().changed);
    bench.farm.parts_stored((DictionaryId(1), 0), walks, &[0].into());
    assert!(bench.farm.take_outbox().changed);
    let left: Vec<_> = bench.acquire(0, "a", 9).iter().map(|l| l.key.part).collect();
    assert_eq!(left, [1, 2]);
}

/// A dictionary with more parts than are allowed keeps no account of them.
#[test]
fn too_large_dictionary_has_no_blocks() {
    let mut large = stored();
    let walks = Walks::new(1_000_000_000_000).unwrap();
    let grid = Grid::new(Scene::paper(), super::axes(), walks, 1, false).unwrap();
    assert!(grid.check_parts().is_err());
    large.grid = Arc::new(grid);
    let mut bench = Bench::new(&[]);
    bench.farm.remove_dictionary(DictionaryId(1));
    bench.farm.add_dictionary(Dictionary::new(large, &[]));
    bench.farm.take_outbox();
    bench.farm.parts_stored((DictionaryId(1), 0), walks, &[0].into());
    assert!(!bench.farm.take_outbox().changed);
}
