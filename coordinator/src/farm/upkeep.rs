//! Maintains the database while no job is computed.

use std::sync::Weak;
use std::time::Duration;

use super::Farm;

/// Pause between two looks.
const PAUSE: Duration = Duration::from_secs(10);
/// Longest time by which maintenance may delay the end of a coordinator.
const AT_END: Duration = Duration::from_secs(3);

/// Maintains the database as long as the farm exists.
pub(super) async fn keep(farm: Weak<Farm>) {
    loop {
        tokio::time::sleep(PAUSE).await;
        match farm.upgrade() {
            Some(farm) if !farm.store.is_closed() => farm.give_back_room().await,
            _ => return,
        }
    }
}

impl Farm {
    /// Returns disk space, unless there are leases: their results would have to wait.
    async fn give_back_room(&self) {
        let (_, leased) = self.scheduler.query(|dispatcher, _| dispatcher.schedule().load());
        if leased > 0 {
            return;
        }
        if let Err(error) = self.store.give_back_room().await {
            tracing::warn!(%error, "room on the disk could not be given back");
        }
    }

    /// Returns disk space before the database is closed, for a limited time; the rest is left for the next time.
    pub(super) async fn give_back_room_at_end(&self) {
        let _ = tokio::time::timeout(AT_END, self.give_back_room()).await;
    }
}
