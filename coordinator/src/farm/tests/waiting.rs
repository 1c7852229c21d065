//! Tests calls that wait for work, for changes or for the disk.

use std::pin::{Pin, pin};
use std::task::Poll;
use std::time::Duration;

use tokio_util::sync::CancellationToken;

use super::*;
use crate::farm::WorkerEnd;

const LONG: Duration = Duration::from_mins(1);

/// Whether a call waits: it is polled once.
async fn waits<F: Future>(call: &mut Pin<&mut F>) -> bool {
    std::future::poll_fn(|context| Poll::Ready(call.as_mut().poll(context).is_pending())).await
}

/// A worker that waits for jobs gets its answer when its waiting time ends, when there are some or another one hands them
/// back, when it is drained, or when the coordinator stops.
#[tokio::test]
async fn waiting_workers_are_woken() {
    let (farm, _dir) = empty().await;
    let (first, stop) = (worker(&farm, "first").await, CancellationToken::new());
    assert!(farm.acquire(&first, 1, Duration::from_millis(1), &stop).await.unwrap().is_none());
    let mut waiting = pin!(farm.acquire(&first, JOBS as usize, LONG, &stop));
    assert!(waits(&mut waiting).await);
    farm.submit(&Actor::default(), name(), grid(), 0).await.unwrap();
    let all = waiting.await.unwrap().unwrap().leases;
    assert_eq!(all.len(), JOBS as usize);

    let others = ["second", "drained", "stopped"].map(|label| worker(&farm, label));
    let [second, drained, stopped] = others;
    let (second, drained, stopped) = (second.await, drained.await, stopped.await);
    let mut waiting = pin!(farm.acquire(&second, 1, LONG, &stop));
    assert!(waits(&mut waiting).await);
    farm.hand_back(&first, &[all[3].key], None);
    assert_eq!(waiting.await.unwrap().unwrap().leases[0].key.job, all[3].key.job);

    let mut waiting = pin!(farm.acquire(&drained, 1, LONG, &stop));
    assert!(waits(&mut waiting).await);
    farm.drain(&Actor::default(), &drained.0).unwrap();
    assert!(waiting.await.unwrap().unwrap().drain);

    let mut waiting = pin!(farm.acquire(&stopped, 1, LONG, &stop));
    assert!(waits(&mut waiting).await);
    stop.cancel();
    assert!(matches!(waiting.await, Err(FarmError::Stopping)));
}

/// A watch reports every change and ends with the dictionary.
#[tokio::test]
async fn watch_reports_every_change() {
    let (farm, worker, _dir) = begun(0.0).await;
    let mut watch = farm.watch(name()).unwrap();
    assert_eq!(watch.next().await.unwrap().unwrap().jobs_done, 0);
    deliver(&farm, &worker, &lease(&farm, &worker).unwrap(), 0.25).await;
    assert_eq!(watch.next().await.unwrap().unwrap().jobs_done, 1);
    farm.cancel(&Actor::default(), &name(), "enough").await.unwrap();
    assert_eq!(watch.next().await.unwrap().unwrap().state, DictionaryState::Cancelled);
    assert!(watch.next().await.unwrap().is_none());
    let mut late = farm.watch(name()).unwrap();
    assert_eq!(late.next().await.unwrap().unwrap().reason, "enough");
    assert!(late.next().await.unwrap().is_none());
}

/// An export has the finished records from an index on, or those that are requested, in the order of the request.
#[tokio::test]
async fn export_is_ordered_and_announces_length() {
    let (farm, _dir) = done().await;
    let mut numbers = Vec::new();
    let mut export = farm.export(name(), 71, &[]).unwrap();
    assert_eq!(export.promised, 9);
    while let Some(record) = export.next().await.unwrap() {
        numbers.push(record.index);
    }
    assert_eq!(numbers, (71..80).collect::<Vec<_>>());
    let mut some = farm.export(name(), 3, &[2, 77, 3]).unwrap();
    assert_eq!(some.promised, 2);
    assert_eq!(some.next().await.unwrap().unwrap().index, 77);
    assert_eq!(some.next().await.unwrap().unwrap().index, 3);
    assert!(some.next().await.unwrap().is_none());
    assert!(farm.export(name(), 80, &[]).unwrap().next().await.unwrap().is_none());
    let refused = farm.export(name(), 81, &[]);
    assert!(matches!(&refused, Err(FarmError::Invalid(why)) if why.field() == "first"), "{refused:?}");
}

