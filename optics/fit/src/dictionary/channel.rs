//! Stores all records of a dictionary in one channel, and caches views of them.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::dictionary::coefficients::Coefficients;
use crate::dictionary::records::Records;
use crate::dictionary::responses::ResponseRecords;
use crate::dictionary::view::{View, ViewKey, made_once};

/// Number of views that are cached besides the one over all pixels with the default wavelet.
const OTHER_VIEWS: usize = 1;

type Slot = Arc<OnceLock<Arc<View>>>;

#[derive(Debug)]
pub(crate) struct ChannelRecords {
    records: Arc<Records>,
    responses: Option<ResponseRecords>,
    /// Made for the first prediction.
    coefficients: OnceLock<Coefficients>,
    /// The default view first, then the latest other one.
    views: Mutex<Vec<(ViewKey, Slot)>>,
}

impl ChannelRecords {
    pub(crate) fn new(records: Records, responses: Option<ResponseRecords>) -> Self {
        Self { records: Arc::new(records), responses, coefficients: OnceLock::new(), views: Mutex::default() }
    }

    pub(crate) fn responses(&self) -> Option<&ResponseRecords> {
        self.responses.as_ref()
    }

    pub(crate) fn records(&self) -> &Records {
        &self.records
    }

    pub(crate) fn coefficients(&self) -> &Coefficients {
        self.coefficients.get_or_init(|| Coefficients::of(&self.records))
    }

    /// The view over all pixels, which stays cached once it was made.
    pub(crate) fn whole_view(&self) -> Arc<View> {
        let settings = optics_model::fit::FitSettings::default();
        let pixels = 0..self.records.pixels();
        self.view(&ViewKey { pixels, wavelet: settings.wavelet, level: settings.level })
    }

    /// The view of a key, made if it is not cached.
    pub(crate) fn view(&self, key: &ViewKey) -> Arc<View> {
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
        made_once(&slot, || Arc::new(View::new(&self.records, key.clone()))).clone()
    }
}
