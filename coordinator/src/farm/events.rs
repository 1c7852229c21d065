//! Writes events to the store in batches, so that no operation waits for them.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use crate::clock::Clock;
use crate::dispatch::Event;
use crate::quota::{Limit, Quota};
use crate::store::{Store, StoredEvent};

/// Events that may wait; more are dropped, and logged.
const QUEUE: usize = 10_000;
/// Most events of one transaction.
const BATCH: usize = 500;
/// Time in which events are gathered between two transactions.
const PAUSE: Duration = Duration::from_millis(200);
/// Most time that a question about events waits for those before it.
const SETTLE: Duration = Duration::from_secs(2);

/// Events of one actor that are kept if they come at once, and in each second after that: a tenth of all that are kept in
/// nearly three hours. The oldest are deleted for the newest, so no actor must be able to write all of them.
const AT_ONCE: u64 = 1000;
const IN_A_SECOND: f64 = 1.0;

#[derive(Debug)]
pub(super) struct Recorder {
    queue: Mutex<Option<mpsc::Sender<StoredEvent>>>,
    /// Number of events that were queued, and of those that were stored or lost.
    queued: AtomicU64,
    settled: watch::Receiver<u64>,
    shares: Arc<Quota>,
    writer: tokio::sync::Mutex<Option<JoinHandle<()>>>,
}

impl Recorder {
    pub(super) fn start(store: Store) -> Self {
        let (queue, events) = mpsc::channel(QUEUE);
        let (done, settled) = watch::channel(0);
        let writer = tokio::spawn(write(store, events, done));
        Self {
            queue: Mutex::new(Some(queue)),
            queued: AtomicU64::new(0),
            settled,
            shares: Quota::refilled(IN_A_SECOND, "events", "cause fewer"),
            writer: tokio::sync::Mutex::new(Some(writer)),
        }
    }

    /// Logs an event, and queues it for the store unless its actor's share is used up.
    pub(super) fn record(&self, event: &Event) {
        let Event { kind, dictionary, job, worker, message, actor } = event;
        tracing::info!(kind = kind.as_str(), dictionary, job, worker, actor, "{message}");
        // Events that workers cause have no actor. Events of the farm itself are always kept.
        let whose = if actor.is_empty() && !worker.is_empty() { "workers" } else { actor.as_str() };
        let whose = whose.split_once(" at ").map_or(whose, |(token, _)| token);
        if !whose.is_empty() && self.shares.spend(&[Limit::new(whose, AT_ONCE)], 1).is_err() {
            return;
        }
        let stored = StoredEvent {
            id: 0,
            unix_ms: Clock::unix_ms() as i64,
            kind: kind.as_str().to_owned(),
            dictionary: dictionary.clone(),
            job: job.map(i64::from),
            worker: worker.clone(),
            message: message.clone(),
            actor: actor.clone(),
        };
        let queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(queue) = queue.as_ref() else { return };
        if queue.try_send(stored).is_ok() {
            self.queued.fetch_add(1, Ordering::Relaxed);
        } else {
            tracing::warn!("too many events at once: this one is not kept");
        }
    }

    /// Waits until the events that were recorded before are stored, but not for long.
    pub(super) async fn settle(&self) {
        let queued = self.queued.load(Ordering::Relaxed);
        let _ =
            tokio::time::timeout(SETTLE, self.settled.clone().wait_for(|settled| *settled >= queued)).await;
    }

    /// Writes the waiting events and ends the writer.
    pub(super) async fn finish(&self) {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(writer) = self.writer.lock().await.take() {
            let _ = writer.await;
        }
    }
}

async fn write(store: Store, mut events: mpsc::Receiver<StoredEvent>, settled: watch::Sender<u64>) {
    let mut batch = Vec::with_capacity(BATCH);
    while events.recv_many(&mut batch, BATCH).await > 0 {
        if let Err(error) = store.add_events(&batch).await {
            tracing::warn!(%error, lost = batch.len(), "events could not be stored");
        }
        settled.send_modify(|settled| *settled += batch.len() as u64);
        batch.clear();
        if !events.is_closed() {
            tokio::time::sleep(PAUSE).await;
        }
    }
}
