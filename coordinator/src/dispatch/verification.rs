//! Verifies results: the coordinator itself computes a share of them once more, and each about which machines disagree.
//!
//! Results are deterministic, so of two that differ one is wrong, and what the coordinator computes decides which: no
//! number of machines outvotes it. This module keeps what is to be computed, and what machines claim to have found.

mod sampling;

use std::collections::{BTreeMap, BTreeSet};

use farm_proto::ids::DictionaryId;
use optics_model::Digest;

use super::Settings;
use super::admission::Arrived;
use super::outbox::{Count, Effect, Event, EventKind, Outbox};
use super::part::{JobRef, PartId};
use super::roster::Roster;
use super::schedule::{Reason, Schedule, Stage};
use crate::stored::{Claim, OpenCheck, Origin};

/// Sampled results that may wait. If the coordinator does not keep up, those with the lowest ranks stay, so that the
/// selection is still random.
const MOST: usize = 1000;
/// Claims of one machine about a part: the result that is stored, and another one.
const CLAIMS_OF_ONE: usize = 2;

/// A part that the coordinator is to compute.
#[derive(Debug)]
struct Check {
    claims: Vec<Claim>,
    /// Some result differs from the stored one.
    is_disputed: bool,
    /// Its place among those that are sampled.
    rank: u32,
}

/// The consequences of the coordinator's own computation of a part.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verdict {
    /// Machines with another result.
    pub wrong: Vec<Origin>,
    /// Why they are fenced off.
    pub reason: String,
    /// The stored result is not the coordinator's.
    pub stored_is_wrong: bool,
}

/// The parts that the coordinator is to compute.
#[derive(Debug)]
pub struct Verification {
    settings: Settings,
    checks: BTreeMap<PartId, Check>,
    /// Checks that the store has yet to note.
    changed: BTreeSet<PartId>,
    agreed: u64,
    disputed: u64,
}

impl Verification {
    pub fn new(settings: Settings) -> Self {
        let (checks, changed) = (BTreeMap::new(), BTreeSet::new());
        Self { settings, checks, changed, agreed: 0, disputed: 0 }
    }

    /// Requests a check of a block that is stored, if it is sampled.
    pub fn block_stored(&mut self, arrived: &Arrived, outbox: &mut Outbox) {
        self.sample(arrived.part(), Claim { by: Some(arrived.by), digest: arrived.digest }, outbox);
    }

    /// Requests a check of a finished job if its result is sampled. Of a divided job its last block is checked, as the
    /// others were: merged sums cannot be taken apart.
    pub fn job_finished(&mut self, arrived: &Arrived, records: Digest, outbox: &mut Outbox) {
        let digest = if arrived.walks.blocks() > 1 { arrived.digest } else { records };
        self.sample(arrived.part(), Claim { by: Some(arrived.by), digest }, outbox);
    }

    fn sample(&mut self, part: PartId, claim: Claim, outbox: &mut Outbox) {
        let Settings { secret, check_share, .. } = &self.settings;
        let Some(rank) = sampling::rank(secret, part, claim.digest, *check_share) else { return };
        if self.checks.contains_key(&part) {
            return;
        }
        if self.checks.len() >= MOST {
            let sampled = self.checks.iter().filter(|(_, check)| !check.is_disputed);
            let last = sampled.max_by_key(|(_, check)| check.rank).map(|(part, check)| (*part, check.rank));
            match last {
                Some((last, its_rank)) if its_rank > rank => self.drop_if(|part| part == last),
                _ => return,
            }
        }
        self.checks.insert(part, Check { claims: vec![claim], is_disputed: false, rank });
        self.changed.insert(part);
        outbox.changed = true;
    }

