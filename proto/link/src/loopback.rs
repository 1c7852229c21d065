//! Connects to a port of loopback without an access file: to the socket of this user's coordinator, or else to the port
//! if it is not another user's.

use std::future::Future;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::pin::Pin;
use std::task::{Context, Poll};

use hyper_util::rt::TokioIo;
use tokio::net::{TcpStream, UnixStream};
use tokio_util::either::Either;
use tonic::codegen::{Service, http::Uri};

use crate::local_socket;

/// The kernel's tables of TCP sockets of this network namespace.
const TABLES: [&str; 2] = ["/proc/net/tcp", "/proc/net/tcp6"];
const LISTENING: &str = "0A";

/// A connection on this machine.
pub(crate) type Stream = Either<UnixStream, TcpStream>;

/// A port of loopback, as a connector for the transport. The address is resolved for every connection.
#[derive(Debug, Clone)]
pub(crate) struct Loopback {
    pub(crate) host: String,
    pub(crate) port: u16,
}

impl Loopback {
    async fn connect(self) -> io::Result<TokioIo<Stream>> {
        if let Some(stream) = local_socket::connect(self.port).await? {
            return Ok(TokioIo::new(Stream::Left(stream)));
        }
        let stream = TcpStream::connect((self.host.trim_matches(['[', ']']), self.port)).await?;
        // A coordinator that has started meanwhile has its socket, since its port listens.
        if let Some(stream) = local_socket::connect(self.port).await? {
            return Ok(TokioIo::new(Stream::Left(stream)));
        }
        check_owner(&stream)?;
        stream.set_nodelay(true)?;
        Ok(TokioIo::new(Stream::Right(stream)))
    }
}

impl Service<Uri> for Loopback {
    type Response = TokioIo<Stream>;
    type Error = io::Error;
    type Future = Pin<Box<dyn Future<Output = io::Result<Self::Response>> + Send>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, _: Uri) -> Self::Future {
        Box::pin(self.clone().connect())
    }
}

/// Refuses a port on which another user listens: every user may take a port that is free. A port of root is accepted,
/// such as a forwarded port of a container; so is a port without a socket here, such as one of another network
/// namespace.
fn check_owner(stream: &TcpStream) -> io::Result<()> {
    let (here, there) = (stream.local_addr()?, stream.peer_addr()?);
    // Listening sockets come first in each table: a socket that is accepted meanwhile is found among the others.
    let tables = TABLES.map(|path| std::fs::read_to_string(path).unwrap_or_default());
    let own = rustix::process::geteuid().as_raw();
    let mut owners = tables.iter().flat_map(|table| owners(table, here, there));
    match owners.find(|owner| *owner != own && *owner != 0) {
        None => Ok(()),
        Some(owner) => Err(io::Error::new(
            io::ErrorKind::PermissionDenied,
            format!(
                "port {} is held by another user of this machine (number {owner}): start your own coordinator on \
                 another port, or use an access file for theirs",
                there.port()
            ),
        )),
    }
}

/// The users whose sockets may be the other end of a connection: the listening sockets of its port, and the accepted one.
fn owners(table: &str, here: SocketAddr, there: SocketAddr) -> impl Iterator<Item = u32> {
    table.lines().skip(1).filter_map(move |line| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let (local, remote) = (address(fields.get(1)?)?, address(fields.get(2)?)?);
        let listens = fields[3] == LISTENING
            && local.port() == there.port()
            && (local.ip().is_unspecified() || same_ip(local, there));
        let is_accepted = same(local, there) && same(remote, here);
        (listens || is_accepted).then(|| fields.get(7)?.parse().ok())?
    })
}

fn same_ip(a: SocketAddr, b: SocketAddr) -> bool {
    a.ip().to_canonical() == b.ip().to_canonical()
}

fn same(a: SocketAddr, b: SocketAddr) -> bool {
    same_ip(a, b) && a.port() == b.port()
}

/// An address as in the tables: words of the machine's byte order in hexadecimal, a colon, the port.
fn address(text: &str) -> Option<SocketAddr> {
    let (ip, port) = text.split_once(':')?;
    let word = |at: usize| u32::from_str_radix(ip.get(at..at + 8)?, 16).ok().map(u32::to_ne_bytes);
    let ip = match ip.len() {
        8 => IpAddr::from(Ipv4Addr::from(word(0)?)),
        32 => {
            let words = [word(0)?, word(8)?, word(16)?, word(24)?];
            IpAddr::from(Ipv6Addr::from(<[u8; 16]>::try_from(words.concat()).ok()?))
        }
        _ => return None,
    };
    Some(SocketAddr::new(ip, u16::from_str_radix(port, 16).ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From /proc/net/tcp6 and tcp of a little-endian machine.
    const LISTENS: &str = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode
   0: 0100007F:1E14 00000000:0000 0A 00000000:00000000 00:00000000 00000000  1000        0 103 1 0 100 0 0 10 0
   1: 0100007F:1E15 00000000:0000 0A 00000000:00000000 00:00000000 00000000  1001        0 104 1 0 100 0 0 10 0
   2: 0100007F:1E14 0100007F:C000 01 00000000:00000000 00:00000000 00000000  1002        0 105 1 0 100 0 0 10 0
   3: 0100007F:1E14 0100007F:C001 01 00000000:00000000 00:00000000 00000000  1003        0 106 1 0 100 0 0 10 0
   4: 0200A8C0:1E14 00000000:0000 0A 00000000:00000000 00:00000000 00000000  1004        0 107 1 0 100 0 0 10 0
";
    const OF_ALL_ADDRESSES: &str = "  sl  local_address                         remote_address                        st
   0: 00000000000000000000000000000000:1E14 00000000000000000000000000000000:0000 0A 0:0 00:0 00000000  1005        0 1
   1: 00000000000000000000000001000000:1E14 00000000000000000000000000000000:0000 0A 0:0 00:0 00000000  1006        0 2
";

    fn found(table: &str, there: &str) -> Vec<u32> {
        owners(table, "127.0.0.1:49152".parse().unwrap(), there.parse().unwrap()).collect()
    }

    /// The sockets of port 7700: those that listen, and the one that has accepted this very connection.
    #[test]
    #[cfg(target_endian = "little")]
    fn owners_of_the_other_end_are_found() {
        assert_eq!(found(LISTENS, "127.0.0.1:7700"), [1000, 1002]);
        assert_eq!(found(OF_ALL_ADDRESSES, "127.0.0.1:7700"), [1005]);
        assert_eq!(found(OF_ALL_ADDRESSES, "[::1]:7700"), [1005, 1006]);
        assert!(found(LISTENS, "127.0.0.1:7702").is_empty() && found("", "127.0.0.1:7700").is_empty());
    }

    /// A port of the same user is accepted.
    #[tokio::test]
    async fn own_port_is_accepted() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let stream = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        check_owner(&stream).unwrap();
        let tables = TABLES.map(|path| std::fs::read_to_string(path).unwrap_or_default());
        let [here, there] = [stream.local_addr().unwrap(), stream.peer_addr().unwrap()];
        let own = rustix::process::geteuid().as_raw();
        assert!(tables.iter().flat_map(|table| owners(table, here, there)).any(|owner| owner == own));
    }
}
