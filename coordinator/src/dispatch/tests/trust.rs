//! Tests the bounds for the workers of one token.

use super::{Bench, about};
use crate::dispatch::DispatchError;
use crate::stored::Origin;

/// The workers of one token leave room for those of others, and a registered process can register again.
#[test]
fn workers_per_token_are_limited() {
    use crate::dispatch::roster::WORKERS_OF_ONE;
    let mut bench = Bench::new(&[]);
    let mut register = |token: &str, instance: usize| {
        let mut about = about(&instance.to_string());
        about.machine.token = token.to_owned();
        bench.register(0, &format!("{token}{instance}"), Origin(9), about)
    };
    (0..WORKERS_OF_ONE).for_each(|instance| register("mallory", instance).unwrap());
    let refused = register("mallory", WORKERS_OF_ONE).unwrap_err();
    assert!(matches!(refused, DispatchError::ManyWorkers { .. }), "{refused}");
    register("mallory", 7).unwrap();
    register("alice", WORKERS_OF_ONE).unwrap();
}
