//! Delivers results to the coordinator and keeps each one until it is acknowledged. Results that wait are sent
//! together.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use farm_proto::RequestLimits;
use farm_proto::lease::LeaseKey;
use farm_proto::wire::{CompletionKind, CompletionOutcome};
use optics_model::Digest;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tonic::{Code, Status};

use crate::leases::HeldLeases;
use crate::pool::TraceResult;
use crate::retry::Pauses;
use crate::session::CoordinatorSession;

mod messages;

/// Bytes after which no further result is added to a call.
const BATCH_BYTES: usize = 16 << 20;
/// First and longest pause after a call of which no result was stored.
const PAUSE: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(10));

/// A result that is not acknowledged yet, with its share of the buffer.
#[derive(Debug)]
pub(crate) struct PendingResult {
    pub key: LeaseKey,
    pub identity: Digest,
    pub result: TraceResult,
    pub bytes: usize,
    pub _room: OwnedSemaphorePermit,
}

/// Memory for all results that are not acknowledged yet, in KiB.
#[derive(Debug, Clone)]
pub(crate) struct ResultBuffer {
    room: Arc<Semaphore>,
    kib: u32,
}

impl ResultBuffer {
    pub(crate) fn new(bytes: usize) -> Self {
        let kib = (bytes / 1024).clamp(1, u32::MAX as usize >> 4) as u32;
        Self { room: Arc::new(Semaphore::new(kib as usize)), kib }
    }

    /// Waits until all results of a set fit into the buffer. A result that is larger than the buffer reserves all of
    /// it.
    pub(crate) async fn take(&self, bytes: &[usize]) -> Option<Vec<OwnedSemaphorePermit>> {
        let kib = |bytes: usize| u32::try_from(bytes.div_ceil(1024)).unwrap_or(u32::MAX).min(self.kib);
        let all = kib(bytes.iter().sum());
        // In one step: two sets that each hold a part and wait for the rest would deadlock.
        let mut room = self.room.clone().acquire_many_owned(all).await.ok()?;
        let share = |bytes: &usize| {
            let kib = (kib(*bytes) as usize).min(room.num_permits());
            room.split(kib)
        };
        bytes.iter().map(share).collect()
    }
}

/// Delivers until the queue is closed and empty.
pub(crate) async fn deliver(
    session: Arc<CoordinatorSession>,
    held: Arc<HeldLeases>,
    mut queue: mpsc::UnboundedReceiver<PendingResult>,
) {
    let mut waiting = VecDeque::new();
    let mut pauses = Pauses::new(PAUSE.0, PAUSE.1);
    let mut back = session.back();
    while !waiting.is_empty() || queue.recv().await.map(|first| waiting.push_back(first)).is_some() {
        while let Ok(next) = queue.try_recv() {
            waiting.push_back(next);
        }
        let batch = next_batch(&mut waiting);
        let (count, not_stored) = (batch.len(), send(&session, &held, batch).await);
        if not_stored.len() < count {
            pauses.reset();
        } else {
            pauses.wait(&mut back).await;
        }
        // Behind the others, so that a result that cannot be stored does not block them.
        waiting.extend(not_stored);
    }
}

/// The results that have waited longest, as many as go into a call.
fn next_batch(waiting: &mut VecDeque<PendingResult>) -> Vec<PendingResult> {
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
async fn send(
    session: &CoordinatorSession,
    held: &HeldLeases,
    batch: Vec<PendingResult>,
) -> Vec<PendingResult> {
    let limit = messages::time_limit(batch.iter().map(|result| result.bytes).sum());
    match session.complete(|worker_token| messages::result_messages(worker_token, &batch), limit).await {
        Ok(outcomes) => settle(held, batch, outcomes),
        // One of the results is invalid; sent singly, the others get through.
        Err(status) if batch.len() > 1 && status.code() == Code::InvalidArgument => {
            let mut not_stored = Vec::new();
            for result in batch {
                not_stored.extend(Box::pin(send(session, held, vec![result])).await);
            }
            not_stored
        }
        Err(status) => {
            for result in &batch {
                give_up(session, &result.key, &status).await;
                held.remove(&result.key);
            }
            Vec::new()
        }
    }
}

/// Drops the results that the coordinator has decided on; gives back the others.
fn settle(
    held: &HeldLeases,
    batch: Vec<PendingResult>,
    outcomes: Vec<CompletionOutcome>,
) -> Vec<PendingResult> {
    let mut outcomes = outcomes.into_iter();
    let mut not_stored = Vec::new();
    for result in batch {
        let outcome = outcomes.next();
        if let Some(outcome) = &outcome {
            log_outcome(&result.key, outcome);
        }
        // A result without an outcome in the answer is not acknowledged either.
        if outcome.is_none_or(|outcome| outcome.kind() == CompletionKind::NotStored) {
            not_stored.push(result);
        } else {
            held.remove(&result.key);
        }
    }
    not_stored
}

fn log_outcome(key: &LeaseKey, outcome: &CompletionOutcome) {
    let (dictionary, job, attempt) = (key.dictionary.0, key.job, key.attempt);
    let message = outcome.message.as_str();
    match outcome.kind() {
        CompletionKind::Stored => tracing::debug!(dictionary, job, attempt, "job done"),
        CompletionKind::Duplicate => {
            tracing::debug!(dictionary, job, attempt, "these records were stored before");
        }
        CompletionKind::Refused | CompletionKind::Unspecified => {
            tracing::info!(dictionary, job, attempt, message, "this result is no longer needed");
        }
        CompletionKind::Conflict => tracing::error!(dictionary, job, attempt, message, "result refused"),
        CompletionKind::NotStored => {
            tracing::warn!(dictionary, job, attempt, message, "the result is kept: it could not be stored");
        }
    }
}

/// Gives up a result that would be refused again, and reports its job as failed.
async fn give_up(session: &CoordinatorSession, key: &LeaseKey, status: &Status) {
    tracing::error!(job = key.job, attempt = key.attempt, message = status.message(), "result refused");
    // Without a report, the job would be leased again and again.
    if status.code() == Code::InvalidArgument
        && let Err(error) = session.fail(key, &format!("result refused: {}", status.message())).await
    {
        tracing::warn!(job = key.job, message = error.message(), "the failure report is no longer needed");
    }
}

#[cfg(test)]
mod tests;
