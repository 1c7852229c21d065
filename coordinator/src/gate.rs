//! Who is let in.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use farm_link::{CoordinatorAccess, LocalKey, Role, Tokens};
use tokio::net::TcpListener;
use tonic::transport::ServerTlsConfig;

use crate::clock::random_secret;

/// How often the key's file is shown to be in use: those who tidy up by age wait for days.
const KEY_TOUCHED_S: u64 = 3600;

/// Who is let in.
#[derive(Debug, Clone)]
pub enum Gate {
    /// Whoever reaches the port may do everything.
    Everybody,
    /// The programs of the user that the coordinator runs as: they alone can read its key. Only on loopback.
    OwnUser(Arc<LocalKey>),
    /// Those whose tokens are in an access file, over TLS.
    File(Arc<CoordinatorAccess>),
}

impl Gate {
    /// Listens on an address of loopback, for the programs of this user.
    pub async fn own_user(address: SocketAddr) -> io::Result<(TcpListener, Self)> {
        // The key of a port that others may know is there before anybody can be turned away for want of it.
        let early = (address.port() != 0).then(|| publish(address.port()));
        let listener = TcpListener::bind(address).await?;
        let key = match early {
            Some(key) => key,
            None => publish(listener.local_addr()?.port()),
        };
        Ok((listener, Self::OwnUser(Arc::new(key?))))
    }

    pub(crate) fn tls(&self) -> Option<ServerTlsConfig> {
        match self {
            Self::File(access) => Some(access.server_tls()),
            Self::Everybody | Self::OwnUser(_) => None,
        }
    }

    /// The tokens of those who are let in; none if everybody is.
    pub(crate) fn tokens(&self) -> Option<Arc<Tokens>> {
        match self {
            Self::Everybody => None,
            Self::OwnUser(key) => Some(key.tokens()),
            Self::File(access) => Some(access.tokens()),
        }
    }

    /// Whether each worker's token has one vote about results: with one token for all, each machine has.
    pub(crate) fn votes_by_token(&self) -> bool {
        self.tokens().is_some_and(|tokens| tokens.count(Role::Worker) > 1)
    }

    /// What to tell those who are not let in.
    pub(crate) fn advice(&self) -> &'static str {
        match self {
            Self::OwnUser(_) => {
                "this coordinator serves its own user's programs on its own machine: for others it needs access files \
                 (farmctl access create, farm-coordinator --access)"
            }
            Self::Everybody | Self::File(_) => "use an access file that is valid (--access FILE)",
        }
    }

    /// Takes up what has changed: tokens that were added or removed. `seconds` counts the calls, one a second.
    pub(crate) fn look_over(&self, seconds: u64) {
        match self {
            Self::OwnUser(key) if seconds.is_multiple_of(KEY_TOUCHED_S) => key.touch(),
            Self::Everybody | Self::OwnUser(_) => {}
            Self::File(access) => match access.refresh() {
                Ok(false) => {}
                Ok(true) => {
                    let tokens = access.tokens();
                    let names: Vec<&str> = tokens.names().map(|(_, name)| name).collect();
                    tracing::info!(
                        tokens = names.join(", "),
                        "the access file has changed: these are let in now"
                    );
                }
                Err(error) => {
                    tracing::error!(%error, "the access file has changed and cannot be used: nothing is changed");
                }
            },
        }
    }
}

fn publish(port: u16) -> io::Result<LocalKey> {
    LocalKey::publish(port, random_secret().0).map_err(|error| {
        let what = format!(
            "making the key for this user's programs: {error} (FARM_KEYS names another folder for it)"
        );
        io::Error::new(error.kind(), what)
    })
}
