//! Memory for results that come in.
//!
//! Room is taken as bytes arrive, so that a result which is only announced, or trickles, holds next to nothing. One
//! machine has a share of it, and one token. Where none is free, a result waits; and so that results which wait for
//! each other do not wait for ever, one at a time goes on without room of its own.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Memory of all results that are being received or stored, in bytes.
const ROOM: usize = 512 << 20;
/// Of that, what the results of one machine may take.
const SHARE: usize = ROOM / 4;
/// What those of one token may take, from however many machines: others deliver, too.
const SHARE_OF_TOKEN: usize = ROOM / 2;
/// What a permit stands for, in bytes.
const GRAIN: usize = 1 << 10;

/// Room in memory for results.
#[derive(Debug)]
pub(super) struct Room {
    bytes: usize,
    share_bytes: usize,
    /// What the results of one token may take, in bytes.
    token_bytes: usize,
    all: Arc<Semaphore>,
    /// For the one result that goes on without.
    express: Arc<Semaphore>,
    shares: Mutex<HashMap<String, Share>>,
    /// By the names of tokens.
    tokens: Mutex<HashMap<String, Weak<Semaphore>>>,
}

/// What the results of one machine may take, while it delivers.
#[derive(Debug)]
struct Share {
    free: Arc<Semaphore>,
    streams: usize,
    waiting: usize,
}

impl Default for Room {
    fn default() -> Self {
        Self::of(ROOM, SHARE, SHARE_OF_TOKEN)
    }
}

impl Room {
    fn of(bytes: usize, share_bytes: usize, token_bytes: usize) -> Self {
        let (all, express) = (Arc::new(Semaphore::new(bytes / GRAIN)), Arc::new(Semaphore::new(1)));
        let (shares, tokens) = (Mutex::default(), Mutex::default());
        Self { bytes, share_bytes, token_bytes, all, express, shares, tokens }
    }

    /// A stream of results of a machine begins, which has shown the token of a name.
    pub fn enter(self: &Arc<Self>, token: &str, machine: String) -> Guest {
        let of_token = self.of_token(token);
        let mut shares = self.shares();
        let new =
            || Share { free: Arc::new(Semaphore::new(self.share_bytes / GRAIN)), streams: 0, waiting: 0 };
        let share = shares.entry(machine.clone()).or_insert_with(new);
        share.streams += 1;
        Guest { room: self.clone(), machine, share: share.free.clone(), of_token }
    }

    /// What the results of a token may take, as long as it delivers.
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

    /// What keeps results waiting, if any wait.
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
pub(super) struct Guest {
    room: Arc<Room>,
    machine: String,
    share: Arc<Semaphore>,
    of_token: Arc<Semaphore>,
}

/// Room that one result has taken, until it is dropped.
#[derive(Debug, Default)]
pub(super) struct Taken {
    permits: Option<Permits>,
    express: Option<OwnedSemaphorePermit>,
}

/// Of a machine's share, of its token's, and of all.
type Permits = [OwnedSemaphorePermit; 3];

impl Taken {
    fn add(&mut self, more: Permits) {
        match &mut self.permits {
            Some(own) => own.iter_mut().zip(more).for_each(|(own, more)| own.merge(more)),
            None => self.permits = Some(more),
        }
    }
}

impl Guest {
    /// Takes room for more bytes of a result, as soon as there is some.
    pub async fn take(&self, taken: &mut Taken, bytes: usize) {
        let grains = bytes.div_ceil(GRAIN) as u32;
        if taken.express.is_some() {
            return;
        }
        let [share, of_token, all] = [&self.share, &self.of_token, &self.room.all];
        let at_once = |semaphore: &Arc<Semaphore>| semaphore.clone().try_acquire_many_owned(grains).ok();
        if let (Some(share), Some(of_token), Some(all)) = (at_once(share), at_once(of_token), at_once(all)) {
            return taken.add([share, of_token, all]);
        }
        let _waiting = Waiting::begin(self);
        let later = async |semaphore: &Arc<Semaphore>| {
            semaphore.clone().acquire_many_owned(grains).await.expect("it is never closed")
        };
        let each = async { [later(share).await, later(of_token).await, later(all).await] };
        tokio::select! {
            permits = each => taken.add(permits),
            express = self.room.express.clone().acquire_owned() => taken.express = express.ok(),
        }
    }

