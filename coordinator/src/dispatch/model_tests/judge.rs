//! Models the coordinator's own computations, which decide what is right.

use std::collections::BTreeSet;

use super::world::World;
use crate::stored::{Origin, Outcome};

/// The coordinator's own machine.
pub const OWN: Origin = Origin(-1);

impl World {
    /// The coordinator begins with what is to be checked next, or comes to its end.
    pub fn judge(&mut self) {
        let Some((part, job)) = self.judging.take() else {
            self.judging = self.farm.next_check(&BTreeSet::new());
            return;
        };
        if !self.store.dictionaries.contains_key(&part.dictionary) {
            return;
        }
        let place = part.job_ref();
        let right = self.store.digest(place.0, place.1, &job, &BTreeSet::new());
        let Some(verdict) = self.farm.verdict(part, &job, right) else { return };
        for machine in &verdict.wrong {
            for (id, job) in self.store.fence(*machine, verdict.reason.clone()) {
                self.reopen(id, job);
            }
        }
        if verdict.stored_is_wrong {
            self.store.blocks.retain(|(id, job, _), _| (*id, *job) != place);
            self.recompute(place.0, place.1);
        }
        self.find_blocks();
        if job.block().is_none()
            && let Some(Outcome::Finished { records } | Outcome::Before { records, .. }) =
                self.store.complete(place.0, place.1, &job, OWN)
        {
            self.insist(records == right, || {
                format!("{place:?} has wrong records, which {verdict:?} leaves")
            });
            self.strikes.remove(&place);
            self.walks.insert(place, job.walks());
            self.store.done.get_mut(&place).expect("it is complete").verified = true;
            self.farm.verified(place, job.walks(), records, OWN);
            for served in self.farm.schedule.served_by(place) {
                self.take_over(served, place, Some(OWN));
            }
        }
        self.farm.settle(part, right, &verdict);
    }
}
