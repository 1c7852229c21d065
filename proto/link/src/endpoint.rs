//! Checks URLs of coordinators, and adds the token to calls.

use std::net::IpAddr;
use std::time::Duration;

use tonic::codegen::http::header::{AUTHORIZATION, HeaderMap, HeaderValue};
use tonic::transport::Endpoint;

use crate::error::{AccessError, root_cause};
use crate::loopback::Loopback;

const CONNECT: Duration = Duration::from_secs(10);
/// Interval of HTTP/2 pings, which detect links that were cut silently.
const KEEPALIVE: Duration = Duration::from_secs(20);

/// Adds `authorization: Bearer TOKEN` to every call; without a token, nothing.
#[derive(Debug, Clone, Default)]
pub struct Bearer(Option<HeaderValue>);

impl Bearer {
    /// A token that has been checked to consist of visible characters.
    pub(crate) fn of(token: &str) -> Self {
        Self(header(token))
    }

    pub(crate) fn mark(&self, headers: &mut HeaderMap) {
        if let Some(header) = &self.0 {
            headers.insert(AUTHORIZATION, header.clone());
        }
    }
}

fn header(token: &str) -> Option<HeaderValue> {
    let mut header = HeaderValue::try_from(format!("Bearer {token}")).ok()?;
    // Keeps it out of logs, and out of HTTP/2's tables of headers that were sent before.
    header.set_sensitive(true);
    Some(header)
}

/// Protection of a connection to a URL against eavesdropping.
#[derive(Debug, Clone, Copy)]
pub(crate) struct UrlSecurity {
    pub(crate) encrypted: bool,
    pub(crate) loopback: bool,
}

/// The endpoint at a URL, with everything but encryption.
pub(crate) fn checked_endpoint(url: &str) -> Result<(Endpoint, UrlSecurity), AccessError> {
    let wrong = |problem: String| AccessError::Url { url: url.to_owned(), problem };
    // Other schemes, such as `unix:`, mean something to the transport but not to the farm.
    if !["http://", "https://"].iter().any(|scheme| url.starts_with(scheme)) {
        return Err(wrong(
            "must begin with https:// or http://, as in https://farm.example.org:7700".to_owned(),
        ));
    }
    let endpoint = Endpoint::from_shared(url.to_owned())
        .map_err(|error| wrong(format!("is not valid: {}", root_cause(&error))))?;
    let uri = endpoint.uri();
    let Some(host) = uri.host().filter(|host| !host.is_empty()) else {
        return Err(wrong("names no host".to_owned()));
    };
    if !matches!(uri.path(), "" | "/") || uri.query().is_some() {
        return Err(wrong("must end after host and port".to_owned()));
    }
    let security = UrlSecurity { encrypted: url.starts_with("https://"), loopback: is_loopback(host) };
    let endpoint = endpoint
        .connect_timeout(CONNECT)
        .http2_keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE)
        .tcp_nodelay(true);
    Ok((endpoint, security))
}

/// The endpoint at a URL without an access file, and the port if it is one of loopback.
pub(crate) fn bare_endpoint(url: &str) -> Result<(Endpoint, Option<Loopback>), AccessError> {
    let (endpoint, security) = checked_endpoint(url)?;
    if security.encrypted {
        let problem = "is encrypted, which needs an access file (--access FILE or FARM_ACCESS): it holds the \
                       certificate to know the coordinator by, and a token";
        return Err(AccessError::Url { url: url.to_owned(), problem: problem.to_owned() });
    }
    let host = endpoint.uri().host().unwrap_or_default().to_owned();
    let loopback =
        security.loopback.then(|| Loopback { host, port: endpoint.uri().port_u16().unwrap_or(80) });
    Ok((endpoint, loopback))
}

fn is_loopback(host: &str) -> bool {
    let address = host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    host.eq_ignore_ascii_case("localhost") || address.is_ok_and(|ip| ip.to_canonical().is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A token adds a header that is marked sensitive; without a token there is none.
    #[test]
    fn bearer_header_is_sensitive_or_absent() {
        let mut headers = HeaderMap::new();
        Bearer::default().mark(&mut headers);
        assert!(headers.is_empty());
        Bearer::of("0123456789").mark(&mut headers);
        let header = &headers[AUTHORIZATION];
        assert_eq!(header, "Bearer 0123456789");
        assert!(header.is_sensitive());
        assert!(!format!("{:?}", Bearer::of("0123456789")).contains("0123"));
    }

    /// Loopback addresses are recognised by name and by number.
    #[test]
    fn loopback_is_recognised_by_name_and_number() {
        for host in ["localhost", "LOCALHOST", "127.0.0.1", "127.8.9.1", "[::1]", "[::ffff:127.0.0.1]"] {
            assert!(is_loopback(host), "{host}");
        }
        for host in ["localhost.org", "128.0.0.1", "[::]", "0.0.0.0", "127.0.0.1.org"] {
            assert!(!is_loopback(host), "{host}");
        }
    }
}
