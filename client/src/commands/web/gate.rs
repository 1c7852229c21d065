//! Authenticates requests to the page: they must come from the page itself and carry its token.
//!
//! Other users of the machine can reach a port on loopback, and so can every web site in the user's browser. Therefore
//! the printed address contains a token, which is exchanged for a cookie; and requests are accepted only for the page's
//! own host (no name that a site has pointed at 127.0.0.1) and from pages of the same origin. Browsers send cookies to
//! every port of a host, and another port may belong to another user: therefore the cookie is limited to an unguessable
//! folder, which contains the whole page.

use std::net::SocketAddr;

use axum::extract::Request;
use axum::http::header::{COOKIE, HOST, ORIGIN};
use axum::http::uri::PathAndQuery;
use axum::http::{HeaderMap, Method, StatusCode, Uri};
use subtle::ConstantTimeEq;

use super::behind::Url;

/// Bytes of randomness in a token, and in the name of the page's folder.
const TOKEN: usize = 24;
const FOLDER: usize = 9;
const COOKIE_NAME: &str = "farm";

/// The reason why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RequestRefusal {
    Host,
    Origin,
    Token,
}

impl RequestRefusal {
    pub fn status(self) -> StatusCode {
        match self {
            Self::Host => StatusCode::MISDIRECTED_REQUEST,
            Self::Origin => StatusCode::FORBIDDEN,
            Self::Token => StatusCode::UNAUTHORIZED,
        }
    }

    pub fn reason(self) -> &'static str {
        match self {
            Self::Host => {
                "This page is served for another host or port than those of the address in this browser. Behind a proxy or \
                 ssh -L, name that address with --behind, as in `farmctl web --behind http://localhost:9000/`."
            }
            Self::Origin => "This request comes from another site.",
            Self::Token => "Open the address that `farmctl web` has printed: it lets this browser in.",
        }
    }
}

#[derive(Debug)]
pub(super) struct PageGate {
    token: String,
    /// The folder that contains the page: begins and ends with a slash.
    folder: String,
    /// Allowed hosts of requests, with their ports.
    hosts: Vec<String>,
    /// Allowed origins of requests.
    origins: Vec<String>,
    /// Path prefix of the addresses that receive the cookie.
    path: String,
    /// Whether the cookie is sent over TLS only.
    secure: bool,
}

impl PageGate {
    pub fn new(address: SocketAddr, behind: Option<&Url>) -> Result<Self, getrandom::Error> {
        let mut random = [0; TOKEN + FOLDER];
        getrandom::fill(&mut random)?;
        let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let (token, folder) = random.split_at(TOKEN);
        Ok(Self::with_token(hex(token), &hex(folder), address, behind))
    }

    fn with_token(token: String, folder: &str, address: SocketAddr, behind: Option<&Url>) -> Self {
        let port = address.port();
        let names = ["127.0.0.1", "localhost", "[::1]"];
        let mut hosts: Vec<String> = names.iter().map(|host| format!("{host}:{port}")).collect();
        if !address.ip().is_unspecified() {
            hosts.push(address.to_string());
        }
        // Browsers omit the default port.
        if port == 80 {
            hosts.extend(names.map(str::to_owned));
        }
        let mut origins: Vec<String> = hosts.iter().map(|host| format!("http://{host}")).collect();
        let folder = format!("/{folder}/");
        let mut path = folder.clone();
        if let Some(url) = behind {
            hosts.push(url.authority.clone());
            origins.push(url.origin());
            path = format!("{}{}", url.path, &folder[1..]);
        }
        let secure = behind.is_some_and(|url| url.scheme == "https");
        Self { token, folder, hosts, origins, path, secure }
    }

    /// Path and query of the address that authenticates a browser.
    pub fn entrance(&self) -> String {
        format!("{}?token={}", self.path, self.token)
    }

    /// An address relative to the page's folder; `None` outside it.
    pub fn within(&self, uri: &Uri) -> Option<Uri> {
        let below = uri.path_and_query()?.as_str().strip_prefix(&self.folder)?;
        Some(format!("/{below}").parse::<PathAndQuery>().ok()?.into())
    }

