//! Renews leases while their jobs are traced, and stops the jobs of lost leases.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

use crate::leases::HeldLeases;
use crate::retry::log_failure;
use crate::session::CoordinatorSession;

/// Renews four times per lease until `end`; cancels `drain` when the coordinator requests that the worker leave.
pub(crate) async fn beat(
    session: Arc<CoordinatorSession>,
    held: Arc<HeldLeases>,
    drain: CancellationToken,
    end: CancellationToken,
) {
    end.run_until_cancelled(async {
        loop {
            // A restarted coordinator may grant leases of another length.
            let next = Instant::now() + interval(session.lease());
            renew(&session, &held, &drain).await;
            sleep_until(next).await;
        }
    })
    .await;
}

fn interval(lease: Duration) -> Duration {
    (lease / 4).max(Duration::from_millis(50))
}

async fn renew(session: &CoordinatorSession, held: &HeldLeases, drain: &CancellationToken) {
    match session.renew(held.all()).await {
        Ok((lost, leave)) => {
            for key in lost.into_iter().filter(|key| held.lose(key)) {
                tracing::warn!(job = key.job, attempt = key.attempt, "lease lost: its job is dropped");
            }
            if leave && !drain.is_cancelled() {
                tracing::info!("the coordinator asks this worker to leave");
                drain.cancel();
            }
        }
        Err(status) => log_failure(&status, "no heartbeat"),
    }
}

#[cfg(test)]
mod tests;