    fn change(&self, change: impl FnOnce(&mut Share)) {
        let mut shares = self.room.shares();
        if let Some(share) = shares.get_mut(&self.machine) {
            change(share);
            if share.streams == 0 {
                shares.remove(&self.machine);
            }
        }
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        self.change(|share| share.streams -= 1);
    }
}

/// A result that waits.
struct Waiting<'a>(&'a Guest);

impl<'a> Waiting<'a> {
    fn begin(guest: &'a Guest) -> Self {
        guest.change(|share| share.waiting += 1);
        Self(guest)
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

    #[tokio::test]
    async fn one_machine_leaves_room_to_the_others() {
        let room = Arc::new(Room::of(8 * MIB, 2 * MIB, 8 * MIB));
        let (greedy, modest) = (room.enter("a", "a@1".to_owned()), room.enter("b", "b@2".to_owned()));
        let mut all_of_it = Taken::default();
        greedy.take(&mut all_of_it, 2 * MIB).await;
        // One more goes on without room of its own, the next one waits.
        let (mut express, mut waits) = (Taken::default(), Taken::default());
        assert!(soon(greedy.take(&mut express, MIB)).await && soon(greedy.take(&mut express, 5 * MIB)).await);
        assert!(!soon(greedy.take(&mut waits, MIB)).await);
        let mut other = Taken::default();
        assert!(soon(modest.take(&mut other, 2 * MIB)).await);
        drop(express);
        assert!(soon(greedy.take(&mut waits, MIB)).await);
    }

    #[tokio::test]
    async fn one_token_from_many_addresses_leaves_room() {
        let room = Arc::new(Room::of(8 * MIB, 2 * MIB, 4 * MIB));
        let guests: Vec<_> = (0..5).map(|i| room.enter("shared", format!("shared@{i}"))).collect();
        let mut taken: Vec<_> = guests.iter().map(|_| Taken::default()).collect();
        guests[0].take(&mut taken[0], 2 * MIB).await;
        guests[1].take(&mut taken[1], 2 * MIB).await;
        // One goes on without room of its own, the next one waits.
        guests[2].take(&mut taken[2], 2 * MIB).await;
        assert!(!soon(guests[3].take(&mut taken[3], MIB)).await);
        let (other, mut of_other) = (room.enter("own", "own@9".to_owned()), Taken::default());
        assert!(soon(other.take(&mut of_other, 2 * MIB)).await);
        drop((guests, other, taken, of_other));
        let last = room.enter("last", "last@1".to_owned());
        assert_eq!(room.tokens.lock().unwrap().keys().collect::<Vec<_>>(), ["last"]);
        drop(last);
    }

    #[tokio::test]
    async fn what_waits_is_told_of_and_goes_on_when_there_is_room() {
        let room = Arc::new(Room::of(4 * MIB, 4 * MIB, 4 * MIB));
        let (first, second) = (
            room.enter("node1", "node1@10.0.0.1".to_owned()),
            room.enter("node2", "node2@10.0.0.2".to_owned()),
        );
        let (mut most, mut express, mut rest) = (Taken::default(), Taken::default(), Taken::default());
        first.take(&mut most, 3 * MIB).await;
        second.take(&mut express, 2 * MIB).await;
        assert_eq!(room.shortage(), None);
        let mut waiting = Box::pin(second.take(&mut rest, 2 * MIB));
        assert!(!soon(waiting.as_mut()).await);
        assert_eq!(
            room.shortage().unwrap(),
            "results wait for room in the coordinator's memory, 1 now: 4 of 4 MiB are taken, 3 of them by node1@10.0.0.1"
        );
        drop(most);
        assert!(soon(waiting.as_mut()).await);
        drop(waiting);
        assert_eq!(room.shortage(), None);
        drop((first, second));
        assert!(room.shares().is_empty());
    }
}
