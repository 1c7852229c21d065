//! A dictionary's progress, as it comes.

use std::sync::Arc;
use std::time::Duration;

use farm_proto::DictionaryName;
use farm_proto::status::DictionaryStatus;
use tokio::sync::watch;

use super::{Farm, Result};

/// Least time between two states.
const PAUSE: Duration = Duration::from_millis(100);

/// The states of a dictionary, from the present one to its end.
#[derive(Debug)]
pub(crate) struct Watch {
    farm: Arc<Farm>,
    name: DictionaryName,
    changes: watch::Receiver<()>,
    /// The state that was told last.
    last: Option<DictionaryStatus>,
}

impl Farm {
    pub(crate) fn watch(self: &Arc<Self>, name: DictionaryName) -> Result<Watch> {
        // Before the first look, so that no change falls between the two.
        let changes = self.door.changes();
        self.found(&name)?;
        Ok(Watch { farm: self.clone(), name, changes, last: None })
    }
}

impl Watch {
    /// The next state that differs from the last; None after the one in which the dictionary has ended.
    pub(crate) async fn next(&mut self) -> Result<Option<DictionaryStatus>> {
        if self.last.as_ref().is_some_and(|last| !last.state().is_open()) {
            return Ok(None);
        }
        loop {
            let now = self.farm.status(&self.name)?;
            if !self.last.as_ref().is_some_and(|last| same(&now, last)) {
                self.last = Some(now.clone());
                return Ok(Some(now));
            }
            if self.changes.changed().await.is_err() {
                return Ok(None);
            }
            tokio::time::sleep(PAUSE).await;
            self.changes.mark_unchanged();
        }
    }
}

/// Whether nothing has changed that people would see: the time that is left changes all the time, by a little.
fn same(a: &DictionaryStatus, b: &DictionaryStatus) -> bool {
    let near = match (a.eta_s, b.eta_s) {
        (Some(a), Some(b)) => (a - b).abs() <= 0.1 * a.max(b),
        (a, b) => a == b,
    };
    near && DictionaryStatus { eta_s: None, ..a.clone() } == DictionaryStatus { eta_s: None, ..b.clone() }
}
