//! Shared by the tests of the page: a browser, and a reverse proxy.
//!
//! They are a separate package, since the browser's driver has many dependencies to build.

#![expect(clippy::unwrap_used, reason = "helpers of tests")]

pub mod browser;
pub mod reverse_proxy;
