//! Bounds what callers take of the coordinator: each amount counts against the limits of one or several keys.
//!
//! An amount that is held comes back when it is dropped, one that is spent with time. `docs/design/access.md` has the table
//! of all quotas.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;
use tokio::time::Instant;

/// Number of keys from which on those that hold nothing are dropped: there may be as many as there are addresses.
const KEYS: usize = 10_000;
/// The key under which the amounts of all callers count.
const ALL: &str = "all callers";

/// The most that may count under a key, such as the name of a token or an address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Limit {
    key: String,
    most: u64,
}

impl Limit {
    pub fn new(key: impl Into<String>, most: u64) -> Self {
        Self { key: key.into(), most }
    }

    /// A limit of all callers together.
    pub fn all_callers(most: u64) -> Self {
        Self::new(ALL, most)
    }

    /// A limit of all callers together, and one of this caller if it has a name: admins, and callers that need no token,
    /// share only the first.
    pub fn shared(caller: &str, own: u64, all: u64) -> Vec<Self> {
        let own = (!caller.is_empty()).then(|| Self::new(caller, own));
        std::iter::once(Self::all_callers(all)).chain(own).collect()
    }

    /// Checks an amount that is counted elsewhere.
    pub fn check(
        self,
        used: u64,
        more: u64,
        what: &'static str,
        remedy: &'static str,
    ) -> Result<(), Exhausted> {
        let left = self.most.saturating_sub(used);
        if more <= left { Ok(()) } else { Err(Exhausted { limit: self, left, what, remedy }) }
    }
}

/// A limit that does not permit what was asked for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{} {what} are allowed for {}, of which {left} are left: {remedy}", limit.most, limit.key)]
pub struct Exhausted {
    limit: Limit,
    left: u64,
    what: &'static str,
    remedy: &'static str,
}

impl From<Exhausted> for tonic::Status {
    fn from(exhausted: Exhausted) -> Self {
        Self::resource_exhausted(exhausted.to_string())
    }
}

/// The amounts of one kind, by the keys under which they count.
#[derive(Debug)]
pub struct Quota {
    what: &'static str,
    remedy: &'static str,
    /// The part of a spent amount that comes back in a second.
    refill: f64,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    used: HashMap<String, Used>,
    /// Calls that wait, by their turn and their arrival.
    waiting: BTreeMap<(u64, u64), Waiting>,
    turn: u64,
    arrivals: u64,
}

#[derive(Debug)]
struct Used {
    amount: f64,
    at: Instant,
}

#[derive(Debug)]
struct Waiting {
    limits: Vec<Limit>,
    amount: u64,
    granted: oneshot::Sender<Held>,
}

/// An amount that counts until this is dropped.
#[derive(Debug)]
pub struct Held {
    quota: Arc<Quota>,
    limits: Vec<Limit>,
    amount: AtomicU64,
}

impl Quota {
    /// `what` is counted, as in "open streams", and `remedy` is the advice to those who ask for too much.
    pub fn new(what: &'static str, remedy: &'static str) -> Arc<Self> {
        Self::refilled(0.0, what, remedy)
    }

    /// A quota of amounts that are spent, of which `refill` comes back in a second.
    pub fn refilled(refill: f64, what: &'static str, remedy: &'static str) -> Arc<Self> {
        Arc::new(Self { what, remedy, refill, state: Mutex::default() })
    }

    /// Spends an amount.
    pub fn spend(&self, limits: &[Limit], amount: u64) -> Result<(), Exhausted> {
        let mut state = self.lock();
        for limit in limits {
            let left = state.left(limit, self.refill);
            if left < amount as f64 {
                let (limit, left) = (limit.clone(), left as u64);
                return Err(Exhausted { limit, left, what: self.what, remedy: self.remedy });
            }
        }
        state.take(limits, amount, self.refill);
        Ok(())
    }

    /// Holds an amount, if the limits permit it now.
    pub fn hold(self: &Arc<Self>, limits: Vec<Limit>, amount: u64) -> Result<Held, Exhausted> {
        self.spend(&limits, amount)?;
        Ok(self.held(limits, amount))
    }

    /// Holds an amount as soon as the limits permit it. The keys that come last in the limits take turns, however many calls
    /// of each wait, and no later call takes what an earlier one waits for.
    pub async fn wait(self: &Arc<Self>, limits: Vec<Limit>, amount: u64) -> Held {
        let (granted, turn) = oneshot::channel();
        self.lock().enqueue(Waiting { limits, amount, granted });
        self.serve();
        turn.await.expect("a waiting call is removed when it is served, or gone")
    }

