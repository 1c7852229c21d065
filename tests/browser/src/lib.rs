//! What the tests of the page share: a browser, and a proxy as laboratories have them.
//!
//! They are a package of their own, since the browser's driver brings much to build.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

pub mod browser;
pub mod reverse_proxy;
