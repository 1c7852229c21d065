//! What must hold after every step.

use std::collections::{BTreeMap, BTreeSet};

use farm_proto::ids::DictionaryId;

use super::super::part::PartId;
use super::super::schedule::{Part, Stage};
use super::super::{Dictionary, Purpose};
use super::world::{LEASE, MAX_ATTEMPTS, World};

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
        self.check_leases()?;
        let (mut waiting, farm) = (0, &self.farm);
        let known: Vec<_> = farm.schedule.dictionaries().map(Dictionary::id).collect();
        must!(known.iter().eq(self.store.dictionaries.keys()), "the dictionaries are {known:?}");
        for (id, stored) in &self.store.dictionaries {
            let dictionary = farm.schedule.by_id(*id).unwrap();
            self.check_jobs(*id, dictionary)?;
            must!(dictionary.priority() == stored.priority, "{id:?} has another priority");
            waiting += if dictionary.is_active() { dictionary.pending() } else { 0 };
        }
        let leases = farm.schedule.leases().iter().count();
        must!(
            farm.schedule.load() == (waiting, leases),
            "the load is {:?}, not {waiting}, {leases}",
            farm.schedule.load()
        );
        let served: Vec<_> = farm.schedule.order().collect();
        let mut wanted: Vec<_> =
            farm.schedule.dictionaries().map(|d| (std::cmp::Reverse(d.priority()), d.id())).collect();
        wanted.sort_unstable();
        must!(served == wanted, "dictionaries are served as {served:?}");
        for worker in self.store.fenced.keys() {
            must!(self.store.wrong.contains(worker), "{worker:?} is honest and fenced off");
        }
        Ok(())
    }

    fn check_leases(&self) -> Result<(), String> {
        let mut of_parts: BTreeMap<PartId, Vec<_>> = BTreeMap::new();
        let mut of_workers = BTreeMap::new();
        for held in self.farm.schedule.leases().iter() {
            of_parts.entry(PartId::from(&held.key)).or_default().push(held);
            *of_workers.entry(&held.worker).or_insert(0) += 1;
            let known = self.farm.roster.get(&held.worker);
            must!(known.is_ok(), "{held:?} is held by one that may not");
            must!(self.origin(&held.worker).is_some(), "{held:?} is held by nobody");
            must!(held.deadline <= self.now + LEASE, "{held:?} ends too late");
        }
        for (part, holders) in of_parts {
            let checks = holders.iter().filter(|h| h.purpose == Purpose::Check).count();
            must!(checks <= 1, "{part:?} has {checks} checks");
            must!(holders.len() - checks <= 2, "{part:?} has {} holders", holders.len());
            let workers: BTreeSet<_> =
                holders.iter().filter(|h| h.purpose != Purpose::Check).map(|h| &h.worker).collect();
            must!(workers.len() == holders.len() - checks, "{part:?} is twice with one worker");
            must!(
                self.farm.schedule.leases().of_part(part).count() == holders.len(),
                "{part:?} is indexed wrongly"
            );
        }
        for (worker, count) in of_workers {
            must!(self.farm.schedule.leases().count_of(worker) == count, "{worker} is indexed wrongly");
        }
        Ok(())
    }

    fn check_jobs(&self, id: DictionaryId, dictionary: &Dictionary) -> Result<(), String> {
        let (mut pending, mut leased, mut done, mut given_up) = (0, 0, 0, 0);
        for index in 0..dictionary.jobs() as u32 {
            let place = (id, index);
            let job = dictionary.job(PartId { dictionary: id, job: index, part: 0 }).unwrap();
            let walks = self.walks_of(place);
            match &job.stage {
                Stage::Done { records, .. } => {
                    let stored = self.store.done.get(&place);
                    must!(stored.is_some_and(|s| s.records == *records), "{place:?} is done: {stored:?}");
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
            for part in 0..job.walks.blocks() {
                let held = self.holders(PartId { dictionary: id, job: index, part });
                let open = dictionary.open_parts(index).contains(&part);
                let waits = dictionary.waits(index, part);
                must!(waits == (open && !held), "{place:?}/{part}: open {open}, held {held}, waits {waits}");
                must!(open || !held, "{place:?}/{part} has ended and is computed");
                pending += usize::from(waits);
                leased += usize::from(held);
            }
        }
        must!(dictionary.pending() == pending, "{id:?}: {} wait, not {pending}", dictionary.pending());
        must!(dictionary.leased() == leased, "{id:?}: {} are leased, not {leased}", dictionary.leased());
        let ended = dictionary.ended();
        must!(ended == (done, given_up), "{id:?}: {ended:?} have ended, not {done}, {given_up}");
        let status = self.farm.status_of(self.now, dictionary);
        let told = (status.jobs_done, status.jobs_leased, status.failed.len());
        must!(told == (done, leased, given_up), "{id:?}: the status tells {told:?}");
        must!(status.records_digest.is_some() == (done == dictionary.jobs()), "{id:?}: complete or not?");
        must!((0.0..=1.0 + 1e-9).contains(&status.work_done), "{id:?}: {} of the work", status.work_done);
        Ok(())
    }

    fn holders(&self, part: PartId) -> bool {
        self.farm.schedule.leases().is_part_held(part)
    }

    /// With every result checked, what is left is right.
    pub fn check_digests(&self) -> Result<(), String> {
        let checked = self.settings.check_share >= 1.0;
        for ((id, job), done) in &self.store.done {
            let wrong = done.by.iter().any(|by| self.store.wrong.contains(by));
            must!(!wrong || !checked, "job {job} of {id:?} is wrong at the end: {done:?}");
        }
        Ok(())
    }
}