    /// Notes a result that differs from the stored one, or from the records of another job with the same walks (`stored` is
    /// none): the coordinator computes the job itself.
    pub fn dispute(
        &mut self,
        arrived: &Arrived,
        stored: Option<Digest>,
        (schedule, roster): (&Schedule, &Roster),
        outbox: &mut Outbox,
    ) {
        let (by, part) = (arrived.by, arrived.part());
        // Records of other walks cannot be compared.
        let is_comparable = schedule.has_walks(arrived.job(), arrived.walks) && !roster.is_fenced(by);
        let Some(dictionary) = schedule.by_id(part.dictionary).filter(|_| is_comparable) else { return };
        // The stored result may have been replaced since the other one was admitted, or may not be noted yet.
        let first = match schedule.job(part).map(|job| &job.stage) {
            Some(Stage::Done(done)) if Some(done.records) == stored => {
                // For verified records no machine answers any more.
                Some(Claim { by: done.by.filter(|_| !done.verified), digest: done.records })
            }
            _ => None,
        };
        let check = self.checks.entry(part);
        let check = check.or_insert(Check { claims: Vec::new(), is_disputed: true, rank: 0 });
        let new = Claim { by: Some(by), digest: arrived.digest };
        for claim in first.into_iter().chain([new]) {
            let claims_of = check.claims.iter().filter(|known| known.by == claim.by).count();
            if claims_of < CLAIMS_OF_ONE && !check.claims.contains(&claim) {
                check.claims.push(claim);
                self.changed.insert(part);
            }
        }
        check.is_disputed = true;
        if self.changed.contains(&part) {
            let message = "other records than those that are stored: the coordinator computes the job itself";
            let event = Event::of_job(EventKind::ResultsDiffer, dictionary.name(), part.job, message);
            outbox.events.push(event.by(roster.label_of(by)));
            outbox.changed = true;
        }
    }

    /// The part that the coordinator is to compute next, among those that `may` allows: disputes first.
    pub fn next(&self, may: impl Fn(PartId) -> bool) -> Option<PartId> {
        let open = self.checks.iter().filter(|(part, _)| may(**part));
        open.min_by_key(|(_, check)| (!check.is_disputed, check.rank)).map(|(part, _)| *part)
    }

    /// The verdict if the coordinator has computed this result of a part; none if the part is no longer checked.
    pub fn verdict(&self, part: PartId, right: Digest, schedule: &Schedule) -> Option<Verdict> {
        let (check, dictionary) = (self.checks.get(&part)?, schedule.by_id(part.dictionary)?);
        let job = dictionary.job(part)?;
        let mut wrong: Vec<Origin> =
            check.claims.iter().filter(|claim| claim.digest != right).filter_map(|claim| claim.by).collect();
        let stored_is_wrong = match &job.stage {
            // Nothing is known of a block but the claim of the machine that computed it.
            _ if job.is_divided() => check.claims.iter().any(|claim| claim.digest != right),
            Stage::Done(done) if done.records != right => {
                wrong.extend(done.by);
                true
            }
            _ => false,
        };
        wrong.sort_unstable();
        wrong.dedup();
        let reason = format!(
            "its records of job {} of {} are wrong: the coordinator has computed others; once the cause is gone, a new token \
             (farmctl access add) lets its machine in again",
            part.job,
            dictionary.name()
        );
        Some(Verdict { wrong, reason, stored_is_wrong })
    }

    /// Ends a check, unless another result has come that the verdict does not concern. The claims of the machines that are
    /// fenced off are dropped everywhere.
    pub fn settle(&mut self, part: PartId, right: Digest, wrong: &[Origin], outbox: &mut Outbox) {
        let is_fenced = |claim: &Claim| claim.by.is_some_and(|by| wrong.contains(&by));
        for (place, check) in &mut self.checks {
            let before = check.claims.len();
            let is_over = |claim: &Claim| *place == part && (claim.digest == right || claim.by.is_none());
            check.claims.retain(|claim| !is_fenced(claim) && !is_over(claim));
            if check.claims.len() < before {
                self.changed.insert(*place);
            }
        }
        self.checks.retain(|_, check| !check.claims.is_empty());
        let (number, count) = match wrong {
            [] => (&mut self.agreed, Count::Agreed),
            _ => (&mut self.disputed, Count::Disputed),
        };
        *number += 1;
        outbox.counts.push(count);
        // A job that was disputed may be given out again.
        outbox.work_came();
    }

    /// Hands the open checks of a removed dictionary over to another one that shares the records of its jobs.
    pub fn hand_over(&mut self, id: DictionaryId, schedule: &Schedule, outbox: &mut Outbox) {
        let own = self.checks.iter().filter(|(part, _)| part.dictionary == id);
        let heirs: Vec<_> = own
            .filter_map(|(part, check)| {
                let (heir, digest) = schedule.heir(*part)?;
                let claims = vec![Claim { by: check.claims[0].by, digest }];
                Some((heir, Check { claims, ..*check }))
            })
            .collect();
        for (heir, check) in heirs {
            self.checks.entry(heir).or_insert(check);
            self.changed.insert(heir);
            outbox.changed = true;
        }
        self.drop_if(|part| part.dictionary == id);
    }

