//! From photographs to profiles: numerics over plain arrays, without files, network or clock.
//!
//! A session runs through steps that take photographs one at a time, so that never more than two are in memory:
//! [`Darks`] → [`Flats`] → [`Patches`] → [`BareShots`] → [`Mountings`], one of those for each sample. Each step has
//! `add(photo)`, which checks and may refuse, and `finish()`, whose result the next one uses.

#[expect(unused_imports)]
mod stub;
mod estimate;
mod frame;
mod refusal;

pub use estimate::{Contribution, Estimate, Source};
pub use frame::{Colour, Exposure, Frame, Levels, Pattern, Photo, Site};
pub use refusal::{Refusal, Side, Warning};
pub use stub::*;
