//! The worker's main loop: leases jobs, traces them and delivers their results until there is a reason to end. On the
//! way out it gives running jobs a grace period, delivers finished results and hands the other leases back.

use std::fmt;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use farm_link::Link;
use farm_proto::lease::Lease;
use optics_model::sums::Sums;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::{Instant, sleep_until, timeout};
use tokio_util::sync::CancellationToken;

use crate::config::Config;
use crate::delivery::{ResultBuffer, deliver};
use crate::heartbeat::beat;
use crate::idle::IdleTime;
use crate::job::JobRunner;
use crate::kernels;
use crate::leases::{HeldLeases, SetSwitch};
use crate::machine;
use crate::pool::Pool;
use crate::retry::{Pauses, is_refusal, log_failure};
use crate::session::{CoordinatorSession, Error, Introduction};

/// Pause after a call that failed, first and longest.
const PAUSE: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));
/// Time limit for the delivery of finished records once the worker stops.
const DELIVERY: Duration = Duration::from_secs(10);
/// Time limit for stopped jobs to end.
const STOPPING: Duration = Duration::from_secs(2);
/// Time before the limit by which all leases are handed back, in addition to the grace.
const MARGIN: Duration = Duration::from_secs(5);

/// Limits of a set of jobs that are traced together: its number of jobs, and the memory of their sums.
const MOST_JOBS: usize = 16;
const MOST_BYTES: usize = 64 << 20;

/// The reason why a worker ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndReason {
    /// Its caller stopped it.
    Stopped,
    /// The coordinator requested that it leave.
    Drained,
    TimeLimit,
    Idle,
}

impl fmt::Display for EndReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Stopped => "stopped",
            Self::Drained => "the coordinator requested it",
            Self::TimeLimit => "the time limit is near",
            Self::Idle => "there was no work",
        })
    }
}

/// Works until `shutdown`, the time limit, or a drain request of the coordinator. Then running jobs get the grace
/// period to end, finished results are delivered, and the other leases are handed back.
///
/// The box has the worker's code in this crate: an `async fn` is compiled by each crate that awaits it.
pub fn run(
    config: Config,
    shutdown: CancellationToken,
) -> Pin<Box<dyn Future<Output = Result<EndReason, Error>> + Send>> {
    Box::pin(async move {
        let link = config.coordinator.connect_lazy();
        work_over(link, config, shutdown).await
    })
}

async fn work_over(link: Link, config: Config, shutdown: CancellationToken) -> Result<EndReason, Error> {
    let kernel = kernels::choose(config.kernel.as_deref())?;
    tracing::debug!(%kernel, threads = config.threads, "tracing");
    let limit = Instant::now() + working_time(&config);
    let pool = Pool::new(config.threads, config.pace)?;
    let held: Arc<HeldLeases> = Arc::default();
    let url = config.coordinator.url();
    let introduction = Introduction {
        label: config.label.clone(),
        host: config.host.clone(),
        threads: config.threads,
        facts: machine::facts(kernel, config.log.clone()),
    };
    let Some(session) = CoordinatorSession::open(link, url, introduction, held.clone(), &shutdown).await?
    else {
        tracing::info!("stopped before the coordinator at {url} was reached");
        return Ok(EndReason::Stopped);
    };
    let session = Arc::new(session);
    let (finished, queue) = mpsc::unbounded_channel();
    let delivery = tokio::spawn(deliver(session.clone(), held.clone(), queue));
    let buffer = ResultBuffer::new(config.buffer_bytes);
    let runner = JobRunner { session: session.clone(), held: held.clone(), pool, buffer, finished };
    let agent = Agent::new(session, held, &config);
    agent.work_until(limit, shutdown, runner, delivery).await
}

/// Time after which to stop, so that grace and delivery end before the limit.
fn working_time(config: &Config) -> Duration {
    /// Practically for ever, but still a valid instant of the clock.
    const FOREVER: Duration = Duration::from_secs(u32::MAX as u64);
    config.time_limit.map_or(FOREVER, |limit| limit.saturating_sub(config.grace + MARGIN).max(limit / 2))
}

struct Agent {
    session: Arc<CoordinatorSession>,
    held: Arc<HeldLeases>,
    /// One permit per job that this worker may hold without a result.
    slots: Arc<Semaphore>,
    /// Cancelled when the coordinator requests that the worker leave.
    drain: CancellationToken,
    grace: Duration,
    idle_exit: Option<Duration>,
}

impl Agent {
    fn new(session: Arc<CoordinatorSession>, held: Arc<HeldLeases>, config: &Config) -> Self {
        Self {
            session,
            held,
            // One job more than threads, so that the next can begin at once when one ends.
            slots: Arc::new(Semaphore::new(config.threads + 1)),
            drain: CancellationToken::new(),
            grace: config.grace,
            idle_exit: config.idle_exit,
        }
    }

    async fn work_until(
        &self,
        limit: Instant,
        shutdown: CancellationToken,
        runner: JobRunner,
        delivery: JoinHandle<()>,
    ) -> Result<EndReason, Error> {
        let ending = CancellationToken::new();
        let heartbeat =
            tokio::spawn(beat(self.session.clone(), self.held.clone(), self.drain.clone(), ending.clone()));
        let mut jobs = JoinSet::new();
        let ended = tokio::select! {
            () = shutdown.cancelled() => Ok(EndReason::Stopped),
            () = self.drain.cancelled() => Ok(EndReason::Drained),
            () = sleep_until(limit) => Ok(EndReason::TimeLimit),
            ended = self.work(&mut jobs, runner) => ended,
        };
        self.wind_up(jobs, delivery, if ended.is_ok() { self.grace } else { Duration::ZERO }).await;
        // A heartbeat after this would register the worker again.
        ending.cancel();
        let _ = heartbeat.await;
        if let Ok(reason) = ended {
            self.leave(reason).await;
        }
        ended
    }

