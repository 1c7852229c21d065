//! Keeps the jobs of one dictionary and their states.

use std::collections::BTreeSet;
use std::sync::Arc;

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use farm_proto::status::{DictionaryState, INTERRUPTED};
use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, Invalid, Walks};

use super::job::{Done, Job, Part, Stage, Strike};
use super::plan::{self, Plan};
use crate::dispatch::part::PartId;
use crate::stored::{DesiredState, EndedJob, StoredDictionary};

/// Counts that change with every job, kept so that they are not recomputed.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub(super) struct Counts {
    pub done: usize,
    pub reused: usize,
    pub given_up: usize,
    pub cost_done: f64,
    pub cost: f64,
    /// Fewest and most walks of a job that is done.
    pub walks: Option<(u64, u64)>,
}

/// A dictionary and the state of each of its jobs.
#[derive(Debug)]
pub struct Dictionary {
    pub(super) stored: StoredDictionary,
    pub(super) outdated: bool,
    /// The reason why it is not worked on: its grid exceeds the limits that now apply.
    pub(super) too_large: Option<Invalid>,
    /// Dictionaries of one family have the same walks at the same points.
    pub(super) family: Option<Digest>,
    pub(super) jobs: Vec<Job>,
    /// Parts that wait, as (rank, job, part).
    pub(super) pending: BTreeSet<(u32, u32, u32)>,
    pub(super) counts: Counts,
    /// Number of leased parts; the schedule keeps the leases.
    leased: usize,
}

impl Dictionary {
    /// Builds a dictionary from the store: the jobs that have not ended are pending.
    pub fn new(stored: StoredDictionary, ended: &[EndedJob]) -> Self {
        Self::planned(Plan::new(&stored.grid), stored, ended)
    }

    /// Builds a dictionary from the store with the plan of its grid.
    pub fn planned(plan: Plan, stored: StoredDictionary, ended: &[EndedJob]) -> Self {
        let Plan { mut jobs, mut pending, too_large } = plan;
        for end in ended {
            if let Some(job) = jobs.get_mut(end.job() as usize) {
                for part in job.open_parts() {
                    pending.remove(&(job.rank, end.job(), part));
                }
                job.end(end);
            }
        }
        let outdated = stored.grid_digest != Digest::of_grid(&stored.grid);
        let (family, counts) = (plan::family(&stored.grid), Counts::default());
        let mut dictionary = Self { stored, outdated, too_large, family, jobs, pending, counts, leased: 0 };
        dictionary.count();
        if let Some(why) = &dictionary.too_large {
            dictionary.stored.reason = format!("its grid is too large: {why}; delete it");
        }
        dictionary
    }

    /// Counts again which jobs have ended. Waiting parts are not counted: they depend on the leases.
    fn count(&mut self) {
        self.counts = Counts::default();
        for job in &self.jobs {
            self.counts.cost += job.cost;
            match &job.stage {
                Stage::Done(done) => self.counts.add_done(job, done.reused),
                Stage::GivenUp { .. } => self.counts.given_up += 1,
                Stage::Open { .. } => {}
            }
        }
    }

    pub fn id(&self) -> DictionaryId {
        self.stored.id
    }

    pub fn name(&self) -> &DictionaryName {
        &self.stored.name
    }

    pub fn grid(&self) -> &Arc<Grid> {
        &self.stored.grid
    }

    pub fn grid_digest(&self) -> Digest {
        self.stored.grid_digest
    }

    pub fn priority(&self) -> i32 {
        self.stored.priority
    }

    pub fn reason(&self) -> &str {
        &self.stored.reason
    }

    /// Its owner: the name of the token that submitted it.
    pub fn owner(&self) -> &str {
        &self.stored.owner
    }

    /// Number of jobs and waiting parts, which take memory.
    pub fn entries(&self) -> usize {
        self.jobs.len() + self.pending.len()
    }

    /// Jobs that have not ended.
    pub fn open_jobs(&self) -> usize {
        self.jobs.len() - self.counts.done - self.counts.given_up
    }

    pub fn jobs(&self) -> usize {
        self.jobs.len()
    }

    /// Numbers of jobs that are done and that were given up.
    pub fn ended(&self) -> (usize, usize) {
        (self.counts.done, self.counts.given_up)
    }

    /// Number of leased parts.
    pub fn leased(&self) -> usize {
        self.leased
    }

    /// Notes that a part is leased.
    pub(super) fn lease_began(&mut self) {
        self.leased += 1;
    }

