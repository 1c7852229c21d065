//! Tests the dispatcher against a model of the farm around it, under random operations.
//!
//! The model holds the store and the workers. It performs effects as the farm does, and after every step the
//! dispatcher's state must equal what the model has counted from scratch.

mod check;
mod effects;
mod ops;
mod results;
mod shared;
mod store;
mod workers;
mod world;

use proptest::prelude::*;
use proptest::test_runner::TestCaseError;

use ops::Op;
use world::World;

/// Steps of one case.
const STEPS: usize = 80;
/// Cases of each test, unless `PROPTEST_CASES` sets another number: a second or two.
const CASES: u32 = 150;

fn config() -> ProptestConfig {
    let cases = std::env::var("PROPTEST_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(CASES);
    ProptestConfig { cases, failure_persistence: None, max_shrink_iters: 20_000, ..ProptestConfig::default() }
}

/// Runs the steps, and then lets honest workers finish the remaining work.
fn run(mut world: World, steps: &[Op]) -> Result<(), TestCaseError> {
    let fail = |at: &dyn std::fmt::Debug, why| TestCaseError::fail(format!("after {at:?}: {why}"));
    for step in steps {
        world.step(step);
        world.check().map_err(|why| fail(step, why))?;
    }
    world.finish_all().map_err(|why| fail(&"the last phase", why))
}

/// Blocks of a job that was begun again with more walks are still checked after a restart of the coordinator.
#[test]
fn blocks_are_checked_after_more_walks() {
    let acquire = |worker, max| Op::Acquire { worker, max };
    let steps = [
        Op::Submit(3),
        acquire(1, 2),
        acquire(2, 1),
        acquire(2, 3),
        acquire(2, 3),
        acquire(0, 1),
        Op::Drain(2),
        Op::Register(3),
        Op::Deliver { worker: 0, lease: 0 },
        acquire(1, 2),
        Op::Deliver { worker: 1, lease: 2 },
        Op::Restart,
    ];
    run(World::new(2, 1.0), &steps).unwrap();
}

proptest! {
    #![proptest_config(config())]

    /// With correct workers all steps keep the invariants of the model, with and without checks.
    #[test]
    fn honest_workers_keep_all_invariants(
        steps in prop::collection::vec(ops::any(), 1..STEPS),
        checked in any::<bool>(),
    ) {
        run(World::new(0, if checked { 1.0 } else { 0.0 }), &steps)?;
    }

    /// When every result is checked, results of wrong workers do not survive.
    #[test]
    fn wrong_results_do_not_survive_checks(
        steps in prop::collection::vec(ops::any(), 1..STEPS),
        wrong in 1_usize..3,
    ) {
        run(World::new(wrong, 1.0), &steps)?;
    }

    /// Without checks, wrong workers do not disturb the counts.
    #[test]
    fn unchecked_wrong_workers_keep_counts_right(steps in prop::collection::vec(ops::any(), 1..STEPS)) {
        run(World::new(2, 0.0), &steps)?;
    }
}
