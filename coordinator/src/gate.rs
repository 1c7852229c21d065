//! Admits connections and calls by tokens, certificates, or their user on this machine.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use farm_link::{AccessError, CoordinatorAccess, LocalSocket, Role};
use tokio::net::{TcpListener, TcpSocket};
use tonic::transport::ServerTlsConfig;

/// Connections that may wait to be accepted.
const BACKLOG: u32 = 1024;

/// The coordinator's rules of admission.
#[derive(Debug, Clone)]
pub enum Gate {
    /// Every caller that reaches the port may do everything.
    Everybody,
    /// Programs of the user that the coordinator runs as, which connect to its Unix socket. Only on loopback.
    OwnUser,
    /// Callers whose tokens are in an access file, over TLS.
    File(Arc<CoordinatorAccess>),
}

/// The sockets on which a coordinator listens.
#[derive(Debug)]
pub struct Listener {
    pub(crate) port: TcpListener,
    /// The socket for the programs of the coordinator's own user.
    pub(crate) own_user: Option<LocalSocket>,
}

impl From<TcpListener> for Listener {
    fn from(port: TcpListener) -> Self {
        Self { port, own_user: None }
    }
}

impl Listener {
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.port.local_addr()
    }
}

impl Gate {
    /// Listens on an address of loopback, for the programs of this user. The port listens once the socket has its name:
    /// a program that reaches the port finds the socket.
    pub fn own_user(address: SocketAddr) -> io::Result<(Listener, Self)> {
        let port = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
        port.set_reuseaddr(true)?;
        port.bind(address)?;
        let socket = LocalSocket::open(port.local_addr()?.port()).map_err(|error| {
            let what = "making the socket for this user's programs";
            io::Error::new(
                error.kind(),
                format!("{what}: {error} (FARM_SOCKETS names another folder for it)"),
            )
        })?;
        Ok((Listener { port: port.listen(BACKLOG)?, own_user: Some(socket) }, Self::OwnUser))
    }

    pub(crate) fn tls(&self) -> Option<ServerTlsConfig> {
        match self {
            Self::File(access) => Some(access.server_tls()),
            Self::Everybody | Self::OwnUser => None,
        }
    }

    /// Whether a connection may be unauthenticated.
    pub(crate) fn has_unauthenticated_peers(&self) -> bool {
        !matches!(self, Self::Everybody)
    }

    /// The advice to callers that are not admitted.
    pub(crate) fn advice(&self) -> &'static str {
        match self {
            Self::OwnUser => {
                "this coordinator serves its own user's programs on its own machine: for others it needs access files \
                 (farmctl access create, farm-coordinator --access)"
            }
            Self::Everybody | Self::File(_) => "use an access file that is valid (--access FILE)",
        }
    }

    /// Ends when a token is no longer accepted.
    pub(crate) async fn revoked(self, token: blake3::Hash, role: Role) {
        match self {
            Self::File(access) => access.revoked(token, role).await,
            Self::Everybody | Self::OwnUser => std::future::pending().await,
        }
    }

    /// Reads tokens that were added or removed.
    pub(crate) fn look_over(&self) -> Result<(), AccessError> {
        let Self::File(access) = self else { return Ok(()) };
        if access.refresh()? {
            let tokens = access.tokens();
            let names: Vec<&str> = tokens.names().map(|(_, name)| name).collect();
            tracing::info!(tokens = names.join(", "), "the access file has changed: its members now");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpStream;

    use super::*;

    /// A program that reaches the port of a coordinator that is starting finds the socket for its user.
    #[tokio::test]
    async fn socket_precedes_the_listening_port() {
        let (first, _) = Gate::own_user("127.0.0.1:0".parse().unwrap()).unwrap();
        let (address, path) =
            (first.local_addr().unwrap(), first.own_user.as_ref().unwrap().path().to_owned());
        drop(first);
        for _ in 0..20 {
            assert!(!path.exists());
            let path = path.clone();
            let knocking = std::thread::spawn(move || {
                while TcpStream::connect(address).is_err() {}
                path.exists()
            });
            let listener = Gate::own_user(address).unwrap();
            assert!(knocking.join().unwrap());
            drop(listener);
        }
    }
}
