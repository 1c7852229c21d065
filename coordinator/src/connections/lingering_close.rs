//! Closes the write half and drains the read half briefly, so that a TLS alert is not lost to a TCP reset.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _, ReadBuf};
use tokio::net::{TcpStream, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::either::Either;
use tonic::transport::server::{Connected, TcpConnectInfo};

use super::OWN_USER;

/// A connection that has received more than this is past its handshake, and is closed without draining.
const HANDSHAKE_BYTES: usize = 32 << 10;
/// Longest time and most bytes for draining the read half.
const LINGER_TIME: Duration = Duration::from_secs(1);
const MOST_BYTES: u64 = 64 << 10;

/// Connections that are drained at a time. Others are closed at once: a farm that is flooded with failed handshakes needs
/// its places.
const LINGERING: usize = 64;
static LINGER: Semaphore = Semaphore::const_new(LINGERING);

/// A connection by TCP or of the Unix socket.
type Stream = Either<TcpStream, UnixStream>;

/// A connection and its place among those allowed.
///
/// A socket that is closed with unread bytes is reset, and a reset discards what the peer has not read yet. With TLS 1.3 a
/// client sends its first call before it receives the alert that its certificate is missing, so a plain close would mostly
/// lose the alert. Hence a connection that ends during its handshake is shut down for writing and read for a moment.
#[derive(Debug)]
pub struct LingeringClose {
    stream: Option<Stream>,
    received: usize,
    /// Released when the connection ends; draining does not hold it.
    _place: OwnedSemaphorePermit,
}

impl LingeringClose {
    pub(super) fn new(stream: Stream, place: OwnedSemaphorePermit) -> Self {
        Self { stream: Some(stream), received: 0, _place: place }
    }

    fn stream(&mut self) -> Pin<&mut Stream> {
        Pin::new(self.stream.as_mut().expect("it is there until it is dropped"))
    }

    #[cfg(test)]
    pub(super) fn nodelay(&self) -> bool {
        let Some(Either::Left(stream)) = &self.stream else { panic!("it is no TCP connection") };
        stream.nodelay().unwrap()
    }
}

impl Drop for LingeringClose {
    fn drop(&mut self) {
        let in_handshake = (1..HANDSHAKE_BYTES).contains(&self.received);
        let (Some(mut stream), Ok(runtime)) = (self.stream.take(), tokio::runtime::Handle::try_current())
        else {
            return;
        };
        if let Some(lingers) = in_handshake.then(|| LINGER.try_acquire().ok()).flatten() {
            runtime.spawn(async move {
                let drain = async {
                    stream.shutdown().await?;
                    tokio::io::copy(&mut stream.take(MOST_BYTES), &mut tokio::io::sink()).await
                };
                // Errors of the peer do not matter.
                let _ = tokio::time::timeout(LINGER_TIME, drain).await;
                drop(lingers);
            });
        }
    }
}

impl AsyncRead for LingeringClose {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        let before = buf.filled().len();
        let read = this.stream().poll_read(cx, buf);
        this.received = this.received.saturating_add(buf.filled().len() - before);
        read
    }
}

impl AsyncWrite for LingeringClose {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        self.get_mut().stream().poll_write(cx, buf)
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.get_mut().stream().poll_flush(cx)
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.get_mut().stream().poll_shutdown(cx)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.get_mut().stream().poll_write_vectored(cx, bufs)
    }

    fn is_write_vectored(&self) -> bool {
        true
    }
}

impl Connected for LingeringClose {
    type ConnectInfo = TcpConnectInfo;

    fn connect_info(&self) -> TcpConnectInfo {
        match self.stream.as_ref().expect("it is there until it is dropped") {
            Either::Left(stream) => stream.connect_info(),
            Either::Right(_) => TcpConnectInfo { local_addr: None, remote_addr: Some(OWN_USER) },
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tokio::net::TcpListener;
    use tokio::sync::Semaphore;

    use super::*;

    /// A connection that has one of the places, and its other end, which has sent these bytes.
    async fn connection(places: &Arc<Semaphore>, sent: &[u8]) -> (LingeringClose, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let mut there = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        there.write_all(sent).await.unwrap();
        let (stream, _) = listener.accept().await.unwrap();
        let place = places.clone().try_acquire_owned().unwrap();
        let mut here = LingeringClose::new(Either::Left(stream), place);
        here.read_exact(&mut [0; 5]).await.unwrap();
        (here, there)
    }

    /// Places are free at once, whatever the number of connections that end together.
    #[tokio::test]
    async fn draining_holds_no_places() {
        let places = Arc::new(Semaphore::new(2 * LINGERING));
        let (mut ends, mut others) = (Vec::new(), Vec::new());
        for _ in 0..2 * LINGERING {
            let (here, there) = connection(&places, b"no greeting").await;
            ends.push(here);
            others.push(there);
        }
        drop(ends);
        assert_eq!(places.available_permits(), 2 * LINGERING);
    }

    /// The last bytes reach the peer although those that it sent were never read, and the place is released.
    #[tokio::test]
    async fn last_bytes_survive_unread_input() {
        let places = Arc::new(Semaphore::new(1));
        let (mut here, mut there) = connection(&places, &[7; 5000]).await;
        here.write_all(b"no").await.unwrap();
        drop(here);
        let mut said = [0; 2];
        there.read_exact(&mut said).await.unwrap();
        assert_eq!((&said, there.read(&mut [0]).await.unwrap()), (b"no", 0));
        // The second would fail if the first had met a closed socket.
        there.write_all(&[7; 10]).await.unwrap();
        there.write_all(&[7; 10]).await.unwrap();
        drop(there);
        drop(tokio::time::timeout(Duration::from_secs(10), places.acquire()).await.unwrap().unwrap());
    }
}
