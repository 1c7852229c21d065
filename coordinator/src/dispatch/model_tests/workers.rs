//! Performs the operations of workers, correct and incorrect ones.

use std::collections::BTreeSet;

use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::{HeldLease, Lease, LeaseKey};
use optics_model::Digest;

use super::world::{Arriving, LEASE, Process, WORKERS, World};
use crate::dispatch::{Admission, Arrived, Dictionary, DispatchError, Purpose, Registration};
use crate::stored::Origin;
use crate::testing::process;

impl World {
    pub fn register(&mut self, worker: usize) {
        self.numbers += 1;
        let (id, origin) = (WorkerId(format!("w{}", self.numbers)), self.processes[worker].origin);
        let Process { instance, machine, .. } = self.processes[worker].clone();
        let about = Registration { instance, ..process(machine, "label") };
        let answer = self.farm.register(self.now, id.clone(), origin, about);
        let fenced = self.store.fenced.contains_key(&origin);
        self.insist(answer.is_err() == fenced, || format!("{origin:?} registers: {answer:?}"));
        if fenced {
            return self.replace(worker, false);
        }
        self.store.met.insert(origin, self.processes[worker].machine.clone());
        let before = std::mem::replace(&mut self.processes[worker].id, id.clone());
        if self.draining.contains(&before) && self.farm.roster.get(&id).is_ok_and(|w| w.draining) {
            self.draining.insert(id.clone());
        }
        self.instances.insert(id.clone(), self.processes[worker].instance.clone());
        self.origins.insert(id, origin);
    }

    /// Handles an answer to a worker; None if the worker has to register again or was refused.
    fn answer<T>(&mut self, worker: usize, answer: Result<T, DispatchError>) -> Option<T> {
        match answer {
            Err(DispatchError::UnknownWorker(_)) => {
                self.register(worker);
                None
            }
            Err(DispatchError::Fenced(_)) => {
                let origin = self.processes[worker].origin;
                self.insist(self.store.fenced.contains_key(&origin), || "fenced off for nothing".to_owned());
                self.register(worker);
                None
            }
            answer => {
                self.forgive(worker);
                answer.ok()
            }
        }
    }

    /// Withdraws the strikes for the silence of a process that has made contact.
    fn forgive(&mut self, worker: usize) {
        let instance = &self.processes[worker].instance;
        for strikes in self.strikes.values_mut() {
            strikes.retain(|(_, silent)| silent.as_ref() != Some(instance));
        }
    }

    pub fn acquire(&mut self, worker: usize, max: usize) {
        let Process { id, origin, .. } = self.processes[worker].clone();
        let paused = self.farm.roster.pause_left(self.now, origin).is_some();
        // The remaining parts of a divided job may be granted if it was under way before the other job.
        let place = |key: &LeaseKey| (key.dictionary, key.job);
        let held = self.farm.schedule.leases().iter();
        let under_way: BTreeSet<_> = held.map(|held| place(&held.key)).collect();
        let disputed: BTreeSet<_> = self.farm.verification.disputes().collect();
        let answer = self.farm.acquire(self.now, &id, max, &mut self.chance);
        let Some(grant) = self.answer(worker, answer) else { return };
        self.insist(grant.leases.len() <= max, || "too many leases".to_owned());
        self.insist(!paused || grant.leases.is_empty(), || format!("{id} is suspended, but got {grant:?}"));
        let drains = self.draining.contains(&id);
        self.insist(grant.drain == drains && (grant.leases.is_empty() || !drains), || {
            format!("{id} drains: {drains}, but got {grant:?}")
        });
        for lease in grant.leases {
            let key = lease.key;
            let purpose = self.farm.schedule.leases().get(&key).expect("it was just given out").purpose;
            let new = self.tokens.insert(key.token);
            self.insist(new, || format!("{key:?} has a token that was used before"));
            let dictionary = self.farm.schedule.by_id(key.dictionary);
            let serves = dictionary.is_some_and(Dictionary::is_active);
            self.insist(serves, || format!("{key:?} is of a dictionary that is not served"));
            if matches!(purpose, Purpose::First | Purpose::Retry) {
                let decided = !disputed.contains(&place(&key));
                self.insist(decided, || format!("{key:?} is disputed and given to a worker"));
                self.check_struck(&key, origin);
                let twice = self.computed_elsewhere(&key).filter(|_| !under_way.contains(&place(&key)));
                self.insist(twice.is_none(), || {
                    format!("{key:?} is given out, and {twice:?} computes the same")
                });
            }
            self.processes[worker].held.push(lease);
        }
    }

