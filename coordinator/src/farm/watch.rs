//! Reports the progress of a dictionary as it changes.

use std::sync::Arc;
use std::time::Duration;

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use farm_proto::status::DictionaryStatus;
use tokio::sync::watch;
use tokio::time::{Instant, timeout_at};

use super::{Farm, FarmError, Result};

/// After this time without a change the last state is repeated: proxies and routers cut connections that are silent for
/// as little as 20 s, and a client recognises a dead connection by its silence.
pub(super) const REPEAT: Duration = Duration::from_secs(10);

/// Least time between two states.
const PAUSE: Duration = Duration::from_millis(100);

/// The states of a dictionary, from the present one to its end.
#[derive(Debug)]
pub(crate) struct Watch {
    farm: Arc<Farm>,
    /// Identifies the dictionary; another one may take its name.
    id: DictionaryId,
    name: DictionaryName,
    changes: watch::Receiver<()>,
    /// The state that was sent last.
    last: Option<DictionaryStatus>,
    /// The time at which it was sent.
    sent: Instant,
}

impl Farm {
    pub(crate) fn watch(self: &Arc<Self>, name: DictionaryName) -> Result<Watch> {
        // Subscribed before the first look, so that no change is missed in between.
        let changes = self.scheduler.changes();
        let (id, _) = self.found(&name)?;
        Ok(Watch { farm: self.clone(), id, name, changes, last: None, sent: Instant::now() })
    }
}

impl Watch {
    /// The next state that differs from the last, or the same again after [`REPEAT`]; None after the one in which the
    /// dictionary has ended.
    pub(crate) async fn next(&mut self) -> Result<Option<DictionaryStatus>> {
        if self.last.as_ref().is_some_and(|last| !last.state().is_open()) {
            return Ok(None);
        }
        loop {
            let now = self.look()?;
            let repeat = self.sent + REPEAT;
            if Instant::now() >= repeat || !self.last.as_ref().is_some_and(|last| same(&now, last)) {
                (self.last, self.sent) = (Some(now.clone()), Instant::now());
                return Ok(Some(now));
            }
            match timeout_at(repeat, self.changes.changed()).await {
                Ok(Ok(())) => {
                    tokio::time::sleep(PAUSE).await;
                    self.changes.mark_unchanged();
                }
                Ok(Err(_)) => return Ok(None),
                Err(_) => {}
            }
        }
    }

    fn look(&self) -> Result<DictionaryStatus> {
        self.farm.scheduler.query(|dispatcher, now| {
            let dictionary = dispatcher.schedule().by_id(self.id);
            let status = dictionary.map(|dictionary| dispatcher.status_of(now, dictionary));
            status.ok_or_else(|| FarmError::Deleted { name: self.name.clone() })
        })
    }
}

/// Whether two states are the same to a user: small changes of the remaining time do not count, since it changes all the
/// time.
fn same(a: &DictionaryStatus, b: &DictionaryStatus) -> bool {
    let near = match (a.eta_s, b.eta_s) {
        (Some(a), Some(b)) => (a - b).abs() <= 0.1 * a.max(b),
        (a, b) => a == b,
    };
    near && DictionaryStatus { eta_s: None, ..a.clone() } == DictionaryStatus { eta_s: None, ..b.clone() }
}