    /// Checks that a request comes from the page and carries the cookie.
    pub fn admit(&self, request: &Request) -> Result<(), RequestRefusal> {
        self.is_for_us(request)?;
        let cookies = request.headers().get_all(COOKIE).iter().filter_map(|v| v.to_str().ok());
        let mut cookies = cookies.flat_map(|v| v.split(';')).filter_map(|v| v.trim().split_once('='));
        let known = cookies.any(|(name, value)| name == COOKIE_NAME && self.is_token(value));
        if known { Ok(()) } else { Err(RequestRefusal::Token) }
    }

    /// The cookie for a request with the token.
    pub fn let_in(&self, request: &Request) -> Result<String, RequestRefusal> {
        self.is_for_us(request)?;
        if !self.is_token(token_of(request.uri()).unwrap_or_default()) {
            return Err(RequestRefusal::Token);
        }
        let secure = if self.secure { "; Secure" } else { "" };
        // SameSite=Lax suffices: links from other sites open the page and change nothing; all changes come from the
        // page.
        Ok(format!("{COOKIE_NAME}={}; Path={}; HttpOnly; SameSite=Lax{secure}", self.token, self.path))
    }

    fn is_for_us(&self, request: &Request) -> Result<(), RequestRefusal> {
        let headers = request.headers();
        if !one_of(headers, HOST.as_str(), &self.hosts).unwrap_or(false) {
            return Err(RequestRefusal::Host);
        }
        // Browsers send the origin with all requests that could change something.
        let harmless = matches!(*request.method(), Method::GET | Method::HEAD);
        if !one_of(headers, ORIGIN.as_str(), &self.origins).unwrap_or(harmless) {
            return Err(RequestRefusal::Origin);
        }
        Ok(())
    }

    fn is_token(&self, given: &str) -> bool {
        given.as_bytes().ct_eq(self.token.as_bytes()).into()
    }
}

/// Whether a header has one of these values; `None` if it is absent.
fn one_of(headers: &HeaderMap, name: &str, allowed: &[String]) -> Option<bool> {
    let mut values = headers.get_all(name).iter().peekable();
    values.peek()?;
    Some(values.all(|value| {
        value.to_str().is_ok_and(|value| allowed.iter().any(|one| one.eq_ignore_ascii_case(value)))
    }))
}

