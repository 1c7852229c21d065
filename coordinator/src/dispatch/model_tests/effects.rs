//! Applies the dispatcher's effects to the model's store.

use farm_proto::ids::DictionaryId;

use super::store::DoneJob;
use super::world::{MAX_ATTEMPTS, World};
use crate::dispatch::Effect;

impl World {
    pub fn settle(&mut self) {
        let outbox = self.farm.take_outbox();
        self.woken = (self.woken.0 || outbox.work, self.woken.1 || outbox.changed);
        for effect in outbox.effects {
            match effect {
                Effect::GiveUp { dictionary, job, reason, quarantined } => {
                    let strikes = self.strikes.remove(&(dictionary, job)).unwrap_or_default();
                    let silent = strikes.iter().any(|s| s.1.is_some());
                    self.insist(strikes.len() >= MAX_ATTEMPTS as usize && silent == quarantined, || {
                        format!("job {job} is given up for {strikes:?}")
                    });
                    let walks = self.store.dictionaries[&dictionary].grid.walks_of(0);
                    self.walks.insert((dictionary, job), walks);
                    self.store.given_up.insert((dictionary, job), (reason, quarantined));
                }
                Effect::NoteCheck(check) => self.store.note_check(check),
            }
            // Applies the effects that this one has caused.
            self.settle();
        }
    }

    /// Deletes a job's records. Records are stored by their walks, so other jobs with the same walks lose them too.
    pub fn recompute(&mut self, id: DictionaryId, job: u32) {
        for (id, job) in self.same_walks(id, job) {
            self.store.done.remove(&(id, job));
            self.reopen(id, job);
        }
        self.find_blocks();
    }

    /// The finished jobs with the same walks as a finished job, which is among them.
    fn same_walks(&self, id: DictionaryId, job: u32) -> Vec<(DictionaryId, u32)> {
        let Some(walks) = self.store.done.get(&(id, job)).map(|done| done.walks) else { return Vec::new() };
        let kind = self.store.kind(id);
        let same = |(of, done): &(&(DictionaryId, u32), &DoneJob)| {
            of.1 == job && done.walks == walks && self.store.kind(of.0) == kind
        };
        self.store.done.iter().filter(same).map(|(of, _)| *of).collect()
    }

    pub fn reopen(&mut self, id: DictionaryId, job: u32) {
        self.strikes.remove(&(id, job));
        self.walks.remove(&(id, job));
        self.farm.reopen(id, &[job]);
    }

    /// Reports the stored blocks to the dispatcher.
    pub fn find_blocks(&mut self) {
        for id in self.store.dictionaries.keys().copied().collect::<Vec<_>>() {
            for (job, spec) in self.farm.schedule.by_id(id).unwrap().divided_jobs() {
                let blocks = self.store.stored_blocks(id, job, spec.walks());
                self.farm.parts_stored((id, job), spec.walks(), &blocks);
            }
        }
    }
}
