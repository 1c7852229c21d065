//! Results as they come in: headers, records and sums of one stream, checked piece by piece.

use std::time::Duration;

use bytes::{Bytes, BytesMut};
use farm_proto::ids::WorkerId;
use farm_proto::lease::LeaseKey;
use farm_proto::wire::complete_request::Content;
use farm_proto::wire::{CompleteRequest, CompletionKind, CompletionOutcome, ResultHeader};
use farm_proto::{RequestLimits, to_status};
use optics_model::job::JobSpec;
use optics_model::sums::Sums;
use optics_model::{Digest, Invalid, PackedRecords};
use tonic::{Code, Status, Streaming};

use super::Context;
use super::leases::identity;
use super::status::{OrStatus, required};
use crate::dispatch::Admission;
use crate::farm::{FarmError, Fate};
use crate::stored::JobResult;

/// How long a client may take for the next piece of a result.
const PATIENCE: Duration = Duration::from_mins(1);

/// Receives all results of a stream, storing each while the next comes in; what became of them, in their order.
pub(super) async fn receive(
    context: &Context,
    mut stream: Streaming<CompleteRequest>,
) -> Result<Vec<CompletionOutcome>, Status> {
    let mut tasks = Vec::new();
    let mut next = next(&mut stream).await?;
    if next.is_none() {
        return Err(to_status(&Invalid::new("content", "nothing", "a header comes first")));
    }
    while let Some(content) = next.take() {
        let Content::Header(header) = content else {
            return Err(to_status(&Invalid::new(
                "content",
                "no header",
                "a header comes before each result",
            )));
        };
        if tasks.len() == RequestLimits::LEASES as usize {
            let allowed = format!("at most {} in one call are allowed", RequestLimits::LEASES);
            return Err(to_status(&Invalid::new("results", tasks.len() + 1, allowed)));
        }
        let key = LeaseKey::from(required("key", header.key.clone())?);
        let worker = WorkerId(header.worker_id.clone());
        match admit(context, &header, &worker, &key) {
            Ok(admission) => {
                let room = context.limits.room(bytes_of(admission.job())).await?;
                let received;
                (received, next) = content_of(&mut stream, admission.job()).await?;
                let farm = context.farm.clone();
                tasks.push(Task::Storing(tokio::spawn(async move {
                    let _room = room;
                    farm.complete(worker, key, admission, received).await
                })));
            }
            // Only this one is not wanted; the others of the stream are.
            Err(status) if status.code() == Code::FailedPrecondition || status.code() == Code::NotFound => {
                tasks.push(Task::Refused(status.message().to_owned()));
                next = skip(&mut stream).await?;
            }
            Err(status) => return Err(status),
        }
    }
    let mut outcomes = Vec::with_capacity(tasks.len());
    for task in tasks {
        outcomes.push(task.outcome().await?);
    }
    Ok(outcomes)
}

enum Task {
    Storing(tokio::task::JoinHandle<Result<Fate, FarmError>>),
    Refused(String),
}

impl Task {
    async fn outcome(self) -> Result<CompletionOutcome, Status> {
        let (kind, message) = match self {
            Self::Refused(message) => (CompletionKind::Refused, message),
            Self::Storing(task) => {
                let stored = task.await.map_err(|_| Status::internal("storing a result failed"))?;
                let outcome = match stored {
                    Ok(outcome) => outcome,
                    // The other results of the stream may be stored.
                    Err(FarmError::Store(error)) => {
                        let kind = CompletionKind::NotStored.into();
                        return Ok(CompletionOutcome { kind, message: error.to_string() });
                    }
                    Err(error) => return Err(error.into()),
                };
                match outcome {
                    Fate::Stored => (CompletionKind::Stored, String::new()),
                    Fate::Duplicate => (CompletionKind::Duplicate, String::new()),
                    Fate::Conflict => {
                        let message = "other records than these are stored: this worker or an earlier one \
                                       computes wrongly";
                        (CompletionKind::Conflict, message.to_owned())
                    }
                    Fate::Unwanted => (CompletionKind::Refused, "not wanted any more".to_owned()),
                }
            }
        };
        Ok(CompletionOutcome { kind: kind.into(), message })
    }
}

fn admit(
    context: &Context,
    header: &ResultHeader,
    worker: &WorkerId,
    key: &LeaseKey,
) -> Result<Admission, Status> {
    let identity: Digest = identity(&header.identity).or_status()?;
    Ok(context.farm.admit(worker, key, identity)?)
}

async fn next(stream: &mut Streaming<CompleteRequest>) -> Result<Option<Content>, Status> {
    let message = tokio::time::timeout(PATIENCE, stream.message()).await;
    let message =
        message.map_err(|_| Status::deadline_exceeded("the next piece of the result did not come"))??;
    message.map(|m| required("content", m.content)).transpose()
}

/// Bytes that a job's result takes.
fn bytes_of(job: &JobSpec) -> usize {
    match job.block() {
        Some(_) => Sums::bytes(job),
        None => PackedRecords::bytes_of(job),
    }
}

/// The content of one result, checked, and what comes after it.
async fn content_of(
    stream: &mut Streaming<CompleteRequest>,
    job: &JobSpec,
) -> Result<(JobResult, Option<Content>), Status> {
    let (bytes, after) = gather(stream, job).await?;
    if job.block().is_none() {
        return Ok((JobResult::Records(PackedRecords::new(job, bytes).or_status()?), after));
    }
    // Refused here rather than when they are merged.
    Sums::from_le_bytes(job, 1, &bytes).or_status()?;
    Ok((JobResult::Sums(bytes), after))
}

/// The pieces of one result as a whole, not longer than it may be, and what comes after it. They are copied to a place of
/// just their size: as they are, they hold on to the messages that they came in, however large these are.
async fn gather(
    stream: &mut Streaming<CompleteRequest>,
    job: &JobSpec,
) -> Result<(Bytes, Option<Content>), Status> {
    let (wanted, what) = (bytes_of(job), if job.block().is_some() { "sums" } else { "records" });
    let mut whole = BytesMut::with_capacity(wanted);
    loop {
        let piece = match (next(stream).await?, job.block()) {
            (Some(Content::Records(piece)), None) | (Some(Content::Sums(piece)), Some(_)) => piece,
            (after @ (None | Some(Content::Header(_))), _) => return Ok((whole.freeze(), after)),
            (Some(Content::Records(_)), _) => {
                let allowed = "the job is divided: sums are wanted";
                return Err(to_status(&Invalid::new("content", "records", allowed)));
            }
            (Some(Content::Sums(_)), _) => {
                let allowed = "the job is not divided: records are wanted";
                return Err(to_status(&Invalid::new("content", "sums", allowed)));
            }
        };
        if piece.is_empty() {
            return Err(to_status(&Invalid::new(what, "an empty piece", "each piece brings something")));
        }
        if whole.len() + piece.len() > wanted {
            let given = format!("more than {wanted} bytes");
            return Err(to_status(&Invalid::new(what, given, format!("{wanted} are needed"))));
        }
        whole.extend_from_slice(&piece);
    }
}

/// Passes over the content of a result that is not wanted.
async fn skip(stream: &mut Streaming<CompleteRequest>) -> Result<Option<Content>, Status> {
    loop {
        match next(stream).await? {
            Some(Content::Records(_) | Content::Sums(_)) => {}
            after => return Ok(after),
        }
    }
}
