//! Dictionaries in memory, loaded at the first question and kept for the next.

use std::sync::{Arc, Mutex, PoisonError};

use farm_proto::ids::DictionaryId;
use farm_proto::profile::RecordShape;
use farm_proto::{DictionaryName, Grid};
use tokio::sync::OnceCell;

use super::{FarmError, Result, blocking, read_chunk};
use crate::fit::{DictionaryBuilder, FitDictionary};
use crate::store::{Store, StoreError};

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
        grid: Grid,
    ) -> Result<Arc<FitDictionary>> {
        let pixels = grid.scene().channels().len() * grid.scene().sensor().pixels();
        let bytes = grid.record_count().saturating_mul(pixels).saturating_mul(3 * size_of::<f32>());
        if bytes > LARGEST_BYTES {
            return Err(FarmError::TooLarge { name: name.clone(), bytes, limit: LARGEST_BYTES });
        }
        let slot = self.slot(id);
        let loaded = slot.get_or_try_init(async || load_dictionary(store, id, grid).await.map(Arc::new));
        Ok(loaded.await?.clone())
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

/// Reads a complete dictionary into memory.
///
/// # Panics
/// If records are missing.
pub async fn load_dictionary(
    store: &Store,
    id: DictionaryId,
    grid: Grid,
) -> Result<FitDictionary, StoreError> {
    let (count, shape) = (grid.record_count(), RecordShape::of(&grid));
    let chunk = read_chunk(&grid);
    let mut builder = DictionaryBuilder::new(grid);
    for first in (0..count).step_by(chunk) {
        for record in store.records(id, first..(first + chunk).min(count), shape).await? {
            builder.add(&record);
        }
    }
    Ok(blocking(move || builder.build()).await)
}