/// The token in `?token=…`.
pub(super) fn token_of(uri: &Uri) -> Option<&str> {
    uri.query()?.split('&').find_map(|pair| pair.strip_prefix("token="))
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn gate(behind: Option<&str>) -> PageGate {
        let behind = behind.map(|url| url.parse().unwrap());
        PageGate::with_token("secret".to_owned(), "folder", ([127, 0, 0, 1], 7780).into(), behind.as_ref())
    }

    fn request(method: &str, uri: &str, headers: &[(&str, &str)]) -> Request {
        let request = Request::builder().method(method).uri(uri);
        headers.iter().fold(request, |r, (name, value)| r.header(*name, *value)).body(Body::empty()).unwrap()
    }

    const OWN: (&str, &str) = ("host", "127.0.0.1:7780");
    const COOKIE: (&str, &str) = ("cookie", "a=b; farm=secret");

    #[test]
    fn token_is_exchanged_for_a_cookie() {
        let gate = gate(None);
        let cookie = gate.let_in(&request("GET", "/?token=secret", &[OWN])).unwrap();
        assert_eq!(cookie, "farm=secret; Path=/folder/; HttpOnly; SameSite=Lax");
        for uri in ["/?token=wrong", "/?token=", "/", "/?token=secre", "/?tokens=secret"] {
            assert_eq!(gate.let_in(&request("GET", uri, &[OWN])), Err(RequestRefusal::Token), "{uri}");
        }
        gate.admit(&request("GET", "/page.js", &[OWN, COOKIE])).unwrap();
        for cookie in ["", "farm=wrong", "farms=secret", "farm"] {
            let refused = gate.admit(&request("GET", "/", &[OWN, ("cookie", cookie)]));
            assert_eq!(refused, Err(RequestRefusal::Token), "{cookie}");
        }
    }

    /// The page is served below its secret folder only.
    #[test]
    fn page_is_below_an_unguessable_folder() {
        let within = |uri: &str| gate(None).within(&uri.parse().unwrap()).map(|uri| uri.to_string());
        assert_eq!(within("/folder/").unwrap(), "/");
        assert_eq!(within("/folder/?token=secret").unwrap(), "/?token=secret");
        assert_eq!(within("/folder/page.js").unwrap(), "/page.js");
        assert_eq!(within("/folder//page.js").unwrap(), "//page.js");
        for outside in ["/", "/folder", "/folders/", "/page.js", "//folder/", "/Folder/", "*"] {
            assert_eq!(within(outside), None, "{outside}");
        }
        assert_eq!(gate(None).entrance(), "/folder/?token=secret");
        assert_eq!(gate(Some("https://farm/resins")).entrance(), "/resins/folder/?token=secret");
        let (one, other) = ([127, 0, 0, 1], 7780);
        let new = || PageGate::new((one, other).into(), None).unwrap().entrance();
        assert_ne!(new(), new());
    }

    fn call(headers: &[(&str, &str)]) -> Request {
        request("POST", "/farm.v1.Farm/Status", &[&[COOKIE], headers].concat())
    }

    /// Calls are accepted from the page's own origin only. Browsers send it with every call; sites may have pointed a name
    /// at this machine.
    #[test]
    fn only_the_page_itself_may_call() {
        const ORIGIN: (&str, &str) = ("origin", "http://127.0.0.1:7780");
        let post = |headers: &[(&str, &str)]| gate(None).admit(&call(headers));
        post(&[OWN, ORIGIN]).unwrap();
        post(&[("host", "LOCALHOST:7780"), ("origin", "http://localhost:7780")]).unwrap();
        assert_eq!(post(&[OWN]), Err(RequestRefusal::Origin));
        for origin in ["http://evil.example", "https://127.0.0.1:7780", "http://127.0.0.1:7781", "null"] {
            assert_eq!(post(&[OWN, ("origin", origin)]), Err(RequestRefusal::Origin), "{origin}");
        }
        for host in ["evil.example:7780", "127.0.0.1", "127.0.0.1:7781", ""] {
            assert_eq!(post(&[("host", host), ORIGIN]), Err(RequestRefusal::Host), "{host}");
        }
        assert_eq!(post(&[]), Err(RequestRefusal::Host));
        assert_eq!(post(&[OWN, ("host", "evil.example"), ORIGIN]), Err(RequestRefusal::Host));
    }

    #[test]
    fn behind_a_proxy_its_url_counts_too() {
        let gate = gate(Some("https://farm.example.org/resins/"));
        for (host, origin, expected) in [
            ("farm.example.org", "https://farm.example.org", Ok(())),
            ("127.0.0.1:7780", "https://farm.example.org", Ok(())),
            ("farm.example.org", "http://farm.example.org", Err(RequestRefusal::Origin)),
            ("farm.example.com", "https://farm.example.org", Err(RequestRefusal::Host)),
        ] {
            assert_eq!(gate.admit(&call(&[("host", host), ("origin", origin)])), expected, "{host} {origin}");
        }
        let elsewhere =
            PageGate::with_token("secret".to_owned(), "folder", ([127, 0, 0, 2], 80).into(), None);
        for host in ["127.0.0.2:80", "localhost", "127.0.0.1:80"] {
            elsewhere.admit(&request("GET", "/", &[("host", host), ("cookie", "farm=secret")])).unwrap();
        }
        let cookie = gate.let_in(&request("GET", "/?token=secret", &[("host", "farm.example.org")])).unwrap();
        assert!(cookie.contains("Path=/resins/folder/;") && cookie.ends_with("; Secure"), "{cookie}");
    }
}
