//! Serves the page's files, which are embedded in the program.

use std::io::Write as _;
use std::sync::LazyLock;

use axum::http::header::{
    ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_TYPE, ETAG, IF_NONE_MATCH, VARY,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::GzEncoder;

/// Name, media type and bytes of each file, as built by `web/build`.
const FILES: [(&str, &str, &[u8]); 4] = [
    ("", "text/html; charset=utf-8", include_bytes!("../../../../web/built/index.html")),
    ("page.js", "text/javascript; charset=utf-8", include_bytes!("../../../../web/built/page.js")),
    ("page.css", "text/css; charset=utf-8", include_bytes!("../../../../web/built/page.css")),
    ("favicon.svg", "image/svg+xml", include_bytes!("../../../../web/built/favicon.svg")),
];

#[derive(Debug)]
struct Asset {
    name: &'static str,
    kind: &'static str,
    plain: &'static [u8],
    gzipped: Vec<u8>,
    etag: String,
}

static ASSETS: LazyLock<Vec<Asset>> = LazyLock::new(|| {
    let asset = |(name, kind, plain): (&'static str, &'static str, &'static [u8])| {
        let mut gzip = GzEncoder::new(Vec::new(), Compression::best());
        // Writing to memory does not fail.
        let _ = gzip.write_all(plain);
        let etag = format!("\"{}\"", &blake3::hash(plain).to_hex()[..16]);
        Asset { name, kind, plain, gzipped: gzip.finish().unwrap_or_default(), etag }
    };
    FILES.map(asset).into()
});

/// A file of the page. Browsers revalidate it each time, and receive it if they have another version.
pub(super) fn asset(name: &str, headers: &HeaderMap) -> Option<Response> {
    let asset = ASSETS.iter().find(|asset| asset.name == name)?;
    let has = |header, what: &str| {
        headers.get(header).and_then(|v| v.to_str().ok()).is_some_and(|v| v.contains(what))
    };
    let common = [(ETAG, asset.etag.as_str()), (CACHE_CONTROL, "no-cache"), (VARY, "accept-encoding")];
    if has(IF_NONE_MATCH, &asset.etag) {
        return Some((StatusCode::NOT_MODIFIED, common).into_response());
    }
    let kind = [(CONTENT_TYPE, asset.kind)];
    Some(if has(ACCEPT_ENCODING, "gzip") {
        (common, kind, [(CONTENT_ENCODING, "gzip")], asset.gzipped.as_slice()).into_response()
    } else {
        (common, kind, asset.plain).into_response()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: axum::http::HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, value.parse().unwrap())])
    }

    /// The compressed files of the page are smaller than 140 kB.
    #[test]
    fn compressed_page_is_small() {
        let bytes: usize = ASSETS.iter().map(|asset| asset.gzipped.len()).sum();
        assert!((1000..140_000).contains(&bytes), "{bytes} bytes");
    }

    /// A browser with the same version gets 304, and one that accepts gzip the compressed file.
    #[test]
    fn assets_are_cached_and_compressed_on_request() {
        let plain = asset("page.js", &HeaderMap::new()).unwrap();
        assert!(plain.headers().get(CONTENT_ENCODING).is_none());
        assert_eq!(plain.headers()[CACHE_CONTROL], "no-cache");
        let gzipped = asset("page.js", &headers(ACCEPT_ENCODING, "br, gzip")).unwrap();
        assert_eq!(gzipped.headers()[CONTENT_ENCODING], "gzip");
        let etag = gzipped.headers()[ETAG].to_str().unwrap();
        let again = asset("page.js", &headers(IF_NONE_MATCH, etag)).unwrap();
        assert_eq!(again.status(), StatusCode::NOT_MODIFIED);
        assert!(asset("page.map", &HeaderMap::new()).is_none());
    }

    /// Nothing is loaded from other sites, and the page has no inline script or style: its policy forbids both.
    #[test]
    fn page_needs_nothing_but_its_files() {
        let html = std::str::from_utf8(FILES[0].2).unwrap();
        for forbidden in ["http://", "https://", "src=\"/", "href=\"/", "<style", "style=", "onclick"] {
            assert!(!html.contains(forbidden), "{forbidden}");
        }
        let inline = html.split("<script").skip(1).any(|script| !script.contains("src=\"./"));
        assert!(!inline, "{html}");
    }
}
