//! A dictionary in memory, laid out for comparison.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use optics_model::profile::RecordShape;
use optics_model::{Grid, PackedRecords};

use super::records::Records;
use super::view::{View, ViewKey};

/// Views kept besides the one over all pixels with the default wavelet.
const OTHER_VIEWS: usize = 1;

/// Collects the records of jobs, which may come in any order.
#[derive(Debug)]
pub struct DictionaryBuilder {
    all: Records,
    /// Which records have come.
    present: Vec<bool>,
}

impl DictionaryBuilder {
    pub fn new(grid: Grid) -> Self {
        let present = vec![false; grid.record_count()];
        Self { all: Records::new(grid), present }
    }

    /// # Panics
    /// If a record is not of the grid's shape or number, or has come before.
    pub fn add(&mut self, records: &PackedRecords) {
        let shape = RecordShape::of(self.all.grid());
        assert_eq!(records.shape(), shape, "the records have the grid's shape");
        for number in records.numbers() {
            let before = std::mem::replace(&mut self.present[number], true);
            assert!(!before, "record {number} comes once");
            for channel in 0..shape.channels {
                let values = self.all.values_mut(number, channel);
                for (value, read) in values.iter_mut().zip(records.radiance_factors(number, channel)) {
                    *value = read;
                }
            }
        }
    }

    /// Computes gradients and descriptions, so that the first question is as fast as the others.
    ///
    /// # Panics
    /// If records are missing.
    pub fn build(self) -> FitDictionary {
        assert!(self.present.iter().all(|present| *present), "every record has come");
        let dictionary = FitDictionary { all: self.all, views: Mutex::default() };
        let key = dictionary.default_view();
        dictionary.view(&key);
        dictionary
    }
}

type Slot = Arc<OnceLock<Arc<View>>>;

/// Values of all records, and views on them.
#[derive(Debug)]
pub struct FitDictionary {
    all: Records,
    /// The default first, then the last other one.
    views: Mutex<Vec<(ViewKey, Slot)>>,
}

impl FitDictionary {
    pub fn grid(&self) -> &Grid {
        self.all.grid()
    }

    /// Radiance factors of a record in one channel.
    pub fn values(&self, record: usize, channel: usize) -> &[f32] {
        self.all.values(record, channel)
    }

    /// The view over all pixels, which is always at hand.
    pub(super) fn whole_view(&self) -> Arc<View> {
        self.view(&self.default_view())
    }

    fn default_view(&self) -> ViewKey {
        let pixels = 0..self.grid().scene().sensor().pixels();
        let settings = optics_model::fit::FitSettings::default();
        ViewKey { pixels, wavelet: settings.wavelet, level: settings.level }
    }

    /// The view of a key, made if it is not at hand.
    pub(super) fn view(&self, key: &ViewKey) -> Arc<View> {
        let slot = {
            let mut views = self.views.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(i) = views.iter().position(|(other, _)| other == key) {
                views[i].1.clone()
            } else {
                if views.len() > OTHER_VIEWS {
                    views.remove(1);
                }
                let slot = Slot::default();
                views.push((key.clone(), slot.clone()));
                slot
            }
        };
        slot.get_or_init(|| Arc::new(View::new(&self.all, key.clone()))).clone()
    }
}
