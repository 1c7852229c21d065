//! Tests divided jobs, and jobs that continue to a target error.

use farm_proto::status::DictionaryState;
use optics_model::Walks;

use super::{Bench, DIGEST, FIRST, seconds};
use crate::dispatch::Admission;
use crate::dispatch::part::PartId;
use crate::testing::grid;

/// A farm with one job in three blocks.
pub(super) fn divided(check_share: f64) -> Bench {
    Bench::of_grid(grid(None, &[1.0], &[0.5], 2_500_000), check_share)
}

/// A divided job is leased block by block.
#[test]
fn divided_job_is_leased_by_blocks() {
    let mut bench = divided(0.0);
    let leases = bench.acquire(0, "a", 2);
    assert_eq!(leases.iter().map(|l| l.job.block()).collect::<Vec<_>>(), [Some(0), Some(1)]);
    let last = bench.acquire(0, "b", 5);
    assert_eq!(last.iter().map(|l| l.job.block()).collect::<Vec<_>>(), [Some(2)]);
    bench.store_part("b", &last[0], DIGEST);
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

/// Two workers compute the same job, and both results need more walks: the second changes nothing.
#[test]
fn only_the_first_copy_adds_walks() {
    let mut bench = Bench::new(&[]);
    let lease = bench.one(0, "a");
    bench.prolong(1, "a", &lease, 500_000);
    let again = bench.one(2, "b");
    assert_eq!((again.key.job, again.job.walks().get()), (lease.key.job, 500_000));
    bench.prolong(3, "a", &lease, 500_000);
    assert!(bench.renew(4, "b", &again, true));
}

/// Blocks shared with another dictionary are gone once it has merged them; a job that still needs them computes them.
#[test]
fn missing_shared_blocks_are_computed_again() {
    let mut bench = divided(0.0);
    // Blocks 0 and 1 were stored by the other dictionary; its job has ended, and they are gone with it.
    let walks = bench.farm.schedule.by_id(FIRST).unwrap().spec(0, 0).walks();
    bench.farm.take_outbox();
    for (walks, changed) in [(Walks::new(3_500_000).unwrap(), false), (walks, true)] {
        bench.farm.parts_stored((FIRST, 0), walks, &[0, 1].into());
        assert_eq!(bench.farm.take_outbox().changed, changed, "blocks count for their walks only");
    }
    let last = bench.acquire(0, "a", 9);
    assert_eq!((last.len(), last[0].key.part), (1, 2));
    assert!(!bench.farm.schedule.waits_for_nothing((FIRST, 0)));
    bench.store_part("a", &last[0], DIGEST);
    assert!(bench.farm.schedule.waits_for_nothing((FIRST, 0)));
    bench.farm.parts_stored((FIRST, 0), walks, &[2].into());
    assert_eq!(bench.parts(2, "b", 9), [0, 1]);
}

/// A dictionary with more parts than are allowed keeps no account of them.
#[test]
fn too_large_dictionary_has_no_blocks() {
    let large = grid(None, &[1.0, 2.0, 30.0], &[0.5, 0.9], 1_000_000_000_000);
    assert!(large.check_parts().is_err());
    let walks = large.walks_of(0);
    let mut bench = Bench::of_grid(large, 0.0);
    bench.farm.take_outbox();
    bench.farm.parts_stored((FIRST, 0), walks, &[0].into());
    assert!(!bench.farm.take_outbox().changed);
}
