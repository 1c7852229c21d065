//! Checks the invariants of the schedule, after every transition of a debug build.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use super::job::{Job, Stage};
use super::{Dictionary, OpenLease, Schedule};
use crate::dispatch::part::PartId;
use crate::dispatch::roster::Roster;

/// Dictionaries with more jobs or parts are skipped, and so are the leases if there are more: a check after every
/// transition must stay cheap when a test has a million jobs.
const MOST: usize = 1000;

macro_rules! must {
    ($holds:expr, $($why:tt)+) => {
        if !$holds {
            return Err(format!($($why)+));
        }
    };
}

impl Schedule {
    /// Checks the invariants of the schedule; the error describes the first violation.
    pub fn check(&self, now: Duration, roster: &Roster) -> Result<(), String> {
        if self.leases.len() <= MOST {
            self.check_leases(now, roster)?;
        }
        let small = |d: &&Dictionary| d.jobs() <= MOST && d.blocks() <= MOST as u64;
        for dictionary in self.dictionaries().filter(small) {
            self.check_parts(dictionary)?;
        }
        let mut wanted: Vec<_> =
            self.dictionaries().map(|d| (std::cmp::Reverse(d.priority()), d.id())).collect();
        wanted.sort_unstable();
        must!(self.order().eq(wanted.iter().copied()), "dictionaries are served as {:?}", self.order);
        let waiting = self.dictionaries().filter(|d| d.is_active()).map(Dictionary::pending).sum::<usize>();
        let load = (waiting, self.leases.iter().count());
        must!(self.load() == load, "the load is {:?}, not {load:?}", self.load());
        Ok(())
    }

    fn check_leases(&self, now: Duration, roster: &Roster) -> Result<(), String> {
        let mut of_parts: BTreeMap<PartId, Vec<&OpenLease>> = BTreeMap::new();
        let mut of_workers = BTreeMap::new();
        for held in self.leases.iter() {
            of_parts.entry(PartId::from(&held.key)).or_default().push(held);
            *of_workers.entry(&held.worker).or_insert(0) += 1;
            must!(roster.get(&held.worker).is_ok(), "{held:?} is held by a worker that may not");
            must!(held.deadline <= now + self.settings.lease, "{held:?} ends too late");
        }
        for (part, holders) in of_parts {
            must!(holders.len() <= 2, "{part:?} has {} holders", holders.len());
            let workers: BTreeSet<_> = holders.iter().map(|held| &held.worker).collect();
            must!(workers.len() == holders.len(), "{part:?} is twice with one worker");
            must!(self.leases.of_part(part).count() == holders.len(), "{part:?} is indexed wrongly");
        }
        for (worker, count) in of_workers {
            must!(self.leases.count_of(worker) == count, "{worker} is indexed wrongly");
        }
        Ok(())
    }

    /// Checks that a part waits if it is open and not leased, and that all counts agree with the states of the jobs.
    fn check_parts(&self, dictionary: &Dictionary) -> Result<(), String> {
        let id = dictionary.id();
        let leased: BTreeSet<PartId> = self.leases.of_dictionary(id).collect();
        let (mut pending, mut done, mut given_up) = (0, 0, 0);
        for (job, index) in dictionary.jobs.iter().zip(0..) {
            done += usize::from(matches!(job.stage, Stage::Done(_)));
            given_up += usize::from(matches!(job.stage, Stage::GivenUp { .. }));
            let open: BTreeSet<u32> = job.open_parts().collect();
            for part in 0..job.walks.blocks() {
                let held = leased.contains(&PartId { dictionary: id, job: index, part });
                let (open, waits) = (open.contains(&part), dictionary.waits(index, part));
                must!(
                    waits == (open && !held),
                    "{id:?}/{index}/{part}: open {open}, held {held}, waits {waits}"
                );
                must!(open || !held, "{id:?}/{index}/{part} has ended and is computed");
                pending += usize::from(waits);
            }
        }
        must!(dictionary.pending() == pending, "{id:?}: {} wait, not {pending}", dictionary.pending());
        let count = leased.len();
        must!(dictionary.leased() == count, "{id:?}: {} are leased, not {count}", dictionary.leased());
        let ended = dictionary.ended();
        must!(ended == (done, given_up), "{id:?}: {ended:?} have ended, not {done}, {given_up}");
        Ok(())
    }
}

impl Dictionary {
    /// Number of parts of all jobs.
    fn blocks(&self) -> u64 {
        self.jobs.iter().map(|job: &Job| u64::from(job.walks.blocks())).sum()
    }
}
