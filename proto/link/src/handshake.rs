//! Makes a separate TLS handshake, to find out why a coordinator ends connections.
//!
//! In TLS 1.3 a client has ended its handshake before the server has checked the client's certificate. By the time the
//! server objects, the client is sending already, and data that is sent to a closed connection makes the system discard
//! the server's alert. A peer that only reads after the handshake receives it.

use std::sync::Arc;
use std::time::Duration;

use rustls::{ClientConfig, RootCertStore};
use rustls_pki_types::pem::PemObject as _;
use rustls_pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio::io::{self, AsyncReadExt as _};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tonic::Status;
use tonic::codegen::http::Uri;

use crate::alert::refusal;

/// Time limit for the coordinator to object.
const PATIENCE: Duration = Duration::from_secs(3);
const HTTPS_PORT: u16 = 443;

/// The credentials that a client presents in a handshake, and the server name that it expects.
#[derive(Debug, Clone)]
pub(crate) struct Handshake {
    host: String,
    port: u16,
    name: ServerName<'static>,
    config: Arc<ClientConfig>,
}

/// The handshake's part of an access file, all in PEM.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Credentials<'a> {
    pub authority: &'a str,
    /// A certificate and its key.
    pub identity: Option<(&'a str, &'a str)>,
    /// The name in the coordinator's certificate, if it is not the host.
    pub server_name: Option<&'a str>,
}

impl Handshake {
    /// A handshake with these credentials; None if they cannot be used.
    pub(crate) fn new(uri: &Uri, credentials: Credentials<'_>) -> Option<Self> {
        let host = uri.host()?.trim_start_matches('[').trim_end_matches(']').to_owned();
        let name = ServerName::try_from(credentials.server_name.unwrap_or(&host)).ok()?.to_owned();
        let port = uri.port_u16().unwrap_or(HTTPS_PORT);
        Some(Self { host, port, name, config: Arc::new(config(credentials)?) })
    }

    /// The reason why the coordinator does not accept the certificate, or its absence; None if it gives no such
    /// reason.
    pub(crate) async fn refusal(&self) -> Option<Status> {
        let ended = tokio::time::timeout(PATIENCE, self.listen()).await;
        ended.ok()?.err().and_then(|error| refusal(&error))
    }

    /// Waits for the first byte of the coordinator, or until it ends the connection.
    async fn listen(&self) -> io::Result<()> {
        let stream = TcpStream::connect((self.host.as_str(), self.port)).await?;
        let mut stream = TlsConnector::from(self.config.clone()).connect(self.name.clone(), stream).await?;
        stream.read_u8().await.map(drop)
    }
}

fn config(Credentials { authority, identity, .. }: Credentials<'_>) -> Option<ClientConfig> {
    let mut roots = RootCertStore::empty();
    roots.add_parsable_certificates(certificates(authority)?);
    let builder = ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()
        .ok()?
        .with_root_certificates(roots);
    let mut config = match identity {
        Some((certificate, key)) => {
            let key = PrivateKeyDer::from_pem_slice(key.as_bytes()).ok()?;
            builder.with_client_auth_cert(certificates(certificate)?, key).ok()?
        }
        None => builder.with_no_client_auth(),
    };
    // The coordinator speaks no other protocol.
    config.alpn_protocols = vec![b"h2".to_vec()];
    Some(config)
}

fn certificates(pem: &str) -> Option<Vec<CertificateDer<'static>>> {
    CertificateDer::pem_slice_iter(pem.as_bytes()).collect::<Result<_, _>>().ok()
}

#[cfg(test)]
mod tests;
