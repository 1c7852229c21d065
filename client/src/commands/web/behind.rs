//! Parses the URL of a proxy that shows the page to others.

use std::str::FromStr;

use optics_model::Invalid;

/// Scheme, host and path of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Url {
    pub scheme: String,
    /// Host, and port unless it is the scheme's default.
    pub authority: String,
    /// Begins and ends with a slash.
    pub path: String,
}

impl Url {
    pub fn origin(&self) -> String {
        format!("{}://{}", self.scheme, self.authority)
    }
}

impl FromStr for Url {
    type Err = Invalid;

    fn from_str(text: &str) -> Result<Self, Invalid> {
        let wanted =
            || Invalid::new("behind", text, "a URL such as https://farm.example.org/resins/ is needed");
        let uri: axum::http::Uri = text.parse().map_err(|_| wanted())?;
        let scheme = uri.scheme_str().filter(|s| ["http", "https"].contains(s)).ok_or_else(wanted)?;
        let authority = uri.authority().filter(|a| !a.as_str().contains('@')).ok_or_else(wanted)?;
        // The path becomes part of a cookie's attribute.
        if uri.query().is_some() || uri.path().contains([';', ',']) {
            return Err(wanted());
        }
        // Over http, token and cookie would be sent in clear text.
        let host = authority.host();
        if scheme == "http" && !["localhost", "127.0.0.1", "[::1]"].contains(&host) {
            return Err(wanted());
        }
        let usual = if scheme == "https" { 443 } else { 80 };
        let port = authority.port_u16().filter(|port| *port != usual);
        let mut path = uri.path().to_owned();
        if !path.ends_with('/') {
            path.push('/');
        }
        let port = port.map_or_else(String::new, |port| format!(":{port}"));
        let authority = format!("{}{port}", host.to_ascii_lowercase());
        Ok(Self { scheme: scheme.to_owned(), authority, path })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn urls_have_scheme_host_and_path() {
        let url: Url = "https://Farm.example.org:8443/resins".parse().unwrap();
        assert_eq!(
            (url.origin(), url.path),
            ("https://farm.example.org:8443".to_owned(), "/resins/".to_owned())
        );
        for (url, authority) in [
            ("https://farm", "farm"),
            ("https://farm:443/", "farm"),
            ("http://localhost:8080/", "localhost:8080"),
        ] {
            let url = url.parse::<Url>().unwrap();
            assert_eq!((&*url.authority, &*url.path), (authority, "/"));
        }
        let wrong =
            "farm|farm:80/x|ftp://farm/|http://farm/|https://u:p@farm/|https://farm/?a=b|https://farm/a;b|";
        for bad in wrong.split('|') {
            assert_eq!(bad.parse::<Url>().unwrap_err().field(), "behind", "{bad}");
        }
    }
}
