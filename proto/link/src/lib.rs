//! How the farm's programs reach each other, and what else several of them need.
//!
//! # Links
//!
//! A [`Link`] is a gRPC connection to a coordinator on which every call carries a token, ends in time and learns why it
//! is not wanted. [`Target`] makes one from an access file, or from a bare URL. [`failure()`] explains why a
//! coordinator does not answer.
//!
//! # Access files
//!
//! They hold roles, and how both sides authenticate each other. All are TOML, and secret: a file that every user of
//! the machine can open is refused.
//!
//! The coordinator has one file ([`CoordinatorAccess`]): its certificate and key, and the hashes of the tokens that it
//! accepts. Everybody else has a file for a [`Role`] ([`ClientAccess`]): the coordinator's URL, the authority that
//! vouches for its certificate, and a token.
//!
//! A coordinator on loopback without a file has a [`LocalSocket`], which the programs of its user find by themselves.
//!
//! # Besides
//!
//! [`arguments`] reads what programs are given, [`logs`] sets up what they log, [`memory`] finds how much they may use,
//! [`signals`] ends them in good order, [`walltime`] reads times as Slurm and
//! people write them, [`sync_folder`] puts the names in a folder on the disk.

#![warn(clippy::print_stdout, clippy::print_stderr, reason = "they panic where the output is full or closed")]

mod alert;
pub mod arguments;
mod client;
mod coordinator;
mod endpoint;
mod error;
mod failure;
mod file;
mod folder;
mod handshake;
mod link;
mod local_socket;
pub mod logs;
mod loopback;
pub mod memory;
mod pem;
pub mod signals;
mod target;
mod tokens;
pub mod walltime;

use std::fmt;
use std::time::Duration;

pub use alert::refusal;
pub use client::ClientAccess;
pub use coordinator::CoordinatorAccess;
pub use endpoint::Bearer;
pub use error::AccessError;
pub use failure::{failure, is_passing};
pub use folder::sync_folder;
pub use link::Link;
pub use local_socket::LocalSocket;
pub use target::Target;
pub use tokens::{Tokens, is_token_name};

/// Longest time for a TLS handshake, on both sides.
const HANDSHAKE: Duration = Duration::from_secs(10);

/// Length of a token in bytes. The shortest still has 128 bits if it is random hexadecimal.
const TOKEN_BYTES: std::ops::RangeInclusive<usize> = 32..=512;

/// Permissions of a token.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Takes jobs and delivers their records.
    Worker,
    /// Submits grids, reads records, asks for fits.
    Client,
    /// May do all that the others may, and steer the farm.
    Admin,
}

impl Role {
    pub const ALL: [Self; 3] = [Self::Worker, Self::Client, Self::Admin];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Worker => "worker",
            Self::Client => "client",
            Self::Admin => "admin",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// What the coordinator's file holds in a token's stead. A plain hash is enough: tokens are random, so that there is
/// nothing to guess from it.
pub fn token_hash(token: &str) -> blake3::Hash {
    blake3::hash(token.as_bytes())
}

#[cfg(test)]
mod testing;
