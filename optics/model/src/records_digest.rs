//! Computes digests of records.

use crate::digest::Digest;
use crate::profile::Record;

impl Digest {
    /// Digest of a job's records: every number of every profile, in order.
    pub fn of_records(records: &[Record]) -> Self {
        let mut hasher = RecordsHasher::new();
        for record in records {
            hasher.add(record.index, |bytes| record.extend_le_bytes(bytes));
        }
        hasher.finalize()
    }

    /// Digest of a job's records as contiguous bytes, `size` for each; `first` is the index of the first.
    pub(crate) fn of_packed(first: usize, records: &[u8], size: usize) -> Self {
        let mut hasher = RecordsHasher::new();
        for (index, record) in (first..).zip(records.chunks_exact(size)) {
            hasher.add(index, |bytes| bytes.extend_from_slice(record));
        }
        hasher.finalize()
    }
}

/// Digests records in lumps: BLAKE3 is several times as fast if it is given many of its blocks of 1,024 bytes at once, in
/// powers of two.
struct RecordsHasher {
    hasher: blake3::Hasher,
    waiting: Vec<u8>,
}

impl RecordsHasher {
    const LUMP: usize = 64 << 10;

    fn new() -> Self {
        Self { hasher: blake3::Hasher::new_derive_key("farm.v1 records"), waiting: Vec::new() }
    }

    /// Adds a record's number, and the bytes that `write` appends.
    fn add(&mut self, index: usize, write: impl FnOnce(&mut Vec<u8>)) {
        self.waiting.extend((index as u64).to_le_bytes());
        write(&mut self.waiting);
        let lumps = self.waiting.len() / Self::LUMP * Self::LUMP;
        if lumps > 0 {
            self.hasher.update(&self.waiting[..lumps]);
            self.waiting.drain(..lumps);
        }
    }

    fn finalize(mut self) -> Digest {
        self.hasher.update(&self.waiting);
        self.hasher.into()
    }
}
