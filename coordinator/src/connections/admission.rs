//! Limits of a connection until a call on it has presented a token.
//!
//! An unauthenticated peer may call health and reflection. The number of its connections per address, their duration and
//! their concurrent calls are bounded, and one connection more evicts the oldest of its address.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fmt;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::Instant;
use tonic::transport::server::TcpConnectInfo;

/// Largest number of calls without a token, such as for the farm's health, that are under way on a connection at a time.
const OPEN_CALLS: usize = 8;
/// Time for the calls of a connection to report that its token is revoked, before the connection is cut.
const LAST_WORDS: std::time::Duration = std::time::Duration::from_secs(3);

/// Properties of a connection that its calls can read.
#[derive(Debug, Clone)]
pub struct Peer {
    pub tcp: TcpConnectInfo,
    pub admission: Admission,
}

/// The admission of a connection: whether a call on it has presented a token, and whether it may stay.
#[derive(Debug, Clone)]
pub struct Admission {
    /// Its place among the unauthenticated peers of its address, until a call has presented a token.
    unauthenticated: Arc<Mutex<Option<UnauthenticatedPeer>>>,
    open_calls: Arc<Semaphore>,
    is_own_user: bool,
    stay: Arc<Mutex<Stay>>,
}

/// The conditions under which an admitted connection stays.
#[derive(Default)]
struct Stay {
    /// The token that was presented last, and whether it is still accepted.
    let_in: Option<(blake3::Hash, Box<dyn Fn() -> bool + Send + Sync>)>,
    revoked: Option<Instant>,
    /// Times by which the answers on the connection have to be read.
    unread: BTreeMap<u64, Instant>,
    answers: u64,
}

impl fmt::Debug for Stay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stay").field("unread", &self.unread.len()).finish_non_exhaustive()
    }
}

/// An answer that waits to be read, until this is dropped.
#[derive(Debug)]
pub(crate) struct Unread {
    stay: Arc<Mutex<Stay>>,
    number: u64,
}

