//! Accepts connections within bounds, and cuts those that are silent, unread, or without a token for too long.
//!
//! The number of connections without a token of one address is bounded, and one more cuts the oldest of them: clients with
//! a token present it soon, and idle connections do not lock them out.

mod guarded;

use std::collections::VecDeque;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use farm_link::LocalSocket;
use tokio::net::TcpListener;
use tokio::time::MissedTickBehavior;
use tokio_stream::Stream;
use tokio_util::either::Either;
use tonic::transport::server::TcpConnectInfo;

use crate::clock::Clock;
use crate::gate::Listener;
use crate::throttle::Throttle;

pub use guarded::{Guarded, OpenConnection};

/// Interval at which all connections are looked at.
const LOOK: Duration = Duration::from_secs(1);
/// Pause after an error that others will follow, as when there are no file descriptors left, so that some can be freed.
const PAUSE: Duration = Duration::from_millis(100);
/// Connections that are refused or cut, and errors, are logged at most this often.
const LOG_INTERVAL: Duration = Duration::from_secs(10);

/// The address of programs that connect to the Unix socket.
const OWN_USER: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// Limits of connections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Largest number of connections at a time, at least 1.
    pub connections: usize,
    /// Longest time until a connection has sent its greeting.
    pub hello: Duration,
    /// Longest silence after that. The server's HTTP/2 pings, which every live peer answers, must come more often.
    pub silence: Duration,
    /// Limits of unauthenticated peers; None where no token is needed.
    pub unauthenticated: Option<UnauthenticatedLimits>,
}

/// Limits of connections that have not presented a token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnauthenticatedLimits {
    /// Largest number of such connections of one address.
    pub connections: usize,
    /// Time limit until a token is presented.
    pub patience: Duration,
}

impl Default for UnauthenticatedLimits {
    fn default() -> Self {
        Self { connections: 128, patience: Duration::from_secs(30) }
    }
}

impl Limits {
    pub fn new(connections: usize, unauthenticated: Option<UnauthenticatedLimits>) -> Self {
        Self { connections, hello: Duration::from_secs(10), silence: Duration::from_mins(1), unauthenticated }
    }
}

/// The two ends of a connection, for the calls on it.
#[derive(Debug, Clone)]
pub struct Peer {
    pub tcp: TcpConnectInfo,
    pub connection: Arc<OpenConnection>,
}

/// All open connections, the oldest first.
#[derive(Debug)]
struct OpenConnections {
    limits: Limits,
    connections: Mutex<VecDeque<Arc<OpenConnection>>>,
    refused: AtomicU64,
    clock: Clock,
    refusals: Throttle,
    cuts: Throttle,
    errors: Throttle,
}

/// Numbers of open and refused connections, for metrics.
#[derive(Debug, Clone)]
pub struct Connections(Arc<OpenConnections>);

impl Connections {
    pub fn open(&self) -> usize {
        self.0.lock().len()
    }

    /// Connections refused since the start because all places were taken.
    pub fn refused(&self) -> u64 {
        self.0.refused.load(Ordering::Relaxed)
    }
}

impl OpenConnections {
    fn lock(&self) -> MutexGuard<'_, VecDeque<Arc<OpenConnection>>> {
        self.connections.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a place for a connection; None if there is none. In the system's queue it would wait without an error, and
    /// block the connections behind it.
    fn enter(&self, peer: SocketAddr, is_own_user: bool) -> Option<Arc<OpenConnection>> {
        let address = network(peer.ip());
        let mut all = self.lock();
        if all.len() >= self.limits.connections.max(1) {
            self.refused.fetch_add(1, Ordering::Relaxed);
            if let Some(connections) = self.refusals.count(self.clock.now()) {
                let limit = self.limits.connections;
                tracing::warn!(connections, limit, %peer, "connections have been refused: there are too many");
            }
            return None;
        }
        let unauthenticated = self.limits.unauthenticated.filter(|_| !is_own_user);
        if let Some(limits) = unauthenticated {
            let mut strangers = all.iter().filter(|other| other.is_stranger_of(&address));
            if strangers.clone().count() >= limits.connections
                && let Some(oldest) = strangers.next()
            {
                oldest.cut("others of this address wait, and the other end has shown no token");
            }
        }
        let connection = Arc::new(OpenConnection::new(address, is_own_user, unauthenticated.is_none()));
        all.push_back(connection.clone());
        Some(connection)
    }

