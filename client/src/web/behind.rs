//! The URL of a proxy that shows the page to others.

use std::str::FromStr;

use optics_model::Invalid;

/// Scheme, host and path of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Url {
    pub scheme: String,
    /// Host, and port if it is not the scheme's.
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
        // Within a cookie's attribute.
        if uri.query().is_some() || uri.path().contains([';', ',']) {
            return Err(wanted());
        }
        let mut path = uri.path().to_owned();
        if !path.ends_with('/') {
            path.push('/');
        }
        Ok(Self { scheme: scheme.to_owned(), authority: authority.as_str().to_ascii_lowercase(), path })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_have_scheme_host_and_path() {
        let url: Url = "https://Farm.example.org:8443/resins".parse().unwrap();
        assert_eq!(url.origin(), "https://farm.example.org:8443");
        assert_eq!(url.path, "/resins/");
        assert_eq!("http://farm".parse::<Url>().unwrap().path, "/");
        for bad in [
            "farm",
            "farm:80/x",
            "ftp://farm/",
            "https://u:p@farm/",
            "https://farm/?a=b",
            "https://farm/a;b",
            "",
        ] {
            let error = bad.parse::<Url>().unwrap_err();
            assert_eq!(error.field(), "behind", "{bad}");
        }
    }
}
