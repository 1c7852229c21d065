//! Limits the memory for results that are being received or stored.
//!
//! Memory is reserved as bytes arrive, so a result that is only announced, or trickles, holds next to nothing. Each
//! machine and each access token may reserve a share. A result for which none is left waits. One result at a time may
//! overdraw the budget, so that results cannot wait for each other for ever.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Memory of all results that are being received or stored, in bytes.
const BUDGET: usize = 512 << 20;
/// The part of it that the results of one machine may reserve.
const SHARE: usize = BUDGET / 4;
/// The part that the results of one token may reserve, from any number of machines: others deliver, too.
const SHARE_OF_TOKEN: usize = BUDGET / 2;
/// Bytes of one permit.
const GRAIN: usize = 1 << 10;

/// Memory for results, with its shares.
#[derive(Debug)]
pub(super) struct ResultBudget {
    bytes: usize,
    share_bytes: usize,
    /// The share of one token, in bytes.
    token_bytes: usize,
    all: Arc<Semaphore>,
    /// For the one result that continues without a reservation.
    overdraft: Arc<Semaphore>,
    shares: Mutex<HashMap<String, Share>>,
    /// By the names of tokens.
    tokens: Mutex<HashMap<String, Weak<Semaphore>>>,
}

/// The share of one machine, while it delivers.
#[derive(Debug)]
struct Share {
    free: Arc<Semaphore>,
    streams: usize,
    waiting: usize,
}

impl Default for ResultBudget {
    fn default() -> Self {
        Self::of(BUDGET, SHARE, SHARE_OF_TOKEN)
    }
}

impl ResultBudget {
    fn of(bytes: usize, share_bytes: usize, token_bytes: usize) -> Self {
        let (all, overdraft) = (Arc::new(Semaphore::new(bytes / GRAIN)), Arc::new(Semaphore::new(1)));
        let (shares, tokens) = (Mutex::default(), Mutex::default());
        Self { bytes, share_bytes, token_bytes, all, overdraft, shares, tokens }
    }

    /// Begins a stream of results from a machine that has presented the token of a name.
    pub fn stream(self: &Arc<Self>, token: &str, machine: String) -> ResultStream {
        let of_token = self.of_token(token);
        let mut shares = self.shares();
        let new =
            || Share { free: Arc::new(Semaphore::new(self.share_bytes / GRAIN)), streams: 0, waiting: 0 };
        let share = shares.entry(machine.clone()).or_insert_with(new);
        share.streams += 1;
        ResultStream { budget: self.clone(), machine, share: share.free.clone(), of_token }
    }

    /// The share of a token, while it delivers.
    fn of_token(&self, token: &str) -> Arc<Semaphore> {
        let mut tokens = self.tokens.lock().unwrap_or_else(PoisonError::into_inner);
        tokens.retain(|_, share| share.strong_count() > 0);
        if let Some(share) = tokens.get(token).and_then(Weak::upgrade) {
            return share;
        }
        let share = Arc::new(Semaphore::new(self.token_bytes / GRAIN));
        tokens.insert(token.to_owned(), Arc::downgrade(&share));
        share
    }

    /// The reason why results wait, if any do.
    pub fn shortage(&self) -> Option<String> {
        let shares = self.shares();
        let waiting: usize = shares.values().map(|share| share.waiting).sum();
        let taken = |share: &Share| self.share_bytes - share.free.available_permits() * GRAIN;
        let most = shares.iter().map(|(machine, share)| (taken(share) >> 20, machine)).max()?;
        let (all, of) = ((self.bytes - self.all.available_permits() * GRAIN) >> 20, self.bytes >> 20);
        (waiting > 0).then(|| {
            let (mib, machine) = most;
            format!(
                "results wait for room in the coordinator's memory, {waiting} now: {all} of {of} MiB are taken, {mib} of them \
                 by {machine}"
            )
        })
    }

