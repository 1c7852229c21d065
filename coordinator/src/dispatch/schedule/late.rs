//! Finds leases that never end and parts that take too long.

use std::time::Duration;

use super::{Job, OpenLease, Schedule};
use crate::dispatch::outbox::Outbox;
use crate::dispatch::part::PartId;

/// If a look comes this much later than the last one, the coordinator itself was held up: no worker is to blame for that.
pub const STALL: Duration = Duration::from_secs(5);

impl Schedule {
    /// Begins a look at everything that depends on time; returns the time of the last one. Moves all deadlines if the
    /// coordinator itself was held up.
    pub fn begin_look(&mut self, now: Duration) -> Duration {
        let last = self.last_look.replace(now);
        if let Some(last) = last
            && now.saturating_sub(last) > STALL
        {
            self.leases.postpone(now.saturating_sub(last), now, self.settings.lease);
        }
        last.unwrap_or_default()
    }

    /// Leases that their workers keep renewing without ever delivering a result. A copy may be under way, but it could be
    /// held for ever, too.
    pub fn endless(&self, now: Duration) -> Vec<OpenLease> {
        let is_endless = |held: &&OpenLease| {
            let cost = self.job(PartId::from(&held.key)).map_or(0.0, Job::part_cost);
            self.pace.is_endless(cost, now.saturating_sub(held.since))
        };
        self.leases.iter().filter(is_endless).cloned().collect()
    }

    /// Whether parts were reserved since the last call, for other machines than those that requested work.
    pub fn take_kept_for_others(&mut self) -> bool {
        std::mem::take(&mut self.kept_for_others)
    }

    /// Looks for parts that take too long; worth doing only once nothing else waits.
    pub fn find_late(&mut self, now: Duration, outbox: &mut Outbox) {
        self.late.clear();
        self.pace.working(now, self.leases.len() > 0);
        if self.gives_out() {
            return;
        }
        let late = self.leases.iter().filter(|held| {
            let cost = self.job(PartId::from(&held.key)).map(Job::part_cost);
            cost.is_some_and(|cost| self.pace.is_late(cost, now.saturating_sub(held.since)))
        });
        self.late = late.map(|held| PartId::from(&held.key)).collect();
        outbox.work |= !self.late.is_empty();
    }
}
