//! Accepts connections within bounds.
//!
//! Excess connections are refused, silent ones time out, and unauthenticated ones must present a token within 30 s. The
//! number of unauthenticated connections of one address is bounded, and one more evicts the oldest of them.

mod admission;
mod guarded;
mod lingering_close;

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use farm_link::LocalSocket;
use tokio::net::{TcpListener, TcpStream, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::Sleep;
use tokio_stream::Stream;
use tokio_util::either::Either;

use crate::clock::Clock;
use crate::gate::Listener;
use crate::throttle::Throttle;

use admission::UnauthenticatedPeers;
pub(crate) use admission::Unread;
pub(crate) use admission::network;
pub use admission::{Admission, Peer};
pub use guarded::Guarded;
pub use lingering_close::LingeringClose;

/// Pause after an error that others will follow, as when there are no file descriptors left, so that some can be freed.
const PAUSE: Duration = Duration::from_millis(100);
/// Connections that are refused or cut, and errors, are logged at most this often.
const LOG_INTERVAL: Duration = Duration::from_secs(10);

/// The address of programs that connect to the Unix socket.
pub(super) const OWN_USER: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

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

/// Numbers of open and refused connections, for metrics.
#[derive(Debug, Clone)]
pub struct Connections {
    counts: Arc<Counts>,
}

#[derive(Debug)]
struct Counts {
    most: usize,
    places: Arc<Semaphore>,
    refused: AtomicU64,
}

impl Connections {
    pub fn open(&self) -> usize {
        self.counts.most - self.counts.places.available_permits()
    }

    /// Connections refused since the start because all places were taken.
    pub fn refused(&self) -> u64 {
        self.counts.refused.load(Ordering::Relaxed)
    }
}

/// The stream of connections, for `serve_with_incoming_shutdown`. It never ends and never fails.
#[derive(Debug)]
pub struct Incoming {
    listener: TcpListener,
    own_user: Option<LocalSocket>,
    limits: Limits,
    counts: Arc<Counts>,
    unauthenticated: UnauthenticatedPeers,
    pause: Option<Pin<Box<Sleep>>>,
    clock: Clock,
    refusals: Throttle,
    cuts: Arc<Cuts>,
    errors: Throttle,
}

/// Logs connections that are cut, at intervals.
#[derive(Debug)]
struct Cuts {
    clock: Clock,
    throttle: Throttle,
}

impl Cuts {
    fn new() -> Arc<Self> {
        Arc::new(Self { clock: Clock::start(), throttle: Throttle::new(LOG_INTERVAL) })
    }

    fn log(&self, why: &str) {
        if let Some(connections) = self.throttle.count(self.clock.now()) {
            tracing::info!(connections, "connections have been cut, the last one because {why}");
        }
    }
}

impl Incoming {
    pub fn new(listener: impl Into<Listener>, limits: Limits) -> Self {
        let Listener { port: listener, own_user } = listener.into();
        let most = limits.connections.clamp(1, Semaphore::MAX_PERMITS);
        let places = Arc::new(Semaphore::new(most));
        let counts = Arc::new(Counts { most, places, refused: AtomicU64::new(0) });
        Self {
            listener,
            own_user,
            limits,
            counts,
            unauthenticated: UnauthenticatedPeers::default(),
            pause: None,
            clock: Clock::start(),
            refusals: Throttle::new(LOG_INTERVAL),
            cuts: Cuts::new(),
            errors: Throttle::new(LOG_INTERVAL),
        }
    }

    pub fn connections(&self) -> Connections {
        Connections { counts: self.counts.clone() }
    }

    /// Takes a place for the connection, or closes it if there is none. In the system's queue it would wait without an
    /// error, and block the connections behind it.
    fn admit(&self, stream: TcpStream, peer: SocketAddr) -> Option<Guarded<LingeringClose>> {
        let place = self.place(peer)?;
        let admission = match self.limits.unauthenticated {
            None => Admission::admitted(),
            Some(limits) => self.unauthenticated.admission(peer.ip(), limits.connections),
        };
        if let Err(error) = stream.set_nodelay(true) {
            // It has most likely been closed already, which its first read will report.
            tracing::debug!(%error, %peer, "small messages on this connection may be delayed");
        }
        Some(self.guarded(Either::Left(stream), place, admission))
    }

    /// As `admit`, for a program of the coordinator's own user.
    fn admit_own(&self, stream: UnixStream) -> Option<Guarded<LingeringClose>> {
        let place = self.place(OWN_USER)?;
        Some(self.guarded(Either::Right(stream), place, Admission::own_user()))
    }

    fn guarded(
        &self,
        stream: Either<TcpStream, UnixStream>,
        place: OwnedSemaphorePermit,
        admission: Admission,
    ) -> Guarded<LingeringClose> {
        Guarded::new(LingeringClose::new(stream, place), self.limits, admission, self.cuts.clone())
    }

    fn place(&self, peer: SocketAddr) -> Option<OwnedSemaphorePermit> {
        let place = self.counts.places.clone().try_acquire_owned().ok();
        if place.is_none() {
            self.refuse(self.counts.most, peer, "there are too many");
        }
        place
    }

    fn refuse(&self, limit: usize, peer: SocketAddr, why: &str) {
        self.counts.refused.fetch_add(1, Ordering::Relaxed);
        if let Some(connections) = self.refusals.count(self.clock.now()) {
            tracing::warn!(connections, limit, %peer, "connections have been refused: {why}");
        }
    }

    fn failed(&mut self, error: &io::Error) {
        use io::ErrorKind::{ConnectionAborted, ConnectionReset, Interrupted};
        // These concern one connection, which was closed before it was accepted.
        if matches!(error.kind(), ConnectionAborted | ConnectionReset | Interrupted) {
            return;
        }
        if let Some(times) = self.errors.count(self.clock.now()) {
            tracing::error!(%error, times, "accepting connections fails; it is tried again");
        }
        self.pause = Some(Box::pin(tokio::time::sleep(PAUSE)));
    }
}

impl Stream for Incoming {
    type Item = io::Result<Guarded<LingeringClose>>;

    fn poll_next(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let this = self.get_mut();
        loop {
            if let Some(pause) = &mut this.pause {
                ready!(pause.as_mut().poll(cx));
                this.pause = None;
            }
            if let Some(Poll::Ready(accepted)) = this.own_user.as_mut().map(|socket| socket.poll_accept(cx)) {
                match accepted.map(|stream| this.admit_own(stream)) {
                    Ok(None) => continue,
                    Ok(Some(connection)) => return Poll::Ready(Some(Ok(connection))),
                    Err(error) => {
                        this.failed(&error);
                        continue;
                    }
                }
            }
            match ready!(this.listener.poll_accept(cx)) {
                Ok((stream, peer)) => {
                    if let Some(connection) = this.admit(stream, peer) {
                        return Poll::Ready(Some(Ok(connection)));
                    }
                }
                Err(error) => this.failed(&error),
            }
        }
    }
}

#[cfg(test)]
mod tests;
