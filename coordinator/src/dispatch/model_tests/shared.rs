//! Models dictionaries with the same walks, whose records are shared.

use farm_proto::ids::DictionaryId;
use farm_proto::lease::LeaseKey;

use super::store::DoneJob;
use super::world::World;
use crate::dispatch::Dictionary;
use crate::dispatch::JobRef;
use crate::stored::Origin;

impl World {
    pub fn take_over(&mut self, place: JobRef, from: JobRef, by: Option<Origin>) {
        let is_open = self.farm.schedule.by_id(place.0).is_some_and(|d| d.is_open(place.1));
        self.insist(is_open && self.store.kind(place.0) == self.store.kind(from.0), || {
            format!("{place:?} is served by {from:?}")
        });
        let Some(done) = self.store.take_over(place, from) else { return };
        self.strikes.remove(&place);
        self.walks.insert(place, done.walks);
        self.farm.taken_over(place, done.walks, done.records, by);
    }

    /// Ends the open jobs of a dictionary with the records of others.
    pub fn take_over_done(&mut self, id: DictionaryId) {
        for job in self.farm.schedule.done_elsewhere(id) {
            let kind = self.store.kind(id);
            let walks = self.walks_of((id, job));
            let same = |(of, done): &(&JobRef, &DoneJob)| {
                of.0 != id && of.1 == job && self.store.kind(of.0) == kind && done.walks.get() == walks
            };
            let from = self.store.done.iter().find(same).map(|(place, _)| *place);
            self.insist(from.is_some(), || format!("job {job} of {id:?} is done nowhere else"));
            if let Some(from) = from {
                self.take_over((id, job), from, None);
            }
        }
    }

    /// Another dictionary that is served and has a job under way whose records will serve this one.
    pub fn computed_elsewhere(&self, key: &LeaseKey) -> Option<DictionaryId> {
        let own = self.farm.schedule.by_id(key.dictionary)?;
        let walks = self.walks_of((key.dictionary, key.job));
        let others = self.farm.schedule.dictionaries().filter(|other| {
            other.id() != own.id()
                && other.is_active()
                && self.store.kind(other.id()) == self.store.kind(own.id())
                && other.grid().albedo().len() >= own.grid().albedo().len()
        });
        let computes = |other: &&Dictionary| {
            other.is_open(key.job)
                && self.walks_of((other.id(), key.job)) == walks
                && self.farm.schedule.leases().is_held((other.id(), key.job))
        };
        others.filter(computes).map(Dictionary::id).next()
    }
}