/// A decision that cannot be stored is retried.
#[tokio::test]
async fn failed_write_is_retried() {
    let (farm, worker, dir) = begun(0.0).await;
    let id = farm.found(&name()).unwrap().0;
    change(&dir, "ALTER TABLE jobs RENAME TO elsewhere").await;
    let job = lease(&farm, &worker).unwrap().key.job;
    farm.hand_back(&worker, &[], Some(WorkerEnd::Left));
    for round in 0..3 {
        let worker = super::worker(&farm, &format!("worker {round}")).await;
        let leases = farm.acquire_now(&worker, JOBS as usize).unwrap().leases;
        let of_job = leases.iter().find(|lease| lease.key.job == job).unwrap();
        farm.failed(&worker, &of_job.key, "no luck").await.unwrap();
        farm.hand_back(&worker, &[], Some(WorkerEnd::Left));
    }
    assert_eq!(farm.status(&name()).unwrap().failed.len(), 1, "it is given up");
    change(&dir, "ALTER TABLE elsewhere RENAME TO jobs").await;
    assert!(farm.store.ended_jobs(id, &grid()).await.unwrap().is_empty(), "and it is not stored");
    farm.look_over();
    farm.scheduler.settled().await;
    let ended = farm.store.ended_jobs(id, &grid()).await.unwrap();
    assert_eq!(ended.iter().map(crate::stored::EndedJob::job).collect::<Vec<_>>(), [job]);
}

/// A watch ends when its dictionary is deleted, even if another one takes its name.
#[tokio::test]
async fn watch_follows_a_dictionary_not_a_name() {
    let (farm, _, _dir) = begun(0.0).await;
    let by = Actor::default();
    let (mut watch, mut jobs) = (farm.watch(name()).unwrap(), farm.watch_jobs(&name()).unwrap());
    watch.next().await.unwrap().unwrap();
    jobs.next().await.unwrap().unwrap();
    farm.cancel(&by, &name(), "").await.unwrap();
    farm.delete(&by, &name()).await.unwrap();
    farm.submit(&by, name(), grid(), 0).await.unwrap();
    assert!(matches!(watch.next().await, Err(FarmError::Deleted { .. })));
    // Nor do those of its jobs seem complete.
    assert!(matches!(jobs.next().await, Err(FarmError::Deleted { .. })));
}

/// A watch without changes repeats the last state within 15 seconds.
#[tokio::test]
async fn quiet_watch_repeats_every_15_seconds() {
    let (farm, _, _dir) = begun(0.0).await;
    tokio::time::pause();
    let (mut watch, mut jobs) = (farm.watch(name()).unwrap(), farm.watch_jobs(&name()).unwrap());
    let (first, of_jobs) = (watch.next().await.unwrap().unwrap(), jobs.next().await.unwrap().unwrap());
    for _ in 0..3 {
        let start = tokio::time::Instant::now();
        assert_eq!(watch.next().await.unwrap().unwrap(), first);
        assert!(start.elapsed() <= Duration::from_secs(15), "{:?}", start.elapsed());
        // A part of the states that were sent before, so that it changes nothing for a client that takes it for a change.
        let (start, again) = (tokio::time::Instant::now(), jobs.next().await.unwrap().unwrap());
        assert!(start.elapsed() <= Duration::from_secs(15), "{:?}", start.elapsed());
        assert_eq!((again.first, again.states.as_slice()), (of_jobs.first, &of_jobs.states[..1]));
    }
}
