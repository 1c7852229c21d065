//! Takes jobs that share their walks from their leases to their results: announces them, has them traced, and queues
//! results for delivery or reports failures.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use farm_proto::lease::{Lease, LeaseKey};
use optics_model::Digest;
use optics_model::job::JobSpec;
use optics_model::sums::result_bytes;
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};

use crate::delivery::{PendingResult, ResultBuffer};
use crate::leases::{HeldLeases, JobSwitches};
use crate::pool::{Pool, StartSignal, TraceEnd, TraceResult};
use crate::session::CoordinatorSession;

/// After this time a message has left this machine, even if the answer takes longer.
const ON_ITS_WAY: Duration = Duration::from_millis(50);

/// State that all jobs of a worker share. The delivery ends when the last clone is dropped.
#[derive(Debug, Clone)]
pub(crate) struct JobRunner {
    pub session: Arc<CoordinatorSession>,
    pub held: Arc<HeldLeases>,
    pub pool: Pool,
    pub buffer: ResultBuffer,
    pub finished: mpsc::UnboundedSender<PendingResult>,
}

/// The data of a lease that the delivery of its result needs.
struct ResultHeader {
    key: LeaseKey,
    identity: Digest,
    bytes: usize,
}

impl ResultHeader {
    fn new(lease: &Lease) -> Self {
        Self { key: lease.key, identity: lease.job.identity(), bytes: result_bytes(&lease.job) }
    }
}

impl JobRunner {
    /// Traces jobs that share their walks and queues their results; frees their slot as soon as other jobs may begin.
    /// Leases of jobs that are stopped with the worker stay in the table, to be handed back.
    pub(crate) async fn run(
        self,
        leases: Vec<Lease>,
        switches: Vec<Arc<JobSwitches>>,
        slot: OwnedSemaphorePermit,
    ) {
        let headers: Vec<ResultHeader> = leases.iter().map(ResultHeader::new).collect();
        let bytes: Vec<usize> = headers.iter().map(|job| job.bytes).collect();
        // Back-pressure: tracing waits here while results cannot be delivered.
        let Some(room) = self.buffer.take(&bytes).await else { return };
        let (begun, begins) = oneshot::channel();
        let announced = self.announce(headers.iter().map(|job| (job.key, job.identity)).collect(), begins);
        let jobs: Vec<JobSpec> = leases.into_iter().map(|lease| lease.job).collect();
        let (end, ()) = tokio::join!(self.pool.trace(jobs.clone(), switches.clone(), begun), announced);
        let ends = match end {
            TraceEnd::Finished(results) => results.into_iter().map(Ok).collect(),
            TraceEnd::Failed(reason) if jobs.len() == 1 => vec![Err(reason)],
            // Only one of the jobs may be the cause.
            TraceEnd::Failed(_) => self.trace_one_by_one(jobs, &switches).await,
            TraceEnd::Stopped => return,
        };
        let all = headers.into_iter().zip(ends).zip(room).zip(switches);
        // A result counts even if its lease was lost meanwhile; a failure only if its job was not stopped.
        let counts = |end: &Result<_, _>, switches: &JobSwitches| end.is_ok() || !switches.is_stopped();
        let ended: Vec<_> =
            all.filter(|(((_, end), _), switches)| counts(end, switches)).map(|(end, _)| end).collect();
        for ((job, end), _) in &ended {
            if end.is_ok() {
                self.held.mark_traced(&job.key);
            }
        }
        // The next jobs may begin while these results are delivered.
        drop(slot);
        for ((ResultHeader { key, identity, bytes }, end), room) in ended {
            match end {
                Ok(result) => {
                    let _ = self.finished.send(PendingResult { key, identity, result, bytes, _room: room });
                }
                Err(reason) => self.report_failure(&key, &reason).await,
            }
        }
    }

    /// The result of each job when it is traced alone, or the reason why it has none. Entries of stopped jobs are
    /// arbitrary.
    async fn trace_one_by_one(
        &self,
        jobs: Vec<JobSpec>,
        switches: &[Arc<JobSwitches>],
    ) -> Vec<Result<TraceResult, String>> {
        let mut ends = Vec::with_capacity(jobs.len());
        for (job, switches) in jobs.into_iter().zip(switches) {
            let (unheard, _) = oneshot::channel();
            ends.push(match self.pool.trace(vec![job], vec![switches.clone()], unheard).await {
                TraceEnd::Finished(results) => results.into_iter().next().ok_or_else(String::new),
                TraceEnd::Failed(reason) => Err(reason),
                TraceEnd::Stopped => Err("stopped".to_owned()),
            });
        }
        ends
    }

    /// Announces to the coordinator that a thread is about to begin. The thread waits until the message is sent, but
    /// not for the answer of a distant coordinator, which would slow small jobs.
    async fn announce(&self, jobs: Vec<(LeaseKey, Digest)>, begins: oneshot::Receiver<StartSignal>) {
        // An error means that the jobs were stopped first.
        let Ok(start) = begins.await else { return };
        let keys: Vec<LeaseKey> = jobs.iter().map(|(key, _)| *key).collect();
        let mut announcement = pin!(self.session.begin(jobs));
        let answered = tokio::time::timeout(ON_ITS_WAY, &mut announcement).await.is_ok();
        let _ = start.send(());
        if !answered {
            announcement.await;
        }
        for LeaseKey { dictionary, job, attempt, .. } in keys {
            tracing::debug!(dictionary = dictionary.0, job, attempt, "job begins");
        }
    }

    async fn report_failure(&self, key: &LeaseKey, reason: &str) {
        tracing::error!(job = key.job, attempt = key.attempt, reason, "job failed");
        if let Err(status) = self.session.fail(key, reason).await {
            let message = status.message();
            tracing::warn!(job = key.job, message, "the failure is not ended any more");
        }
        self.held.remove(key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::leases::SetSwitch;
    use crate::testing::{Answer, Call, Coordinator, Method, job, lease, session};

    /// The report of a panic is repeated until it gets an answer.
    #[tokio::test(start_paused = true)]
    async fn tracer_panic_is_reported() {
        let coordinator = Coordinator::start();
        let (session, held) = session(&coordinator).await;
        let (finished, _queue) = mpsc::unbounded_channel();
        let (pool, buffer) = (Pool::new(1, Duration::ZERO).unwrap(), ResultBuffer::new(1));
        let runner = JobRunner { session, held: held.clone(), pool, buffer, finished };
        let key = lease(4).key;
        held.add(key, job(4).identity(), SetSwitch::new(1));
        coordinator.answer(Method::Fail, Answer::Error(tonic::Status::unavailable("")));
        coordinator.answer(Method::Fail, Answer::Lost);
        runner.report_failure(&key, "the tracer panicked: no message").await;
        let failures = coordinator.calls(Call::fail);
        assert_eq!(failures.len(), 3, "the first reports were not accepted");
        assert!(failures.iter().all(|f| f.lease.as_ref().unwrap().job == 4 && f.reason.contains("panicked")));
        assert!(held.is_empty());
    }
}