    fn leave(&self, connection: &Arc<OpenConnection>) {
        self.lock().retain(|other| !Arc::ptr_eq(other, connection));
        if let Some(why) = connection.reason()
            && let Some(connections) = self.cuts.count(self.clock.now())
        {
            tracing::info!(connections, "connections have been cut, the last one because {why}");
        }
    }

    async fn failed(&self, error: &io::Error) {
        use io::ErrorKind::{ConnectionAborted, ConnectionReset, Interrupted};
        // These concern one connection, which was closed before it was accepted.
        if matches!(error.kind(), ConnectionAborted | ConnectionReset | Interrupted) {
            return;
        }
        if let Some(times) = self.errors.count(self.clock.now()) {
            tracing::error!(%error, times, "accepting connections fails; it is tried again");
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// Cuts overdue connections. Time is counted in looks: while this process is halted, no connection becomes overdue.
async fn look_over(open: Weak<OpenConnections>) {
    let mut tick = tokio::time::interval(LOOK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        let Some(open) = open.upgrade() else { return };
        open.lock().iter().for_each(|connection| connection.look(&open.limits));
    }
}

/// Accepts connections on a port, and those of the coordinator's own user on its socket.
#[derive(Debug)]
pub struct Incoming {
    port: TcpListener,
    own_user: Option<LocalSocket>,
    open: Arc<OpenConnections>,
}

impl Incoming {
    pub fn new(listener: impl Into<Listener>, limits: Limits) -> Self {
        let Listener { port, own_user } = listener.into();
        let [refusals, cuts, errors] = [(); 3].map(|()| Throttle::new(LOG_INTERVAL));
        let (connections, refused) = (Mutex::default(), AtomicU64::new(0));
        let clock = Clock::start();
        let open = Arc::new(OpenConnections { limits, connections, refused, clock, refusals, cuts, errors });
        tokio::spawn(look_over(Arc::downgrade(&open)));
        Self { port, own_user, open }
    }

    pub fn connections(&self) -> Connections {
        Connections(self.open.clone())
    }

    /// The next connection that has a place.
    pub async fn accept(&mut self) -> Guarded {
        loop {
            let accepted = tokio::select! {
                accepted = self.port.accept() => accepted.map(|(stream, peer)| (Either::Left(stream), peer)),
                accepted = accept_own(&mut self.own_user) => accepted.map(|stream| (Either::Right(stream), OWN_USER)),
            };
            match accepted {
                Ok((stream, peer)) => {
                    if let Some(connection) = self.open.enter(peer, matches!(stream, Either::Right(_))) {
                        return Guarded::new(stream, connection, self.open.clone());
                    }
                }
                Err(error) => self.open.failed(&error).await,
            }
        }
    }

    /// The connections one after the other, for `serve_with_incoming_shutdown`. It never ends and never fails.
    pub fn into_stream(self) -> impl Stream<Item = io::Result<Guarded>> {
        futures_util::stream::unfold(self, |mut incoming| async move {
            let next = incoming.accept().await;
            Some((Ok(next), incoming))
        })
    }
}

async fn accept_own(socket: &mut Option<LocalSocket>) -> io::Result<tokio::net::UnixStream> {
    match socket {
        Some(socket) => std::future::poll_fn(|cx| socket.poll_accept(cx)).await,
        None => std::future::pending().await,
    }
}

impl axum::serve::Listener for Incoming {
    type Io = Guarded;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Guarded, SocketAddr) {
        let connection = self.accept().await;
        let address = connection.remote_addr();
        (connection, address)
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.port.local_addr()
    }
}

/// Identifies a machine by its address. An IPv6 address counts by its /64 network, since a machine may use any address
/// in it; loopback addresses count as they are.
pub(crate) fn network(address: IpAddr) -> String {
    match address.to_canonical() {
        IpAddr::V6(address) if !address.is_loopback() => {
            let [a, b, c, d, ..] = address.segments();
            format!("{}/64", Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0))
        }
        address => address.to_string(),
    }
}

#[cfg(test)]
mod tests;
