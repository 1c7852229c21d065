//! What becomes of results: which are wanted, which are compared, and who is fenced off.

use std::time::Duration;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::lease::LeaseKey;
use optics_model::job::JobSpec;
use optics_model::{Digest, Walks};

use super::checks::{Verdict, Vote};
use super::job::{Stage, Strike};
use super::{Count, DispatchError, Dispatcher, Effect, Event, EventKind, JobRef, PartId, Purpose, checks};
use crate::stored::{Origin, Outcome};

/// What to do with a result that has come in.
#[derive(Debug, Clone, PartialEq)]
pub enum Admission {
    /// Store it.
    Store { job: JobSpec, by: Origin },
    /// The job is done: compare it with what is stored.
    Compare { job: JobSpec, by: Origin, stored: Digest },
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

/// A result that has reached the store.
#[derive(Debug)]
pub struct Arrived<'a> {
    pub worker: &'a WorkerId,
    /// The worker's process, also if the worker is not known any more.
    pub by: Origin,
    pub key: &'a LeaseKey,
    /// Of its whole job.
    pub walks: Walks,
}

/// What is to be looked up in the store now that a result has come.
#[derive(Debug, PartialEq, Eq)]
pub enum Next {
    Nothing,
    /// Which blocks of the job there are.
    FindBlocks,
    /// These jobs of other dictionaries, which the records may serve too.
    Serve(Vec<JobRef>),
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
        let admitted = self.wanted(key, identity, by);
        let unused = matches!(admitted, Err(_) | Ok(Admission::Repeated { .. }));
        if unused && self.leases.get(key).is_some_and(|held| held.worker == *worker) {
            // The worker drops the result and forgets the lease: nobody must be blamed for its end.
            self.free(key.token);
        }
        admitted
    }

    fn wanted(&self, key: &LeaseKey, identity: Digest, by: Origin) -> Result<Admission, DispatchError> {
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
            Stage::Done { records, .. } => Ok(Admission::Compare { job: spec, by, stored: *records }),
            Stage::Open { .. } if !dictionary.open_parts(key.job).contains(&key.part) => {
                Ok(Admission::Repeated { job: spec })
            }
            Stage::Open { .. } | Stage::GivenUp { .. } if dictionary.takes_results() => {
                Ok(Admission::Store { job: spec, by })
            }
            Stage::Open { .. } | Stage::GivenUp { .. } => Err(lost),
        }
    }

    /// Notes what the store has made of a result. [`Outcome::Differs`] is for [`Self::distrust`].
    pub fn arrived(&mut self, now: Duration, arrived: &Arrived, outcome: Outcome) -> Next {
        let key = arrived.key;
        match outcome {
            Outcome::Finished { records } => {
                self.finished(now, arrived, records);
                Next::Serve(self.served_by((key.dictionary, key.job)))
            }
            Outcome::Part => {
                self.part_finished(now, arrived);
                // Blocks are shared by dictionaries that ask for the same: another one may have merged those that this
                // one has counted.
                if self.waits_for_nothing(key) { Next::FindBlocks } else { Next::Nothing }
            }
            Outcome::MoreWalks(walks) => {
                self.prolong(now, arrived, walks);
                Next::FindBlocks
            }
            Outcome::Before { records, new } => {
                self.compared(arrived.by, key, records, new);
                Next::Nothing
            }
            Outcome::Unwanted | Outcome::Repeated | Outcome::Differs => Next::Nothing,
        }
    }

    /// Notes that a job's records are stored.
    pub fn finished(&mut self, now: Duration, arrived: &Arrived, records: Digest) {
        let Arrived { by, key, walks, .. } = *arrived;
        self.result_came(now, arrived);
        self.jobs_done += 1;
        let id = key.dictionary;
        if !self.dictionaries.contains_key(&id) {
            return;
        }
        self.end_leases_of_job(id, key.job);
        let Some(dictionary) = self.dictionaries.get_mut(&id) else { return };
        dictionary.finish(key.job, walks, records, Some(by), false);
        let suspect = self.suspects.remove(&(id, key.job));
        if walks.blocks() == 1 && (suspect || checks::is_drawn(records, self.settings.check_share)) {
            self.checks.want(PartId::from(key), Vote { by: Some(by), digest: records });
            self.outbox.work = true;
        }
        self.tell_end(id);
    }

    /// Tells that a dictionary has ended, if none of its jobs is open.
    pub(super) fn tell_end(&mut self, id: DictionaryId) {
        if let Some(dictionary) = self.dictionaries.get(&id).filter(|d| d.open_jobs() == 0) {
            let (done, given_up) = dictionary.ended();
            let kind = if given_up == 0 { EventKind::Done } else { EventKind::Ended };
            let message = format!("{done} jobs done, {given_up} given up");
            self.outbox.events.push(Event::of_dictionary(kind, dictionary.name(), message));
        }
    }

    /// A result differs from the records of other jobs that asked for the same walks. Which is wrong is not known: all
    /// are done again, and then compared with what a second worker finds. It counts as a failed attempt, so that it cannot go
    /// on for ever.
    pub fn distrust(&mut self, arrived: &Arrived, others: &[(DictionaryId, u32)]) {
        let key = arrived.key;
        self.suspects.insert((key.dictionary, key.job));
        self.suspects.extend(others);
        if self.leases.get(key).is_some() {
            self.free(key.token);
        }
        let what = "other records than those of the same walks in another dictionary";
        self.tell_difference(arrived.by, key, format!("{what}: both are computed again"));
        let reason = format!("attempt {}: {what}", key.attempt);
        self.strike(key, Strike { worker: Some(arrived.by), silent: false, reason });
    }

    /// Notes that a block of a divided job is stored.
    pub fn part_finished(&mut self, now: Duration, arrived: &Arrived) {
        let key = arrived.key;
        // A block of fewer walks may arrive after its job was begun again with more.
        let current = self.has_walks(key, arrived.walks);
        if current {
            self.result_came(now, arrived);
        }
        if let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary).filter(|_| current) {
            dictionary.part_stored(key.job, key.part);
        }
    }

    /// Whether a job is not done, although all of its blocks are thought to be there.
    pub fn waits_for_nothing(&self, key: &LeaseKey) -> bool {
        let dictionary = self.dictionaries.get(&key.dictionary);
        dictionary.is_some_and(|d| d.is_open(key.job) && d.open_parts(key.job).is_empty())
    }

    /// The target error is not reached: begins the job again with more walks.
    pub fn prolong(&mut self, now: Duration, arrived: &Arrived, more: Walks) {
        let (id, job) = (arrived.key.dictionary, arrived.key.job);
        // Of two copies that came at once, the second asks for what the first has brought about.
        if !self.has_walks(arrived.key, arrived.walks) || !self.dictionaries[&id].is_open(job) {
            return;
        }
        self.result_came(now, arrived);
        self.end_leases_of_job(id, job);
        if let Some(dictionary) = self.dictionaries.get_mut(&id) {
            dictionary.prolong(job, more);
            self.outbox.work = true;
        }
    }

    fn has_walks(&self, key: &LeaseKey, walks: Walks) -> bool {
        let job = self.dictionaries.get(&key.dictionary).and_then(|d| d.job(PartId::from(key)));
        job.is_some_and(|job| job.walks == walks)
    }

    /// A result for a part came: its leases end, and the pace is measured.
    fn result_came(&mut self, now: Duration, arrived: &Arrived) {
        let key = arrived.key;
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
        // A check, if the job was begun again in the meantime.
        if self.leases.get(key).is_some() {
            self.leases.remove(key.token);
            self.outbox.work = true;
        }
        self.pace.working(now, self.leases.len() > 0);
        self.workers.job_done(arrived.worker);
        self.outbox.changed = true;
    }

    /// Compares a result with the one that is stored. True if they are equal.
    pub fn compared(&mut self, by: Origin, key: &LeaseKey, stored: Digest, new: Digest) -> bool {
        let part = PartId::from(key);
        if self.leases.get(key).is_some_and(|held| held.purpose == Purpose::Check) {
            self.leases.remove(key.token);
            // If this settles nothing another worker may check.
            self.outbox.work = true;
        }
        if self.workers.is_fenced(by) {
            return stored == new;
        }
        let stage = self.dictionaries.get(&part.dictionary).and_then(|d| d.job(part)).map(|job| &job.stage);
        let first = match stage {
            Some(Stage::Done { records, by, .. }) if *records == stored => *by,
            // What it was compared with is not what is there now: either not noted yet, or forgotten meanwhile.
            stage => {
                if stored != new && stage.is_some() {
                    self.suspects.insert((key.dictionary, key.job));
                }
                return stored == new;
            }
        };
        let verdict =
            self.checks.vote(part, Vote { by: first, digest: stored }, Vote { by: Some(by), digest: new });
        self.outbox.changed = true;
        let confirmed = match &verdict {
            Verdict::Agreed => true,
            Verdict::Wrong(wrong) => stored == new && !wrong.contains(&Some(by)),
            Verdict::Disputed | Verdict::Repeated | Verdict::Contradicted => false,
        };
        if confirmed {
            let (dictionary, job) = (part.dictionary, part.job);
            self.outbox.effects.push(Effect::Agreed { dictionary, job, worker: by });
        }
        match verdict {
            Verdict::Repeated => {}
            Verdict::Agreed => self.outbox.counts.push(Count::Agreed),
            Verdict::Disputed => {
                self.outbox.counts.push(Count::Disputed);
                // A third worker decides, which may be waiting for work.
                self.outbox.work = true;
                let first = first.map_or_else(|| "an earlier one".to_owned(), |o| self.workers.label_of(o));
                self.tell_difference(
                    by,
                    key,
                    format!("other records than those of {first}: a third worker decides"),
                );
            }
            Verdict::Contradicted => {
                self.outbox.counts.push(Count::Disputed);
                self.tell_difference(by, key, "records differ between workers");
                self.fence(part, Some(by));
            }
            Verdict::Wrong(wrong) => {
                self.tell_difference(by, key, "records differ between workers");
                for origin in wrong {
                    self.fence(part, origin);
                }
            }
        }
        stored == new
    }

    fn tell_difference(&mut self, by: Origin, key: &LeaseKey, message: impl Into<String>) {
        if let Some(dictionary) = self.dictionaries.get(&key.dictionary) {
            let event = Event::of_job(EventKind::ResultsDiffer, dictionary.name(), key.job, message);
            self.outbox.events.push(event.by(self.workers.label_of(by)));
        }
    }

    /// Fences off whoever computed wrongly; if that is not known, at least the job is computed again.
    fn fence(&mut self, part: PartId, origin: Option<Origin>) {
        let name = self.dictionaries.get(&part.dictionary).map(|d| d.name().to_string()).unwrap_or_default();
        let Some(origin) = origin else {
            let (dictionary, job) = (part.dictionary, part.job);
            self.outbox.effects.push(Effect::Recompute { dictionary, job });
            return;
        };
        let reason = format!("its records of job {} of {name} are wrong: two other results agree", part.job);
        if self.workers.is_fenced(origin) {
            return;
        }
        self.workers.fence(origin, reason.clone());
        let label = self.workers.label_of(origin);
        self.outbox.events.push(Event::of_worker(EventKind::WorkerFenced, label, reason.clone()));
        for id in self.workers.ids_of(origin) {
            for token in self.leases.of_worker(&id) {
                self.free(token);
            }
        }
        self.outbox.effects.push(Effect::Fence { worker: origin, reason });
    }
}
