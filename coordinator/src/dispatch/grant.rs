//! Grants leases and renews them. The order of work is checks, costliest jobs first, then second copies of late parts.

use std::time::Duration;

use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::{Lease, LeaseKey};
use optics_model::Digest;

use super::leases::{Held, Leases};
use super::shared::Taker;
use super::{Count, Dictionary, DispatchError, Dispatcher, Grant, PartId, Purpose, TokenSource};

/// Most parts that come with another because they share its walks, and how much their records may take.
const MOST_COMPANIONS: usize = 15;
const MOST_BYTES: usize = 32 << 20;
/// Leases of a grant from which on none come on top.
const MOST_LEASES: usize = 256;

/// What a worker asks for.
#[derive(Debug, Clone, Copy)]
pub struct Wish {
    pub parts: usize,
    /// It traces parts that share their walks together.
    pub whole_sets: bool,
}

impl From<usize> for Wish {
    /// Each part by itself.
    fn from(parts: usize) -> Self {
        Self { parts, whole_sets: false }
    }
}

impl Dispatcher {
    /// Gives out as many parts as are wished: checks first, then the costliest of the dictionary that is served first, and
    /// when nothing waits any more, second copies of those that take too long. With whole sets, those that share their
    /// walks with one that was given out come on top of that.
    pub fn acquire(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        wish: impl Into<Wish>,
        tokens: &mut impl TokenSource,
    ) -> Result<Grant, DispatchError> {
        let Wish { parts: max, whole_sets } = wish.into();
        self.seen(now, worker)?;
        let known = self.workers.get(worker)?;
        let origin = known.origin;
        if known.draining {
            return Ok(Grant { drain: true, ..Grant::default() });
        }
        let mut grant = Grant::default();
        let machines = &self.workers.machines;
        if machines.pause_left(now, origin).is_some() {
            return Ok(grant);
        }
        let trial = machines.is_on_trial(origin);
        if trial && self.workers.ids_of(origin).iter().any(|id| self.leases.count_of(id) > 0) {
            return Ok(grant);
        }
        let max = if trial { 1 } else { max };
        let is_own = |other| machines.share_a_vote(origin, other);
        let checks: Vec<PartId> =
            self.checks.open_to(is_own).filter(|part| self.may_check(*part)).take(max).collect();
        for part in checks {
            self.grant(now, worker, part, Purpose::Check, tokens, &mut grant);
        }
        // Those that come with others do not count.
        let mut companions = 0;
        let order: Vec<DictionaryId> = self.order.iter().map(|(_, id)| *id).collect();
        let mut taker = Taker::new(origin);
        for id in order {
            // Workers that outlived a restart may have the costliest of these in hand, and have not said so yet.
            let returning = now < self.settings.lease && self.taken_up.contains(&id);
            while grant.leases.len() - companions < max
                && let Some(part) = self.next_part_for(now, &mut taker, id, returning)
            {
                let with_others = whole_sets && !trial && grant.leases.len() < MOST_LEASES;
                let others = if with_others { self.companions(part) } else { Vec::new() };
                companions += others.len();
                for part in std::iter::once(part).chain(others) {
                    self.begin(now, worker, part, tokens, &mut grant);
                }
            }
        }
        self.kept_for_others |= taker.kept;
        while grant.leases.len() - companions < max
            && let Some(part) = self.next_late(worker)
        {
            self.grant(now, worker, part, Purpose::Copy, tokens, &mut grant);
        }
        self.pace.working(now, self.leases.len() > 0);
        self.outbox.changed |= !grant.leases.is_empty();
        Ok(grant)
    }

    /// Parts that are to be given out together with one: they share its walks, and nobody has tried any of them before, so
    /// that none is blamed for another.
    fn companions(&self, part: PartId) -> Vec<PartId> {
        let Some(dictionary) = self.dictionaries.get(&part.dictionary) else { return Vec::new() };
        let bytes = dictionary.grid().albedo().len() * dictionary.grid().record_bytes();
        let most = MOST_COMPANIONS.min(MOST_BYTES / bytes.max(1));
        let others = dictionary.companions(part.job, part.part).into_iter();
        let own = others.filter(|job| self.computed_by((part.dictionary, *job)).is_none());
        own.map(|job| PartId { job, ..part }).take(most).collect()
    }