    /// Leases and traces until there is a reason to end.
    async fn work(&self, jobs: &mut JoinSet<()>, runner: JobRunner) -> Result<EndReason, Error> {
        loop {
            let Some((leases, slots)) = self.next_leases().await? else {
                return Ok(if self.drain.is_cancelled() { EndReason::Drained } else { EndReason::Idle });
            };
            let mut slots = slots.into_iter();
            for leases in sets(leases) {
                let set = SetSwitch::new(leases.len());
                let add = |lease: &Lease| self.held.add(lease.key, lease.job.identity(), set.clone());
                let switches = leases.iter().map(add).collect();
                // One slot per set, unless the coordinator groups jobs into sets by other rules.
                let slot = match slots.next() {
                    Some(slot) => slot,
                    None => match self.slots.clone().acquire_owned().await {
                        Ok(slot) => slot,
                        Err(_) => break,
                    },
                };
                jobs.spawn(runner.clone().run(leases, switches, slot));
            }
            while jobs.try_join_next().is_some() {}
        }
    }

    /// Leases for the free slots, with these slots; None if the worker should end.
    async fn next_leases(&self) -> Result<Option<(Vec<Lease>, Vec<OwnedSemaphorePermit>)>, Error> {
        let mut pauses = Pauses::new(PAUSE.0, PAUSE.1);
        let mut back = self.session.back();
        let mut idle = IdleTime::new(self.idle_exit);
        loop {
            let slots = self.free_slots().await;
            if !self.held.is_empty() {
                idle.reset();
            }
            match self.session.acquire(slots.len(), idle.wait()).await {
                Ok((_, true)) => {
                    self.drain.cancel();
                    return Ok(None);
                }
                Ok((leases, _)) if !leases.is_empty() => return Ok(Some((leases, slots))),
                Ok(_) if idle.is_over() && self.held.is_empty() => return Ok(None),
                Ok(_) => pauses.reset(),
                Err(status) if is_refusal(&status) => return Err(Error::Refused(status)),
                Err(status) => {
                    log_failure(&status, "no leases");
                    pauses.wait(&mut back).await;
                }
            }
        }
    }

    /// Waits for a slot, then takes all free ones.
    async fn free_slots(&self) -> Vec<OwnedSemaphorePermit> {
        let first = self.slots.clone().acquire_owned().await.ok();
        let others = std::iter::from_fn(|| self.slots.clone().try_acquire_owned().ok());
        first.into_iter().chain(others).collect()
    }

    /// Hands back leases of jobs that have not begun, lets the others end within the grace, and waits for the delivery.
    async fn wind_up(&self, jobs: JoinSet<()>, mut delivery: JoinHandle<()>, grace: Duration) {
        let waiting = self.held.give_up_waiting();
        // Also if no lease waits: the process may be killed before the grace is over, so the stop is announced now.
        if !self.held.is_empty()
            && grace > Duration::ZERO
            && let Err(status) = self.session.stop(waiting).await
        {
            tracing::warn!(message = status.message(), "leases could not be handed back yet");
        }
        self.end_jobs(jobs, grace).await;
        // The jobs owned all senders, so the delivery ends when its queue is empty.
        if timeout(DELIVERY, &mut delivery).await.is_err() {
            delivery.abort();
            tracing::warn!(
                "finished records could not be delivered in time: their jobs will be computed again"
            );
        }
    }

    /// Lets jobs end within the grace, and stops those that do not.
    async fn end_jobs(&self, mut jobs: JoinSet<()>, grace: Duration) {
        if timeout(grace, all_ended(&mut jobs)).await.is_ok() {
            return;
        }
        self.held.stop_all();
        // A job that waits for buffer space, or reports its failure, would wait until the coordinator is back.
        if timeout(STOPPING, all_ended(&mut jobs)).await.is_err() {
            jobs.shutdown().await;
        }
    }

    /// Deregisters from the coordinator and hands back the remaining leases.
    async fn leave(&self, reason: EndReason) {
        let url = self.session.url();
        match self.session.leave(self.held.untraced()).await {
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
}

/// Groups leases into sets of jobs that share their walks; the leases of a set are consecutive. A retried job is traced
/// alone, so that no other job is blamed if it fails again.
fn sets(leases: Vec<Lease>) -> Vec<Vec<Lease>> {
    let is_retry = |lease: &Lease| lease.key.attempt > lease.job.walks().blocks();
    let fits = |set: &[Lease], lease: &Lease| {
        set[0].job.shares_walks_with(&lease.job)
            && set.len() < MOST_JOBS
            && (set.len() + 1) * Sums::bytes(&lease.job) <= MOST_BYTES
            && !is_retry(&set[0])
            && !is_retry(lease)
    };
    let mut sets: Vec<Vec<Lease>> = Vec::new();
    for lease in leases {
        match sets.last_mut().filter(|set| fits(set, &lease)) {
            Some(set) => set.push(lease),
            None => sets.push(vec![lease]),
        }
    }
    sets
}

async fn all_ended(jobs: &mut JoinSet<()>) {
    while jobs.join_next().await.is_some() {}
}

#[cfg(test)]
mod tests;
