//! Receives streams of results: headers, records and sums, checked piece by piece. Each result is stored while the next
//! is received.

use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use farm_proto::RequestLimits;
use farm_proto::ids::WorkerId;
use farm_proto::lease::LeaseKey;
use optics_model::job::JobSpec;
use optics_model::sums::{Sums, result_bytes};
use optics_model::{Digest, Invalid, PackedRecords};
use tokio::task::JoinHandle;
use tokio_stream::{Stream, StreamExt};

use super::result_room::{ResultRoom, Taken};
use super::{Farm, FarmError, Result};
use crate::dispatch::DispatchError;
use crate::store::StoreError;
use crate::stored::{JobResult, Machine, Outcome};

/// Largest message of a stream of results: a worker's pieces have 1 MiB.
pub(crate) const MESSAGE_BYTES: usize = 2 << 20;

/// A piece of a stream of results: each result is a header, and then its content.
#[derive(Debug)]
pub(crate) enum Piece {
    Header(Header),
    Records(Bytes),
    Sums(Bytes),
}

/// The worker whose result follows, and its lease.
#[derive(Debug)]
pub(crate) struct Header {
    pub worker: WorkerId,
    pub key: LeaseKey,
    /// The identity of the job as the worker received it.
    pub identity: Digest,
}

/// The reason why a result was not stored.
#[derive(Debug)]
pub(crate) enum Refusal {
    /// The worker is to deliver it again later.
    NotStored(StoreError),
    /// The worker is to drop it.
    Unwanted(DispatchError),
}

/// A result that is being stored, or the error of one that is refused.
type Task = Result<JoinHandle<Result<Outcome>>, DispatchError>;

impl Farm {
    /// Receives all results of a machine's stream, storing each while the next is received. Returns their outcomes, in
    /// their order.
    pub(crate) async fn receive<S, E>(
        self: &Arc<Self>,
        machine: &Machine,
        stream: S,
    ) -> Result<Vec<Result<Outcome, Refusal>>, E>
    where
        S: Stream<Item = Result<Piece, E>> + Unpin,
        E: From<FarmError>,
    {
        let _turn = self.results.call(machine).await;
        let mut pieces = Pieces { stream, machine, room: &self.results };
        let mut tasks: Vec<Task> = Vec::new();
        let mut next = pieces.next().await?;
        if next.is_none() {
            return Err(refused("content", "nothing", "a header comes first"));
        }
        while let Some(piece) = next.take() {
            let Piece::Header(Header { worker, key, identity }) = piece else {
                return Err(refused("content", "no header", "a header comes before each result"));
            };
            if tasks.len() == RequestLimits::LEASES as usize {
                let allowed = format!("at most {} in one call are allowed", RequestLimits::LEASES);
                return Err(refused("results", tasks.len() + 1, allowed));
            }
            match self.admit(&worker, &key, identity) {
                Ok(admission) => {
                    let result;
                    let taken;
                    (result, taken, next) = pieces.result(admission.job()).await?;
                    let result = match result {
                        Ok(result) => result,
                        Err(invalid) => {
                            self.cannot_be(&worker, &key, &invalid);
                            return Err(FarmError::from(invalid).into());
                        }
                    };
                    let farm = self.clone();
                    tasks.push(Ok(tokio::spawn(async move {
                        let _taken = taken;
                        farm.complete(worker, key, admission, result).await
                    })));
                }
                // Only this result is refused; the others of the stream are accepted.
                Err(FarmError::Dispatch(
                    error @ (DispatchError::LeaseLost { .. } | DispatchError::UnknownJob(_)),
                )) => {
                    tasks.push(Err(error));
                    next = pieces.skip().await?;
                }
                Err(error) => return Err(error.into()),
            }
        }
        let mut delivered = Vec::with_capacity(tasks.len());
        for task in tasks {
            delivered.push(ended(task).await?);
        }
        Ok(delivered)
    }

