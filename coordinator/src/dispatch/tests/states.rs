//! Tests the reported states of jobs, dictionaries and workers.

use farm_proto::ids::DictionaryId;
use farm_proto::status::JobState::{Checked, Computing, Done, Failed, Waiting};
use farm_proto::status::WorkerState;

use super::{Bench, DIGEST, FIRST, done, seconds, worker};
use crate::dispatch::EventKind;
use crate::stored::DesiredState;

/// A job waits, is computed, done and checked, or given up.
#[test]
fn job_states_follow_its_life() {
    let mut bench = Bench::with_checks(&[], 1.0);
    let states = |bench: &Bench| bench.farm.job_states(FIRST);
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
    // A result that the coordinator has confirmed is checked, not only done.
    bench.judge(DIGEST);
    assert_eq!(states(&bench), with(Checked, Computing));
    // A job whose attempt failed waits again, until it is given up.
    bench.fail(3, "a", &leases[1]);
    assert_eq!(states(&bench), with(Checked, Waiting));
    let again = bench.acquire(4, "c", 3);
    let again = again.iter().find(|lease| lease.key.job as usize == other).expect("it is tried again");
    bench.fail(5, "c", again);
    assert_eq!(states(&bench)[other], Failed);
    assert!(bench.farm.job_states(DictionaryId(9)).is_empty());
}

/// Records that came from other dictionaries are counted, and so are the finished ones of a range: jobs 0 and 2 are done,
/// with two records each.
#[test]
fn finished_and_reused_records_are_counted() {
    let bench = Bench::new(&[done(0, None, true), done(2, None, true)]);
    assert_eq!(bench.status().records_reused, 4);
    let dictionary = bench.farm.schedule.dictionaries().next().unwrap();
    assert_eq!([0..6, 1..5, 2..4].map(|range| dictionary.finished_records(range)), [4, 2, 0]);
}

/// Changes of a dictionary's desired state, and its end, are recorded as its events.
#[test]
fn dictionary_events_are_recorded_in_order() {
    let mut bench = Bench::new(&[]);
    bench.desire(FIRST, DesiredState::Pause);
    bench.desire(FIRST, DesiredState::Run);
    let leases = bench.acquire(0, "a", 3);
    bench.finish_all(1, "a", &leases);
    let events = bench.farm.take_outbox().events;
    let kinds: Vec<_> = events.iter().filter(|event| event.dictionary == "d").map(|e| e.kind).collect();
    assert_eq!(kinds, [EventKind::Paused, EventKind::Resumed, EventKind::Done]);
}

/// A worker is listed as silent once it has missed its heartbeats, until its next call.
#[test]
fn unheard_workers_are_listed_as_silent() {
    let mut bench = Bench::new(&[]);
    let states = |bench: &Bench, at| {
        let workers = bench.farm.workers(seconds(at), &worker(""), 9);
        workers.into_iter().map(|worker| worker.state).collect::<Vec<_>>()
    };
    assert_eq!(states(&bench, 30), [WorkerState::Idle; 3]);
    assert_eq!(states(&bench, 31), [WorkerState::Silent; 3]);
    bench.acquire(31, "a", 1);
    assert_eq!(states(&bench, 31), [WorkerState::Working, WorkerState::Silent, WorkerState::Silent]);
}
