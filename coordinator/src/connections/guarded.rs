//! A connection that ends when the peer is silent for too long, or stays unauthenticated for too long.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep};
use tonic::transport::server::{Connected, TcpConnectInfo};

use super::{Admission, Cuts, Limits, Peer};

/// Length of the greeting (preface) that begins every HTTP/2 connection; that of TLS is longer. A first byte alone
/// would not suffice: it costs nothing to send.
const GREETING_BYTES: usize = 24;
/// Interval at which the admission of a connection is checked.
const LOOK: Duration = Duration::from_secs(1);

/// A connection and its deadlines. An encrypted connection is guarded below TLS.
#[derive(Debug)]
pub struct Guarded<IO> {
    io: IO,
    watch: Watch,
    admission: Admission,
}

#[derive(Debug)]
struct Watch {
    /// Time of the last bytes from the other end, or the start while its greeting is incomplete.
    heard: Instant,
    greeting_left: usize,
    hello: Duration,
    silence: Duration,
    /// The deadline for presenting a token.
    token_deadline: Option<Instant>,
    /// Time of the last check of the admission.
    looked: Instant,
    /// Where the end of the connection is logged, once.
    cuts: Option<Arc<Cuts>>,
    /// Wakes the reader. It may be early, since it is set again only after it has fired: reads are many, deadlines few.
    alarm: Pin<Box<Sleep>>,
}

impl<IO> Guarded<IO> {
    pub(super) fn new(io: IO, limits: Limits, admission: Admission, cuts: Arc<Cuts>) -> Self {
        let Limits { hello, silence, unauthenticated, .. } = limits;
        let alarm = Box::pin(tokio::time::sleep(hello.min(silence).min(LOOK)));
        let heard = Instant::now();
        let token_deadline = unauthenticated.map(|limits| heard + limits.patience);
        let watch = Watch {
            heard,
            greeting_left: GREETING_BYTES,
            hello,
            silence,
            token_deadline,
            looked: heard,
            cuts: Some(cuts),
            alarm,
        };
        Self { io, watch, admission }
    }
}

impl Watch {
    fn hear(&mut self, bytes: usize) {
        self.greeting_left = self.greeting_left.saturating_sub(bytes);
        if bytes > 0 && self.greeting_left == 0 {
            self.heard = Instant::now();
        }
    }

    /// Logs a reason, and returns the error with which the connection ends.
    fn cut(&mut self, why: &'static str) -> io::Error {
        if let Some(cuts) = self.cuts.take() {
            cuts.log(why);
        }
        io::Error::new(io::ErrorKind::TimedOut, why)
    }

    /// The reason why the admission has ended, checked at intervals, since reads are many.
    fn look(&mut self, admission: &Admission) -> Option<io::Error> {
        let now = Instant::now();
        if now < self.looked + LOOK {
            return None;
        }
        self.looked = now;
        admission.is_over(now).map(|why| self.cut(why))
    }

    /// Ready when the other end has been silent for too long, or the admission has ended.
    fn poll_overdue(&mut self, cx: &mut Context<'_>, admission: &Admission) -> Poll<io::Error> {
        let (limit, mut what) = match self.greeting_left {
            0 => (self.silence, "the other end is silent"),
            _ => (self.hello, "the other end does not begin"),
        };
        let mut deadline = self.heard + limit;
        if let Some(end) = self.token_deadline.filter(|end| *end < deadline && !admission.is_admitted()) {
            (deadline, what) = (end, "the other end has shown no token");
        }
        loop {
            if Instant::now() >= deadline {
                return Poll::Ready(self.cut(what));
            }
            if let Some(error) = self.look(admission) {
                return Poll::Ready(error);
            }
            ready!(self.alarm.as_mut().poll(cx));
            self.alarm.as_mut().reset(deadline.min(Instant::now() + LOOK));
        }
    }
}

impl<IO: AsyncRead + Unpin> AsyncRead for Guarded<IO> {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        if let Some(error) = this.watch.look(&this.admission) {
            return Poll::Ready(Err(error));
        }
        let before = buf.filled().len();
        // Received bytes count even if they are read late: the delay was on this side.
        match Pin::new(&mut this.io).poll_read(cx, buf) {
            Poll::Ready(read) => {
                this.watch.hear(buf.filled().len() - before);
                Poll::Ready(read)
            }
            Poll::Pending => this.watch.poll_overdue(cx, &this.admission).map(Err),
        }
    }
}

impl<IO> Guarded<IO> {
    /// Bounds a pending write as `poll_read` bounds a pending read: a peer that reads nothing is overdue, too. While
    /// the answer to a ping is pending, nothing is read, so no bytes extend the deadline either.
    fn or_overdue<T>(&mut self, cx: &mut Context<'_>, polled: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        match polled {
            Poll::Pending => self.watch.poll_overdue(cx, &self.admission).map(Err),
            ready @ Poll::Ready(_) => ready,
        }
    }
}

impl<IO: AsyncWrite + Unpin> AsyncWrite for Guarded<IO> {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        let polled = Pin::new(&mut this.io).poll_write(cx, buf);
        this.or_overdue(cx, polled)
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        let polled = Pin::new(&mut this.io).poll_flush(cx);
        this.or_overdue(cx, polled)
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        let polled = Pin::new(&mut this.io).poll_shutdown(cx);
        this.or_overdue(cx, polled)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        let polled = Pin::new(&mut this.io).poll_write_vectored(cx, bufs);
        this.or_overdue(cx, polled)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }
}

impl<IO: Connected<ConnectInfo = TcpConnectInfo>> Connected for Guarded<IO> {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        Peer { tcp: self.io.connect_info(), admission: self.admission.clone() }
    }
}

