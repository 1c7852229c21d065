//! Leases that end without a result: handed back or failed. Failures are counted against jobs and machines.

use std::collections::BTreeSet;
use std::time::Duration;

use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::LeaseKey;

use super::job::{Job, Strike};
use super::leases::Held;
use super::{Count, DispatchError, Dispatcher, Effect, Event, EventKind, PartId, Purpose};
use crate::stored::Origin;

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
        let (origin, log) = self.workers.get(worker).map(|worker| (worker.origin, worker.log_note()))?;
        let lost = DispatchError::LeaseLost { job: key.job, attempt: key.attempt };
        if self.leases.get(key).is_none_or(|held| held.worker != *worker) {
            return Err(lost);
        }
        let checked = self.free(key.token).is_some_and(|held| held.purpose == Purpose::Check);
        let reason = format!("attempt {}: {reason}{log}", key.attempt);
        self.failed_on(now, origin, key, &reason);
        if !checked {
            self.strike(now, key, Strike { machine: origin, silent: None, reason });
        }
        Ok(())
    }

    /// Counts against a machine that a job has come to nothing there.
    pub(super) fn failed_on(&mut self, now: Duration, machine: Origin, key: &LeaseKey, reason: &str) {
        let alone = !self.able(now).any(|other| other != machine);
        let job = (key.dictionary, key.job);
        if let Some(pause) = self.workers.machines.failed(now, machine, job, alone) {
            let message =
                format!("it fails one job after the other and gets none for {} s; {reason}", pause.as_secs());
            let label = self.workers.label_of(machine);
            self.outbox.events.push(Event::of_worker(EventKind::WorkerSuspended, label, message));
            self.outbox.changed = true;
        }
    }

    /// Machines that could take a job now or soon.
    pub(super) fn able(&self, now: Duration) -> impl Iterator<Item = Origin> {
        let here = self.workers.active().filter(move |(_, worker)| !self.is_silent(now, worker));
        let origins = here.map(|(_, worker)| worker.origin);
        origins.filter(move |origin| self.workers.machines.pause_left(now, *origin).is_none())
    }

    /// Ends one lease; its part waits again if nobody else holds it.
    pub(super) fn free(&mut self, token: Token) -> Option<Held> {
        let held = self.leases.remove(token)?;
        if held.purpose == Purpose::Check {
            // Another worker may take it.
            self.work_came();
            return Some(held);
        }
        let part = PartId::from(&held.key);
        let still_held = self.leases.of_part(part).any(|other| other.purpose != Purpose::Check);
        if let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary)
            && !still_held
        {
            dictionary.leased = dictionary.leased.saturating_sub(1);
            dictionary.put_back(part.job, part.part);
            self.work_came();
        }
        Some(held)
    }

    pub(super) fn strike(&mut self, now: Duration, key: &LeaseKey, strike: Strike) {
        let (id, job) = (key.dictionary, key.job);
        let label = self.workers.label_of(strike.machine);
        let able: BTreeSet<Origin> = self.able(now).collect();
        let Some(dictionary) = self.dictionaries.get_mut(&id) else { return };
        let name = dictionary.name().clone();
        let no_other = |job: &Job| able.iter().all(|machine| job.is_struck_by(*machine));
        let given_up = dictionary.strike(job, strike.clone(), self.settings.max_attempts, no_other);
        if dictionary.jobs.get(job as usize).is_some_and(|job| job.machines_struck() > 1) {
            self.outbox.work |= self.workers.machines.exonerate(now, (id, job));
        }
        let event = |kind, message: String| Event::of_job(kind, &name, job, message).by(label.as_str());
        self.outbox.events.push(event(EventKind::AttemptFailed, strike.reason));
        self.outbox.changed = true;
        if let Some((reason, quarantined)) = given_up {
            let kind = if quarantined { EventKind::JobQuarantined } else { EventKind::JobFailed };
            self.outbox.counts.push(Count::GivenUp { quarantined });
            self.outbox.events.push(event(kind, reason.clone()));
            self.outbox.effects.push(Effect::GiveUp { dictionary: id, job, reason, quarantined });
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
}