    /// Notes that a part is no longer leased.
    pub(super) fn lease_ended(&mut self) {
        self.leased = self.leased.saturating_sub(1);
    }

    /// Whether results are accepted. Parts that were leased before a pause may still be finished.
    pub(super) fn takes_results(&self) -> bool {
        self.stored.desire != DesiredState::Cancel && self.is_workable()
    }

    /// Whether parts of it may be given out.
    pub fn is_active(&self) -> bool {
        self.stored.desire == DesiredState::Run && self.is_workable()
    }

    /// Whether its jobs could be worked on, whatever its desired state.
    pub fn is_workable(&self) -> bool {
        !self.outdated && self.too_large.is_none()
    }

    /// Whether all records are present.
    pub fn is_complete(&self) -> bool {
        self.state() == DictionaryState::Done
    }

    /// The job that a part belongs to, if there is such a part.
    pub fn job(&self, id: PartId) -> Option<&Job> {
        self.jobs.get(id.job as usize).filter(|job| job.has_part(id.part))
    }

    pub fn open_parts(&self, index: u32) -> Vec<u32> {
        self.jobs.get(index as usize).map(|job| job.open_parts().collect()).unwrap_or_default()
    }

    /// Jobs that are divided and open, whose blocks may be in the store already.
    pub fn divided_jobs(&self) -> Vec<(u32, JobSpec)> {
        let wanted = |job: &Job| job.is_divided() && matches!(job.stage, Stage::Open { .. });
        let open = self.jobs.iter().zip(0..).filter(|(job, _)| wanted(job));
        open.map(|(_, index)| (index, self.spec(index, 0))).collect()
    }

    /// The specification from which a worker computes a part.
    pub fn spec(&self, index: u32, part: u32) -> JobSpec {
        let job = &self.jobs[index as usize];
        let spec = JobSpec::of(self.grid(), index as usize).with_walks(job.walks);
        if job.is_divided() { spec.with_block(part).expect("the job has this block") } else { spec }
    }

    /// Notes that a block of a divided job is stored; false if it was before.
    pub(super) fn part_stored(&mut self, index: u32, part: u32) -> bool {
        let job = &mut self.jobs[index as usize];
        self.pending.remove(&(job.rank, index, part));
        match &mut job.stage {
            Stage::Open { parts } => {
                parts.get_mut(part as usize).is_some_and(|p| std::mem::replace(p, Part::Stored) == Part::Open)
            }
            // The block is available when the job is tried again.
            Stage::GivenUp { .. } => true,
            Stage::Done(_) => false,
        }
    }

    /// Notes that a block of a divided job is not stored, or no longer stored; it waits unless it is held. True if it did
    /// not wait before.
    pub(super) fn part_missing(&mut self, index: u32, part: u32, held: bool) -> bool {
        let job = &mut self.jobs[index as usize];
        let Stage::Open { parts } = &mut job.stage else { return false };
        parts[part as usize] = Part::Open;
        !held && self.pending.insert((job.rank, index, part))
    }

    /// Notes that a job's records, of this many walks, are stored.
    pub(super) fn finish(&mut self, index: u32, walks: Walks, done: Done) {
        let job = &mut self.jobs[index as usize];
        match job.stage {
            Stage::Done(_) => return,
            Stage::GivenUp { .. } => self.counts.given_up -= 1,
            Stage::Open { .. } => {}
        }
        // The job may have been begun again with other walks since the result was admitted.
        self.begin_again(index, walks);
        let job = &mut self.jobs[index as usize];
        for part in job.open_parts() {
            self.pending.remove(&(job.rank, index, part));
        }
        job.stage = Stage::Done(done);
        self.counts.add_done(job, done.reused);
    }

    /// Begins jobs again, with the walks of the grid.
    pub(super) fn reopen(&mut self, jobs: &[u32]) {
        for index in jobs {
            if (*index as usize) < self.jobs.len() {
                let walks = self.grid().walks_of(*index as usize);
                self.begin_again(*index, walks);
            }
        }
        self.count();
    }

    /// Restarts an open job with more walks.
    pub(super) fn prolong(&mut self, index: u32, walks: Walks) {
        self.begin_again(index, walks);
    }

