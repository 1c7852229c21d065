//! A dictionary in memory, laid out for comparison.

use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use optics_model::fit::Wavelet;
use optics_model::{Grid, Record};

use super::view::View;

/// Views kept besides the one over all pixels with the default wavelet.
const OTHER_VIEWS: usize = 1;

/// Which pixels are compared, and how their gradients are taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ViewKey {
    pub pixels: Range<usize>,
    pub wavelet: Wavelet,
    pub level: u32,
}

/// Collects records, which may come in any order.
#[derive(Debug)]
pub struct DictionaryBuilder {
    grid: Grid,
    values: Vec<f32>,
    present: usize,
}

impl DictionaryBuilder {
    pub fn new(grid: Grid) -> Self {
        let numbers = grid.record_count() * grid.scene().channels().len() * grid.scene().sensor().pixels();
        Self { grid, values: vec![0.0; numbers], present: 0 }
    }

    /// # Panics
    /// If the record is not of the grid's shape or number.
    pub fn add(&mut self, record: &Record) {
        let (pixels, records) = (self.grid.scene().sensor().pixels(), self.grid.record_count());
        assert_eq!(record.profiles.len(), self.grid.scene().channels().len(), "one profile per channel");
        for (channel, profile) in record.profiles.iter().enumerate() {
            let start = (channel * records + record.index) * pixels;
            self.values[start..start + pixels].copy_from_slice(profile.radiance_factor.values());
        }
        self.present += 1;
    }

    /// Computes gradients and descriptions, so that the first question is as fast as the others.
    ///
    /// # Panics
    /// If records are missing.
    pub fn build(self) -> FitDictionary {
        assert_eq!(self.present, self.grid.record_count(), "every record once");
        let dictionary = FitDictionary { grid: self.grid, values: self.values, views: Mutex::default() };
        let key = dictionary.default_view();
        dictionary.view(&key);
        dictionary
    }
}

type Slot = Arc<OnceLock<Arc<View>>>;

/// Values of all records, and views on them.
#[derive(Debug)]
pub struct FitDictionary {
    grid: Grid,
    /// `[channel][record][pixel]`.
    values: Vec<f32>,
    /// The default first, then the last other one.
    views: Mutex<Vec<(ViewKey, Slot)>>,
}

impl FitDictionary {
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Radiance factors of a record in one channel.
    pub fn values(&self, record: usize, channel: usize) -> &[f32] {
        let pixels = self.grid.scene().sensor().pixels();
        let start = (channel * self.grid.record_count() + record) * pixels;
        &self.values[start..start + pixels]
    }

    fn default_view(&self) -> ViewKey {
        let pixels = 0..self.grid.scene().sensor().pixels();
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
        slot.get_or_init(|| Arc::new(View::new(self, key.clone()))).clone()
    }
}
