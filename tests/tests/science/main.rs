//! Tests what is computed: physics, photographs that become profiles, and media that are found again.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

mod capture;
mod charts;
mod measure;
mod physics;