impl Drop for Unread {
    fn drop(&mut self) {
        lock(&self.stay).unread.remove(&self.number);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Admission {
    fn new(unauthenticated: Option<UnauthenticatedPeer>) -> Self {
        let (unauthenticated, open_calls) =
            (Arc::new(Mutex::new(unauthenticated)), Arc::new(Semaphore::new(OPEN_CALLS)));
        Self { unauthenticated, open_calls, is_own_user: false, stay: Arc::default() }
    }

    /// The admission of a program of the user that the coordinator runs as.
    pub(super) fn own_user() -> Self {
        Self { is_own_user: true, ..Self::new(None) }
    }

    pub(crate) fn is_own_user(&self) -> bool {
        self.is_own_user
    }

    /// The admission of a peer that needs no token.
    pub(crate) fn admitted() -> Self {
        Self::new(None)
    }

    /// Notes that a call has presented a token.
    pub(crate) fn admit(&self) {
        lock(&self.unauthenticated).take();
    }

    /// Notes that a call has presented a token, which is accepted as long as `let_in` returns true.
    pub(crate) fn stays_while(&self, token: blake3::Hash, let_in: impl Fn() -> bool + Send + Sync + 'static) {
        let mut stay = lock(&self.stay);
        if stay.let_in.as_ref().is_none_or(|(last, _)| *last != token) {
            stay.let_in = Some((token, Box::new(let_in)));
        }
    }

    /// Notes an answer that has to be read before `until`.
    pub(crate) fn unread(&self, until: Instant) -> Unread {
        let mut stay = lock(&self.stay);
        stay.answers += 1;
        let number = stay.answers;
        stay.unread.insert(number, until);
        Unread { stay: self.stay.clone(), number }
    }

    /// The reason why the connection ends now; None if it stays.
    pub(crate) fn is_over(&self, now: Instant) -> Option<&'static str> {
        if lock(&self.unauthenticated).as_ref().is_some_and(|peer| peer.evicted.load(Ordering::Relaxed)) {
            return Some("others of this address wait, and the other end has shown no token");
        }
        let stay = &mut *lock(&self.stay);
        if stay.unread.values().any(|until| *until <= now) {
            return Some("the other end does not read an answer");
        }
        if stay.let_in.as_ref().is_none_or(|(_, let_in)| let_in()) {
            stay.revoked = None;
            return None;
        }
        let revoked = *stay.revoked.get_or_insert(now);
        (revoked + LAST_WORDS <= now).then_some("the token was revoked")
    }

    pub(crate) fn is_admitted(&self) -> bool {
        lock(&self.unauthenticated).is_none()
    }

    /// A place for a call that needs no token; none if too many are under way on this connection.
    pub(crate) fn open_call(&self) -> Option<OwnedSemaphorePermit> {
        self.open_calls.clone().try_acquire_owned().ok()
    }
}

/// Connections without a token by address, the oldest first, each with a flag that is set when it loses its place.
#[derive(Debug, Clone, Default)]
pub(super) struct UnauthenticatedPeers(Arc<Mutex<HashMap<String, VecDeque<Arc<AtomicBool>>>>>);

impl UnauthenticatedPeers {
    /// A place among the at most `most` unauthenticated connections of an address. If all are taken, the oldest is
    /// evicted: clients with a token present it soon, and idle connections do not lock them out.
    pub fn admission(&self, address: IpAddr, most: usize) -> Admission {
        let (address, evicted) = (network(address), Arc::new(AtomicBool::new(false)));
        let mut of_all = self.lock();
        let of_address = of_all.entry(address.clone()).or_default();
        if of_address.len() >= most
            && let Some(oldest) = of_address.pop_front()
        {
            oldest.store(true, Ordering::Relaxed);
        }
        of_address.push_back(evicted.clone());
        Admission::new(Some(UnauthenticatedPeer { address, evicted, peers: self.clone() }))
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, VecDeque<Arc<AtomicBool>>>> {
        lock(&self.0)
    }
}

/// One connection among the unauthenticated ones of its address, until it is dropped.
#[derive(Debug)]
struct UnauthenticatedPeer {
    address: String,
    /// Whether another connection has taken its place.
    evicted: Arc<AtomicBool>,
    peers: UnauthenticatedPeers,
}

impl Drop for UnauthenticatedPeer {
    fn drop(&mut self) {
        let mut of_all = self.peers.lock();
        if let Some(of_address) = of_all.get_mut(&self.address) {
            of_address.retain(|other| !Arc::ptr_eq(other, &self.evicted));
            if of_address.is_empty() {
                of_all.remove(&self.address);
            }
        }
    }
}

/// Identifies a machine by its address. An IPv6 address counts by its /64 network, since a machine may use any address
/// in it; loopback addresses count as they are.
pub(crate) fn network(address: IpAddr) -> String {
    match address.to_canonical() {
        IpAddr::V6(address) if !address.is_loopback() => {
            let [a, b, c, d, ..] = address.segments();
            format!("{}/64", std::net::Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0))
        }
        address => address.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beyond the limit, the oldest unauthenticated connection of the same address is evicted.
    #[test]
    fn oldest_unauthenticated_peer_is_evicted() {
        let peers = UnauthenticatedPeers::default();
        let [here, there]: [IpAddr; 2] = ["10.0.0.7", "10.0.0.8"].map(|a| a.parse().unwrap());
        let is_over = |admission: &Admission| admission.is_over(Instant::now()).is_some();
        let first = peers.admission(here, 2);
        let second = peers.admission(here, 2);
        assert!(!first.is_admitted());
        first.clone().admit();
        let [third, elsewhere] = [peers.admission(here, 2), peers.admission(there, 2)];
        assert!(first.is_admitted() && ![&second, &third, &elsewhere].into_iter().any(is_over));
        let fourth = peers.admission(here, 2);
        assert_eq!([&first, &second, &third, &fourth].map(is_over), [false, true, false, false]);
        drop((second, third));
        let fifth = peers.admission(here, 2);
        assert!(!is_over(&fourth) && !is_over(&fifth));
        drop((fourth, fifth, elsewhere));
        assert!(peers.lock().is_empty(), "nothing is left of closed connections");
    }

    /// A connection ends shortly after its token is revoked.
    #[tokio::test(start_paused = true)]
    async fn revoked_token_ends_its_connection_soon() {
        let (admission, now) = (Admission::admitted(), Instant::now());
        let let_in = Arc::new(std::sync::atomic::AtomicBool::new(true));
        let is_let_in = let_in.clone();
        admission.stays_while(blake3::hash(b"token"), move || {
            is_let_in.load(std::sync::atomic::Ordering::Relaxed)
        });
        assert_eq!(admission.is_over(now + LAST_WORDS), None);
        let_in.store(false, std::sync::atomic::Ordering::Relaxed);
        assert_eq!(admission.is_over(now), None, "its calls hear why");
        assert!(admission.is_over(now + LAST_WORDS).is_some());
    }
}
