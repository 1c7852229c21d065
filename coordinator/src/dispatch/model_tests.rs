//! Tests the dispatcher against a model of the farm around it, under random operations.
//!
//! The model holds the store and the workers. It performs effects as the farm does, and after every step the
//! dispatcher's state must equal what the model has counted from scratch.

mod check;
mod effects;
mod judge;
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
/// Cases, unless `PROPTEST_CASES` sets another number: some seconds.
const CASES: u32 = 300;

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

proptest! {
    #![proptest_config(config())]

    /// All steps keep the invariants of the model, with correct workers and with wrong ones, with and without checks. When
    /// every result is checked, results of wrong workers do not survive; without checks they do not disturb the counts.
    /// Honest workers are never fenced off, however many wrong ones agree.
    #[test]
    fn all_steps_keep_all_invariants(
        steps in prop::collection::vec(ops::any(), 1..STEPS),
        wrong in 0_usize..5,
        checked in any::<bool>(),
    ) {
        run(World::new(wrong, if checked { 1.0 } else { 0.0 }), &steps)?;
    }
}
