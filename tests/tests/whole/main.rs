//! Tests the programs as people run them: commands, documents, work, faults, access, sessions of photographs, and a soak.
//!
//! Most of these tests wait for processes, and run side by side.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

mod access;
mod cli;
mod documents;
mod faults;
mod flow;
mod session;
mod soak;
