//! The regular look at all that time alone changes: leases past their deadline, effects to be tried again, parts that
//! take too long, workers that are gone.

use std::time::Duration;

use super::job::{Job, Strike};
use super::{Count, Dispatcher, Effect, Event, EventKind, PartId, Purpose};

/// A look that comes this much later than the last was itself held up: no worker is to blame for that.
pub(super) const STALL: Duration = Duration::from_secs(5);

impl Dispatcher {
    /// Looks at everything once; returns how many leases it has freed.
    pub fn look_over(&mut self, now: Duration) -> usize {
        self.forgive_own_stall(now);
        self.try_effects_again();
        let freed = self.free_expired(now);
        self.find_late(now);
        self.pace.working(now, self.leases.len() > 0);
        self.forget_vanished(now);
        freed
    }

    /// Moves all deadlines if the coordinator itself was held up.
    fn forgive_own_stall(&mut self, now: Duration) {
        if let Some(last) = self.last_look.replace(now)
            && now.saturating_sub(last) > STALL
        {
            self.leases.postpone(now.saturating_sub(last));
        }
    }

    /// Asks again for effects that could not be performed, as far as they still hold.
    fn try_effects_again(&mut self) {
        let put_off = std::mem::take(&mut self.put_off);
        let holds = |effect: &Effect| match effect {
            Effect::GiveUp { dictionary, job, .. } | Effect::Agreed { dictionary, job, .. } => {
                self.by_id(*dictionary).is_some_and(|d| !d.is_open(*job))
            }
            Effect::Recompute { dictionary, .. } => self.dictionaries.contains_key(dictionary),
            Effect::Fence { .. } => true,
        };
        let again: Vec<_> = put_off.into_iter().filter(holds).collect();
        self.outbox.effects.extend(again);
    }

    /// Frees leases past their deadline. A job that was being computed is blamed for its worker's silence.
    fn free_expired(&mut self, now: Duration) -> usize {
        let expired = self.leases.expired(now);
        for token in &expired {
            let Some(held) = self.free(*token) else { continue };
            if !held.running || held.purpose == Purpose::Check {
                continue;
            }
            let worker = self.workers.get(&held.worker).ok().map(|w| w.origin);
            let label = worker.map(|o| self.workers.label_of(o)).unwrap_or_default();
            let attempt = held.key.attempt;
            let reason = format!("attempt {attempt}: worker {label} fell silent while it computed this job");
            if let Some(origin) = worker {
                self.workers.silent(origin, (held.key.dictionary, held.key.job));
            }
            self.strike(&held.key, Strike { worker, silent: true, reason });
        }
        if !expired.is_empty() {
            self.outbox.counts.push(Count::Expired(expired.len()));
            self.work_came();
        }
        expired.len()
    }

    /// Looks for parts that take too long; worth doing only once nothing else waits.
    fn find_late(&mut self, now: Duration) {
        self.late.clear();
        if self.gives_out() {
            return;
        }
        let late = self.leases.iter().filter(|held| {
            let part = PartId::from(&held.key);
            let cost = self.dictionaries.get(&part.dictionary).and_then(|d| d.job(part)).map(Job::part_cost);
            held.purpose != Purpose::Check
                && cost.is_some_and(|cost| self.pace.is_late(cost, now.saturating_sub(held.since)))
        });
        self.late = late.map(|held| PartId::from(&held.key)).collect();
        self.outbox.work |= !self.late.is_empty();
    }

    /// Forgets workers that were silent for long and hold nothing.
    fn forget_vanished(&mut self, now: Duration) {
        let leases = &self.leases;
        for gone in self.workers.forget_silent(now, |id| leases.count_of(id) == 0) {
            self.outbox.events.push(Event::of_worker(EventKind::WorkerGone, gone, "not heard of any more"));
            self.outbox.changed = true;
        }
    }
}
