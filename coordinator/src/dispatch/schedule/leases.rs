//! Keeps the open leases with their holders and deadlines, indexed by token, deadline, part and worker.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::LeaseKey;

use crate::dispatch::part::{JobRef, PartId, Purpose};

/// A lease that has neither ended nor expired.
#[derive(Debug, Clone)]
pub struct OpenLease {
    pub key: LeaseKey,
    pub worker: WorkerId,
    pub purpose: Purpose,
    pub since: Duration,
    pub deadline: Duration,
    /// The worker has reported that it is tracing the part.
    pub running: bool,
}

/// All open leases, indexed by token, deadline, part and worker.
#[derive(Debug, Default)]
pub struct Leases {
    all: BTreeMap<Token, OpenLease>,
    deadlines: BTreeSet<(Duration, Token)>,
    of_parts: BTreeMap<PartId, Vec<Token>>,
    of_workers: BTreeMap<WorkerId, BTreeSet<Token>>,
}

impl Leases {
    pub fn insert(&mut self, held: OpenLease) {
        let token = held.key.token;
        self.deadlines.insert((held.deadline, token));
        self.of_parts.entry(PartId::from(&held.key)).or_default().push(token);
        self.of_workers.entry(held.worker.clone()).or_default().insert(token);
        self.all.insert(token, held);
    }

    pub fn remove(&mut self, token: Token) -> Option<OpenLease> {
        let held = self.all.remove(&token)?;
        self.deadlines.remove(&(held.deadline, token));
        let part = PartId::from(&held.key);
        if let Some(tokens) = self.of_parts.get_mut(&part) {
            tokens.retain(|t| *t != token);
            if tokens.is_empty() {
                self.of_parts.remove(&part);
            }
        }
        if let Some(tokens) = self.of_workers.get_mut(&held.worker) {
            tokens.remove(&token);
            if tokens.is_empty() {
                self.of_workers.remove(&held.worker);
            }
        }
        Some(held)
    }

    /// Whether some lease has this token.
    pub fn has(&self, token: Token) -> bool {
        self.all.contains_key(&token)
    }

    /// The lease of this key.
    pub fn get(&self, key: &LeaseKey) -> Option<&OpenLease> {
        self.all.get(&key.token).filter(|held| held.key == *key)
    }

    /// The lease of this key, if this worker holds it.
    pub fn held_by(&self, key: &LeaseKey, worker: &WorkerId) -> Option<&OpenLease> {
        self.get(key).filter(|held| held.worker == *worker)
    }

    /// Ends all leases of a part.
    pub fn remove_part(&mut self, part: PartId) -> Vec<OpenLease> {
        let tokens = self.of_parts.get(&part).cloned().unwrap_or_default();
        tokens.into_iter().filter_map(|token| self.remove(token)).collect()
    }

    /// Ends all leases of a dictionary.
    pub fn remove_dictionary(&mut self, dictionary: DictionaryId) {
        let is_own = |held: &&OpenLease| held.key.dictionary == dictionary;
        let tokens: Vec<Token> = self.all.values().filter(is_own).map(|h| h.key.token).collect();
        for token in tokens {
            self.remove(token);
        }
    }

    pub fn of_part(&self, part: PartId) -> impl Iterator<Item = &OpenLease> {
        self.of_parts.get(&part).into_iter().flatten().filter_map(|token| self.all.get(token))
    }

    /// Parts of a job that are leased.
    pub fn parts_of_job(&self, job: JobRef) -> Vec<PartId> {
        self.of_parts.range(PartId::range_of(job)).map(|(part, _)| *part).collect()
    }

    /// Whether a part of a job is leased.
    pub fn is_held(&self, job: JobRef) -> bool {
        self.of_parts.range(PartId::range_of(job)).next().is_some()
    }

    pub fn is_part_held(&self, part: PartId) -> bool {
        self.of_parts.contains_key(&part)
    }

    /// The leased parts of a dictionary.
    pub fn of_dictionary(&self, id: DictionaryId) -> impl Iterator<Item = PartId> {
        let first = PartId { dictionary: id, job: 0, part: 0 };
        self.of_parts.range(first..).map(|(part, _)| *part).take_while(move |part| part.dictionary == id)
    }

    pub fn of_worker(&self, worker: &WorkerId) -> Vec<Token> {
        self.of_workers.get(worker).map(|t| t.iter().copied().collect()).unwrap_or_default()
    }

    pub fn count_of(&self, worker: &WorkerId) -> usize {
        self.of_workers.get(worker).map_or(0, BTreeSet::len)
    }

    pub fn len(&self) -> usize {
        self.all.len()
    }

    pub fn iter(&self) -> impl Iterator<Item = &OpenLease> {
        self.all.values()
    }

    pub fn extend(&mut self, token: Token, deadline: Duration, running: bool) {
        if let Some(held) = self.all.get_mut(&token) {
            self.deadlines.remove(&(held.deadline, token));
            self.deadlines.insert((deadline, token));
            held.deadline = deadline;
            held.running = running;
        }
    }

    /// Leases whose deadline has come.
    pub fn expired(&self, now: Duration) -> Vec<Token> {
        self.deadlines.iter().take_while(|(deadline, _)| *deadline <= now).map(|(_, token)| *token).collect()
    }

    /// Moves all deadlines, and the times of the grants, but not beyond those of a lease that is granted now: some may
    /// have been granted or renewed since the coordinator continued.
    pub fn postpone(&mut self, by: Duration, now: Duration, lease: Duration) {
        for held in self.all.values_mut() {
            held.deadline = (held.deadline + by).min(now + lease);
            held.since = (held.since + by).min(now);
        }
        self.deadlines = self.all.iter().map(|(token, held)| (held.deadline, *token)).collect();
    }
}
