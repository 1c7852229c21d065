//! Domain types of the farm and its gRPC interface, package `farm.v1`.
//!
//! A domain type has private fields and one validating constructor: whoever holds a [`Grid`] or a
//! [`Scene`] holds a correct one. The generated wire types are in [`wire`]; `convert` is the only
//! place that turns one into the other.

pub mod access;
pub mod digest;
pub mod fit;
pub mod grid;
pub mod ids;
pub mod invalid;
pub mod job;
pub mod logs;
pub mod measurement;
pub mod optics;
pub mod packed;
pub mod profile;
pub mod scene;
pub mod status;
pub mod sums;
pub mod walltime;

mod convert;
mod files;

pub use digest::Digest;
pub use files::{GridFile, SceneFile, SceneRef, whole};
pub use grid::{Grid, Quality, Walks};
pub use ids::{DictionaryName, RequestLimits};
pub use invalid::{Invalid, Result};
pub use measurement::{MeasuredProfile, Measurement};
pub use optics::{Medium, TransportPoint};
pub use packed::PackedRecords;
pub use profile::{Derivatives, Estimate, Profile, Record};
pub use scene::Scene;

/// Version of everything that changes the bytes of a record: tracer, sampling, random streams.
/// Workers and coordinator must agree on it.
pub const PHYSICS_VERSION: u32 = 3;

/// Version of the messages between workers and coordinator. Whoever changes them so that older programs would
/// misunderstand them raises it: then these are refused when they register.
pub const PROTOCOL_VERSION: u32 = 2;

/// Metadata of the answer to an export: how many of the records asked for are done when it begins.
pub const RECORDS_PROMISED: &str = "farm-records-promised";

/// Generated from `proto/farm/v1/*.proto`.
#[expect(clippy::pedantic, clippy::allow_attributes, reason = "generated code")]
pub mod wire {
    tonic::include_proto!("farm.v1");

    /// The package's file descriptors, for reflection.
    pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
}
