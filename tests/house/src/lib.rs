//! Tests the sources and documents themselves: boundaries between crates, links, language and size. It links none of the
//! crates that it looks at, so it is built in seconds.

#![cfg(test)]

mod architecture;
mod documents;
mod files;
mod language;
mod modules;
mod size;
