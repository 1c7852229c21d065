//! How the farm's programs reach each other. [`logs`], [`signals`] and [`walltime`] are what several of them share
//! besides.
//!
//! Access files say who may do what, and how both sides know each other.
//!
//! The coordinator has one file ([`CoordinatorAccess`]): its certificate and key, and the hashes of the tokens it
//! accepts. Everybody else has a file of their own role ([`ClientAccess`]): the coordinator's URL, the certificate
//! authority to check it by, and a token. [`Target`] makes a connection of such a file, or of a bare URL.
//!
//! All are TOML, and secret: a file that every user of the machine can open is refused.

mod alert;
mod client;
mod coordinator;
mod error;
mod failure;
mod file;
mod link;
pub mod logs;
mod pem;
pub mod signals;
mod target;
pub mod walltime;

use std::fmt;
use std::time::Duration;

pub use alert::refusal;
pub use client::ClientAccess;
pub use coordinator::CoordinatorAccess;
pub use error::AccessError;
pub use failure::failure;
pub use link::Link;
pub use target::{Bearer, Target};

/// Longest time for a TLS handshake, on both sides.
const HANDSHAKE: Duration = Duration::from_secs(10);

/// Length of a token in bytes. The shortest still has 128 bits if it is random hexadecimal.
const TOKEN_BYTES: std::ops::RangeInclusive<usize> = 32..=512;

/// What somebody with a token may do.
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
