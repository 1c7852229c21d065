//! Sets the number of walks of a transport point: a given number, or as many as a target error needs.

use crate::invalid::{Invalid, Result};
use crate::profile::{Estimate, Record};

/// Walks of one batch: the unit of the random streams and of the standard errors.
pub const BATCH_WALKS: u64 = 500;
/// Batches of one chunk: the unit that is traced in one go and gives the spread of its batches. Part of the physics
/// version.
pub const CHUNK_BATCHES: u64 = 25;
/// Batches of one block: the part of a divided job that is traced on its own. Part of the physics version, since sums are
/// added up within blocks first.
pub const BLOCK_BATCHES: u64 = 2000;
const _: () = assert!(BLOCK_BATCHES.is_multiple_of(CHUNK_BATCHES), "a block holds whole chunks");
const MAX_WALKS: u64 = 1_000_000_000_000;

/// Number of random walks per transport point: a multiple of [`BATCH_WALKS`], at least two batches,
/// since the standard errors come from the spread between batches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Walks(u64);

impl Walks {
    /// Near the most that any point of the paper needs for its noise, see [`super::NoiseLevel`].
    pub const PAPER: Self = Self(50_000);

    pub fn new(walks: u64) -> Result<Self> {
        if (2 * BATCH_WALKS..=MAX_WALKS).contains(&walks) && walks.is_multiple_of(BATCH_WALKS) {
            Ok(Self(walks))
        } else {
            let least = 2 * BATCH_WALKS;
            let nearest = (walks.min(MAX_WALKS) + BATCH_WALKS / 2) / BATCH_WALKS * BATCH_WALKS;
            let nearest = nearest.clamp(least, MAX_WALKS);
            let allowed = format!(
                "allowed are multiples of {BATCH_WALKS} from {least} to {MAX_WALKS}; the nearest is {nearest}"
            );
            Err(Invalid::new("walks", walks, allowed))
        }
    }

    pub fn get(self) -> u64 {
        self.0
    }

    /// This many times the walks, or the most that are allowed.
    #[must_use]
    pub(super) fn times(self, factor: u32) -> Self {
        Self(self.0.saturating_mul(u64::from(factor)).min(MAX_WALKS))
    }

    pub fn batches(self) -> u64 {
        self.0 / BATCH_WALKS
    }

    /// Blocks that the batches fill; the last may be smaller.
    pub fn blocks(self) -> u32 {
        self.batches().div_ceil(BLOCK_BATCHES) as u32
    }

    /// Batches of a block.
    pub fn batches_of_block(self, block: u32) -> u64 {
        BLOCK_BATCHES.min(self.batches().saturating_sub(u64::from(block) * BLOCK_BATCHES))
    }
}

/// The stopping criterion for tracing a transport point: see [`Quality::noise_of`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    relative_std_error: f64,
    max_walks: Walks,
}

impl Quality {
    pub fn new(relative_std_error: f64, max_walks: Walks) -> Result<Self> {
        if !(1e-6..=1.0).contains(&relative_std_error) {
            let allowed = "allowed are 0.000001 to 1";
            return Err(Invalid::new("relative_std_error", relative_std_error, allowed));
        }
        Ok(Self { relative_std_error, max_walks })
    }

    pub fn relative_std_error(self) -> f64 {
        self.relative_std_error
    }

    pub fn max_walks(self) -> Walks {
        self.max_walks
    }

    /// Largest over records and channels of the root mean square of a profile's standard errors over its mean; 0 for
    /// a profile that is 0 everywhere.
    pub fn noise_of(records: &[Record]) -> f64 {
        let noise = |estimate: &Estimate| {
            let n = estimate.values().len() as f64;
            let mean = estimate.values().iter().map(|v| f64::from(*v)).sum::<f64>() / n;
            let square = estimate.std_errors().iter().map(|e| f64::from(*e).powi(2)).sum::<f64>() / n;
            if mean > 0.0 { square.sqrt() / mean } else { 0.0 }
        };
        let profiles = records.iter().flat_map(|r| &r.profiles);
        profiles.map(|p| noise(&p.radiance_factor)).fold(0.0, f64::max)
    }

    /// Number of walks to trace after a round of `walks` that left this noise; None if no more are needed or allowed.
    ///
    /// Noise falls with the root of the walks; a tenth is added, so that one more round mostly suffices. The result
    /// depends on the records alone, so that it is the same on every machine.
    pub fn more_walks(self, walks: Walks, noise: f64) -> Option<Walks> {
        if noise <= self.relative_std_error || walks.get() >= self.max_walks.get() {
            return None;
        }
        let wanted = walks.get() as f64 * (noise / self.relative_std_error).powi(2) * 1.1;
        let batches = ((wanted / BATCH_WALKS as f64).ceil() as u64).max(walks.batches() + 1);
        Some(Walks((batches * BATCH_WALKS).min(self.max_walks.get())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    /// The refusal of a number of walks names the nearest valid one: whole batches, and enough for a standard error.
    #[test]
    fn refused_walks_name_the_nearest_valid_one() {
        for (given, nearest) in [
            (0, 1000),
            (749, 1000),
            (1249, 1000),
            (1250, 1500),
            (1_000_001, 1_000_000),
            (MAX_WALKS + 1, MAX_WALKS),
            (u64::MAX, MAX_WALKS),
        ] {
            let allowed = Walks::new(given).unwrap_err().allowed().to_owned();
            assert!(allowed.contains("multiples of 500"), "{allowed}");
            assert!(allowed.ends_with(&format!("; the nearest is {nearest}")), "{given}: {allowed}");
            assert!(Walks::new(nearest).is_ok());
        }
    }
}
