//! Connects to a coordinator, with an access file or without.

use tonic::transport::{Channel, Endpoint};

use crate::client::ClientAccess;
use crate::endpoint::{Bearer, bare_endpoint};
use crate::error::AccessError;
use crate::handshake::Handshake;
use crate::link::{Link, was_cut};
use crate::loopback::Loopback;

/// A coordinator that can be connected to.
#[derive(Debug, Clone)]
pub struct Target {
    endpoint: Endpoint,
    /// Set if it is a port of this machine without an access file.
    loopback: Option<Loopback>,
    bearer: Bearer,
    handshake: Option<Handshake>,
    url: String,
}

impl Target {
    /// The coordinator of an access file, or at a URL, or both: then the URL takes precedence, and the file
    /// authenticates the coordinator there. A bare URL is never encrypted, since nothing authenticates the other side;
    /// on loopback it means the user's own coordinator.
    pub fn new(access: Option<&ClientAccess>, url: Option<&str>) -> Result<Self, AccessError> {
        let (endpoint, loopback) = match (access, url) {
            (Some(access), url) => (access.endpoint(url)?, None),
            (None, Some(url)) => bare_endpoint(url)?,
            (None, None) => return Err(AccessError::NoServer),
        };
        let bearer = access.map(ClientAccess::bearer).unwrap_or_default();
        let handshake = access.and_then(|access| access.handshake(&endpoint));
        let url = url.or(access.map(ClientAccess::server)).unwrap_or_default().to_owned();
        Ok(Self { endpoint, loopback, bearer, handshake, url })
    }

    pub fn url(&self) -> &str {
        &self.url
    }

    /// Connects now.
    pub async fn connect(&self) -> Result<Link, tonic::transport::Error> {
        let connected = match self.loopback.clone() {
            Some(loopback) => self.endpoint.connect_with_connector(loopback).await,
            None => self.endpoint.connect().await,
        };
        match connected {
            Ok(channel) => Ok(self.link(channel)),
            // The first call finds out the reason.
            Err(error) if was_cut(&error) => Ok(self.connect_lazy()),
            Err(error) => Err(error),
        }
    }

    /// Connects at the first call. Must be called within a tokio runtime.
    pub fn connect_lazy(&self) -> Link {
        self.link(match self.loopback.clone() {
            Some(loopback) => self.endpoint.connect_with_connector_lazy(loopback),
            None => self.endpoint.connect_lazy(),
        })
    }

    #[cfg(test)]
    pub(crate) fn handshake(&self) -> Option<&Handshake> {
        self.handshake.as_ref()
    }

    fn link(&self, channel: Channel) -> Link {
        Link::new(channel, self.bearer.clone(), self.handshake.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A URL without an access file is accepted without encryption only, and refused if it is not that of a coordinator.
    #[test]
    fn bare_url_is_for_plain_http_only() {
        let target = Target::new(None, Some("http://10.0.0.1:7700")).unwrap();
        assert_eq!(target.url(), "http://10.0.0.1:7700");
        let error = Target::new(None, Some("https://10.0.0.1:7700")).unwrap_err().to_string();
        assert!(error.contains("needs an access file"), "{error}");
        let error = Target::new(None, None).unwrap_err().to_string();
        assert!(error.contains("no server is named"), "{error}");
        for url in
            ["", "farm:7700", "unix:/tmp/farm", "ftp://farm", "http://", "http://farm/path", "http://a b"]
        {
            let error = Target::new(None, Some(url)).unwrap_err().to_string();
            assert!(error.starts_with(&format!("server URL {url:?} ")), "{error}");
        }
    }
}
