//! Dictionaries in memory, loaded at the first question and kept for the next.

use std::sync::{Arc, Mutex, PoisonError};

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use optics_fit::{DictionaryBuilder, FitDictionary};
use optics_model::Grid;
use tokio::sync::OnceCell;

use super::{FarmError, Result, blocking};
use crate::store::{Damaged, Store};

/// Dictionaries kept at a time.
const KEPT: usize = 2;
/// Largest dictionary that is loaded: values of all records, and gradients for two ranges of pixels.
const LARGEST_BYTES: usize = 4 << 30;

type Slot = Arc<OnceCell<Arc<FitDictionary>>>;

/// Most recently used last.
#[derive(Debug, Default)]
pub(super) struct FitCache(Mutex<Vec<(DictionaryId, Slot)>>);

impl FitCache {
    pub(super) async fn get(
        &self,
        store: &Store,
        name: &DictionaryName,
        id: DictionaryId,
        grid: Arc<Grid>,
    ) -> Result<Arc<FitDictionary>> {
        let pixels = grid.scene().channels().len() * grid.scene().sensor().pixels();
        let bytes = grid.record_count().saturating_mul(pixels).saturating_mul(3 * size_of::<f32>());
        if bytes > LARGEST_BYTES {
            return Err(FarmError::TooLarge { name: name.clone(), bytes, limit: LARGEST_BYTES });
        }
        let slot = self.slot(id);
        let loaded =
            slot.get_or_try_init(async || load_dictionary(store, name, id, &grid).await.map(Arc::new));
        Ok(loaded.await?.clone())
    }

    /// Drops a dictionary whose records have changed.
    pub(super) fn forget(&self, id: DictionaryId) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).retain(|(other, _)| *other != id);
    }

    fn slot(&self, id: DictionaryId) -> Slot {
        let mut slots = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let slot = match slots.iter().position(|(other, _)| *other == id) {
            Some(i) => slots.remove(i).1,
            None => Slot::default(),
        };
        slots.push((id, slot.clone()));
        if slots.len() > KEPT {
            slots.remove(0);
        }
        slot
    }
}

/// Reads a complete dictionary into memory, and compares its records with their digests.
pub async fn load_dictionary(
    store: &Store,
    name: &DictionaryName,
    id: DictionaryId,
    grid: &Arc<Grid>,
) -> Result<FitDictionary> {
    let jobs = grid.job_count();
    let chunk = ((8 << 20) / (grid.albedo().len() * grid.record_bytes())).clamp(1, 1024);
    let mut builder = DictionaryBuilder::new((**grid).clone());
    for first in (0..jobs).step_by(chunk) {
        for found in store.all_jobs(id, grid, first..(first + chunk).min(jobs)).await? {
            let damaged = |Damaged { job, what }| FarmError::Damaged { name: name.clone(), job, what };
            builder.add(&found.map_err(damaged)?.records);
        }
    }
    Ok(blocking(move || builder.build()).await)
}
