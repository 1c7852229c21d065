//! Keyed hashes with the secret of the database: lease tokens, worker tokens and the choice of results to verify derive
//! from them.
//!
//! They are functions of their subject and the secret, so none of them is stored. After a restart the same results are
//! sampled, and the tokens that were issued before still verify.

use super::part::PartId;
use crate::stored::Secret;

/// A hash keyed by the secret. Each purpose has hashes of its own.
pub(super) fn hasher(secret: &Secret, purpose: &str) -> blake3::Hasher {
    let mut hasher = blake3::Hasher::new_keyed(&secret.0);
    hasher.update(purpose.as_bytes());
    hasher
}

pub(super) fn write_part(hasher: &mut blake3::Hasher, part: PartId) {
    hasher.update(&part.dictionary.0.to_le_bytes());
    hasher.update(&part.job.to_le_bytes());
    hasher.update(&part.part.to_le_bytes());
}

pub(super) fn first_bytes<const N: usize>(hasher: &blake3::Hasher) -> [u8; N] {
    let mut bytes = [0; N];
    bytes.copy_from_slice(&hasher.finalize().as_bytes()[..N]);
    bytes
}
