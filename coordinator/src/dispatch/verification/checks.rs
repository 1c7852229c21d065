//! Keeps the open checks: the votes of machines about results, and the verdicts that follow from them.
//!
//! Results are deterministic, so of two that differ one is wrong. A third machine decides: the result with most votes is
//! right, if it has at least two. A machine has one vote, and only for a check that it was given.

use std::collections::BTreeMap;

use farm_proto::ids::DictionaryId;
use optics_model::Digest;

use crate::dispatch::part::{JobRef, PartId};
use crate::stored::{Origin, Vote};

/// Checks that may wait; when there are more, the oldest are dropped.
const MOST: usize = 1000;

/// The outcome of a vote.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Verdict {
    /// All agree.
    Agreed,
    /// The part is not being checked, or this machine has voted already.
    NotCounted,
    /// No result has more votes than the others: another machine is needed.
    Disputed,
    /// Most agree on `right`; `wrong` are the machines with another result.
    Wrong { right: Digest, wrong: Vec<Option<Origin>> },
}

#[derive(Debug)]
struct Open {
    votes: Vec<Vote>,
    /// The store holds the check too.
    stored: bool,
}

#[derive(Debug, Default)]
pub struct Checks {
    open: BTreeMap<PartId, Open>,
    /// Votes about blocks of jobs that have no such blocks at present: after a restart a job begins with its initial
    /// number of walks, and finds its blocks again when it continues to more. The store holds these votes too.
    aside: BTreeMap<PartId, Vec<Vote>>,
    /// Checks that the store has yet to note.
    changed: BTreeMap<PartId, Vec<Vote>>,
    pub agreed: u64,
    pub disputed: u64,
}

impl Checks {
    /// Opens a check of a result, with the votes so far. `lasting`: the store notes it, since a restart would not sample it
    /// again.
    pub fn want(&mut self, part: PartId, votes: Vec<Vote>, lasting: bool) {
        if self.open.contains_key(&part) {
            return;
        }
        if self.open.len() >= MOST {
            // A dispute must be settled; a check that merely waits for a first comparison can be dropped.
            let waiting = self.open.iter().find(|(_, open)| !is_disputed(&open.votes)).map(|(part, _)| *part);
            if let Some(part) = waiting {
                self.settle(part);
            }
        }
        if lasting {
            self.changed.insert(part, votes.clone());
        }
        self.open.insert(part, Open { votes, stored: lasting });
    }

    /// Restores a check from the store.
    pub fn remember(&mut self, part: PartId, votes: Vec<Vote>) {
        self.open.insert(part, Open { votes, stored: true });
    }

    /// Keeps a check from the store until its block exists again.
    pub fn put_aside(&mut self, part: PartId, votes: Vec<Vote>) {
        self.aside.insert(part, votes);
    }

    /// Resumes the check of a block that exists again; false if there is none to resume.
    pub fn take_up(&mut self, part: PartId) -> bool {
        let votes = self.aside.remove(&part).filter(|_| !self.open.contains_key(&part));
        votes.is_some_and(|votes| {
            self.remember(part, votes);
            true
        })
    }

    /// Drops the checks that were put aside for a job, whose blocks will not exist again.
    pub fn forget_aside(&mut self, job: JobRef) {
        let gone: Vec<PartId> = self.aside.range(PartId::range_of(job)).map(|(part, _)| *part).collect();
        for part in gone {
            self.drop_aside(part);
        }
    }

    /// Drops all checks of a dictionary.
    pub fn forget_dictionary(&mut self, id: DictionaryId) {
        let gone: Vec<PartId> = self.aside.keys().filter(|part| part.dictionary == id).copied().collect();
        for part in gone {
            self.drop_aside(part);
        }
        self.retain(|part| part.dictionary != id);
    }

    fn drop_aside(&mut self, part: PartId) {
        if self.aside.remove(&part).is_some() && !self.open.contains_key(&part) {
            self.changed.insert(part, Vec::new());
        }
    }

    /// Checks that the store has yet to note: their votes, none if settled.
    pub fn take_changed(&mut self) -> BTreeMap<PartId, Vec<Vote>> {
        std::mem::take(&mut self.changed)
    }

    #[cfg(debug_assertions)]
    pub fn all(&self) -> impl Iterator<Item = (PartId, &[Vote])> {
        self.open.iter().map(|(part, open)| (*part, &open.votes[..]))
    }

