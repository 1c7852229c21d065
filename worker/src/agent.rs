//! The worker's life: lease, trace, deliver, until there is a reason to end.

use std::fmt;
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
use crate::job::Workshop;
use crate::kernels;
use crate::leases::{HeldLeases, SetSwitch};
use crate::machine;
use crate::pool::Pool;
use crate::retry::{Pauses, is_refusal, log_failure};
use crate::session::{Error, Introduction, Session};

/// Pause after a call that failed, first and longest.
const PAUSE: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));
/// How long finished records may take to be delivered once the worker is told to stop.
const DELIVERY: Duration = Duration::from_secs(10);
/// How long jobs that were told to stop may take to do so.
const STOPPING: Duration = Duration::from_secs(2);
/// Time before the limit at which everything is to be handed back, besides the grace.
const MARGIN: Duration = Duration::from_secs(5);

/// Most jobs that are traced together, and the memory that their sums may take.
const MOST_JOBS: usize = 16;
const MOST_BYTES: usize = 64 << 20;

/// Why a worker ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// Its caller stopped it.
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
    let link = config.coordinator.connect_lazy();
    work_over(link, config, shutdown).await
}

async fn work_over(link: Link, config: Config, shutdown: CancellationToken) -> Result<Ended, Error> {
    let kernel = kernels::choose(config.kernel.as_deref())?;
    tracing::debug!(%kernel, threads = config.threads, "tracing");
    let limit = Instant::now() + working_time(&config);
    let pool = Pool::new(config.threads)?;
    let held: Arc<HeldLeases> = Arc::default();
    let url = config.coordinator.url();
    let introduction = Introduction {
        label: config.label.clone(),
        host: config.host.clone(),
        threads: config.threads,
        facts: machine::facts(kernel, config.log.clone()),
    };
    let Some(session) = Session::open(link, url, introduction, held.clone(), &shutdown).await? else {
        tracing::info!("stopped before the coordinator at {url} was reached");
        return Ok(Ended::Stopped);
    };
    let session = Arc::new(session);
    let (finished, queue) = mpsc::unbounded_channel();
    let delivery = tokio::spawn(deliver(session.clone(), held.clone(), queue));
    let buffer = ResultBuffer::new(config.buffer_bytes);
    let workshop = Workshop { session: session.clone(), held: held.clone(), pool, buffer, finished };
    let agent = Agent::new(session, held, &config);
    agent.work_until(limit, shutdown, workshop, delivery).await
}

/// Time to work in, so that grace and delivery end before the limit.
fn working_time(config: &Config) -> Duration {
    /// As good as for ever, and still an instant that the clock can tell.
    const FOREVER: Duration = Duration::from_secs(u32::MAX as u64);
    config.time_limit.map_or(FOREVER, |limit| limit.saturating_sub(config.grace + MARGIN).max(limit / 2))
}

struct Agent {
    session: Arc<Session>,
    held: Arc<HeldLeases>,
    /// One for each job that may be on this worker without a result.
    slots: Arc<Semaphore>,
    /// The coordinator wants the worker to leave.
    drain: CancellationToken,
    grace: Duration,
    idle_exit: Option<Duration>,
}

impl Agent {
    fn new(session: Arc<Session>, held: Arc<HeldLeases>, config: &Config) -> Self {
        Self {
            session,
            held,
            // One job more than threads: the next is there when one ends.
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
        workshop: Workshop,
        delivery: JoinHandle<()>,
    ) -> Result<Ended, Error> {
        let ending = CancellationToken::new();
        let heartbeat =
            tokio::spawn(beat(self.session.clone(), self.held.clone(), self.drain.clone(), ending.clone()));
        let mut jobs = JoinSet::new();
        let ended = tokio::select! {
            () = shutdown.cancelled() => Ok(Ended::Stopped),
            () = self.drain.cancelled() => Ok(Ended::Drained),
            () = sleep_until(limit) => Ok(Ended::TimeLimit),
            ended = self.work(&mut jobs, workshop) => ended,
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
    async fn work(&self, jobs: &mut JoinSet<()>, workshop: Workshop) -> Result<Ended, Error> {
        loop {
            let Some((leases, slots)) = self.next_leases().await? else {
                return Ok(if self.drain.is_cancelled() { Ended::Drained } else { Ended::Idle });
            };
            let mut slots = slots.into_iter();
            for leases in sets(leases) {
                let set = SetSwitch::new(leases.len());
                let add = |lease: &Lease| self.held.add(lease.key, lease.job.identity(), set.clone());
                let switches = leases.iter().map(add).collect();
                // There is one for each, unless the coordinator has another notion of what sets are.
                let slot = match slots.next() {
                    Some(slot) => slot,
                    None => match self.slots.clone().acquire_owned().await {
                        Ok(slot) => slot,
                        Err(_) => break,
                    },
                };
                jobs.spawn(workshop.clone().run(leases, switches, slot));
            }
            while jobs.try_join_next().is_some() {}
        }
    }

    /// Leases for the slots that are free, with their slots; None if the worker is to end.
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

    /// Waits for a slot, and takes all that are free then.
    async fn free_slots(&self) -> Vec<OwnedSemaphorePermit> {
        let first = self.slots.clone().acquire_owned().await.ok();
        let others = std::iter::from_fn(|| self.slots.clone().try_acquire_owned().ok());
        first.into_iter().chain(others).collect()
    }

    /// Hands back what has not begun, lets the rest end within the grace, and delivers.
    async fn wind_up(&self, jobs: JoinSet<()>, mut delivery: JoinHandle<()>, grace: Duration) {
        let waiting = self.held.give_up_waiting();
        // Also if none waits: whoever wants it to stop may kill it before the grace is over.
        if !self.held.is_empty()
            && grace > Duration::ZERO
            && let Err(status) = self.session.stop(waiting).await
        {
            tracing::warn!(message = status.message(), "leases could not be handed back yet");
        }
        self.end_jobs(jobs, grace).await;
        // All senders are gone with the jobs: the delivery ends when all is delivered.
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
        // One that waits for room, or tells of its failure, would wait as long as the coordinator is away.
        if timeout(STOPPING, all_ended(&mut jobs)).await.is_err() {
            jobs.shutdown().await;
        }
    }

    /// Takes leave of the coordinator, handing back what is left.
    async fn leave(&self, reason: Ended) {
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

/// Leases by the walks that their jobs share; those of a set follow one another. What was given out before and came to
/// nothing is traced by itself, so that nobody is blamed for it but itself.
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
