//! Connects the farm's programs to each other, and provides what several of them need.
//!
//! # Links
//!
//! A [`Link`] is a gRPC connection to a coordinator on which every call carries a token, ends in time, and reports why
//! it is refused. [`Target`] makes one from an access file, or from a bare URL. [`failure()`] explains why a
//! coordinator does not answer.
//!
//! # Access files
//!
//! Access files hold roles, and the credentials with which both sides authenticate each other. All are TOML, and
//! secret: a file that every user of the machine can open is refused.
//!
//! The coordinator has one file ([`CoordinatorAccess`]): its certificate and key, and the hashes of the tokens that it
//! accepts. Every other program has a file for a [`Role`] ([`ClientAccess`]): the coordinator's URL, the authority that
//! vouches for its certificate, and a token.
//!
//! A coordinator on loopback without a file has a [`LocalSocket`], which the programs of its user find automatically.
//!
//! # Other modules
//!
//! [`arguments`] parses command lines, [`logs`] sets up logging, [`memory`] finds how much memory a program may use,
//! [`signals`] waits for signals to end, [`walltime`] reads times in Slurm's forms and with units, [`sync_folder`]
//! writes the names in a folder to the disk.
//!
//! `docs/glossary.md` explains the terms.

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
    /// Submits grids, reads records, requests fits.
    Client,
    /// May do everything that the others may, and manage the farm.
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

/// The hash of a token that the coordinator's file holds instead of the token. A plain hash suffices: tokens are
/// random, so they cannot be guessed from it.
pub fn token_hash(token: &str) -> blake3::Hash {
    blake3::hash(token.as_bytes())
}

#[cfg(test)]
mod testing;
