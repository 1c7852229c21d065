//! From photographs to profiles: figures of the stage, with photographs whose truth is known.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

mod figures;
mod refusals;
mod stage;
