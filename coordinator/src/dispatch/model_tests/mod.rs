//! The dispatcher against a model of the farm around it, under random operations.
//!
//! The model holds the store and the workers. It performs effects as the farm does, and after every step the
//! dispatcher must say what the model has counted from scratch.

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
/// Cases of each test unless `PROPTEST_CASES` says otherwise: a second or two.
const CASES: u32 = 150;

fn config() -> ProptestConfig {
    let cases = std::env::var("PROPTEST_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(CASES);
    ProptestConfig { cases, failure_persistence: None, max_shrink_iters: 20_000, ..ProptestConfig::default() }
}

/// Runs the steps, and then lets honest workers finish what is left.
fn run(mut world: World, steps: &[Op]) -> Result<(), TestCaseError> {
    let fail = |at: &dyn std::fmt::Debug, why| TestCaseError::fail(format!("after {at:?}: {why}"));
    for step in steps {
        world.step(step);
        world.check().map_err(|why| fail(step, why))?;
    }
    world.finish_all().map_err(|why| fail(&"the last phase", why))
}

#[test]
fn blocks_of_a_job_with_more_walks_are_checked_after_a_restart() {
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

    #[test]
    fn with_honest_workers_everything_ends_well(
        steps in prop::collection::vec(ops::any(), 1..STEPS),
        checked in any::<bool>(),
    ) {
        run(World::new(0, if checked { 1.0 } else { 0.0 }), &steps)?;
    }

    #[test]
    fn what_wrong_workers_compute_does_not_survive_checks(
        steps in prop::collection::vec(ops::any(), 1..STEPS),
        wrong in 1_usize..3,
    ) {
        run(World::new(wrong, 1.0), &steps)?;
    }

    #[test]
    fn without_checks_wrong_workers_harm_no_count(steps in prop::collection::vec(ops::any(), 1..STEPS)) {
        run(World::new(2, 0.0), &steps)?;
    }
}
