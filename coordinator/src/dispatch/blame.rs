//! Leases that come to nothing: handed back, failed, past their deadline; and who is blamed for it.

use std::time::Duration;

use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::LeaseKey;

use super::job;
use super::job::Strike;
use super::leases::Held;
use super::{DispatchError, Dispatcher, Effect, Event, EventKind, PartId, Purpose};

/// A reaper that comes this much later than the time before was itself stopped: no worker is to blame for that.
pub(super) const STALL: Duration = Duration::from_secs(5);

impl Dispatcher {
    /// Takes leases back without blame; those that are not held are passed over.
    pub fn hand_back(&mut self, leases: &[LeaseKey]) {
        for key in leases {
            if self.leases.get(key).is_some() {
                self.free(key.token);
            }
        }
    }

    /// Counts a failed attempt; the job is tried again or given up.
    pub fn failed(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        key: &LeaseKey,
        reason: &str,
    ) -> Result<(), DispatchError> {
        self.seen(now, worker)?;
        let origin = self.workers.get(worker)?.origin;
        let lost = DispatchError::LeaseLost { job: key.job, attempt: key.attempt };
        if self.leases.get(key).is_none_or(|held| held.worker != *worker) {
            return Err(lost);
        }
        let checked = self.free(key.token).is_some_and(|held| held.purpose == Purpose::Check);
        if !checked {
            let reason = format!("attempt {}: {reason}", key.attempt);
            self.strike(key, Strike { worker: Some(origin), silent: false, reason });
        }
        Ok(())
    }

    /// Ends one lease; its part waits again if nobody else holds it.
    pub(super) fn free(&mut self, token: Token) -> Option<Held> {
        let held = self.leases.remove(token)?;
        if held.purpose == Purpose::Check {
            return Some(held);
        }
        let part = PartId::from(&held.key);
        let still_held = self.leases.of_part(part).any(|other| other.purpose != Purpose::Check);
        if let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary)
            && !still_held
        {
            dictionary.leased = dictionary.leased.saturating_sub(1);
            dictionary.put_back(part.job, part.part);
        }
        Some(held)
    }

    pub(super) fn strike(&mut self, key: &LeaseKey, strike: Strike) {
        let (id, job) = (key.dictionary, key.job);
        let label = strike.worker.map(|origin| self.workers.label_of(origin)).unwrap_or_default();
        let Some(dictionary) = self.dictionaries.get_mut(&id) else { return };
        let event = |kind, message: String| Event {
            kind,
            dictionary: Some(id),
            job: Some(job),
            worker: label.clone(),
            message,
        };
        self.events.push(event(EventKind::AttemptFailed, strike.reason.clone()));
        if let Some((reason, quarantined)) = dictionary.strike(job, strike, self.settings.max_attempts) {
            let kind = if quarantined { EventKind::JobQuarantined } else { EventKind::JobFailed };
            self.events.push(event(kind, reason.clone()));
            self.effects.push(Effect::GiveUp { dictionary: id, job, reason, quarantined });
            self.end_leases_of_job(id, job);
        }
    }

    /// Ends the leases of all parts of a job.
    pub(super) fn end_leases_of_job(&mut self, dictionary: DictionaryId, job: u32) {
        for part in self.leases.parts_of_job(dictionary, job) {
            self.end_leases(part);
        }
    }

    /// Ends the leases of a part that is computed no more, but for checks.
    pub(super) fn end_leases(&mut self, part: PartId) -> Vec<Held> {
        let ended = self.leases.remove_part(part);
        let (checks, ended): (Vec<_>, Vec<_>) = ended.into_iter().partition(|h| h.purpose == Purpose::Check);
        for check in checks {
            self.leases.insert(check);
        }
        if !ended.is_empty()
            && let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary)
        {
            dictionary.leased = dictionary.leased.saturating_sub(1);
        }
        ended
    }

    /// Frees leases past their deadline, looks for parts that take too long and forgets workers long gone; returns the
    /// number of leases freed. A job that was being computed is blamed for its worker's silence.
    pub fn expire(&mut self, now: Duration) -> usize {
        if let Some(last) = self.last_look.replace(now)
            && now.saturating_sub(last) > STALL
        {
            self.leases.postpone(now.saturating_sub(last));
        }
        let put_off = std::mem::take(&mut self.put_off);
        let holds = |effect: &Effect| match effect {
            Effect::GiveUp { dictionary, job, .. } => {
                self.by_id(*dictionary).is_some_and(|d| !d.is_open(*job))
            }
            Effect::Recompute { dictionary, .. } => self.dictionaries.contains_key(dictionary),
            Effect::Agreed { dictionary, job, .. } => {
                self.by_id(*dictionary).is_some_and(|d| !d.is_open(*job))
            }
            Effect::Fence { .. } => true,
        };
        let again: Vec<_> = put_off.into_iter().filter(holds).collect();
        self.effects.extend(again);
        let expired = self.leases.expired(now);
        for token in &expired {
            let Some(held) = self.free(*token) else { continue };
            if held.running && held.purpose != Purpose::Check {
                let worker = self.workers.get(&held.worker).ok().map(|w| w.origin);
                let label = worker.map(|o| self.workers.label_of(o)).unwrap_or_default();
                let reason = format!(
                    "attempt {}: worker {label} fell silent while it computed this job",
                    held.key.attempt
                );
                if let Some(origin) = worker {
                    self.workers.silent(origin, (held.key.dictionary, held.key.job));
                }
                self.strike(&held.key, Strike { worker, silent: true, reason });
            }
        }
        self.find_late(now);
        self.pace.working(now, self.leases.len() > 0);
        let leases = &self.leases;
        for gone in self.workers.forget_silent(now, |id| leases.count_of(id) == 0) {
            self.events.push(Event::of_worker(EventKind::WorkerGone, gone, "not heard of any more"));
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
            let cost =
                self.dictionaries.get(&part.dictionary).and_then(|d| d.job(part)).map(job::Job::part_cost);
            held.purpose != Purpose::Check
                && cost.is_some_and(|cost| self.pace.is_late(cost, now.saturating_sub(held.since)))
        });
        self.late = late.map(|held| PartId::from(&held.key)).collect();
    }

    /// Whether some parts take so long that second copies are wanted.
    pub fn wants_copies(&self) -> bool {
        !self.late.is_empty()
    }
}
