//! Tests what becomes of the records of a machine that is fenced off.

use super::*;
use crate::stored::KnownMachine;

/// A store in which the first machine has computed job 0 of a dictionary, and the second, which is bad, job 1.
async fn good_and_bad() -> (TempDir, Store, StoredDictionary) {
    let (dir, store) = empty().await;
    for name in ["good", "bad", "third"] {
        store.register_worker(&Machine::at(name), name).await.unwrap();
    }
    let d = dictionary(&store).await;
    complete(&store, &d, 0, 0.25).await;
    store.complete(Completion { worker: BAD, ..completion(&d, 1, 0.5) }).await.unwrap();
    (dir, store, d)
}

const GOOD: Origin = Origin(1);
const BAD: Origin = Origin(2);

/// Each finished job with its machine, and whether the coordinator has confirmed it.
async fn behind(store: &Store, d: &StoredDictionary) -> Vec<(u32, Option<Origin>, bool)> {
    let behind = |end| match end {
        EndedJob::Done { job, by, verified, .. } => (job, by, verified),
        EndedJob::GivenUp { .. } => panic!("{end:?}"),
    };
    store.ended_jobs(d.id, &d.grid).await.unwrap().into_iter().map(behind).collect()
}

/// Its token and address identify a machine. While it is fenced off, its label and host name do not change.
#[tokio::test]
async fn machine_keeps_row_and_fence_when_renamed() {
    let (_dir, store) = empty().await;
    let machine = Machine { token: "t".to_owned(), host: "h".to_owned(), ..Machine::at("10.0.0.1") };
    let bad = store.register_worker(&machine, "first").await.unwrap();
    fence(&store, bad).await;
    let liar = Machine { host: "another".to_owned(), ..machine.clone() };
    assert_eq!(store.register_worker(&liar, "second").await.unwrap(), bad);
    let other_token = Machine { token: "u".to_owned(), ..machine.clone() };
    assert_ne!(store.register_worker(&other_token, "third").await.unwrap(), bad);
    let known = store.machines().await.unwrap().remove(0);
    let (label, fenced) = ("first".to_owned(), Some("wrong".to_owned()));
    assert_eq!(known, KnownMachine { origin: bad, machine, label, fenced }, "it is still known as it was");
}

/// The records of a fenced machine are deleted in the transaction that fences it off, and computed again. Its fence
/// outlasts a restart, and results of its on their way are not stored.
#[tokio::test]
async fn fenced_records_are_computed_again() {
    let (dir, store, d) = good_and_bad().await;
    assert_eq!(fence(&store, BAD).await, [(d.id, 1)]);
    let store = reopened(store, &dir).await;
    assert_eq!(all_records(&store, &d).await, records(0, 0.25), "no others");
    assert_eq!((count(&store, "points").await, count(&store, "records").await), (1, 2));
    assert!(store.machines().await.unwrap()[1].fenced.is_some());
    let late = Completion { worker: BAD, ..completion(&d, 1, 0.5) };
    assert_eq!(store.complete(late).await.unwrap(), Outcome::Unwanted);
    assert!(matches!(complete(&store, &d, 1, 0.25).await, Outcome::Finished { .. }));
    assert_eq!(behind(&store, &d).await, [(0, Some(GOOD), false), (1, Some(GOOD), false)]);
    assert!(store.faults().await.unwrap().is_empty());
}

/// Records that the coordinator has confirmed stay when their machine is fenced off, unless they are the wrong ones.
#[tokio::test]
async fn verified_records_survive_a_fence() {
    let (dir, store, d) = good_and_bad().await;
    store.note_verified(d.id, 1).await.unwrap();
    let store = reopened(store, &dir).await;
    assert_eq!(fence(&store, BAD).await, []);
    assert_eq!(behind(&store, &d).await, [(0, Some(GOOD), false), (1, Some(BAD), true)]);
    let wrong = completion(&d, 1, 0.5).job.identity();
    let again = store.ledger().exclusive().await.fence(&[], "", &[wrong]).await.unwrap();
    assert_eq!(again, [(d.id, 1)]);
}

/// Records that another dictionary adds to a verified point are not verified with it.
#[tokio::test]
async fn records_added_to_a_point_are_unverified() {
    let (_dir, store, d) = good_and_bad().await;
    store.note_verified(d.id, 1).await.unwrap();
    let more = overlapping(&store, "e", vec![0.7, 0.95]).await;
    let added = Completion { worker: BAD, ..completion(&more, 0, 0.75) };
    assert!(matches!(store.complete(added).await.unwrap(), Outcome::Finished { .. }));
    assert_eq!(fence(&store, BAD).await, [(d.id, 1), (more.id, 0)]);
}

/// Machines are deleted only if no record, claim or fence refers to them.
#[tokio::test]
async fn only_unused_machines_are_forgotten() {
    let (dir, store, d) = good_and_bad().await;
    for name in ["useless", "fenced", "claimant"] {
        store.register_worker(&Machine::at(name), name).await.unwrap();
    }
    fence(&store, Origin(5)).await;
    let claims = vec![Claim { by: Some(Origin(6)), digest: Digest::from_bytes([1; 32]) }];
    store.note_check(&OpenCheck { dictionary: d.id, job: 0, block: 0, claims }).await.unwrap();
    let store = reopened(store, &dir).await;
    let left: Vec<i64> = store.machines().await.unwrap().iter().map(|known| known.origin.0).collect();
    assert_eq!(left, [1, 2, 5, 6]);
}
