//! Admits results, and updates the states of their jobs once they are stored.

use std::time::Duration;

use farm_proto::ids::DictionaryId;
use farm_proto::lease::LeaseKey;
use optics_model::{Digest, Walks};

use super::{Dictionary, Done, Job, Schedule, Stage, lease_token};
use crate::dispatch::DispatchError;
use crate::dispatch::admission::{Admission, Arrived};
use crate::dispatch::outbox::{EventKind, Outbox};
use crate::dispatch::part::{JobRef, PartId};
use crate::stored::Origin;

impl Schedule {
    /// Decides whether a result is accepted. `holder` is the access token of its worker, by name.
    pub fn admit(
        &self,
        key: &LeaseKey,
        identity: Digest,
        by: Origin,
        holder: &str,
    ) -> Result<Admission, DispatchError> {
        let part = PartId::from(key);
        let lost = DispatchError::LeaseLost { job: key.job, attempt: key.attempt };
        if !lease_token::verify(&self.settings.secret, key, holder) {
            return Err(lost);
        }
        let unknown = DispatchError::UnknownJob(key.dictionary.0);
        let Some(dictionary) = self.by_id(key.dictionary) else { return Err(unknown) };
        let Some(job) = dictionary.job(part) else { return Err(unknown) };
        let spec = dictionary.spec(key.job, key.part);
        if spec.identity() != identity {
            return Err(lost);
        }
        match &job.stage {
            Stage::Done(_) if job.is_divided() => Ok(Admission::Repeated { job: spec }),
            Stage::Done(done) => Ok(Admission::Compare { job: spec, by, stored: done.records }),
            Stage::Open { .. } if !dictionary.open_parts(key.job).contains(&key.part) => {
                Ok(Admission::Repeated { job: spec })
            }
            Stage::Open { .. } | Stage::GivenUp { .. } if dictionary.takes_results() => {
                Ok(Admission::Store { job: spec, by, quality: dictionary.grid().quality() })
            }
            Stage::Open { .. } | Stage::GivenUp { .. } => Err(lost),
        }
    }

    /// Notes that a result for a part has arrived: its leases end, and the pace is measured.
    pub fn result_came(&mut self, now: Duration, arrived: &Arrived, outbox: &mut Outbox) {
        let (key, part) = (arrived.key, arrived.part());
        let cost = self.job(part).map(Job::part_cost);
        for held in self.end_leases(part) {
            if held.key == *key
                && let Some(cost) = cost
            {
                self.pace.completed(now, cost, now.saturating_sub(held.since));
                self.pace_history.part_done(now, cost);
            }
        }
        self.pace.working(now, self.leases.len() > 0);
        outbox.changed = true;
    }

    /// Notes that a job's records are stored; false if its dictionary is gone.
    pub fn finish(&mut self, now: Duration, arrived: &Arrived, records: Digest) -> bool {
        let (id, job) = arrived.job();
        self.jobs_done += 1;
        self.pace_history.job_done(now);
        self.end_leases_of_job((id, job));
        let Some(dictionary) = self.dictionaries.get_mut(&id) else { return false };
        let by = Some(arrived.by);
        dictionary.finish(job, arrived.walks, Done { records, by, reused: false, verified: false });
        true
    }

    /// Notes that the store has ended a job with records that came for another dictionary, or from the coordinator; false
    /// if the job is done already.
    pub fn take_over(&mut self, (id, job): JobRef, walks: Walks, done: Done) -> bool {
        self.end_leases_of_job((id, job));
        let dictionary = self.dictionaries.get_mut(&id).filter(|dictionary| !dictionary.is_done(job));
        dictionary.is_some_and(|dictionary| {
            dictionary.finish(job, walks, done);
            true
        })
    }

    /// Records that a dictionary has ended, if none of its jobs is open.
    pub fn note_end(&self, id: DictionaryId, outbox: &mut Outbox) {
        if let Some((done, given_up)) = self.by_id(id).filter(|d| d.open_jobs() == 0).map(Dictionary::ended) {
            let kind = if given_up == 0 { EventKind::Done } else { EventKind::Ended };
            self.note(id, None, kind, format!("{done} jobs done, {given_up} given up"), outbox);
        }
    }

    /// Notes that a block of a divided job is stored; false if it was before.
    pub fn part_stored(&mut self, PartId { dictionary, job, part }: PartId) -> bool {
        self.dictionaries.get_mut(&dictionary).is_some_and(|d| d.part_stored(job, part))
    }

    /// Whether the blocks of a job are those of this many walks.
    pub fn has_blocks_of(&self, (id, job): JobRef, walks: Walks) -> bool {
        self.by_id(id).is_some_and(|d| d.too_large.is_none()) && self.has_walks((id, job), walks)
    }

    /// Notes that the store holds a block.
    pub fn part_found(&mut self, part: PartId, outbox: &mut Outbox) {
        outbox.changed |= !self.end_leases(part).is_empty();
        outbox.changed |= self.part_stored(part);
    }

    /// Notes that the store does not hold a block, or no longer holds it.
    pub fn part_missing(&mut self, part: PartId, outbox: &mut Outbox) {
        let held = self.leases.is_part_held(part);
        if let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary)
            && dictionary.part_missing(part.job, part.part, held)
        {
            outbox.work_came();
        }
    }

    /// Begins a job again with more walks, since the target error is not reached.
    pub fn prolong(&mut self, job: JobRef, more: Walks, outbox: &mut Outbox) {
        self.end_leases_of_job(job);
        if let Some(dictionary) = self.dictionaries.get_mut(&job.0) {
            dictionary.prolong(job.1, more);
            outbox.work = true;
        }
    }

    pub fn is_open(&self, job: JobRef) -> bool {
        self.by_id(job.0).is_some_and(|dictionary| dictionary.is_open(job.1))
    }

    pub fn has_walks(&self, job: JobRef, walks: Walks) -> bool {
        self.job(PartId::first_of(job)).is_some_and(|job| job.walks == walks)
    }

    /// Whether a job is open although all of its blocks are counted as stored.
    pub fn waits_for_nothing(&self, (id, job): JobRef) -> bool {
        self.by_id(id).is_some_and(|d| d.is_open(job) && d.open_parts(job).is_empty())
    }

    /// The digest of a job's records, if it is done.
    pub fn records_of(&self, job: JobRef) -> Option<Digest> {
        self.by_id(job.0)?.records_of(job.1)
    }
}
