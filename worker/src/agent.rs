//! The worker's life: lease, trace, report, until told to stop.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use farm_proto::job::Lease;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::config::Config;
use crate::heartbeat::{Held, beat};
use crate::pool::{Outcome, Pool};
use crate::session::{Error, Session, is_passing};

/// How long one call waits for work.
const WAIT: Duration = Duration::from_secs(20);
/// Pause after a call that failed.
const PAUSE: Duration = Duration::from_millis(500);
/// How long finished records may take to be delivered once the worker is told to stop.
const DELIVERY: Duration = Duration::from_secs(10);

/// Works until `shutdown`; then stops tracing, delivers what is finished and hands the other leases back.
pub async fn run(config: Config, shutdown: CancellationToken) -> Result<(), Error> {
    let pool = Pool::new(config.threads)?;
    // One job more than threads: the next is there when one ends.
    let places = Arc::new(Semaphore::new(config.threads + 1));
    let Some(session) = Session::open(config, &shutdown).await? else { return Ok(()) };
    let session = Arc::new(session);
    let held = Arc::new(Held::default());
    let heartbeat_end = CancellationToken::new();
    let heartbeat = tokio::spawn(beat(session.clone(), held.clone(), heartbeat_end.clone()));
    let mut jobs = JoinSet::new();

    while let Some((leases, permits)) = next_leases(&session, &places, &shutdown).await {
        for (lease, permit) in leases.into_iter().zip(permits) {
            let stop = held.add(lease.key.clone());
            jobs.spawn(work(session.clone(), held.clone(), pool.clone(), lease, stop, permit));
        }
        while jobs.try_join_next().is_some() {}
    }

    held.stop_all();
    let finished = async { while jobs.join_next().await.is_some() {} };
    if tokio::time::timeout(DELIVERY, finished).await.is_err() {
        tracing::warn!("finished records could not be delivered in time: their jobs will be computed again");
    }
    // A heartbeat after this would register the worker again.
    heartbeat_end.cancel();
    let _ = heartbeat.await;
    if let Err(status) = session.leave(held.keys()).await {
        tracing::warn!(message = status.message(), "leases could not be handed back: they will expire");
    }
    Ok(())
}

/// Leases for the places that are free, with their places; None once `shutdown` has come.
async fn next_leases(
    session: &Session,
    places: &Arc<Semaphore>,
    shutdown: &CancellationToken,
) -> Option<(Vec<Lease>, Vec<OwnedSemaphorePermit>)> {
    loop {
        let mut permits = tokio::select! {
            () = shutdown.cancelled() => return None,
            permit = places.clone().acquire_owned() => vec![permit.ok()?],
        };
        permits.extend(std::iter::from_fn(|| places.clone().try_acquire_owned().ok()));
        let answer = tokio::select! {
            () = shutdown.cancelled() => return None,
            answer = session.acquire(permits.len(), WAIT) => answer,
        };
        match answer {
            Ok(leases) if leases.is_empty() => {}
            Ok(leases) => return Some((leases, permits)),
            Err(status) => {
                tracing::warn!(code = ?status.code(), message = status.message(), "no leases");
                tokio::select! {
                    () = shutdown.cancelled() => return None,
                    () = tokio::time::sleep(PAUSE) => {}
                }
            }
        }
    }
}

/// One job from lease to acknowledgement. A lease that is stopped with the worker stays held, to be handed back.
async fn work(
    session: Arc<Session>,
    held: Arc<Held>,
    pool: Pool,
    Lease { key, job }: Lease,
    stop: Arc<AtomicBool>,
    place: OwnedSemaphorePermit,
) {
    let delivered = match pool.trace(job, stop).await {
        Outcome::Traced(records) => session.complete(&key, &records).await,
        Outcome::Panicked(reason) => session.fail(&key, &reason).await,
        Outcome::Stopped => return,
    };
    held.remove(&key);
    drop(place);
    match delivered {
        Ok(()) => tracing::debug!(job = key.job, attempt = key.attempt, "job done"),
        Err(status) => {
            debug_assert!(!is_passing(&status), "passing faults are retried");
            tracing::error!(
                job = key.job,
                attempt = key.attempt,
                message = status.message(),
                "result refused"
            );
        }
    }
}