    /// Checks that a job at which this machine has failed goes to other machines first, as long as there are any.
    fn check_struck(&mut self, key: &LeaseKey, origin: Origin) {
        let strikes = self.strikes.get(&(key.dictionary, key.job)).cloned().unwrap_or_default();
        let struck = |machine: Origin| strikes.iter().any(|(by, _)| *by == machine);
        let other = self.farm.roster.able(self.now).find(|machine| !struck(*machine));
        self.insist(!struck(origin) || other.is_none(), || {
            format!("{key:?} goes to {origin:?}, which has failed at it, rather than to {other:?}")
        });
    }

    pub fn take_lease(&mut self, worker: usize, lease: usize) -> Option<Lease> {
        let process = &mut self.processes[worker];
        if lease >= process.held.len() {
            return None;
        }
        let lease = process.held.remove(lease);
        process.old.push(lease.clone());
        if process.old.len() > 6 {
            process.old.remove(0);
        }
        Some(lease)
    }

    pub fn renew(&mut self, worker: usize, which: u8, running: u8) {
        let Process { id, held, .. } = self.processes[worker].clone();
        let bit = |bits: u8, i: usize| bits >> (i % 8) & 1 == 1;
        let chosen = held.iter().enumerate().filter(|(i, _)| bit(which, *i));
        let lease = |(i, Lease { key, job }): (usize, &Lease)| HeldLease {
            key: *key,
            running: bit(running, i),
            identity: job.identity(),
        };
        let leases: Vec<HeldLease> = chosen.map(lease).collect();
        let mine = |key: &LeaseKey| self.farm.schedule.leases().get(key).is_some_and(|h| h.worker == id);
        let valid: Vec<_> = leases.iter().map(|l| l.key).filter(mine).collect();
        let answer = self.farm.renew(self.now, &id, leases.clone());
        let Some((lost, _)) = self.answer(worker, answer) else { return };
        for HeldLease { key, running, .. } in leases {
            let is_lost = lost.contains(&key);
            self.insist(!(is_lost && valid.contains(&key)), || format!("{key:?} was valid and is lost"));
            let held = self.farm.schedule.leases().get(&key).filter(|h| h.worker == id);
            let noted = held.is_some_and(|h| h.running == running && h.deadline >= self.now + LEASE);
            self.insist(is_lost || noted, || format!("{key:?} is not lost and not noted"));
        }
        for key in lost {
            if let Some(i) = self.processes[worker].held.iter().position(|l| l.key == key) {
                self.take_lease(worker, i);
            }
        }
    }

    /// Uses forged keys: of another worker's lease, or with a changed token, job, attempt or part.
    pub fn forge(&mut self, worker: usize, lease: usize, how: u8) {
        let other = (worker + 1) % WORKERS;
        let from = if how == 0 { other } else { worker };
        let Some(Lease { mut key, job }) = self.processes[from].held.get(lease).cloned() else { return };
        match how {
            0 => {}
            1 => key.token = Token(key.token.0 ^ 1 << 100),
            2 => key.job += 1,
            3 => key.attempt = u32::MAX,
            _ => key.part += 1,
        }
        let before = self.farm.schedule.leases().get(&key).cloned();
        let in_use = self.is_held(key.token);
        let id = self.processes[worker].id.clone();
        let held = HeldLease { key, running: true, identity: job.identity() };
        let answer = self.farm.renew(self.now, &id, vec![held]);
        if let Some((lost, _)) = self.answer(worker, answer) {
            // After a restart the coordinator may accept another worker's lease, since it has no record of the holder.
            let kept = before.is_some_and(|held| held.worker != id) || in_use || how > 0;
            self.insist(!kept || !lost.is_empty(), || format!("{key:?} was forged and is renewed"));
            if lost.is_empty() {
                self.tokens.insert(key.token);
                self.farm.hand_back(&[key]);
            }
        }
        // The worker may be another process by now.
        let id = self.processes[worker].id.clone();
        let answer = self.farm.admit(self.now, &id, &key, job.identity());
        self.insist(answer.is_err() || how == 0, || format!("{key:?} was forged and its result is taken"));
        self.answer(worker, answer);
        let id = self.processes[worker].id.clone();
        let answer = self.farm.failed(self.now, &id, &key, "sabotage");
        self.insist(answer.is_err(), || format!("{key:?} was forged and has failed"));
        self.answer(worker, answer);
    }

