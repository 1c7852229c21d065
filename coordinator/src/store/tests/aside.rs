//! Tests results that are set aside, and how they are replaced or restored.

use optics_model::Walks;

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
const THIRD: Origin = Origin(3);

/// The machine that vouches for each finished job.
async fn behind(store: &Store, d: &StoredDictionary) -> Vec<(u32, Option<Origin>, Vec<Origin>)> {
    let vouching = |end| match end {
        EndedJob::Done { job, by, confirmed, .. } => (job, by, confirmed),
        EndedJob::GivenUp { .. } => panic!("{end:?}"),
    };
    store.ended_jobs(d.id, &d.grid).await.unwrap().into_iter().map(vouching).collect()
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

/// The records of a fenced machine are set aside and not read, and are deleted when other records take their place.
#[tokio::test]
async fn fenced_records_are_kept_until_recomputed() {
    let (_dir, store, d) = good_and_bad().await;
    assert_eq!(fence(&store, BAD).await, [(d.id, 1)]);
    assert_eq!(all_records(&store, &d).await, records(0, 0.25), "no others");
    assert_eq!((count(&store, "set_aside").await, count(&store, "records").await), (1, 4));
    assert!(matches!(complete(&store, &d, 1, 0.25).await, Outcome::Finished { .. }));
    assert_eq!((count(&store, "set_aside").await, count(&store, "records").await), (0, 4));
    assert_eq!(behind(&store, &d).await, [(0, Some(GOOD), vec![]), (1, Some(GOOD), vec![])]);
    assert!(store.faults().await.unwrap().is_empty());
}

/// A machine whose fence is lifted gets its records back, also after a restart.
#[tokio::test]
async fn readmitted_machine_restores_its_records() {
    let (dir, store, d) = good_and_bad().await;
    let before = all_records(&store, &d).await;
    fence(&store, BAD).await;
    // A restart keeps the fence and the records.
    let store = reopened(store, &dir).await;
    let restored = store.ledger().exclusive().await.lift_fence(BAD).await.unwrap();
    let [(id, EndedJob::Done { job: 1, walks, by: Some(BAD), .. })] = &restored[..] else {
        panic!("{restored:?}")
    };
    assert_eq!((*id, *walks), (d.id, Walks::new(5000).unwrap()));
    assert_eq!(all_records(&store, &d).await, before);
    assert!(store.machines().await.unwrap().iter().all(|known| known.fenced.is_none()));
    assert_eq!(count(&store, "set_aside").await + count(&store, "jobs_set_aside").await, 0);
    assert_eq!(delete(&store, d.id).await, 4);
    assert!(store.faults().await.unwrap().is_empty());
}

/// Records that others have confirmed stay when their author is fenced, under the names of those others.
#[tokio::test]
async fn confirmed_records_pass_to_confirmers() {
    let (_dir, store, d) = good_and_bad().await;
    store.note_agreement(d.id, 0, BAD).await.unwrap();
    store.note_agreement(d.id, 1, THIRD).await.unwrap();
    assert_eq!(behind(&store, &d).await, [(0, Some(GOOD), vec![BAD]), (1, Some(BAD), vec![THIRD])]);
    assert_eq!(fence(&store, BAD).await, []);
    assert_eq!(behind(&store, &d).await, [(0, Some(GOOD), vec![]), (1, Some(THIRD), vec![])]);
    assert_eq!(fence(&store, THIRD).await, [(d.id, 1)], "no other machine has confirmed it");
}

/// Deleting a dictionary also deletes its records that were set aside.
#[tokio::test]
async fn deletion_includes_records_set_aside() {
    let (_dir, store, d) = good_and_bad().await;
    fence(&store, BAD).await;
    delete(&store, d.id).await;
    for table in ["records", "points", "set_aside", "jobs_set_aside", "contributions"] {
        assert_eq!(count(&store, table).await, 0, "{table}");
    }
    assert!(store.faults().await.unwrap().is_empty());
}

/// Machines are deleted only if no record, vote or fence refers to them.
#[tokio::test]
async fn only_unused_machines_are_forgotten() {
    let (dir, store, d) = good_and_bad().await;
    for name in ["useless", "fenced", "voter"] {
        store.register_worker(&Machine::at(name), name).await.unwrap();
    }
    fence(&store, Origin(5)).await;
    store.note_agreement(d.id, 0, THIRD).await.unwrap();
    let votes = vec![Vote { by: Some(Origin(6)), digest: Digest::from_bytes([1; 32]) }];
    store.note_check(&OpenCheck { dictionary: d.id, job: 0, block: 0, votes }).await.unwrap();
    let store = reopened(store, &dir).await;
    let left: Vec<i64> = store.machines().await.unwrap().iter().map(|known| known.origin.0).collect();
    assert_eq!(left, [1, 2, 3, 5, 6]);
}
