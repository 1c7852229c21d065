//! Defines the farm's gRPC interface, package `farm.v1`, and its types for dictionaries, workers and leases.
//!
//! The generated wire types are in [`wire`]; `convert` is the only place that turns them into the types of
//! `optics-model` and of this crate, and back.
//!
//! `docs/glossary.md` explains the terms.

pub mod codec;
mod convert;
pub mod ids;
pub mod lease;
pub mod status;

pub use convert::{check_pixels, is_printable, mixtures, to_status};
pub use ids::{DictionaryName, RequestLimits};

/// Version of the messages between workers and coordinator. It is raised by every change that older programs would
/// misunderstand, so that they are refused when they register.
pub const PROTOCOL_VERSION: u32 = 2;

/// Metadata of the answer to an export: the number of requested records that are done when it begins.
pub const RECORDS_PROMISED: &str = "farm-records-promised";

/// The paths of all methods, as in `/farm.v1.Fits/Fit`.
pub const METHODS: &[&str] = include!(concat!(env!("OUT_DIR"), "/methods.rs"));

/// Generated from `proto/farm/v1/*.proto`.
#[expect(clippy::pedantic, clippy::allow_attributes, reason = "generated code")]
pub mod wire {
    tonic::include_proto!("farm.v1");

    /// The package's file descriptors, for reflection.
    pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
}
