//! The worker's life: lease, trace, deliver, until told to stop.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use farm_proto::lease::Lease;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::config::Config;
use crate::delivery::{Buffer, Finished, bytes_of, deliver};
use crate::heartbeat::beat;
use crate::held::{Held, Switches};
use crate::pool::{Outcome, Pool};
use crate::session::{Error, Session, failed, is_refusal, jittered};

/// How long one call waits for work.
const WAIT: Duration = Duration::from_secs(20);
/// Pause after a call that failed, first and longest.
const PAUSE: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));
/// How long finished records may take to be delivered once the worker is told to stop.
const DELIVERY: Duration = Duration::from_secs(10);
/// How long jobs that were told to stop may take to do so.
const STOPPING: Duration = Duration::from_secs(2);
/// Time before the limit at which everything is to be handed back, besides the grace.
const MARGIN: Duration = Duration::from_secs(5);

/// Why a worker ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// It was told to by its caller.
    Stopped,
    /// The coordinator asked it to leave.
    Drained,
    TimeLimit,
    Idle,
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Stopped => "stopped",
            Self::Drained => "it asked for that",
            Self::TimeLimit => "the time limit is near",
            Self::Idle => "there was no work for long enough",
        })
    }
}

/// Works until `shutdown`, the time limit, or the coordinator's wish; then gives jobs that are being traced the grace
/// to end, delivers what is finished and hands the other leases back.
pub async fn run(config: Config, shutdown: CancellationToken) -> Result<Ended, Error> {
    let pool = Pool::new(config.threads)?;
    let limit = tokio::time::Instant::now()
        + config.time_limit.map_or(Duration::MAX / 4, |limit| working_time(&config, limit));
    let grace = config.grace;
    let held: Arc<Held> = Arc::default();
    let url = config.coordinator.url().to_owned();
    let (buffer, threads, idle_exit) = (Buffer::new(config.buffer_bytes), config.threads, config.idle_exit);
    let Some(session) = Session::open(config, held.clone(), &shutdown).await? else {
        tracing::info!("stopped before the coordinator at {url} was reached");
        return Ok(Ended::Stopped);
    };
    let agent = Agent {
        // One job more than threads: the next is there when one ends.
        places: Arc::new(Semaphore::new(threads + 1)),
        buffer,
        idle_exit,
        session: Arc::new(session),
        held,
        pool,
        drain: CancellationToken::new(),
    };
    let ending = CancellationToken::new();
    let heartbeat =
        tokio::spawn(beat(agent.session.clone(), agent.held.clone(), agent.drain.clone(), ending.clone()));
    let (finished, queue) = mpsc::unbounded_channel();
    let delivery = tokio::spawn(deliver(agent.session.clone(), agent.held.clone(), queue));
    let mut jobs = JoinSet::new();
    let ended = tokio::select! {
        () = shutdown.cancelled() => Ok(Ended::Stopped),
        () = agent.drain.cancelled() => Ok(Ended::Drained),
        () = tokio::time::sleep_until(limit) => Ok(Ended::TimeLimit),
        ended = agent.work(&mut jobs, finished) => ended,
    };
    agent.wind_up(jobs, delivery, if ended.is_ok() { grace } else { Duration::ZERO }).await;
    // A heartbeat after this would register the worker again.
    ending.cancel();
    let _ = heartbeat.await;
    if let Ok(reason) = ended {
        agent.leave(reason).await;
    }
    ended
}

/// Time to work in, so that grace and delivery end before the limit.
fn working_time(config: &Config, limit: Duration) -> Duration {
    limit.saturating_sub(config.grace + MARGIN).max(limit / 2)
}

struct Agent {
    session: Arc<Session>,
    held: Arc<Held>,
    places: Arc<Semaphore>,
    buffer: Buffer,
    pool: Pool,
    /// The coordinator wants the worker to leave.
    drain: CancellationToken,
    idle_exit: Option<Duration>,
}

impl Agent {
    /// Leases and traces until there is a reason to end.
    async fn work(
        &self,
        jobs: &mut JoinSet<()>,
        finished: mpsc::UnboundedSender<Finished>,
    ) -> Result<Ended, Error> {
        loop {
            let Some((leases, permits)) = self.next_leases().await? else {
                return Ok(if self.drain.is_cancelled() { Ended::Drained } else { Ended::Idle });
            };
            for (lease, permit) in leases.into_iter().zip(permits) {
                let switches = self.held.add(lease.key, lease.job.identity());
                let job = Job {
                    session: self.session.clone(),
                    held: self.held.clone(),
                    pool: self.pool.clone(),
                    buffer: self.buffer.clone(),
                    finished: finished.clone(),
                };
                jobs.spawn(job.run(lease, switches, permit));
            }
            while jobs.try_join_next().is_some() {}
        }
    }

