//! Grants leases and renews them. The order of work is costliest jobs first, then second copies of late parts.

use std::collections::BTreeSet;
use std::time::Duration;

use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::{HeldLease, Lease, LeaseKey};

use super::{Dictionary, OpenLease, Schedule, lease_token};
use crate::dispatch::outbox::{Count, Outbox};
use crate::dispatch::part::{JobRef, PartId, Purpose};
use crate::dispatch::roster::Roster;
use crate::dispatch::{Settings, TokenSource};
use crate::stored::Origin;

/// Most parts that are granted with another because they share its walks, and the most bytes that their records may take.
const MOST_COMPANIONS: usize = 15;
const MOST_BYTES: usize = 32 << 20;
/// Number of leases in a grant from which on no more are added on top.
const MOST_LEASES: usize = 256;

/// The leases that a worker requests.
#[derive(Debug, Clone, Copy)]
pub struct LeaseRequest {
    pub parts: usize,
    /// The worker traces parts that share their walks together.
    pub whole_sets: bool,
}

impl From<usize> for LeaseRequest {
    /// Requests each part by itself.
    fn from(parts: usize) -> Self {
        Self { parts, whole_sets: false }
    }
}

/// The worker that requests leases.
#[derive(Debug, Clone, Copy)]
pub struct Requester<'a> {
    pub worker: &'a WorkerId,
    pub machine: Origin,
    /// All workers, since parts that this machine has failed at go to others first.
    pub roster: &'a Roster,
    /// Jobs that the coordinator computes itself.
    pub disputed: &'a BTreeSet<JobRef>,
}

/// One answer to a request for leases.
struct Round<'a> {
    schedule: &'a mut Schedule,
    now: Duration,
    requester: Requester<'a>,
    tokens: &'a mut dyn TokenSource,
    outbox: &'a mut Outbox,
    leases: Vec<Lease>,
}

impl Schedule {
    /// Grants as many parts as requested: the costliest of the dictionary that is served first, and when nothing waits any
    /// more, second copies of those that take too long. With whole sets, parts that share their walks with a granted one
    /// are added on top of that.
    pub fn grant(
        &mut self,
        now: Duration,
        requester: Requester<'_>,
        request: LeaseRequest,
        tokens: &mut dyn TokenSource,
        outbox: &mut Outbox,
    ) -> Vec<Lease> {
        let mut round = Round { schedule: self, now, requester, tokens, outbox, leases: Vec::new() };
        round.grant_waiting(request);
        let leases = round.leases;
        self.pace.working(now, self.leases.len() > 0);
        outbox.changed |= !leases.is_empty();
        leases
    }

    /// Parts that are to be granted together with a part: they share its walks, and none of them was tried before, so
    /// that none is blamed for another.
    fn companions(&self, part: PartId) -> Vec<PartId> {
        let Some(dictionary) = self.by_id(part.dictionary) else { return Vec::new() };
        let bytes = dictionary.grid().albedo().len() * dictionary.grid().record_bytes();
        let most = MOST_COMPANIONS.min(MOST_BYTES / bytes.max(1));
        let others = dictionary.companions(part.job, part.part).into_iter();
        let own = others.filter(|job| self.computed_by((part.dictionary, *job)).is_none());
        own.map(|job| PartId { job, ..part }).take(most).collect()
    }

    /// Takes a part that takes too long, and that another worker holds.
    fn next_late(&mut self, worker: &WorkerId) -> Option<PartId> {
        let fits = |part: &PartId| {
            let mut holders = self.leases.of_part(*part);
            self.by_id(part.dictionary).is_some_and(Dictionary::is_active)
                && matches!((holders.next(), holders.next()), (Some(held), None) if held.worker != *worker)
        };
        let place = self.late.iter().position(fits)?;
        Some(self.late.swap_remove(place))
    }

