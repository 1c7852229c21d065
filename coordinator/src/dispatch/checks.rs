//! Results compared bit for bit between workers, and who is believed when they differ.
//!
//! Results are deterministic, so of two that differ one is wrong. A third worker decides: what two agree on is right.

use std::collections::BTreeMap;

use farm_proto::ids::DictionaryId;
use optics_model::Digest;

use super::PartId;
use crate::stored::Origin;

/// Checks that may wait; when there are more, the oldest are dropped.
const MOST: usize = 1000;

/// Whether a result is among the share that is checked. Its digest decides: that is as good as chance for a wrong result,
/// since nobody can foresee its digest, and after a restart the same are drawn.
pub(super) fn is_drawn(records: Digest, share: f64) -> bool {
    let [a, b, c, d, ..] = *records.as_bytes();
    f64::from(u32::from_le_bytes([a, b, c, d])) < share * 2.0_f64.powi(32)
}

/// One worker's result, as its digest. The worker is unknown if the coordinator was restarted in between.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Vote {
    pub by: Option<Origin>,
    pub digest: Digest,
}

/// What a vote led to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Verdict {
    /// All agree.
    Agreed,
    /// The same worker said the same again.
    Repeated,
    /// The same worker says something else than before.
    Contradicted,
    /// Two results differ: another worker is needed.
    Disputed,
    /// Two agree against these.
    Wrong(Vec<Option<Origin>>),
}

#[derive(Debug, Default)]
pub(super) struct Checks {
    open: BTreeMap<PartId, Vec<Vote>>,
    pub agreed: u64,
    pub disputed: u64,
}

impl Checks {
    /// Asks for a second opinion on a result.
    pub fn want(&mut self, part: PartId, first: Vote) {
        if self.open.len() >= MOST {
            // A dispute must be settled; what merely waits for a first comparison can be let go.
            let waiting = self.open.iter().find(|(_, votes)| votes.len() < 2).map(|(part, _)| *part);
            if let Some(part) = waiting {
                self.open.remove(&part);
            }
        }
        self.open.entry(part).or_insert_with(|| vec![first]);
    }

    /// The open checks of a dictionary's jobs.
    pub fn of_dictionary(&self, id: DictionaryId) -> Vec<(PartId, Vec<Vote>)> {
        let of_it = self.open.iter().filter(|(part, _)| part.dictionary == id);
        of_it.map(|(part, votes)| (*part, votes.clone())).collect()
    }

    /// Goes on with a check at another job with the same records.
    pub fn take_over(&mut self, part: PartId, votes: Vec<Vote>) {
        self.open.entry(part).or_insert(votes);
    }

    /// Parts that this worker has not computed itself.
    pub fn open_to(&self, worker: Origin) -> impl Iterator<Item = PartId> {
        let unseen = move |votes: &Vec<Vote>| votes.iter().all(|v| v.by != Some(worker));
        self.open.iter().filter(move |(_, votes)| unseen(votes)).map(|(part, _)| *part)
    }

    pub fn waiting(&self) -> usize {
        self.open.len()
    }

    pub fn is_disputed(&self, part: PartId) -> bool {
        self.open.get(&part).is_some_and(|votes| votes.len() > 1)
    }

    /// Compares one more result with the stored one, whether or not it was asked for.
    pub fn vote(&mut self, part: PartId, stored: Vote, new: Vote) -> Verdict {
        let asked_for = self.open.contains_key(&part);
        let votes = self.open.entry(part).or_insert_with(|| vec![stored]);
        if let Some(same) = votes.iter().position(|v| v.by.is_some() && v.by == new.by) {
            let consistent = votes[same].digest == new.digest;
            if consistent {
                // Its own opinion again proves nothing.
                if !asked_for {
                    self.open.remove(&part);
                }
                return Verdict::Repeated;
            }
            // What it said before counts no more; what others said is still to be settled.
            votes.remove(same);
            if votes.is_empty() {
                self.open.remove(&part);
            }
            self.disputed += 1;
            return Verdict::Contradicted;
        }
        votes.push(new);
        let count = |digest: Digest| votes.iter().filter(|v| v.digest == digest).count();
        let Some(right) = votes.iter().map(|v| v.digest).find(|d| count(*d) > 1) else {
            self.disputed += 1;
            return Verdict::Disputed;
        };
        let mut wrong: Vec<_> = votes.iter().filter(|v| v.digest != right).map(|v| v.by).collect();
        wrong.dedup();
        self.open.remove(&part);
        if wrong.is_empty() {
            self.agreed += 1;
            return Verdict::Agreed;
        }
        Verdict::Wrong(wrong)
    }

    /// Forgets checks whose subject is gone.
    pub fn retain(&mut self, keep: impl Fn(PartId) -> bool) {
        self.open.retain(|part, _| keep(*part));
    }
}
