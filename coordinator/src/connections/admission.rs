//! What a connection may take as long as nobody on it has shown a token.
//!
//! Strangers may ask for the farm's health and for its interface. Nothing else is theirs: of one address only so many
//! connections are open at a time, each for so long and with so many calls, until one of them shows a token.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tonic::transport::server::TcpConnectInfo;

/// Open calls of a connection, such as for the farm's health, that are under way at a time.
const OPEN_CALLS: usize = 8;

/// What the calls on a connection know of it.
#[derive(Debug, Clone)]
pub struct Peer {
    pub tcp: TcpConnectInfo,
    pub admission: Admission,
}

/// Whether somebody on a connection has shown a token.
#[derive(Debug, Clone)]
pub struct Admission {
    /// Its place among the strangers of its address, until then.
    stranger: Arc<Mutex<Option<Stranger>>>,
    open_calls: Arc<Semaphore>,
}

impl Admission {
    fn new(stranger: Option<Stranger>) -> Self {
        Self { stranger: Arc::new(Mutex::new(stranger)), open_calls: Arc::new(Semaphore::new(OPEN_CALLS)) }
    }

    /// One who needs none.
    pub(crate) fn admitted() -> Self {
        Self::new(None)
    }

    /// A call has shown a token.
    pub(crate) fn admit(&self) {
        self.lock().take();
    }

    pub(crate) fn is_admitted(&self) -> bool {
        self.lock().is_none()
    }

    /// A place for a call that needs no token; none if too many are under way on this connection.
    pub(crate) fn open_call(&self) -> Option<OwnedSemaphorePermit> {
        self.open_calls.clone().try_acquire_owned().ok()
    }

    fn lock(&self) -> MutexGuard<'_, Option<Stranger>> {
        self.stranger.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Connections without a token, by address.
#[derive(Debug, Clone, Default)]
pub(super) struct Strangers(Arc<Mutex<HashMap<String, usize>>>);

impl Strangers {
    /// A place among the connections of an address without a token, of which there may be so many.
    pub fn admission(&self, address: IpAddr, most: usize) -> Option<Admission> {
        let address = network(address);
        let mut counts = self.lock();
        let count = counts.entry(address.clone()).or_default();
        if *count >= most {
            return None;
        }
        *count += 1;
        Some(Admission::new(Some(Stranger { address, strangers: self.clone() })))
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, usize>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One connection among the strangers of its address, until it is dropped.
#[derive(Debug)]
struct Stranger {
    address: String,
    strangers: Strangers,
}

impl Drop for Stranger {
    fn drop(&mut self) {
        let mut counts = self.strangers.lock();
        if let Some(count) = counts.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.address);
            }
        }
    }
}

/// What counts as one machine, as far as its address tells: a network of IPv6 does, since a machine has as many addresses
/// there as it likes.
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

    #[test]
    fn an_address_has_so_many_strangers_and_each_that_is_admitted_or_gone_makes_room() {
        let strangers = Strangers::default();
        let [here, there]: [IpAddr; 2] = ["10.0.0.7", "10.0.0.8"].map(|a| a.parse().unwrap());
        let first = strangers.admission(here, 2).unwrap();
        let second = strangers.admission(here, 2).unwrap();
        assert!(strangers.admission(here, 2).is_none() && strangers.admission(there, 2).is_some());
        assert!(!first.is_admitted());
        first.clone().admit();
        assert!(first.is_admitted() && !second.is_admitted());
        let third = strangers.admission(here, 2).unwrap();
        assert!(strangers.admission(here, 2).is_none());
        drop(second);
        assert!(strangers.admission(here, 2).is_some());
        drop(third);
        assert!(strangers.lock().is_empty(), "nothing is left of those who have gone");
    }

    #[test]
    fn a_connection_has_so_many_open_calls() {
        let admission = Admission::admitted();
        let calls: Vec<_> = (0..OPEN_CALLS).map(|_| admission.open_call().unwrap()).collect();
        assert!(admission.open_call().is_none());
        drop(calls);
        assert!(admission.open_call().is_some());
    }
}
