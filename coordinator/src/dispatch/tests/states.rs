//! How far each job is told to be.

use farm_proto::ids::DictionaryId;
use farm_proto::status::JobState::{Checked, Computing, Done, Failed, Waiting};

use super::{Bench, DIGEST};

/// A job waits, is computed, done and checked, or given up.
#[test]
fn job_states_follow_its_life() {
    let mut bench = Bench::with_checks(&[], 1.0);
    let states = |bench: &Bench| bench.farm.job_states(DictionaryId(1));
    assert_eq!(states(&bench), [Waiting; 3]);
    let leases = bench.acquire(0, "a", 2);
    let [one, other] = [0, 1].map(|i| leases[i].key.job as usize);
    let with = |first, second| {
        let mut all = [Waiting; 3];
        (all[one], all[other]) = (first, second);
        all
    };
    assert_eq!(states(&bench), with(Computing, Computing));
    bench.finish(1, "a", &leases[0]);
    assert_eq!(states(&bench), with(Done, Computing));
    // A check is no computing, and agreement of another machine's result is more than done.
    let check = bench.acquire(2, "b", 1).remove(0);
    assert_eq!(check.key.job as usize, one);
    assert_eq!(states(&bench), with(Done, Computing));
    assert!(bench.compare("b", &check, DIGEST, DIGEST));
    assert_eq!(states(&bench), with(Checked, Computing));
    // What is tried again is computed, until it is given up.
    bench.fail(3, "a", &leases[1]);
    assert_eq!(states(&bench), with(Checked, Waiting));
    let again = bench.acquire(4, "c", 3);
    let again = again.iter().find(|lease| lease.key.job as usize == other).expect("it is tried again");
    bench.fail(5, "c", again);
    assert_eq!(states(&bench)[other], Failed);
    assert!(bench.farm.job_states(DictionaryId(9)).is_empty());
}