    /// Leases for the places that are free, with their places; None if the worker is to end.
    async fn next_leases(&self) -> Result<Option<(Vec<Lease>, Vec<OwnedSemaphorePermit>)>, Error> {
        let mut pause = PAUSE.0;
        let mut idle_since = tokio::time::Instant::now();
        loop {
            let Ok(first) = self.places.clone().acquire_owned().await else { return Ok(None) };
            let mut permits = vec![first];
            permits.extend(std::iter::from_fn(|| self.places.clone().try_acquire_owned().ok()));
            if !self.held.is_empty() {
                idle_since = tokio::time::Instant::now();
            }
            let wait =
                self.idle_exit.map_or(WAIT, |limit| limit.saturating_sub(idle_since.elapsed()).min(WAIT));
            match self.session.acquire(permits.len(), wait).await {
                Ok((_, true)) => {
                    self.drain.cancel();
                    return Ok(None);
                }
                Ok((leases, _)) if leases.is_empty() => {
                    pause = PAUSE.0;
                    let idle = self.held.is_empty()
                        && self.idle_exit.is_some_and(|limit| idle_since.elapsed() >= limit);
                    if idle {
                        return Ok(None);
                    }
                }
                Ok((leases, _)) => return Ok(Some((leases, permits))),
                Err(status) if is_refusal(&status) => return Err(Error::Refused(status)),
                Err(status) => {
                    failed(&status, "no leases");
                    tokio::time::sleep(jittered(pause)).await;
                    pause = (2 * pause).min(PAUSE.1);
                }
            }
        }
    }

    /// Takes leave of the coordinator, handing back what is left.
    async fn leave(&self, reason: Ended) {
        let url = self.session.url();
        match self.session.hand_back(self.held.untraced(), true).await {
            Ok(()) => tracing::info!("left the coordinator at {url}: {reason}"),
            Err(status) => {
                let message = status.message();
                tracing::warn!(
                    message,
                    "left without the coordinator at {url}: {reason}; leases will expire"
                );
            }
        }
    }

    /// Hands back what has not begun, lets the rest end within the grace, and delivers.
    async fn wind_up(
        &self,
        mut jobs: JoinSet<()>,
        mut delivery: tokio::task::JoinHandle<()>,
        grace: Duration,
    ) {
        let waiting = self.held.give_up_waiting();
        if !waiting.is_empty()
            && grace > Duration::ZERO
            && let Err(status) = self.session.hand_back(waiting, false).await
        {
            tracing::warn!(message = status.message(), "leases could not be handed back yet");
        }
        let all = async { while jobs.join_next().await.is_some() {} };
        if tokio::time::timeout(grace, all).await.is_err() {
            self.held.stop_all();
            // One that waits for room, or tells of its failure, would wait as long as the coordinator is away.
            let stopped = async { while jobs.join_next().await.is_some() {} };
            if tokio::time::timeout(STOPPING, stopped).await.is_err() {
                jobs.shutdown().await;
            }
        }
        // All senders are gone with the jobs: the delivery ends when all is delivered.
        if tokio::time::timeout(DELIVERY, &mut delivery).await.is_err() {
            delivery.abort();
            tracing::warn!(
                "finished records could not be delivered in time: their jobs will be computed again"
            );
        }
    }
}

/// What one job needs on its way from lease to result.
struct Job {
    session: Arc<Session>,
    held: Arc<Held>,
    pool: Pool,
    buffer: Buffer,
    finished: mpsc::UnboundedSender<Finished>,
}

impl Job {
    /// A lease that is stopped with the worker stays held, to be handed back.
    async fn run(self, Lease { key, job }: Lease, switches: Arc<Switches>, place: OwnedSemaphorePermit) {
        let (bytes, identity) = (bytes_of(&job), job.identity());
        // If results cannot be delivered, tracing waits here.
        let Some(room) = self.buffer.take(bytes).await else { return };
        match self.pool.trace(job, switches).await {
            Outcome::Traced(traced) => {
                self.held.traced(&key);
                // The next job may begin while this result is on its way.
                drop(place);
                let _ = self.finished.send(Finished { key, identity, traced, bytes, _room: room });
            }
            Outcome::Panicked(reason) => {
                tracing::error!(job = key.job, attempt = key.attempt, reason, "job failed");
                if let Err(status) = self.session.fail(&key, &reason).await {
                    tracing::warn!(
                        job = key.job,
                        message = status.message(),
                        "the failure is not wanted any more"
                    );
                }
                self.held.remove(&key);
            }
            Outcome::Stopped => {}
        }
    }
}
