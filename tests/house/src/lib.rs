//! Tests the sources and documents themselves: boundaries between crates, links, and language. It links none of the
//! crates that it looks at, so it is built in seconds.

#![cfg(test)]

mod architecture;
mod documents;
mod files;
mod language;
mod modules;
