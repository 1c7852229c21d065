//! Keeps leases alive while their jobs are traced, and stops those that are lost.

use std::sync::Arc;
use std::time::Duration;

use tokio_util::sync::CancellationToken;

use crate::held::Held;
use crate::session::{Session, failed};

/// Renews four times per lease until `end`; `drain` is told when the coordinator wants the worker to leave.
pub(crate) async fn beat(
    session: Arc<Session>,
    held: Arc<Held>,
    drain: CancellationToken,
    end: CancellationToken,
) {
    let mut tick = tokio::time::interval((session.lease() / 4).max(Duration::from_millis(50)));
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = end.cancelled() => return,
            _ = tick.tick() => {}
        }
        let renewed = tokio::select! {
            () = end.cancelled() => return,
            renewed = session.renew(held.all()) => renewed,
        };
        match renewed {
            Ok((lost, leave)) => {
                for key in lost.into_iter().filter(|key| held.lose(key)) {
                    tracing::warn!(job = key.job, attempt = key.attempt, "lease lost: its job is dropped");
                }
                if leave && !drain.is_cancelled() {
                    tracing::info!("the coordinator asks this worker to leave");
                    drain.cancel();
                }
            }
            Err(status) => failed(&status, "no heartbeat"),
        }
    }
}