    /// Extends a lease; false if it is lost. A lease that is not known (the coordinator was restarted, or it had expired)
    /// is taken up again if its part still waits.
    pub fn renew(&mut self, now: Duration, worker: &WorkerId, holder: &str, lease: &HeldLease) -> bool {
        let HeldLease { key, running, identity } = *lease;
        let deadline = now + self.settings.lease;
        if let Some(held) = self.leases.get(&key) {
            let own = held.worker == *worker;
            if own {
                self.leases.extend(key.token, deadline, running);
            }
            return own;
        }
        if !lease_token::verify(&self.settings.secret, &key, holder) || self.leases.has(key.token) {
            return false;
        }
        let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary) else { return false };
        let wanted = dictionary.job(PartId::from(&key)).is_some()
            && dictionary.is_active()
            && dictionary.spec(key.job, key.part).identity() == identity;
        if !wanted || !dictionary.take(key.job, key.part, key.attempt) {
            return false;
        }
        dictionary.lease_began();
        let worker = worker.clone();
        self.leases.insert(OpenLease { key, worker, purpose: Purpose::Retry, since: now, deadline, running });
        true
    }
}

impl Round<'_> {
    /// Grants parts that wait, and then copies of those that are late.
    fn grant_waiting(&mut self, request: LeaseRequest) {
        // Parts that are added on top do not count.
        let mut companions = 0;
        let order: Vec<DictionaryId> = self.schedule.order().map(|(_, id)| id).collect();
        for id in order {
            // Workers that outlived a restart may hold the costliest of these parts, and may not have renewed their
            // leases yet.
            let returning = self.now < self.schedule.settings.lease && self.schedule.taken_up.contains(&id);
            while self.leases.len() - companions < request.parts
                && let Some(part) = self.schedule.next_part_for(self.now, self.requester, id, returning)
            {
                let with_others = request.whole_sets && self.leases.len() < MOST_LEASES;
                let others = if with_others { self.schedule.companions(part) } else { Vec::new() };
                companions += others.len();
                for part in std::iter::once(part).chain(others) {
                    self.begin(part);
                }
            }
        }
        while self.leases.len() - companions < request.parts
            && let Some(part) = self.schedule.next_late(self.requester.worker)
        {
            self.grant_copy(part);
        }
    }

    /// Grants a part that waits.
    fn begin(&mut self, part: PartId) {
        let Some(dictionary) = self.schedule.dictionaries.get_mut(&part.dictionary) else { return };
        let attempt = dictionary.begin(part.job, part.part);
        let purpose = if dictionary.is_retry(part.job) { Purpose::Retry } else { Purpose::First };
        dictionary.lease_began();
        self.lease(part, attempt, purpose);
    }

    /// Grants a second copy of a part that another worker holds.
    fn grant_copy(&mut self, part: PartId) {
        if let Some(dictionary) = self.schedule.dictionaries.get_mut(&part.dictionary) {
            let attempt = dictionary.attempt(part.job);
            self.lease(part, attempt, Purpose::Copy);
        }
    }

    fn lease(&mut self, part: PartId, attempt: u32, purpose: Purpose) {
        let PartId { dictionary, job, part } = part;
        let Settings { secret, lease, .. } = &self.schedule.settings;
        let Requester { worker, machine, roster, .. } = self.requester;
        let bare = LeaseKey { dictionary, job, attempt, token: Token(0), part };
        let nonce = self.tokens.token().0 as u64;
        let token = lease_token::issue(secret, &bare, nonce, roster.access_token(machine));
        let (key, worker, deadline) = (LeaseKey { token, ..bare }, worker.clone(), self.now + *lease);
        let held = OpenLease { key, worker, purpose, since: self.now, deadline, running: false };
        self.schedule.leases.insert(held);
        self.leases.push(Lease { key, job: self.schedule.dictionaries[&dictionary].spec(job, part) });
        self.outbox.counts.push(Count::Granted(purpose));
    }
}