    /// The open checks of a dictionary's jobs.
    pub fn of_dictionary(&self, id: DictionaryId) -> impl Iterator<Item = (PartId, &[Vote])> {
        let from = PartId { dictionary: id, job: 0, part: 0 };
        let of_it = self.open.range(from..).take_while(move |(part, _)| part.dictionary == id);
        of_it.map(|(part, open)| (*part, &open.votes[..]))
    }

    /// Parts that a machine may check: those without a vote of its own, as `is_own` decides.
    pub fn open_to(&self, is_own: impl Fn(Origin) -> bool) -> impl Iterator<Item = PartId> {
        let unseen = move |open: &Open| !open.votes.iter().any(|vote| vote.by.is_some_and(&is_own));
        self.open.iter().filter(move |(_, open)| unseen(open)).map(|(part, _)| *part)
    }

    pub fn waiting(&self) -> usize {
        self.open.len()
    }

    /// The first vote of an open check, which is about the stored result.
    pub fn subject(&self, part: PartId) -> Option<Digest> {
        Some(self.open.get(&part)?.votes.first()?.digest)
    }

    pub fn disputed_in(&self, id: DictionaryId) -> impl Iterator<Item = PartId> {
        self.of_dictionary(id).filter(|(_, votes)| is_disputed(votes)).map(|(part, _)| part)
    }

    /// Adds the vote of one more machine about a part that is being checked. `is_own` is true for machines that share its
    /// vote.
    pub fn vote(&mut self, part: PartId, new: Vote, is_own: impl Fn(Origin) -> bool) -> Verdict {
        let Some(open) = self.open.get_mut(&part) else { return Verdict::NotCounted };
        if open.votes.iter().any(|vote| vote.by.is_some_and(&is_own)) {
            return Verdict::NotCounted;
        }
        open.votes.push(new);
        let Some(right) = most_agreed(&open.votes) else {
            self.disputed += 1;
            open.stored = true;
            self.changed.insert(part, open.votes.clone());
            return Verdict::Disputed;
        };
        let mut wrong: Vec<_> = open.votes.iter().filter(|v| v.digest != right).map(|v| v.by).collect();
        wrong.dedup();
        self.settle(part);
        if wrong.is_empty() {
            self.agreed += 1;
            return Verdict::Agreed;
        }
        Verdict::Wrong { right, wrong }
    }

    /// Withdraws the votes of a machine. A check stays open if the stored result has a vote left.
    pub fn withdraw_votes(&mut self, machine: Origin) {
        let has_voted = |open: &Open| open.votes.iter().any(|vote| vote.by == Some(machine));
        let of_it: Vec<PartId> =
            self.open.iter().filter(|(_, open)| has_voted(open)).map(|(part, _)| *part).collect();
        // The blocks of the machine are gone.
        let begun_by = |votes: &[Vote]| votes.first().is_some_and(|first| first.by == Some(machine));
        let gone: Vec<PartId> =
            self.aside.iter().filter(|(_, votes)| begun_by(votes)).map(|(part, _)| *part).collect();
        for part in gone {
            self.drop_aside(part);
        }
        for votes in self.aside.values_mut() {
            votes.retain(|vote| vote.by != Some(machine));
        }
        for part in of_it {
            let Some(open) = self.open.get_mut(&part) else { continue };
            let subject = open.votes[0].digest;
            open.votes.retain(|vote| vote.by != Some(machine));
            if open.votes.first().is_none_or(|first| first.digest != subject) {
                self.settle(part);
            } else if open.stored {
                self.changed.insert(part, open.votes.clone());
            }
        }
    }

    /// Drops the checks whose subject is gone.
    pub fn retain(&mut self, keep: impl Fn(PartId) -> bool) {
        let gone: Vec<PartId> = self.open.keys().filter(|part| !keep(**part)).copied().collect();
        for part in gone {
            self.settle(part);
        }
    }

    /// Ends the check of a part.
    pub fn settle(&mut self, part: PartId) {
        if self.open.remove(&part).is_some_and(|open| open.stored) {
            self.changed.insert(part, Vec::new());
        }
    }
}

pub(super) fn is_disputed(votes: &[Vote]) -> bool {
    votes.iter().any(|vote| vote.digest != votes[0].digest)
}

/// The digest that at least two machines found, and more than any other.
fn most_agreed(votes: &[Vote]) -> Option<Digest> {
    let count = |digest: Digest| votes.iter().filter(|vote| vote.digest == digest).count();
    let most = votes.iter().map(|vote| count(vote.digest)).max()?;
    let mut best = votes.iter().map(|vote| vote.digest).filter(|digest| count(*digest) == most);
    let first = best.next()?;
    (most > 1 && best.all(|other| other == first)).then_some(first)
}
