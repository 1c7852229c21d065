//! The regular look at all that time alone changes: leases past their deadline, effects to be tried again, parts that
//! take too long, workers that are gone.

use std::time::Duration;

use super::job::{Job, Strike};
use super::leases::Held;
use super::{Count, Dispatcher, Effect, Event, EventKind, PartId, Purpose};

/// A look that comes this much later than the last was itself held up: no worker is to blame for that.
pub(super) const STALL: Duration = Duration::from_secs(5);

impl Dispatcher {
    /// Looks at everything once; returns how many leases it has freed.
    pub fn look_over(&mut self, now: Duration) -> usize {
        self.forgive_own_stall(now);
        self.try_effects_again();
        let freed = self.free_expired(now) + self.end_endless(now);
        self.wake_for_others(now);
        self.find_late(now);
        self.pace.working(now, self.leases.len() > 0);
        self.forget_vanished(now);
        freed
    }

    /// Moves all deadlines if the coordinator itself was held up.
    fn forgive_own_stall(&mut self, now: Duration) {
        if let Some(last) = self.last_look
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
            Effect::NoteCheck(check) => self.dictionaries.contains_key(&check.dictionary),
            Effect::Fence { .. } | Effect::LiftFence { .. } => true,
        };
        let again: Vec<_> = put_off.into_iter().filter(holds).collect();
        self.outbox.effects.extend(again);
    }

    /// Frees leases past their deadline. A job that was being computed is blamed for its worker's silence, unless the worker
    /// was asked to stop before.
    fn free_expired(&mut self, now: Duration) -> usize {
        let expired = self.leases.expired(now);
        for token in &expired {
            let Some(held) = self.free(*token) else { continue };
            if !held.running || held.purpose == Purpose::Check {
                continue;
            }
            let Ok(worker) = self.workers.get(&held.worker) else { continue };
            if worker.stopping {
                continue;
            }
            let (machine, process) = (worker.origin, worker.about.instance.clone());
            let log = worker.log_note();
            let label = self.workers.label_of(machine);
            let attempt = held.key.attempt;
            let reason =
                format!("attempt {attempt}: worker {label} fell silent while it computed this job{log}");
            self.workers.silent(&held.worker, (held.key.dictionary, held.key.job));
            self.failed_on(now, machine, &held.key, &reason);
            self.strike(now, &held.key, Strike { machine, silent: Some(process), reason });
        }
        if !expired.is_empty() {
            self.outbox.counts.push(Count::Expired(expired.len()));
            self.work_came();
        }
        expired.len()
    }

    /// Frees leases that their workers renew and never end. A copy may be under way, but that could be held for ever,
    /// too.
    fn end_endless(&mut self, now: Duration) -> usize {
        let is_endless = |held: &&Held| {
            let part = PartId::from(&held.key);
            let cost = self.dictionaries.get(&part.dictionary).and_then(|d| d.job(part)).map(Job::part_cost);
            self.pace.is_endless(cost.unwrap_or(0.0), now.saturating_sub(held.since))
        };
        let endless: Vec<Held> = self.leases.iter().filter(is_endless).cloned().collect();
        for held in &endless {
            self.free(held.key.token);
            let Ok(worker) = self.workers.get(&held.worker) else { continue };
            let (machine, age) = (worker.origin, now.saturating_sub(held.since).as_secs());
            let log = worker.log_note();
            let label = self.workers.label_of(machine);
            let attempt = held.key.attempt;
            let reason = format!("attempt {attempt}: worker {label} had no result after {age} s{log}");
            self.failed_on(now, machine, &held.key, &reason);
            if held.purpose != Purpose::Check {
                self.strike(now, &held.key, Strike { machine, silent: None, reason });
            }
        }
        if !endless.is_empty() {
            self.outbox.counts.push(Count::Expired(endless.len()));
            self.work_came();
        }
        endless.len()
    }

    /// Wakes machines whose pause is over, and those that may take now what was kept for others.
    fn wake_for_others(&mut self, now: Duration) {
        let since = self.last_look.replace(now).unwrap_or_default();
        let kept = std::mem::take(&mut self.kept_for_others);
        if kept || self.workers.machines.pause_ended(since, now) {
            self.work_came();
        }
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