    /// Number of calls that wait, the amount of all keys, and the key with the largest amount; None if none waits.
    pub fn shortage(&self) -> Option<(usize, u64, (u64, String))> {
        let mut state = self.lock();
        state.forget_gone();
        let amount = |used: &Used| used.amount as u64;
        let all = state.used.get(ALL).map_or(0, amount);
        let of_keys = state.used.iter().filter(|(key, _)| *key != ALL);
        let most = of_keys.map(|(key, used)| (amount(used), key.clone())).max()?;
        (!state.waiting.is_empty()).then(|| (state.waiting.len(), all, most))
    }

    /// Grants what waiting calls ask for, as far as the limits permit.
    fn serve(self: &Arc<Self>) {
        loop {
            let Some(Waiting { limits, amount, granted }) = self.lock().next(self.refill) else { return };
            // If the call has gone meanwhile, the amount is dropped, and thereby given back.
            drop(granted.send(self.held(limits, amount)));
        }
    }

    fn held(self: &Arc<Self>, limits: Vec<Limit>, amount: u64) -> Held {
        Held { quota: self.clone(), limits, amount: AtomicU64::new(amount) }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Used {
    fn now(&self, refill: f64) -> f64 {
        (self.amount - refill * self.at.elapsed().as_secs_f64()).max(0.0)
    }
}

impl State {
    fn left(&self, limit: &Limit, refill: f64) -> f64 {
        limit.most as f64 - self.used.get(&limit.key).map_or(0.0, |used| used.now(refill))
    }

    fn take(&mut self, limits: &[Limit], amount: u64, refill: f64) {
        if amount == 0 {
            return;
        }
        if self.used.len() >= KEYS {
            self.used.retain(|_, used| used.now(refill) > 0.0);
        }
        for Limit { key, .. } in limits {
            let before = self.used.get(key).map_or(0.0, |used| used.now(refill));
            self.used.insert(key.clone(), Used { amount: before + amount as f64, at: Instant::now() });
        }
    }

    fn give_back(&mut self, limits: &[Limit], amount: u64) {
        for Limit { key, .. } in limits {
            if let Some(used) = self.used.get_mut(key) {
                used.amount -= amount as f64;
                if used.amount <= 0.0 {
                    self.used.remove(key);
                }
            }
        }
    }

    fn enqueue(&mut self, call: Waiting) {
        self.forget_gone();
        let own = call.limits.last().map(|limit| &limit.key);
        let before = self.waiting.values().filter(|other| other.limits.last().map(|l| &l.key) == own).count();
        self.arrivals += 1;
        self.waiting.insert((self.turn + 1 + before as u64, self.arrivals), call);
    }

    /// Removes the next waiting call that is served now, for which the amount is taken.
    fn next(&mut self, refill: f64) -> Option<Waiting> {
        self.forget_gone();
        let mut awaited = HashSet::new();
        let (&place, _) = self.waiting.iter().find(|(_, call)| {
            let is_lacking = |limit: &&Limit| {
                awaited.contains(&limit.key) || self.left(limit, refill) < call.amount as f64
            };
            let lacking: Vec<&String> =
                call.limits.iter().filter(is_lacking).map(|limit| &limit.key).collect();
            let is_served = lacking.is_empty();
            awaited.extend(lacking);
            is_served
        })?;
        let call = self.waiting.remove(&place)?;
        self.turn = place.0;
        self.take(&call.limits, call.amount, refill);
        Some(call)
    }

    fn forget_gone(&mut self) {
        self.waiting.retain(|_, call| !call.granted.is_closed());
    }
}

impl Held {
    /// Holds more; refused if the limits do not permit it.
    pub fn more(&self, amount: u64) -> Result<(), Exhausted> {
        self.quota.spend(&self.limits, amount)?;
        self.amount.fetch_add(amount, Ordering::Relaxed);
        Ok(())
    }

    /// Gives back all that is held.
    pub fn give_back(&self) {
        let amount = self.amount.swap(0, Ordering::Relaxed);
        if amount > 0 {
            self.quota.lock().give_back(&self.limits, amount);
            self.quota.serve();
        }
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.give_back();
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::task::JoinHandle;
    use tokio::time::advance;

    use super::*;

    fn limits(caller: &str, own: u64, all: u64) -> Vec<Limit> {
        vec![Limit::all_callers(all), Limit::new(caller, own)]
    }

    /// Starts a call that waits for an amount, and lets it begin.
    async fn waits(quota: &Arc<Quota>, limits: Vec<Limit>, amount: u64) -> JoinHandle<Held> {
        let quota = quota.clone();
        let task = tokio::spawn(async move { quota.wait(limits, amount).await });
        tokio::task::yield_now().await;
        task
    }

    /// One key leaves the share of others, a refusal gives the numbers and the remedy, and what is dropped comes back.
    #[test]
    fn one_key_leaves_room_for_others() {
        let quota = Quota::new("bytes", "wait");
        let held = |caller, amount| quota.hold(limits(caller, 100, 250), amount);
        let first = held("alice", 60).unwrap();
        let refused = held("alice", 41).unwrap_err().to_string();
        assert_eq!(refused, "100 bytes are allowed for alice, of which 40 are left: wait");
        first.more(40).unwrap();
        assert!(first.more(1).is_err());
        let others = [held("bob", 100).unwrap(), held("carol", 50).unwrap()];
        let refused = held("carol", 1).unwrap_err().to_string();
        assert_eq!(refused, "250 bytes are allowed for all callers, of which 0 are left: wait");
        first.give_back();
        drop((first, held("carol", 50).unwrap(), others));
        assert!(quota.lock().used.is_empty(), "nothing is left of calls that have ended");
    }

    /// Spent amounts come back with time, and keys that have all of it back are dropped.
    #[tokio::test(start_paused = true)]
    async fn spent_amounts_come_back_with_time() {
        let quota = Quota::refilled(2.0, "events", "wait");
        let kept = |key: &str| (0..2000).filter(|_| quota.spend(&[Limit::new(key, 1000)], 1).is_ok()).count();
        assert_eq!((kept("mallory"), kept("alice")), (1000, 1000));
        advance(Duration::from_mins(1)).await;
        assert_eq!(kept("mallory"), 120);
        advance(Duration::from_hours(24)).await;
        assert_eq!(kept("mallory"), 1000);
        (0..KEYS).for_each(|key| quota.spend(&[Limit::new(key.to_string(), 1)], 1).unwrap());
        advance(Duration::from_hours(1)).await;
        quota.spend(&[Limit::new("one more", 1)], 1).unwrap();
        assert_eq!(quota.lock().used.len(), 1);
    }

    /// Keys take turns, however many calls of one of them wait, and calls that are gone are passed over.
    #[tokio::test]
    async fn keys_take_turns_whatever_their_load() {
        let quota = Quota::new("cores", "wait");
        let held = quota.wait(limits("mallory", 1, 1), 1).await;
        let mut of_mallory = Vec::new();
        for _ in 0..20 {
            of_mallory.push(waits(&quota, limits("mallory", 1, 1), 1).await);
        }
        let of_alice = waits(&quota, limits("alice", 1, 1), 1).await;
        of_mallory.remove(1).abort();
        tokio::task::yield_now().await;
        drop(held);
        drop(of_mallory.remove(0).await.unwrap());
        let of_alice = of_alice.await.unwrap();
        assert_eq!(quota.lock().waiting.len(), 18, "hers is the second turn, not the last");
        of_mallory.iter().for_each(JoinHandle::abort);
        tokio::task::yield_now().await;
        drop(of_alice);
        assert!(quota.lock().used.is_empty() && quota.shortage().is_none());
    }

    /// A call that lacks only what its own key may hold delays no other; one that lacks what all share is not overtaken.
    #[tokio::test]
    async fn large_waiting_call_is_not_overtaken() {
        let quota = Quota::new("MiB", "wait");
        let held = [quota.wait(limits("alice", 4, 8), 4).await, quota.wait(limits("bob", 4, 8), 2).await];
        let second = waits(&quota, limits("alice", 4, 8), 1).await;
        let large = waits(&quota, limits("carol", 4, 8), 4).await;
        let small = waits(&quota, limits("dave", 4, 8), 2).await;
        assert_eq!(quota.shortage(), Some((3, 6, (4, "alice".to_owned()))));
        assert!(!second.is_finished() && !large.is_finished() && !small.is_finished());
        let [of_alice, of_bob] = held;
        drop(of_bob);
        let large = large.await.unwrap();
        assert!(!second.is_finished() && !small.is_finished());
        drop((of_alice, large));
        drop((second.await.unwrap(), small.await.unwrap()));
        assert!(quota.lock().used.is_empty());
    }
}