    /// Gives out a part that waits.
    fn begin(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        part: PartId,
        tokens: &mut impl TokenSource,
        grant: &mut Grant,
    ) {
        let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary) else { return };
        let attempt = dictionary.begin(part.job, part.part);
        let purpose = if dictionary.is_retry(part.job) { Purpose::Retry } else { Purpose::First };
        dictionary.leased += 1;
        self.lease(now, worker, part, attempt, purpose, tokens, grant);
    }

    pub(super) fn may_check(&self, part: PartId) -> bool {
        let serves = |d: &Dictionary| d.job(part).is_some() && (d.is_active() || d.is_complete());
        self.dictionaries.get(&part.dictionary).is_some_and(serves)
            && self.leases.of_part(part).all(|held| held.purpose != Purpose::Check)
    }

    /// A part that takes too long, and is not this worker's own.
    fn next_late(&mut self, worker: &WorkerId) -> Option<PartId> {
        let served = |id| self.dictionaries.get(&id).is_some_and(Dictionary::is_active);
        let fits = |leases: &Leases, part: PartId| {
            // A part whose result is only checked any more is not late.
            let mut holders = leases.of_part(part);
            served(part.dictionary)
                && matches!((holders.next(), holders.next()), (Some(held), None) if held.purpose != Purpose::Check && held.worker != *worker)
        };
        let place = self.late.iter().position(|part| fits(&self.leases, *part))?;
        Some(self.late.swap_remove(place))
    }

    /// Gives out a part besides others.
    fn grant(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        part: PartId,
        purpose: Purpose,
        tokens: &mut impl TokenSource,
        grant: &mut Grant,
    ) {
        if let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary) {
            let attempt = dictionary.attempt(part.job);
            self.lease(now, worker, part, attempt, purpose, tokens, grant);
        }
    }

    #[expect(clippy::too_many_arguments, reason = "all of them describe one lease")]
    fn lease(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        id: PartId,
        attempt: u32,
        purpose: Purpose,
        tokens: &mut impl TokenSource,
        grant: &mut Grant,
    ) {
        let PartId { dictionary, job, part } = id;
        let bare = LeaseKey { dictionary, job, attempt, token: Token(0), part };
        let token = self.mac().token(&bare, tokens.token().0 as u64, self.holder(worker));
        let key = LeaseKey { token, ..bare };
        let deadline = now + self.settings.lease;
        let worker = worker.clone();
        self.leases.insert(Held { key, worker, purpose, since: now, deadline, running: false });
        grant.leases.push(Lease { key, job: self.dictionaries[&dictionary].spec(job, part) });
        self.outbox.counts.push(Count::Granted(purpose));
    }

    /// The access token that a worker has shown, by its name.
    pub(super) fn holder(&self, worker: &WorkerId) -> &str {
        self.workers.get(worker).map_or("", |worker| self.workers.machines.token(worker.origin))
    }

    /// Extends leases; tells which are lost, and whether the worker is to leave. A lease that is not known (the
    /// coordinator was restarted, or it had expired) is taken up again if its part still waits.
    pub fn renew(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        leases: Vec<(LeaseKey, bool, Digest)>,
    ) -> Result<(Vec<LeaseKey>, bool), DispatchError> {
        self.seen(now, worker)?;
        let drain = self.workers.get(worker)?.draining;
        let lost = leases
            .into_iter()
            .filter(|(key, running, identity)| !self.extend(now, worker, key, *running, *identity))
            .map(|(key, ..)| key)
            .collect();
        Ok((lost, drain))
    }

    fn extend(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        key: &LeaseKey,
        running: bool,
        identity: Digest,
    ) -> bool {
        let deadline = now + self.settings.lease;
        if let Some(held) = self.leases.get(key) {
            let own = held.worker == *worker;
            if own {
                self.leases.extend(key.token, deadline, running);
            }
            return own;
        }
        if !self.mac().verify(key, self.holder(worker)) {
            return false;
        }
        let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary) else { return false };
        let wanted = !self.leases.has(key.token)
            && dictionary.job(PartId::from(key)).is_some()
            && dictionary.is_active()
            && dictionary.spec(key.job, key.part).identity() == identity;
        if !wanted || !dictionary.take(key.job, key.part, key.attempt) {
            return false;
        }
        dictionary.leased += 1;
        let worker = worker.clone();
        self.leases.insert(Held {
            key: *key,
            worker,
            purpose: Purpose::Retry,
            since: now,
            deadline,
            running,
        });
        true
    }
}
