//! A connection that can be cut: by its age, its silence, or a call on it.

use std::io::{self, IoSlice};
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpStream, UnixStream};
use tokio::task::JoinSet;
use tokio_util::either::Either;
use tokio_util::sync::{CancellationToken, WaitForCancellationFutureOwned};
use tonic::transport::server::{Connected, TcpConnectInfo};

use super::{LOOK, Limits, OWN_USER, OpenConnections, Peer};

/// Length of the greeting (preface) that begins every HTTP/2 connection; that of TLS is longer. A first byte alone
/// would not suffice: it costs nothing to send.
const GREETING_BYTES: usize = 24;
/// Largest number of bytes from a peer without a token: a handshake, and small calls.
const STRANGER_BYTES: usize = 64 << 10;
/// Time for the calls of a connection to report that its token is revoked, before the connection is cut.
const LAST_WORDS: Duration = Duration::from_secs(3);

/// By TCP, or of the Unix socket.
type Stream = Either<TcpStream, UnixStream>;

/// An open connection, as its calls and the others see it.
#[derive(Debug)]
pub struct OpenConnection {
    /// The machine at the other end.
    address: String,
    pub(crate) is_own_user: bool,
    state: Mutex<State>,
    cut: CancellationToken,
}

#[derive(Debug, Default)]
struct State {
    /// Whether a call has presented a token, or none is needed.
    is_admitted: bool,
    /// The token that was presented last, and the task that cuts the connection when it is revoked.
    token: Option<(blake3::Hash, JoinSet<()>)>,
    received: usize,
    /// Number of looks since the beginning, and since the last bytes were received.
    looks: u32,
    quiet: u32,
    /// Why it was cut.
    why: Option<&'static str>,
}

impl OpenConnection {
    pub(crate) fn new(address: String, is_own_user: bool, is_admitted: bool) -> Self {
        let state = Mutex::new(State { is_admitted, ..State::default() });
        Self { address, is_own_user, state, cut: CancellationToken::new() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether it is of this machine, and has not presented a token.
    pub(super) fn is_stranger_of(&self, address: &str) -> bool {
        self.address == address && !self.lock().is_admitted && !self.cut.is_cancelled()
    }

    /// Ends the connection.
    pub(super) fn cut(&self, why: &'static str) {
        self.lock().why.get_or_insert(why);
        self.cut.cancel();
    }

    /// The reason why it was cut; None if it was not.
    pub(crate) fn reason(&self) -> Option<&'static str> {
        self.lock().why
    }

    /// Notes that a call has presented a token. `revoked` ends when the token is no longer accepted.
    pub(crate) fn admit(
        self: &Arc<Self>,
        token: blake3::Hash,
        revoked: impl Future<Output = ()> + Send + 'static,
    ) {
        let mut state = self.lock();
        state.is_admitted = true;
        if state.token.as_ref().is_some_and(|(last, _)| *last == token) {
            return;
        }
        let (mut task, connection) = (JoinSet::new(), Arc::downgrade(self));
        task.spawn(async move {
            revoked.await;
            tokio::time::sleep(LAST_WORDS).await;
            if let Some(connection) = connection.upgrade() {
                connection.cut("the token was revoked");
            }
        });
        state.token = Some((token, task));
    }

    /// Cuts the connection after this time unless the answer is dropped, which is when the answer has been read.
    pub(crate) fn cut_unless_read(self: &Arc<Self>, time: Duration) -> JoinSet<()> {
        let (mut answer, connection) = (JoinSet::new(), self.clone());
        answer.spawn(async move {
            tokio::time::sleep(time).await;
            connection.cut("the other end does not read an answer");
        });
        answer
    }

    /// Counts received bytes; returns whether they are too many.
    fn receives_too_much(&self, bytes: usize) -> bool {
        let state = &mut *self.lock();
        state.received = state.received.saturating_add(bytes);
        if bytes > 0 && state.received >= GREETING_BYTES {
            state.quiet = 0;
        }
        !state.is_admitted && state.received > STRANGER_BYTES
    }

    /// Cuts the connection if it is overdue.
    pub(super) fn look(&self, limits: &Limits) {
        let why = {
            let state = &mut *self.lock();
            // The first interval may have begun just before.
            let [age, silence] = [state.looks, state.quiet].map(|looks| LOOK * looks);
            (state.looks, state.quiet) = (state.looks + 1, state.quiet + 1);
            if state.received < GREETING_BYTES && age >= limits.hello {
                "the other end does not begin"
            } else if silence >= limits.silence {
                "the other end is silent"
            } else if !state.is_admitted
                && limits.unauthenticated.is_some_and(|limits| age >= limits.patience)
            {
                "the other end has shown no token"
            } else {
                return;
            }
        };
        self.cut(why);
    }
}

/// A connection and its place among the open ones. An encrypted connection is guarded below TLS.
#[derive(Debug)]
pub struct Guarded {
    pub(super) stream: Stream,
    pub(super) connection: Arc<OpenConnection>,
    open: Arc<OpenConnections>,
    cut: Pin<Box<WaitForCancellationFutureOwned>>,
}

impl Guarded {
    pub(super) fn new(stream: Stream, connection: Arc<OpenConnection>, open: Arc<OpenConnections>) -> Self {
        if let Either::Left(stream) = &stream
            && let Err(error) = stream.set_nodelay(true)
        {
            // It has most likely been closed already, which its first read will report.
            tracing::debug!(%error, "small messages on a connection may be delayed");
        }
        let cut = Box::pin(connection.cut.clone().cancelled_owned());
        Self { stream, connection, open, cut }
    }

    pub(super) fn remote_addr(&self) -> SocketAddr {
        self.connect_info().tcp.remote_addr.unwrap_or(OWN_USER)
    }

    /// Polls the stream, unless the connection is cut.
    fn uncut<T>(
        &mut self,
        cx: &mut Context<'_>,
        poll: impl FnOnce(Pin<&mut Stream>, &mut Context<'_>) -> Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        if self.cut.as_mut().poll(cx).is_ready() {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        poll(Pin::new(&mut self.stream), cx)
    }
}

impl Drop for Guarded {
    fn drop(&mut self) {
        self.open.leave(&self.connection);
    }
}

impl AsyncRead for Guarded {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        let before = buf.filled().len();
        ready!(this.uncut(cx, |stream, cx| stream.poll_read(cx, buf)))?;
        let bytes = buf.filled().len() - before;
        if this.connection.receives_too_much(bytes) {
            this.connection.cut("the other end sends much, and has shown no token");
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Guarded {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        self.get_mut().uncut(cx, |stream, cx| stream.poll_write(cx, buf))
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.get_mut().uncut(cx, AsyncWrite::poll_flush)
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.get_mut().uncut(cx, AsyncWrite::poll_shutdown)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.get_mut().uncut(cx, |stream, cx| stream.poll_write_vectored(cx, bufs))
    }

    fn is_write_vectored(&self) -> bool {
        true
    }
}

impl Connected for Guarded {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        let tcp = match &self.stream {
            Either::Left(stream) => stream.connect_info(),
            Either::Right(_) => TcpConnectInfo { local_addr: None, remote_addr: Some(OWN_USER) },
        };
        Peer { tcp, connection: self.connection.clone() }
    }
}
