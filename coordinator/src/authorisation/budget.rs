//! Bounds the memory that calls hold before and after their work, for each token and in total.
//!
//! A call holds the bytes of its question until it is answered, and those of its answer until they are read. They count
//! for its token, over all connections and calls, or for the address of the other end if no token is needed.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tonic::Status;

/// Ratio of the budget of all calls to that of one token's calls.
const SHARES: usize = 4;

/// The budget of bytes that calls may hold.
#[derive(Debug)]
pub(super) struct Budget {
    share: usize,
    all: usize,
    held: Mutex<HeldBytes>,
}

/// Bytes held by all calls, and by the calls of each token.
#[derive(Debug, Default)]
struct HeldBytes {
    all: usize,
    of: HashMap<String, usize>,
}

impl Budget {
    /// A budget of `share` bytes for the calls of one token, and of `SHARES` times as much for all calls.
    pub fn of(share: usize) -> Self {
        Self { share, all: share.saturating_mul(SHARES), held: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, HeldBytes> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The bytes that one call holds. They are released when the last copy is dropped.
#[derive(Debug, Clone)]
pub(super) struct Account(Arc<Entry>);

#[derive(Debug)]
struct Entry {
    budget: Arc<Budget>,
    caller: String,
    bytes: Mutex<usize>,
}

impl Account {
    pub fn new(budget: Arc<Budget>, caller: String) -> Self {
        Self(Arc::new(Entry { budget, caller, bytes: Mutex::new(0) }))
    }

    /// Reserves more bytes; refused if the budget does not suffice.
    pub fn hold(&self, more: usize) -> Result<(), Status> {
        let Entry { budget, caller, bytes } = &*self.0;
        let mut held = budget.lock();
        let of_caller = held.of.get(caller).copied().unwrap_or_default();
        let left = (budget.share - of_caller).min(budget.all - held.all);
        if more > left {
            return Err(Status::resource_exhausted(format!(
                "the questions and unread answers of this caller ({caller}) would hold {} bytes of the coordinator's \
                 memory, of which {left} are left to it: wait for answers, and read them, before the next call",
                of_caller.saturating_add(more)
            )));
        }
        held.all += more;
        *held.of.entry(caller.clone()).or_default() += more;
        *bytes.lock().unwrap_or_else(PoisonError::into_inner) += more;
        Ok(())
    }

    /// Releases all bytes that the call holds.
    pub fn release(&self) {
        self.0.release();
    }
}

impl Entry {
    fn release(&self) {
        let bytes = std::mem::take(&mut *self.bytes.lock().unwrap_or_else(PoisonError::into_inner));
        if bytes == 0 {
            return;
        }
        let mut held = self.budget.lock();
        held.all -= bytes;
        if let Some(of_caller) = held.of.get_mut(&self.caller) {
            *of_caller -= bytes;
            if *of_caller == 0 {
                held.of.remove(&self.caller);
            }
        }
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        self.release();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One caller leaves part of the budget to others, and gets back its share when a request ends.
    #[test]
    fn one_caller_leaves_room_in_the_budget() {
        let budget = Arc::new(Budget::of(100));
        let account = |caller: &str| Account::new(budget.clone(), caller.to_owned());
        let (first, second, other) = (account("alice"), account("alice"), account("bob"));
        first.hold(60).unwrap();
        let refused = second.hold(41).unwrap_err();
        assert_eq!(refused.code(), tonic::Code::ResourceExhausted);
        for part in ["(alice) would hold 101 bytes", "40 are"] {
            assert!(refused.message().contains(part), "{refused}");
        }
        second.hold(40).unwrap();
        other.hold(100).unwrap();
        first.release();
        second.hold(60).unwrap();
        drop((first, second, other));
        let held = budget.lock();
        assert!(held.all == 0 && held.of.is_empty(), "{held:?}");
    }

    /// All callers together have a limit, but not within the same process.
    #[test]
    fn all_callers_share_a_limit() {
        let budget = Arc::new(Budget::of(100));
        let all: Vec<_> = (0..SHARES).map(|i| Account::new(budget.clone(), i.to_string())).collect();
        for account in &all {
            account.hold(100).unwrap();
        }
        let late = Account::new(budget.clone(), "late".to_owned());
        assert!(late.hold(1).is_err());
        drop(all);
        late.hold(100).unwrap();
        Account::new(Arc::new(Budget::of(usize::MAX)), String::new()).hold(usize::MAX / 2).unwrap();
    }
}