    /// Counts an impossible result, such as one with NaN, as a failed attempt.
    fn cannot_be(&self, worker: &WorkerId, key: &LeaseKey, why: &Invalid) {
        let reason = format!("its result cannot be: {why}");
        // Without a lease it counts for nothing.
        let _ = self.scheduler.transition(|dispatcher, now| dispatcher.failed(now, worker, key, &reason));
    }
}

async fn ended(task: Task) -> Result<Result<Outcome, Refusal>> {
    let stored = match task {
        Ok(task) => task.await.map_err(|_| FarmError::Broken)?,
        Err(error) => return Ok(Err(Refusal::Unwanted(error))),
    };
    match stored {
        Ok(outcome) => Ok(Ok(outcome)),
        // The other results of the stream may be stored.
        Err(FarmError::Store(error)) => Ok(Err(Refusal::NotStored(error))),
        Err(error) => Err(error),
    }
}

fn refused<E: From<FarmError>>(field: &str, given: impl std::fmt::Display, allowed: impl Into<String>) -> E {
    FarmError::from(Invalid::new(field, given, allowed)).into()
}

/// The pieces of a machine's stream.
struct Pieces<'a, S> {
    stream: S,
    machine: &'a Machine,
    room: &'a ResultRoom,
}

impl<S, E> Pieces<'_, S>
where
    S: Stream<Item = Result<Piece, E>> + Unpin,
    E: From<FarmError>,
{
    async fn next(&mut self) -> Result<Option<Piece>, E> {
        self.stream.next().await.transpose()
    }

    /// One result, checked, with the memory reserved for it and the piece that follows it.
    async fn result(
        &mut self,
        job: &JobSpec,
    ) -> Result<(std::result::Result<JobResult, Invalid>, Taken, Option<Piece>), E> {
        let mut taken = Taken::default();
        let (bytes, after) = self.gather(job, &mut taken).await?;
        let checked = if job.block().is_some() {
            // Invalid sums are refused here rather than when they are merged.
            Sums::from_le_bytes(job, 1, &bytes).map(|_| JobResult::Sums(bytes))
        } else {
            PackedRecords::new(job, bytes).map(JobResult::Records)
        };
        Ok((checked, taken, after))
    }

    /// Joins the pieces of one result, up to its permitted length, and returns them with the piece that follows. They are
    /// copied to a buffer of exactly their size: otherwise each would keep the whole message in memory in which it arrived.
    async fn gather(&mut self, job: &JobSpec, taken: &mut Taken) -> Result<(Bytes, Option<Piece>), E> {
        let (wanted, what) = (result_bytes(job), if job.block().is_some() { "sums" } else { "records" });
        let mut whole = BytesMut::new();
        loop {
            let piece = match (self.next().await?, job.block()) {
                (Some(Piece::Records(piece)), None) | (Some(Piece::Sums(piece)), Some(_)) => piece,
                (after @ (None | Some(Piece::Header(_))), _) => return Ok((whole.freeze(), after)),
                (Some(Piece::Records(_)), Some(_)) => {
                    return Err(refused("content", "records", "the job is divided: send sums"));
                }
                (Some(Piece::Sums(_)), None) => {
                    return Err(refused("content", "sums", "the job is not divided: send records"));
                }
            };
            if piece.is_empty() {
                return Err(refused(what, "an empty piece", "each piece brings something"));
            }
            if whole.len() + piece.len() > wanted {
                let given = format!("more than {wanted} bytes");
                return Err(refused(what, given, format!("{wanted} are needed")));
            }
            self.room.take(self.machine, taken, piece.len()).await;
            // Reserved all at once, so that the buffer is never moved; the system provides the memory as it is written to.
            whole.reserve(wanted - whole.len());
            whole.extend_from_slice(&piece);
        }
    }

    /// Passes over the content of a refused result.
    async fn skip(&mut self) -> Result<Option<Piece>, E> {
        loop {
            match self.next().await? {
                Some(Piece::Records(_) | Piece::Sums(_)) => {}
                after => return Ok(after),
            }
        }
    }
}
