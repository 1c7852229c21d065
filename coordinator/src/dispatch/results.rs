//! What becomes of results: which are wanted, which are compared, and who is fenced off.

use std::time::Duration;

use farm_proto::ids::WorkerId;
use farm_proto::job::{JobSpec, LeaseKey};
use farm_proto::{Digest, Walks};

use super::checks::{Verdict, Vote};
use super::job::Stage;
use super::{Chance, DispatchError, Dispatcher, Effect, Event, EventKind, Origin, PartId, Purpose};

/// What to do with a result that has come in.
#[derive(Debug, Clone, PartialEq)]
pub enum Admission {
    /// Store it.
    Store { job: JobSpec, by: Origin },
    /// The job is done: compare it with what is stored.
    Compare { job: JobSpec, stored: Digest },
    /// A block that is stored already, or was merged: nothing is left to compare with.
    Repeated { job: JobSpec },
}

impl Admission {
    /// What was computed, and how many walks.
    pub fn job(&self) -> &JobSpec {
        match self {
            Self::Store { job, .. } | Self::Compare { job, .. } | Self::Repeated { job } => job,
        }
    }
}

impl Dispatcher {
    /// Whether a result is wanted. It counts also if its lease is lost: records depend on the job alone. `identity` is
    /// what the worker was told to compute, so that a result for another grid or another number of walks is refused.
    pub fn admit(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        key: &LeaseKey,
        identity: Digest,
    ) -> Result<Admission, DispatchError> {
        self.seen(now, worker)?;
        let by = self.workers.get(worker)?.origin;
        let part = PartId::from(key);
        let lost = DispatchError::LeaseLost { job: key.job, attempt: key.attempt };
        let dictionary =
            self.dictionaries.get(&key.dictionary).ok_or(DispatchError::UnknownJob(key.dictionary.0))?;
        let Some(job) = dictionary.job(part) else { return Err(DispatchError::UnknownJob(key.dictionary.0)) };
        let spec = dictionary.spec(key.job, key.part);
        if spec.identity() != identity {
            return Err(lost);
        }
        match &job.stage {
            Stage::Done { .. } if job.is_divided() => Ok(Admission::Repeated { job: spec }),
            Stage::Done { records, .. } => Ok(Admission::Compare { job: spec, stored: *records }),
            Stage::Open { .. } if !dictionary.open_parts(key.job).contains(&key.part) => {
                Ok(Admission::Repeated { job: spec })
            }
            Stage::Open { .. } | Stage::GivenUp { .. } if dictionary.is_active() => {
                Ok(Admission::Store { job: spec, by })
            }
            Stage::Open { .. } | Stage::GivenUp { .. } => Err(lost),
        }
    }

    /// Notes that a job's records are stored. `by` computed them, whether or not the worker is still known.
    #[expect(clippy::too_many_arguments, reason = "all of them describe one result")]
    pub fn finished(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        by: Origin,
        key: &LeaseKey,
        records: Digest,
        chance: &mut impl Chance,
    ) {
        let by = Some(by);
        self.result_came(now, worker, key);
        self.jobs_done += 1;
        let part = PartId::from(key);
        let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary) else { return };
        let divided = dictionary.job(part).is_none_or(super::job::Job::is_divided);
        dictionary.finish(key.job, records, by);
        let ended = dictionary.open_jobs() == 0;
        let (done, given_up) = dictionary.ended();
        if !divided && chance.share() < self.settings.check_share {
            self.checks.want(part, Vote { by, digest: records });
        }
        if ended {
            let kind = if given_up == 0 { EventKind::Done } else { EventKind::Ended };
            let message = format!("{done} jobs done, {given_up} given up");
            self.events.push(Event::of_dictionary(kind, key.dictionary, message));
        }
    }

    /// Notes that a block of a divided job is stored.
    pub fn part_finished(&mut self, now: Duration, worker: &WorkerId, key: &LeaseKey) {
        self.result_came(now, worker, key);
        if let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary) {
            dictionary.part_stored(key.job, key.part);
        }
    }

    /// The target error is not reached: begins the job again with more walks.
    pub fn prolong(&mut self, now: Duration, worker: &WorkerId, key: &LeaseKey, walks: Walks) {
        self.result_came(now, worker, key);
        if let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary) {
            dictionary.prolong(key.job, walks);
        }
    }

    /// A result for a part came: its leases end, and the pace is measured.
    fn result_came(&mut self, now: Duration, worker: &WorkerId, key: &LeaseKey) {
        let part = PartId::from(key);
        let cost =
            self.dictionaries.get(&part.dictionary).and_then(|d| d.job(part)).map(super::job::Job::part_cost);
        for held in self.end_leases(part) {
            if held.key == *key
                && let Some(cost) = cost
            {
                self.pace.completed(now, cost, now.saturating_sub(held.since));
            }
        }
        self.workers.job_done(worker);
    }

    /// Compares a result with the one that is stored. True if they are equal.
    pub fn compared(&mut self, worker: &WorkerId, key: &LeaseKey, stored: Digest, new: Digest) -> bool {
        let part = PartId::from(key);
        if self.leases.get(key).is_some_and(|held| held.purpose == Purpose::Check) {
            self.leases.remove(key.token);
        }
        let Ok(by) = self.workers.get(worker).map(|w| w.origin) else { return stored == new };
        let first =
            self.dictionaries.get(&part.dictionary).and_then(|d| d.job(part)).and_then(|job| {
                match job.stage {
                    Stage::Done { by, .. } => by,
                    _ => None,
                }
            });
        let verdict =
            self.checks.vote(part, Vote { by: first, digest: stored }, Vote { by: Some(by), digest: new });
        let label = self.workers.label_of(by);
        let event = |message: String| Event {
            kind: EventKind::ResultsDiffer,
            dictionary: Some(key.dictionary),
            job: Some(key.job),
            worker: label.clone(),
            message,
        };
        match verdict {
            Verdict::Agreed | Verdict::Repeated => {}
            Verdict::Disputed => {
                let first = first.map_or_else(|| "an earlier one".to_owned(), |o| self.workers.label_of(o));
                self.events
                    .push(event(format!("other records than those of {first}: a third worker decides")));
            }
            Verdict::Wrong(wrong) => {
                self.events.push(event("records differ between workers".to_owned()));
                for origin in wrong {
                    self.fence(part, origin);
                }
            }
        }
        stored == new
    }

    /// Fences off whoever computed wrongly; if that is not known, at least the job is computed again.
    fn fence(&mut self, part: PartId, origin: Option<Origin>) {
        let name = self.dictionaries.get(&part.dictionary).map(|d| d.name().to_string()).unwrap_or_default();
        let Some(origin) = origin else {
            let (dictionary, job) = (part.dictionary, part.job);
            self.effects.push(Effect::Recompute { dictionary, job });
            return;
        };
        let reason = format!("its records of job {} of {name} are wrong: two other results agree", part.job);
        if self.workers.is_fenced(origin) {
            return;
        }
        self.workers.fence(origin, reason.clone());
        let label = self.workers.label_of(origin);
        self.events.push(Event::of_worker(EventKind::WorkerFenced, label, reason.clone()));
        for id in self.workers.ids_of(origin) {
            for token in self.leases.of_worker(&id) {
                self.free(token);
            }
        }
        self.effects.push(Effect::Fence { worker: origin, reason });
    }
}
