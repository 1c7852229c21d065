//! Delivers results to the model's store.

use std::collections::BTreeSet;

use super::world::{Arriving, World};
use crate::dispatch::Arrived;
use crate::stored::Outcome;

impl World {
    /// A result reaches the store.
    pub fn end(&mut self, which: usize) {
        let Some(last) = self.arriving.len().checked_sub(1) else { return };
        let Arriving { worker, by, key, job } = self.arriving.remove(which.min(last));
        let place = (key.dictionary, key.job);
        let digest = self.store.digest(key.dictionary, key.job, &job, &BTreeSet::from([by]));
        let arrived = Arrived { worker: &worker, by, key: &key, walks: job.walks(), digest };
        match self.store.complete(key.dictionary, key.job, &job, by) {
            None | Some(Outcome::Unwanted) => {}
            Some(Outcome::Finished { records }) => {
                self.strikes.remove(&place);
                self.walks.insert(place, job.walks());
                self.farm.finished(self.now, &arrived, records);
                // Now and then the store fails: then the others compute for themselves.
                if !self.chance.tokens.is_multiple_of(4) {
                    for served in self.farm.schedule.served_by(place) {
                        self.take_over(served, place, Some(by));
                    }
                }
            }
            Some(Outcome::Part) => self.farm.part_finished(self.now, &arrived),
            Some(Outcome::MoreWalks(walks)) => {
                self.farm.prolong(self.now, &arrived, walks);
                if !self.store.given_up.contains_key(&place) && self.walks_of(place) == job.walks().get() {
                    self.walks.insert(place, walks);
                    self.strikes.remove(&place);
                }
                self.find_blocks();
            }
            Some(Outcome::Before { records, .. }) => {
                self.farm.compare_with_stored(&arrived, records);
            }
            Some(Outcome::Differs | Outcome::Repeated) => {
                unreachable!("the model's store compares neither points nor blocks")
            }
        }
    }

    /// A result that reaches the store differs from the records of a job with the same walks.
    pub fn clash(&mut self, which: usize, with: usize) {
        let Some(other) = self.store.done.keys().nth(with).copied() else { return };
        let Some(last) = self.arriving.len().checked_sub(1) else { return };
        let Arriving { worker, by, key, job } = self.arriving.remove(which.min(last));
        if self.farm.schedule.by_id(key.dictionary).is_none() || (key.dictionary, key.job) == other {
            return;
        }
        let digest = self.store.digest(key.dictionary, key.job, &job, &BTreeSet::from([by]));
        let arrived = Arrived { worker: &worker, by, key: &key, walks: job.walks(), digest };
        if job.block().is_some() {
            self.store.blocks.retain(|(id, job, _), _| (*id, *job) != (key.dictionary, key.job));
            self.recompute(other.0, other.1);
            if self.farm.schedule.is_open((key.dictionary, key.job)) {
                self.strike(key.dictionary, key.job, by, None);
            }
        }
        self.farm.contradict(self.now, &arrived);
        self.find_blocks();
    }
}
