//! Checks the invariants that must hold after every step.

use std::collections::BTreeSet;

use farm_proto::ids::DictionaryId;

use super::world::{MAX_ATTEMPTS, World};
use crate::dispatch::Dictionary;
use crate::dispatch::part::PartId;
use crate::dispatch::schedule::{Part, Stage};

macro_rules! must {
    ($holds:expr, $($why:tt)+) => {
        if !$holds {
            return Err(format!($($why)+));
        }
    };
}

impl World {
    pub fn check(&self) -> Result<(), String> {
        if let Some(complaint) = &self.complaint {
            return Err(complaint.clone());
        }
        // The invariants that need no model.
        self.farm.check(self.now)?;
        let farm = &self.farm;
        for held in farm.schedule.leases().iter() {
            must!(self.origin(&held.worker).is_some(), "{held:?} is held by no worker");
        }
        let known: Vec<_> = farm.schedule.dictionaries().map(Dictionary::id).collect();
        must!(known.iter().eq(self.store.dictionaries.keys()), "the dictionaries are {known:?}");
        for (id, stored) in &self.store.dictionaries {
            let dictionary = farm.schedule.by_id(*id).unwrap();
            self.check_jobs(*id, dictionary)?;
            must!(dictionary.priority() == stored.priority, "{id:?} has another priority");
        }
        for worker in self.store.fenced.keys() {
            must!(self.store.wrong.contains(worker), "{worker:?} is honest and fenced off");
        }
        Ok(())
    }

    fn check_jobs(&self, id: DictionaryId, dictionary: &Dictionary) -> Result<(), String> {
        let (mut done, mut given_up) = (0, 0);
        for index in 0..dictionary.jobs() as u32 {
            let place = (id, index);
            let job = dictionary.job(PartId { dictionary: id, job: index, part: 0 }).unwrap();
            let walks = self.walks_of(place);
            match &job.stage {
                Stage::Done(job) => {
                    let stored = self.store.done.get(&place);
                    let same = stored.is_some_and(|s| (s.records, s.verified) == (job.records, job.verified));
                    must!(same, "{place:?} is done: {stored:?}");
                    done += 1;
                }
                Stage::GivenUp { .. } => {
                    must!(self.store.given_up.contains_key(&place), "{place:?} is given up for nothing");
                    given_up += 1;
                }
                Stage::Open { parts } => {
                    let ended =
                        self.store.done.contains_key(&place) || self.store.given_up.contains_key(&place);
                    must!(!ended, "{place:?} is open, and has ended in the store");
                    must!(job.walks.get() == walks, "{place:?} has {:?}, not {walks}", job.walks);
                    must!(parts.len() == job.walks.blocks() as usize, "{place:?} has other parts");
                    let blocks = self.store.stored_blocks(id, index, job.walks);
                    let stored: BTreeSet<u32> =
                        parts.iter().zip(0..).filter(|(p, _)| **p == Part::Stored).map(|(_, i)| i).collect();
                    must!(stored == blocks, "{place:?} has blocks {stored:?}, not {blocks:?}");
                    let strikes = self.strikes.get(&place).map_or(0, Vec::len);
                    must!(job.strikes.len() == strikes, "{place:?} has {:?}, not {strikes}", job.strikes);
                    must!(job.machines_struck() < MAX_ATTEMPTS as usize, "{place:?} is still tried");
                }
            }
        }
        let ended = dictionary.ended();
        must!(ended == (done, given_up), "{id:?}: {ended:?} have ended, not {done}, {given_up}");
        let status = self.farm.status_of(self.now, dictionary);
        let reported = (status.jobs_done, status.jobs_leased, status.failed.len());
        must!(reported == (done, dictionary.leased(), given_up), "{id:?}: the status has {reported:?}");
        must!(status.records_digest.is_some() == (done == dictionary.jobs()), "{id:?}: complete or not?");
        must!((0.0..=1.0 + 1e-9).contains(&status.work_done), "{id:?}: {} of the work", status.work_done);
        Ok(())
    }

    /// Checks that no wrong result is left, if every result is verified.
    pub fn check_digests(&self) -> Result<(), String> {
        let checked = self.settings.check_share >= 1.0;
        for ((id, job), done) in &self.store.done {
            let wrong = done.by.iter().any(|by| self.store.wrong.contains(by));
            must!(!wrong || !checked, "job {job} of {id:?} is wrong at the end: {done:?}");
        }
        Ok(())
    }
}
