//! Results on their way to the coordinator: kept until they are acknowledged, sent together when several wait.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use farm_proto::RequestLimits;
use farm_proto::lease::LeaseKey;
use farm_proto::wire::complete_request::Content;
use farm_proto::wire::{CompleteRequest, CompletionKind, CompletionOutcome, ResultHeader};
use optics_model::job::JobSpec;
use optics_model::sums::Sums;
use optics_model::{Digest, PackedRecords};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tonic::{Code, Status};

use crate::held::Held;
use crate::pool::Traced;
use crate::session::{Session, jittered};

/// Bytes after which a call takes no more results.
const BATCH_BYTES: usize = 16 << 20;
/// Pause after a call of which nothing was stored, first and longest.
const PAUSE: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(10));
/// Bytes of one piece of a result.
const PIECE: usize = 1 << 20;

/// A result that waits, with its room in the buffer.
#[derive(Debug)]
pub(crate) struct Finished {
    pub key: LeaseKey,
    pub identity: Digest,
    pub traced: Traced,
    pub bytes: usize,
    pub _room: OwnedSemaphorePermit,
}

/// Memory of all results that wait, in KiB.
#[derive(Debug, Clone)]
pub(crate) struct Buffer {
    room: Arc<Semaphore>,
    kib: u32,
}

impl Buffer {
    pub(crate) fn new(bytes: usize) -> Self {
        let kib = (bytes / 1024).clamp(1, u32::MAX as usize >> 4) as u32;
        Self { room: Arc::new(Semaphore::new(kib as usize)), kib }
    }

    /// Waits until there is room for a job's result. One that is larger than the whole buffer gets all of it.
    pub(crate) async fn take(&self, bytes: usize) -> Option<OwnedSemaphorePermit> {
        let kib = (bytes.div_ceil(1024) as u32).min(self.kib);
        self.room.clone().acquire_many_owned(kib).await.ok()
    }
}

/// Bytes of a job's result.
pub(crate) fn bytes_of(job: &JobSpec) -> usize {
    match job.block() {
        Some(_) => Sums::bytes(job),
        None => PackedRecords::bytes_of(job),
    }
}

/// Delivers until the queue is closed and empty.
pub(crate) async fn deliver(
    session: Arc<Session>,
    held: Arc<Held>,
    mut queue: mpsc::UnboundedReceiver<Finished>,
) {
    let mut waiting = VecDeque::new();
    let mut pause = PAUSE.0;
    while !waiting.is_empty() || queue.recv().await.map(|first| waiting.push_back(first)).is_some() {
        while let Ok(next) = queue.try_recv() {
            waiting.push_back(next);
        }
        let batch = next_batch(&mut waiting);
        let (count, not_stored) = (batch.len(), send(&session, &held, batch).await);
        if not_stored.len() < count {
            pause = PAUSE.0;
        } else {
            tokio::time::sleep(jittered(pause)).await;
            pause = (2 * pause).min(PAUSE.1);
        }
        // The others first: one that cannot be stored must not keep them waiting.
        waiting.extend(not_stored);
    }
}

/// The results that have waited longest, as many as go into a call.
fn next_batch(waiting: &mut VecDeque<Finished>) -> Vec<Finished> {
    let (mut batch, mut bytes) = (Vec::new(), 0);
    while bytes < BATCH_BYTES
        && batch.len() < RequestLimits::LEASES as usize
        && let Some(next) = waiting.pop_front()
    {
        bytes += next.bytes;
        batch.push(next);
    }
    batch
}

/// Sends results until they are acknowledged or refused for good; gives back those that the coordinator's store did
/// not take.
async fn send(session: &Session, held: &Held, batch: Vec<Finished>) -> Vec<Finished> {
    match session.complete(|worker| parts(worker, &batch), batch.iter().map(|f| f.bytes).sum()).await {
        Ok(outcomes) => {
            let mut not_stored = Vec::new();
            let mut outcomes = outcomes.into_iter();
            for finished in batch {
                let Some(outcome) = outcomes.next() else {
                    not_stored.push(finished);
                    continue;
                };
                tell(&finished.key, &outcome);
                if outcome.kind() == CompletionKind::NotStored {
                    not_stored.push(finished);
                } else {
                    held.remove(&finished.key);
                }
            }
            not_stored
        }
        // One of them is not as it should be; the others must not suffer.
        Err(status) if batch.len() > 1 && status.code() == Code::InvalidArgument => {
            let mut not_stored = Vec::new();
            for finished in batch {
                not_stored.extend(Box::pin(send(session, held, vec![finished])).await);
            }
            not_stored
        }
        Err(status) => {
            for finished in &batch {
                refused(session, &finished.key, &status).await;
                held.remove(&finished.key);
            }
            Vec::new()
        }
    }
}

fn tell(key: &LeaseKey, outcome: &CompletionOutcome) {
    let (dictionary, job, attempt) = (key.dictionary.0, key.job, key.attempt);
    let message = outcome.message.as_str();
    match outcome.kind() {
        CompletionKind::Stored => tracing::debug!(dictionary, job, attempt, "job done"),
        CompletionKind::Duplicate => {
            tracing::debug!(dictionary, job, attempt, "these records were stored before");
        }
        CompletionKind::Refused | CompletionKind::Unspecified => {
            tracing::info!(dictionary, job, attempt, message, "this result is not wanted any more");
        }
        CompletionKind::Conflict => tracing::error!(dictionary, job, attempt, message, "result refused"),
        CompletionKind::NotStored => {
            tracing::warn!(dictionary, job, attempt, message, "the result is kept: it could not be stored");
        }
    }
}

/// A result that no repetition would bring in.
async fn refused(session: &Session, key: &LeaseKey, status: &Status) {
    tracing::error!(job = key.job, attempt = key.attempt, message = status.message(), "result refused");
    // The job would come back for ever if nobody told that it came to nothing.
    if status.code() == Code::InvalidArgument
        && let Err(error) = session.fail(key, &format!("result refused: {}", status.message())).await
    {
        tracing::warn!(job = key.job, message = error.message(), "the failure is not wanted any more");
    }
}

/// The messages of a call that delivers results.
fn parts(worker: &str, batch: &[Finished]) -> Vec<CompleteRequest> {
    let mut parts = Vec::new();
    let mut push = |content| parts.push(CompleteRequest { content: Some(content) });
    for Finished { key, identity, traced, .. } in batch {
        push(Content::Header(ResultHeader {
            worker_id: worker.to_owned(),
            key: Some((*key).into()),
            identity: identity.as_bytes().to_vec(),
        }));
        match traced {
            Traced::Records(records) => pieces(records.bytes()).for_each(|p| push(Content::Records(p))),
            Traced::Sums(sums) => pieces(&sums.to_le_bytes().into()).for_each(|p| push(Content::Sums(p))),
        }
    }
    parts
}

fn pieces(bytes: &Bytes) -> impl Iterator<Item = Bytes> {
    (0..bytes.len()).step_by(PIECE).map(|start| bytes.slice(start..bytes.len().min(start + PIECE)))
}

/// How long a delivery may take.
pub(crate) fn time_for(bytes: usize) -> Duration {
    /// Slowest link, in bytes a second, over which results are delivered before the call is given up and repeated.
    const SLOWEST: f64 = 50_000.0;
    Duration::from_mins(1) + Duration::from_secs_f64(bytes as f64 / SLOWEST)
}