#[cfg(test)]
impl Guarded<super::LingeringClose> {
    pub(super) fn nodelay(&self) -> bool {
        self.io.nodelay()
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, DuplexStream};
    use tokio::time::{advance, timeout};

    use super::*;
    use crate::connections::{UnauthenticatedLimits, UnauthenticatedPeers};

    const LIMITS: Limits = Limits {
        connections: 1,
        hello: HELLO,
        silence: SILENCE,
        unauthenticated: Some(UnauthenticatedLimits { connections: 1, patience: PATIENCE }),
    };
    const HELLO: Duration = Duration::from_secs(10);
    const SILENCE: Duration = Duration::from_mins(1);
    const PATIENCE: Duration = Duration::from_secs(30);

    fn pair() -> (Guarded<DuplexStream>, DuplexStream) {
        with_admission(Admission::admitted())
    }

    fn with_admission(admission: Admission) -> (Guarded<DuplexStream>, DuplexStream) {
        let (here, there) = tokio::io::duplex(1024);
        (Guarded::new(here, LIMITS, admission, Cuts::new()), there)
    }

    /// A connection that has sent its greeting, with a token or without.
    async fn greeted(admitted: bool) -> (Guarded<DuplexStream>, DuplexStream) {
        let admission = UnauthenticatedPeers::default().admission([10, 0, 0, 7].into(), 1);
        let (mut guarded, mut there) = with_admission(admission.clone());
        there.write_all(&[0; GREETING_BYTES]).await.unwrap();
        guarded.read_exact(&mut [0; GREETING_BYTES]).await.unwrap();
        if admitted {
            admission.admit();
        }
        (guarded, there)
    }

    /// Sends single bytes, each after a pause, and then keeps the connection.
    fn chatter(mut there: DuplexStream, bytes: usize, pause: Duration) {
        tokio::spawn(async move {
            for _ in 0..bytes {
                tokio::time::sleep(pause).await;
                let _ = there.write_all(b".").await;
            }
            std::future::pending::<()>().await;
        });
    }

    /// The time until a read fails because the connection is overdue.
    async fn overdue_after(guarded: &mut Guarded<DuplexStream>) -> Duration {
        let start = Instant::now();
        let error = loop {
            match timeout(SILENCE * 2, guarded.read(&mut [0; 64])).await.expect("it ends") {
                Ok(bytes) => assert!(bytes > 0),
                Err(error) => break error,
            }
        };
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        start.elapsed()
    }

    fn about(found: Duration, expected: Duration) {
        assert!(found.abs_diff(expected) < Duration::from_millis(10), "{found:?} is not {expected:?}");
    }

    /// A peer that does not send the greeting is overdue after the hello time, also if it sends it byte by byte.
    #[tokio::test(start_paused = true)]
    async fn missing_greeting_is_overdue() {
        for bytes in [0, GREETING_BYTES - 1] {
            let (mut guarded, there) = pair();
            chatter(there, bytes, Duration::from_secs(1));
            about(overdue_after(&mut guarded).await, HELLO);
            about(overdue_after(&mut guarded).await, Duration::ZERO);
        }
    }

    /// After the greeting, silence counts from the last byte that was received.
    #[tokio::test(start_paused = true)]
    async fn silence_counts_from_the_last_byte() {
        let (mut guarded, mut there) = greeted(true).await;
        for _ in 0..5 {
            let quiet = timeout(SILENCE.mul_f64(0.9), guarded.read_u8()).await;
            assert!(quiet.is_err(), "it is not overdue yet");
            there.write_all(&[0]).await.unwrap();
            guarded.read_u8().await.unwrap();
        }
        about(overdue_after(&mut guarded).await, SILENCE);
    }

    /// A connection without a token ends, however much it sends. One with a token stays, unless it does not read an answer.
    #[tokio::test(start_paused = true)]
    async fn connection_without_token_ends() {
        for (admitted, unread, end) in [
            (true, false, Duration::from_secs(40) + SILENCE),
            (false, false, PATIENCE),
            (true, true, PATIENCE + LOOK),
        ] {
            let (mut guarded, there) = greeted(admitted).await;
            let _unread = unread.then(|| guarded.admission.unread(Instant::now() + PATIENCE));
            chatter(there, 20, Duration::from_secs(2));
            let (found, most) = (overdue_after(&mut guarded).await, if unread { LOOK } else { LOOK / 100 });
            assert!(found.abs_diff(end) <= most, "{admitted} {unread}: {found:?} is not {end:?}");
        }
    }

    /// A write to a peer that reads nothing fails when the peer is overdue.
    #[tokio::test(start_paused = true)]
    async fn peer_that_never_reads_is_overdue() {
        for (admitted, expected) in [(true, SILENCE), (false, PATIENCE)] {
            let (mut guarded, _there) = greeted(admitted).await;
            let start = Instant::now();
            let written = timeout(SILENCE * 2, guarded.write_all(&[0; 4096])).await.expect("it ends");
            assert_eq!(written.unwrap_err().kind(), io::ErrorKind::TimedOut);
            about(start.elapsed(), expected);
        }
    }

    /// Bytes that have arrived are read, even if the reader is late.
    #[tokio::test(start_paused = true)]
    async fn waiting_bytes_are_read_after_a_delay() {
        let (mut guarded, mut there) = pair();
        there.write_all(&[7; GREETING_BYTES]).await.unwrap();
        advance(SILENCE * 2).await;
        assert_eq!(guarded.read_u8().await.unwrap(), 7);
    }
}