    /// Drops the checks of jobs whose records are gone.
    pub fn forget_jobs(&mut self, id: DictionaryId, jobs: &[u32]) {
        self.drop_if(|part| part.dictionary == id && jobs.contains(&part.job));
    }

    /// Drops the checks of the blocks of a job that is begun again with more walks.
    pub fn forget_blocks(&mut self, job: JobRef) {
        self.drop_if(|part| part.job_ref() == job);
    }

    /// Drops the check of a block that is no longer stored.
    pub fn forget_block(&mut self, block: PartId) {
        self.drop_if(|part| part == block);
    }

    fn drop_if(&mut self, is_over: impl Fn(PartId) -> bool) {
        let over: Vec<PartId> = self.checks.keys().filter(|part| is_over(**part)).copied().collect();
        for part in over {
            self.checks.remove(&part);
            self.changed.insert(part);
        }
    }

    /// Restores a check from the store.
    pub fn remember(&mut self, check: OpenCheck, schedule: &Schedule) {
        let OpenCheck { dictionary, job, block, claims } = check;
        let part = PartId { dictionary, job, part: block };
        // After a restart a job with a target error begins with fewer walks, so that claims do not apply to it.
        let begins_again =
            schedule.by_id(dictionary).is_some_and(|d| d.grid().quality().is_some() && !d.is_done(job));
        let known = schedule.job(part).filter(|_| !begins_again);
        let (Some(known), Some(first)) = (known, claims.first()) else {
            self.changed.insert(part);
            return;
        };
        let stored = match known.stage {
            Stage::Done(done) if !known.is_divided() => done.records,
            _ => first.digest,
        };
        let is_disputed = claims.iter().any(|claim| claim.digest != stored)
            || (!known.is_divided() && schedule.is_open(part.job_ref()));
        self.checks.insert(part, Check { claims, is_disputed, rank: 0 });
    }

    /// Orders the store to note the checks that have changed.
    pub fn publish(&mut self, outbox: &mut Outbox) {
        for part in std::mem::take(&mut self.changed) {
            let PartId { dictionary, job, part: block } = part;
            let claims = self.checks.get(&part).map(|check| check.claims.clone()).unwrap_or_default();
            outbox.effects.push(Effect::NoteCheck(OpenCheck { dictionary, job, block, claims }));
            outbox.changed = true;
        }
    }

    /// Numbers of results that the coordinator has computed too: equal, unequal, and those that wait for it.
    pub fn counts(&self) -> (u64, u64, usize) {
        (self.agreed, self.disputed, self.checks.len())
    }

    #[cfg(test)]
    pub fn parts(&self) -> impl Iterator<Item = PartId> {
        self.checks.keys().copied()
    }

    /// Jobs about which machines disagree.
    pub fn disputes(&self) -> impl Iterator<Item = JobRef> {
        self.checks.iter().filter(|(_, check)| check.is_disputed).map(|(part, _)| part.job_ref())
    }

    /// Jobs of a dictionary about which machines disagree.
    pub fn disputed(&self, id: DictionaryId) -> BTreeSet<u32> {
        self.disputes().filter(|job| job.0 == id).map(|(_, job)| job).collect()
    }

    /// The reason that concerns the disputes of a dictionary.
    pub fn explain(&self, id: DictionaryId) -> Option<Reason> {
        let disputed = self.disputed(id);
        let first = disputed.first()?;
        let count = disputed.len();
        let text = format!(
            "machines disagree about {count} jobs, the first is job {first}: the coordinator computes them itself"
        );
        Some(Reason::new("DISPUTED", text))
    }

    /// Verifies the invariants of the checks.
    #[cfg(debug_assertions)]
    pub fn check(&self, schedule: &Schedule) -> Result<(), String> {
        for (part, Check { claims, .. }) in &self.checks {
            let claims_of = |by| claims.iter().filter(|claim| claim.by == by).count();
            let is_bounded = claims.iter().all(|claim| claims_of(claim.by) <= CLAIMS_OF_ONE);
            if claims.is_empty() || !is_bounded || schedule.by_id(part.dictionary).is_none() {
                return Err(format!("{part:?} is checked with the claims {claims:?}"));
            }
        }
        Ok(())
    }
}
