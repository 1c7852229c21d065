//! The domain of the science: media, scenes, grids, profiles, measurements, and the answers of fits.
//!
//! A type with a rule has private fields and one validating constructor, so a [`Grid`] or a [`Scene`] is always
//! correct. Nothing here uses a runtime, a network, a clock, a database or a file.
//!
//! `docs/glossary.md` explains the terms.

pub mod angle;
mod canonical;
pub mod controls;
pub mod descent;
pub mod digest;
mod files;
pub mod fit;
pub mod grid;
pub mod identity;
pub mod invalid;
pub mod job;
pub mod limits;
pub mod measurement;
pub mod medium;
pub mod packed;
pub mod phase;
pub mod profile;
pub mod quantities;
mod records_digest;
pub mod scene;
pub mod sums;

pub use digest::Digest;
pub use files::{GridFile, SceneFile, SceneRef, whole};
pub use grid::{Grid, Quality, Walks};
pub use invalid::{Invalid, Result};
pub use measurement::{MeasuredProfile, Measurement, ProfileSetup};
pub use medium::{Medium, TransportPoint};
pub use packed::{Layout, PackedRecords};
pub use profile::{Derivatives, Estimate, Profile, Record};
pub use quantities::Quantity;
pub use scene::Scene;

/// Version of everything that changes the bytes of a record: tracer, sampling, random streams, exact levels.
/// Workers and coordinator must agree on it.
pub const PHYSICS_VERSION: u32 = 8;