    /// Restarts a job, none of whose parts is leased: all of them wait.
    fn begin_again(&mut self, index: u32, walks: Walks) {
        let job = &mut self.jobs[index as usize];
        for part in job.open_parts() {
            self.pending.remove(&(job.rank, index, part));
        }
        self.counts.cost -= job.cost;
        job.reopen(walks, plan::parts_of(walks, self.too_large.as_ref()));
        self.counts.cost += job.cost;
        self.pending.extend(job.open_parts().map(|part| (job.rank, index, part)));
    }

    /// Whether a job has not ended.
    pub fn is_open(&self, index: u32) -> bool {
        self.jobs.get(index as usize).is_some_and(|job| matches!(job.stage, Stage::Open { .. }))
    }

    /// The digest of a job's records, if it is done.
    pub(super) fn records_of(&self, index: u32) -> Option<Digest> {
        match self.jobs.get(index as usize)?.stage {
            Stage::Done(done) => Some(done.records),
            _ => None,
        }
    }

    pub fn is_done(&self, index: u32) -> bool {
        self.jobs.get(index as usize).is_some_and(|job| matches!(job.stage, Stage::Done(_)))
    }

    /// Counts a failed attempt at a job. The job is given up if `max` machines have failed at it, or if as many attempts
    /// have failed and no other machine is available (`no_other`). Returns all reasons then, and whether silence was
    /// among them.
    pub(super) fn strike(
        &mut self,
        index: u32,
        strike: Strike,
        max: u32,
        no_other: impl FnOnce(&Job) -> bool,
    ) -> Option<(String, bool)> {
        let job = &mut self.jobs[index as usize];
        if !matches!(job.stage, Stage::Open { .. }) {
            return None;
        }
        job.strikes.push(strike);
        if job.strikes.len() < max as usize || (job.machines_struck() < max as usize && !no_other(job)) {
            return None;
        }
        let reasons: Vec<_> = job.strikes.iter().map(|s| s.reason.as_str()).collect();
        let (reason, quarantined) = (reasons.join("; "), job.strikes.iter().any(|s| s.silent.is_some()));
        for part in job.open_parts() {
            self.pending.remove(&(job.rank, index, part));
        }
        job.stage = Stage::GivenUp { reason: reason.clone(), quarantined };
        self.counts.given_up += 1;
        Some((reason, quarantined))
    }

    /// Withdraws the blame for the silence of a process that has made contact again.
    pub(super) fn forgive(&mut self, index: u32, process: &str) {
        if let Some(job) = self.jobs.get_mut(index as usize) {
            job.strikes.retain(|s| s.silent.as_deref() != Some(process));
        }
    }

    /// Notes that the stored records of a job are those that the coordinator has computed.
    pub(super) fn set_verified(&mut self, index: u32) {
        if let Some(Job { stage: Stage::Done(done), .. }) = self.jobs.get_mut(index as usize) {
            done.verified = true;
        }
    }

    /// Retries the jobs that were given up; returns their indices.
    pub(super) fn retry(&mut self) -> Vec<u32> {
        let given_up = |job: &Job| matches!(job.stage, Stage::GivenUp { .. });
        let again: Vec<u32> =
            self.jobs.iter().zip(0..).filter(|(job, _)| given_up(job)).map(|(_, index)| index).collect();
        self.reopen(&again);
        again
    }

    pub(super) fn set_desire(&mut self, desire: DesiredState, reason: String) {
        self.stored.desire = desire;
        if self.too_large.is_none() {
            self.stored.reason = reason;
        }
    }

    /// Interrupts it if it is unfinished, until it is resumed; the database is not changed.
    pub fn hold(&mut self) {
        if self.state() == DictionaryState::Running {
            self.set_desire(DesiredState::Cancel, INTERRUPTED.to_owned());
        }
    }

    pub(super) fn set_priority(&mut self, priority: i32) {
        self.stored.priority = priority;
    }

    /// The job with the most failed attempts that is still tried, with their reasons.
    pub(super) fn most_troubled(&self) -> Option<(u32, &[Strike])> {
        let open = self.jobs.iter().zip(0..).filter(|(job, _)| matches!(job.stage, Stage::Open { .. }));
        let worst = open.max_by_key(|(job, _)| job.strikes.len())?;
        (!worst.0.strikes.is_empty()).then_some((worst.1, &worst.0.strikes[..]))
    }
}

impl Counts {
    fn add_done(&mut self, job: &Job, reused: bool) {
        self.done += 1;
        self.reused += usize::from(reused);
        self.cost_done += job.cost;
        let walks = job.walks.get();
        self.walks = Some(self.walks.map_or((walks, walks), |(a, b)| (a.min(walks), b.max(walks))));
    }
}