    fn shares(&self) -> MutexGuard<'_, HashMap<String, Share>> {
        self.shares.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One machine's stream of results.
#[derive(Debug)]
pub(super) struct ResultStream {
    budget: Arc<ResultBudget>,
    machine: String,
    share: Arc<Semaphore>,
    of_token: Arc<Semaphore>,
}

/// The memory reserved for one result, until it is dropped.
#[derive(Debug, Default)]
pub(super) struct Reservation {
    permits: Option<Permits>,
    overdraft: Option<OwnedSemaphorePermit>,
}

/// Permits from a machine's share, from its token's, and from the whole budget.
type Permits = [OwnedSemaphorePermit; 3];

impl Reservation {
    fn add(&mut self, more: Permits) {
        match &mut self.permits {
            Some(own) => own.iter_mut().zip(more).for_each(|(own, more)| own.merge(more)),
            None => self.permits = Some(more),
        }
    }
}

impl ResultStream {
    /// Reserves memory for more bytes of a result, as soon as there is some.
    pub async fn reserve(&self, reservation: &mut Reservation, bytes: usize) {
        let grains = bytes.div_ceil(GRAIN) as u32;
        if reservation.overdraft.is_some() {
            return;
        }
        let [share, of_token, all] = [&self.share, &self.of_token, &self.budget.all];
        let at_once = |semaphore: &Arc<Semaphore>| semaphore.clone().try_acquire_many_owned(grains).ok();
        if let (Some(share), Some(of_token), Some(all)) = (at_once(share), at_once(of_token), at_once(all)) {
            return reservation.add([share, of_token, all]);
        }
        let _waiting = Waiting::begin(self);
        let later = async |semaphore: &Arc<Semaphore>| {
            semaphore.clone().acquire_many_owned(grains).await.expect("it is never closed")
        };
        let each = async { [later(share).await, later(of_token).await, later(all).await] };
        tokio::select! {
            permits = each => reservation.add(permits),
            overdraft = self.budget.overdraft.clone().acquire_owned() => reservation.overdraft = overdraft.ok(),
        }
    }

    fn change(&self, change: impl FnOnce(&mut Share)) {
        let mut shares = self.budget.shares();
        if let Some(share) = shares.get_mut(&self.machine) {
            change(share);
            if share.streams == 0 {
                shares.remove(&self.machine);
            }
        }
    }
}

impl Drop for ResultStream {
    fn drop(&mut self) {
        self.change(|share| share.streams -= 1);
    }
}

/// A result that waits.
struct Waiting<'a>(&'a ResultStream);

impl<'a> Waiting<'a> {
    fn begin(stream: &'a ResultStream) -> Self {
        stream.change(|share| share.waiting += 1);
        Self(stream)
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.change(|share| share.waiting -= 1);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const MIB: usize = 1 << 20;

    async fn soon(future: impl Future<Output = ()>) -> bool {
        tokio::time::timeout(Duration::from_millis(50), future).await.is_ok()
    }

    fn stream(budget: &Arc<ResultBudget>, machine: &str) -> ResultStream {
        budget.stream(machine.split('@').next().unwrap(), machine.to_owned())
    }

    /// Neither one machine nor one token, regardless of the number of its addresses, exhausts the budget for results.
    #[tokio::test(start_paused = true)]
    async fn one_caller_leaves_budget_for_others() {
        for (of_machine, of_token, machines) in [(2, 8, ["a@1"; 3]), (8, 2, ["a@1", "a@2", "a@3"])] {
            let budget = Arc::new(ResultBudget::of(8 * MIB, of_machine * MIB, of_token * MIB));
            let [first, second, third] = machines.map(|machine| stream(&budget, machine));
            let [mut most, mut overdraft, mut waits, mut of_other] = [(); 4].map(|()| Reservation::default());
            first.reserve(&mut most, 2 * MIB).await;
            // One more overdraws the budget, the next one waits.
            assert!(soon(second.reserve(&mut overdraft, MIB)).await);
            assert!(soon(second.reserve(&mut overdraft, 5 * MIB)).await);
            assert!(!soon(third.reserve(&mut waits, MIB)).await, "{machines:?}");
            let other = stream(&budget, "b@4");
            assert!(soon(other.reserve(&mut of_other, 2 * MIB)).await, "{machines:?}");
            drop(overdraft);
            assert!(soon(third.reserve(&mut waits, MIB)).await, "{machines:?}");
            drop((first, second, third, other, most, waits, of_other));
            let _last = stream(&budget, "last@1");
            assert_eq!(budget.tokens.lock().unwrap().keys().collect::<Vec<_>>(), ["last"]);
        }
    }

    /// Results that wait for memory are reported, and continue when memory is free.
    #[tokio::test(start_paused = true)]
    async fn waiting_results_continue_with_free_memory() {
        let budget = Arc::new(ResultBudget::of(4 * MIB, 4 * MIB, 4 * MIB));
        let [first, second] = ["node1@10.0.0.1", "node2@10.0.0.2"].map(|machine| stream(&budget, machine));
        let [mut most, mut overdraft, mut rest] = [(); 3].map(|()| Reservation::default());
        first.reserve(&mut most, 3 * MIB).await;
        second.reserve(&mut overdraft, 2 * MIB).await;
        assert_eq!(budget.shortage(), None);
        let mut waiting = Box::pin(second.reserve(&mut rest, 2 * MIB));
        assert!(!soon(waiting.as_mut()).await);
        assert_eq!(
            budget.shortage().unwrap(),
            "results wait for room in the coordinator's memory, 1 now: 4 of 4 MiB are taken, 3 of them by node1@10.0.0.1"
        );
        drop(most);
        assert!(soon(waiting.as_mut()).await);
        drop(waiting);
        assert_eq!(budget.shortage(), None);
        drop((first, second));
        assert!(budget.shares().is_empty());
    }
}
