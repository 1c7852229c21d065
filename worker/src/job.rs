//! Jobs that share their walks, on their way from lease to result.

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
use crate::pool::{JobResult, Pool, Start, TraceEnd};
use crate::session::Session;

/// By then a message has left this machine, wherever the coordinator is.
const ON_ITS_WAY: Duration = Duration::from_millis(50);

/// What all jobs of a worker share. The delivery ends when the last of these is dropped.
#[derive(Debug, Clone)]
pub(crate) struct Workshop {
    pub session: Arc<Session>,
    pub held: Arc<HeldLeases>,
    pub pool: Pool,
    pub buffer: ResultBuffer,
    pub finished: mpsc::UnboundedSender<PendingResult>,
}

/// The part of a lease that is needed once its job has been traced.
struct About {
    key: LeaseKey,
    identity: Digest,
    bytes: usize,
}

impl About {
    fn of(lease: &Lease) -> Self {
        Self { key: lease.key, identity: lease.job.identity(), bytes: result_bytes(&lease.job) }
    }
}

impl Workshop {
    /// Traces jobs that share their walks and passes their results on; gives their slot back as soon as others may begin.
    ///
    /// The leases of jobs that are stopped with the worker stay held, to be handed back.
    pub(crate) async fn run(
        self,
        leases: Vec<Lease>,
        switches: Vec<Arc<JobSwitches>>,
        slot: OwnedSemaphorePermit,
    ) {
        let about: Vec<About> = leases.iter().map(About::of).collect();
        let bytes: Vec<usize> = about.iter().map(|job| job.bytes).collect();
        // If results cannot be delivered, tracing waits here.
        let Some(room) = self.buffer.take(&bytes).await else { return };
        let (begun, begins) = oneshot::channel();
        let announced = self.announce(about.iter().map(|job| (job.key, job.identity)).collect(), begins);
        let jobs: Vec<JobSpec> = leases.into_iter().map(|lease| lease.job).collect();
        let (end, ()) = tokio::join!(self.pool.trace(jobs.clone(), switches.clone(), begun), announced);
        let ends = match end {
            TraceEnd::Finished(results) => results.into_iter().map(Ok).collect(),
            TraceEnd::Failed(reason) if jobs.len() == 1 => vec![Err(reason)],
            // One of them is to blame, and not the others.
            TraceEnd::Failed(_) => self.trace_one_by_one(jobs, &switches).await,
            TraceEnd::Stopped => return,
        };
        let all = about.into_iter().zip(ends).zip(room).zip(switches);
        // A result counts whatever became of its lease meanwhile; a failure only of what is still wanted.
        let counts = |end: &Result<_, _>, switches: &JobSwitches| end.is_ok() || !switches.is_stopped();
        let wanted: Vec<_> =
            all.filter(|(((_, end), _), switches)| counts(end, switches)).map(|(end, _)| end).collect();
        for ((job, end), _) in &wanted {
            if end.is_ok() {
                self.held.mark_traced(&job.key);
            }
        }
        // The next jobs may begin while these results are on their way.
        drop(slot);
        for ((About { key, identity, bytes }, end), room) in wanted {
            match end {
                Ok(result) => {
                    let _ = self.finished.send(PendingResult { key, identity, result, bytes, _room: room });
                }
                Err(reason) => self.report_failure(&key, &reason).await,
            }
        }
    }

    /// What each job yields by itself, or why it does not; of one that is stopped, anything.
    async fn trace_one_by_one(
        &self,
        jobs: Vec<JobSpec>,
        switches: &[Arc<JobSwitches>],
    ) -> Vec<Result<JobResult, String>> {
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

    /// Tells the coordinator when a thread is about to begin, which waits until that is on its way: the answer of a
    /// coordinator far away would cost small jobs more time than it is worth.
    async fn announce(&self, jobs: Vec<(LeaseKey, Digest)>, begins: oneshot::Receiver<Start>) {
        // Otherwise the jobs were stopped before.
        let Ok(start) = begins.await else { return };
        let keys: Vec<LeaseKey> = jobs.iter().map(|(key, _)| *key).collect();
        let mut told = pin!(self.session.begin(jobs));
        let answered = tokio::time::timeout(ON_ITS_WAY, &mut told).await.is_ok();
        let _ = start.send(());
        if !answered {
            told.await;
        }
        for LeaseKey { dictionary, job, attempt, .. } in keys {
            tracing::debug!(dictionary = dictionary.0, job, attempt, "job begins");
        }
    }

    async fn report_failure(&self, key: &LeaseKey, reason: &str) {
        tracing::error!(job = key.job, attempt = key.attempt, reason, "job failed");
        if let Err(status) = self.session.fail(key, reason).await {
            let message = status.message();
            tracing::warn!(job = key.job, message, "the failure is not wanted any more");
        }
        self.held.remove(key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::leases::SetSwitch;
    use crate::testing::{Answer, Call, Coordinator, Method, job, lease, session};

    /// The report is repeated until it gets an answer.
    #[tokio::test(start_paused = true)]
    async fn a_tracer_panic_is_reported_and_the_lease_released() {
        let coordinator = Coordinator::start();
        let (session, held) = session(&coordinator).await;
        let (finished, _queue) = mpsc::unbounded_channel();
        let (pool, buffer) = (Pool::new(1).unwrap(), ResultBuffer::new(1));
        let workshop = Workshop { session, held: held.clone(), pool, buffer, finished };
        let key = lease(4).key;
        held.add(key, job(4).identity(), SetSwitch::new(1));
        coordinator.answer(Method::Fail, Answer::Lost);
        workshop.report_failure(&key, "the tracer panicked: no message").await;
        let failures = coordinator.calls(Call::fail);
        assert_eq!(failures.len(), 2, "the first report got no answer");
        assert!(failures.iter().all(|f| f.lease.as_ref().unwrap().job == 4 && f.reason.contains("panicked")));
        assert!(held.is_empty());
    }
}
