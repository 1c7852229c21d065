//! Admits results before they are stored, and notes their outcomes afterwards. Results that are not wanted are refused,
//! those of jobs that are done already are compared.

use std::time::Duration;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::lease::LeaseKey;
use optics_model::job::JobSpec;
use optics_model::{Digest, Walks};

use super::job::{Stage, Strike};
use super::{DispatchError, Dispatcher, Event, EventKind, JobRef, PartId, Purpose};
use crate::stored::{Origin, Outcome, Vote};

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
    /// The worker's machine, also if the worker is not known any more.
    pub by: Origin,
    pub key: &'a LeaseKey,
    /// Of its whole job.
    pub walks: Walks,
    /// Of what has come: records, or the sums of a block.
    pub digest: Digest,
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
    /// Whether a result is wanted. It counts also if its lease is lost, as long as the coordinator gave it, be it before a
    /// restart: records depend on the job alone. `identity` is what the worker was told to compute, so that a result
    /// for another grid or another number of walks is refused.
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
        if !self.mac().verify(key, self.workers.machines.token(by)) {
            return Err(lost);
        }
        let dictionary =
            self.dictionaries.get(&key.dictionary).ok_or(DispatchError::UnknownJob(key.dictionary.0))?;
        let Some(job) = dictionary.job(part) else { return Err(DispatchError::UnknownJob(key.dictionary.0)) };
        let spec = dictionary.spec(key.job, key.part);
        if spec.identity() != identity {
            return Err(lost);
        }
        let is_check = self.leases.get(key).is_some_and(|held| held.purpose == Purpose::Check);
        if let Some(stored) = self.checks.subject(part).filter(|_| is_check && job.is_divided()) {
            return Ok(Admission::Compare { job: spec, by, stored });
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
                self.compare_with_stored(arrived, records, new);
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
        self.pace_history.job_done(now);
        let id = key.dictionary;
        if !self.dictionaries.contains_key(&id) {
            return;
        }
        self.end_leases_of_job(id, key.job);
        let Some(dictionary) = self.dictionaries.get_mut(&id) else { return };
        dictionary.finish(key.job, walks, records, Some(by), false);
        self.checks.forget_aside(id, key.job);
        self.confirmed.remove(&(id, key.job));
        let suspect = self.suspects.remove(&(id, key.job));
        if walks.blocks() > 1 {
            self.want_check_of_block(arrived, suspect);
        } else if suspect || self.is_sampled(key, records) {
            self.checks.want(PartId::from(key), vec![Vote { by: Some(by), digest: records }], suspect);
            self.outbox.work = true;
        }
        self.tell_end(id);
    }

    fn is_sampled(&self, key: &LeaseKey, digest: Digest) -> bool {
        self.mac().is_sampled(PartId::from(key), digest, self.settings.check_share)
    }

    /// Asks for a second opinion on a block, if it is sampled. Its sums are merged and cannot be recovered later, so the
    /// store keeps their digest.
    fn want_check_of_block(&mut self, arrived: &Arrived, suspect: bool) {
        let Arrived { by, key, digest, .. } = *arrived;
        if suspect || self.is_sampled(key, digest) {
            self.checks.want(PartId::from(key), vec![Vote { by: Some(by), digest }], true);
            self.outbox.work = true;
        }
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
    /// are done again, and then compared with what a second machine finds. It counts as a failed attempt, so that it
    /// cannot go on for ever.
    pub fn distrust(&mut self, now: Duration, arrived: &Arrived, others: &[JobRef]) {
        self.suspects.insert((arrived.key.dictionary, arrived.key.job));
        self.suspects.extend(others);
        let what = "other records than those of the same walks in another dictionary";
        self.reject(now, arrived, what, format!("{what}: both are computed again"));
    }

    /// A result differs from records of the same walks that several machines have found alike: one against these undoes
    /// nothing.
    pub fn contradict(&mut self, now: Duration, arrived: &Arrived) {
        let what =
            "other records than those that several machines found for the same walks in another dictionary";
        self.reject(now, arrived, what, format!("{what}: they are not taken"));
    }

    fn reject(&mut self, now: Duration, arrived: &Arrived, what: &str, told: String) {
        let key = arrived.key;
        if self.leases.get(key).is_some() {
            self.free(key.token);
        }
        self.tell_difference(arrived.by, key, told);
        let reason = format!("attempt {}: {what}", key.attempt);
        self.strike(now, key, Strike { machine: arrived.by, silent: None, reason });
    }

    /// Whether several machines have found the records of one of these jobs.
    pub fn is_confirmed(&self, jobs: &[JobRef]) -> bool {
        jobs.iter().any(|job| self.confirmed.contains_key(job))
    }

    /// Notes that a block of a divided job is stored.
    pub fn part_finished(&mut self, now: Duration, arrived: &Arrived) {
        let key = arrived.key;
        // A block of fewer walks may arrive after its job was begun again with more.
        let current = self.has_walks(key, arrived.walks);
        if current {
            self.result_came(now, arrived);
        }
        if let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary).filter(|_| current)
            && dictionary.part_stored(key.job, key.part)
        {
            let suspect = self.suspects.contains(&(key.dictionary, key.job));
            self.want_check_of_block(arrived, suspect);
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
            self.checks.retain(|part| (part.dictionary, part.job) != (id, job));
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
                self.pace_history.part_done(now, cost);
            }
        }
        // A check, if the job was begun again in the meantime.
        if self.leases.get(key).is_some() {
            self.leases.remove(key.token);
            self.outbox.work = true;
        }
        self.pace.working(now, self.leases.len() > 0);
        self.workers.job_done(arrived.worker);
        self.workers.machines.succeeded(arrived.by);
        self.outbox.changed = true;
    }
}
