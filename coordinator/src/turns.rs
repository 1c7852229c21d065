//! Assigns cores to fits: callers take turns, however many fits of each wait.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;
use tonic::Status;

/// Largest number of fits that wait for a core, in addition to those that have one.
const WAITING: usize = 256;
/// Largest number of waiting fits of one client's token.
const WAITING_OF_ONE: usize = 64;

/// The cores, and the queues of callers that wait for them.
#[derive(Debug)]
pub(crate) struct Turns {
    cores: usize,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    busy: usize,
    waiting: usize,
    callers: HashMap<String, Caller>,
    /// Callers whose fits wait, the next first.
    next: VecDeque<String>,
}

#[derive(Debug, Default)]
struct Caller {
    busy: usize,
    waiting: VecDeque<oneshot::Sender<Core>>,
}

/// A core for a fit, until it is dropped.
#[derive(Debug)]
pub(crate) struct Core {
    turns: Arc<Turns>,
    caller: String,
}

impl Turns {
    pub(crate) fn new(cores: usize) -> Self {
        Self { cores, state: Mutex::default() }
    }

    /// Waits for a core, in this caller's turn. A caller with a name never has all cores, if there are several.
    pub(crate) async fn core(self: &Arc<Self>, caller: &str) -> Result<Core, Status> {
        let turn = self.enqueue(caller)?;
        self.give();
        turn.await.map_err(|_| Status::unavailable("the coordinator is stopping"))
    }

    fn enqueue(&self, name: &str) -> Result<oneshot::Receiver<Core>, Status> {
        let state = &mut *self.lock();
        state.forget_those_gone();
        let of_one = state.callers.get(name).map_or(0, |caller| caller.waiting.len());
        if !name.is_empty() && of_one >= WAITING_OF_ONE {
            let why = format!("{WAITING_OF_ONE} fits of this token ({name}) wait already: try again later");
            return Err(Status::resource_exhausted(why));
        }
        if state.waiting >= WAITING {
            let why = format!("{WAITING} fits wait already: try again later");
            return Err(Status::resource_exhausted(why));
        }
        let (sender, receiver) = oneshot::channel();
        state.callers.entry(name.to_owned()).or_default().waiting.push_back(sender);
        state.waiting += 1;
        if of_one == 0 {
            state.next.push_back(name.to_owned());
        }
        Ok(receiver)
    }

    /// Gives out the cores that are free.
    fn give(self: &Arc<Self>) {
        while let Some((turn, caller)) = self.next() {
            // If the caller has gone, the core is dropped and thereby returned at once.
            drop(turn.send(Core { turns: self.clone(), caller }));
        }
    }

    /// The next fit that gets a core, which is counted as busy.
    fn next(&self) -> Option<(oneshot::Sender<Core>, String)> {
        let most_of_one = self.cores.saturating_sub(1).max(1);
        let state = &mut *self.lock();
        if state.busy >= self.cores {
            return None;
        }
        let may = |name: &String| name.is_empty() || state.callers[name].busy < most_of_one;
        let index = state.next.iter().position(may)?;
        let name = state.next.remove(index)?;
        let caller = state.callers.get_mut(&name)?;
        let turn = caller.waiting.pop_front()?;
        caller.busy += 1;
        state.busy += 1;
        state.waiting -= 1;
        if !caller.waiting.is_empty() {
            state.next.push_back(name.clone());
        }
        Some((turn, name))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Removes waiting fits whose callers have gone.
    fn forget_those_gone(&mut self) {
        let Self { waiting, callers, next, .. } = self;
        for caller in callers.values_mut() {
            caller.waiting.retain(|turn| !turn.is_closed());
        }
        *waiting = callers.values().map(|caller| caller.waiting.len()).sum();
        next.retain(|name| !callers[name].waiting.is_empty());
        callers.retain(|_, caller| caller.busy > 0 || !caller.waiting.is_empty());
    }
}

impl Drop for Core {
    fn drop(&mut self) {
        {
            let state = &mut *self.turns.lock();
            state.busy -= 1;
            if let Some(caller) = state.callers.get_mut(&self.caller) {
                caller.busy -= 1;
            }
            state.forget_those_gone();
        }
        self.turns.give();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Starts a fit, and returns once it waits.
    async fn waits(turns: &Arc<Turns>, caller: &str) -> tokio::task::JoinHandle<Result<Core, Status>> {
        let (before, own, caller) = (turns.lock().waiting, turns.clone(), caller.to_owned());
        let task = tokio::spawn(async move { own.core(&caller).await });
        while turns.lock().waiting == before {
            tokio::task::yield_now().await;
        }
        task
    }

    /// Callers take turns, regardless of how many fits of one of them wait.
    #[tokio::test]
    async fn callers_take_turns_whatever_their_load() {
        let turns = Arc::new(Turns::new(1));
        let core = turns.core("mallory").await.unwrap();
        let mut of_mallory = Vec::new();
        for _ in 0..20 {
            of_mallory.push(waits(&turns, "mallory").await);
        }
        let of_alice = waits(&turns, "alice").await;
        drop(core);
        drop(of_mallory.remove(0).await.unwrap().unwrap());
        assert_eq!(of_alice.await.unwrap().unwrap().caller, "alice", "hers is the second turn, not the last");
    }

    /// The fits of one token leave a core free for the fits of others.
    #[tokio::test]
    async fn one_token_leaves_a_core_for_others() {
        let turns = Arc::new(Turns::new(2));
        let of_alice = turns.core("alice").await.unwrap();
        let second = waits(&turns, "alice").await;
        let of_bob = turns.core("bob").await.unwrap();
        assert!(!second.is_finished(), "she has her share");
        drop(of_alice);
        let of_alice = second.await.unwrap().unwrap();
        drop((of_alice, of_bob));
        let admins = [turns.core("").await.unwrap(), turns.core("").await.unwrap()];
        drop(admins);
        let state = turns.lock();
        assert!(state.busy == 0 && state.callers.is_empty() && state.next.is_empty(), "{state:?}");
    }

    /// A token may have a limited number of waiting fits; places are returned when a fit ends.
    #[tokio::test]
    async fn waiting_places_are_shared_and_returned() {
        let turns = Arc::new(Turns::new(1));
        let core = turns.core("alice").await.unwrap();
        let mut waiting = Vec::new();
        for _ in 0..WAITING_OF_ONE {
            waiting.push(waits(&turns, "alice").await);
        }
        let refused = turns.core("alice").await.unwrap_err();
        assert_eq!(refused.message(), "64 fits of this token (alice) wait already: try again later");
        let of_bob = waits(&turns, "bob").await;
        waiting.iter().for_each(tokio::task::JoinHandle::abort);
        for gone in waiting {
            assert!(gone.await.is_err());
        }
        drop(core);
        assert_eq!(of_bob.await.unwrap().unwrap().caller, "bob");
        assert_eq!(turns.lock().waiting, 0);
    }
}