    pub fn is_held(&self, token: Token) -> bool {
        self.farm.schedule.leases().iter().any(|held| held.key.token == token)
    }

    pub fn begin(&mut self, worker: usize, lease: usize) {
        if let Some(lease) = self.take_lease(worker, lease) {
            self.admit(worker, &lease);
        }
    }

    pub fn deliver_old(&mut self, worker: usize, lease: usize) {
        if let Some(lease) = self.processes[worker].old.get(lease).cloned() {
            self.admit(worker, &lease);
            self.end(usize::MAX);
        }
    }

    pub fn deliver_alien(&mut self, worker: usize, lease: usize) {
        if let Some(Lease { key, .. }) = self.take_lease(worker, lease) {
            let id = self.processes[worker].id.clone();
            let answer = self.farm.admit(self.now, &id, &key, Digest::from_bytes([0; 32]));
            self.insist(answer.is_err(), || format!("{key:?} is admitted with another identity"));
            self.answer(worker, answer);
        }
    }

    pub fn admit(&mut self, worker: usize, lease: &Lease) {
        let (id, origin) = (self.processes[worker].id.clone(), self.processes[worker].origin);
        let answer = self.farm.admit(self.now, &id, &lease.key, lease.job.identity());
        let key = lease.key;
        match self.answer(worker, answer) {
            Some(Admission::Store { job, by, .. }) => {
                self.insist(by == origin, || format!("{key:?} came from {origin:?}, not {by:?}"));
                self.arriving.push(Arriving { worker: id, by, key, job });
            }
            Some(Admission::Compare { job, by, stored }) => {
                let digest = self.store.digest(key.dictionary, key.job, &job, &BTreeSet::from([by]));
                let arrived = Arrived { worker: &id, by, key: &key, walks: job.walks(), digest };
                self.farm.compare_with_stored(&arrived, stored);
            }
            Some(Admission::Repeated { .. }) | None => {}
        }
    }

    pub fn fail(&mut self, worker: usize, lease: usize) {
        let Some(Lease { key, .. }) = self.take_lease(worker, lease) else { return };
        let Process { id, origin, .. } = self.processes[worker].clone();
        let held = self.farm.schedule.leases().held_by(&key, &id).is_some();
        let answer = self.farm.failed(self.now, &id, &key, "boom");
        self.insist(answer.is_err() || held, || format!("{key:?} fails and is not held"));
        if self.answer(worker, answer).is_some() {
            self.strike(key.dictionary, key.job, origin, None);
        }
    }

    pub fn strike(&mut self, id: DictionaryId, job: u32, by: Origin, silent: Option<String>) {
        self.strikes.entry((id, job)).or_default().push((by, silent));
    }

    pub fn leave(&mut self, worker: usize) {
        let id = self.processes[worker].id.clone();
        if self.farm.roster.get(&id).is_ok() {
            self.forgive(worker);
        }
        self.farm.leave(&id);
        let left = !self.farm.schedule.leases().iter().any(|held| held.worker == id);
        self.insist(left, || format!("{id} has left and holds leases"));
        self.begin_anew(worker);
    }
}
