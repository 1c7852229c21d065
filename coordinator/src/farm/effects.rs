//! Makes the dispatcher's decisions durable, one effect after the other. An effect that fails is deferred and retried.

use std::sync::Weak;

use farm_proto::ids::DictionaryId;
use tokio::sync::mpsc;

use super::Farm;
use super::scheduler::Order;
use crate::dispatch::Effect;
use crate::store::{Exclusive, StoreError};

/// Performs orders as long as the farm exists. An effect that cannot be stored now is retried at the next look.
pub(super) async fn perform(farm: Weak<Farm>, mut orders: mpsc::UnboundedReceiver<Order>) {
    while let Some(order) = orders.recv().await {
        let Some(farm) = farm.upgrade() else { return };
        match order {
            Order::Perform(effect) => {
                // Performed in a separate task, so that a panic loses neither this decision nor those that follow.
                let performing = {
                    let (farm, effect) = (farm.clone(), effect.clone());
                    tokio::spawn(async move { farm.perform(&effect).await })
                };
                let failure = match performing.await {
                    Ok(performed) => performed.err().map(|error| error.to_string()),
                    Err(panic) => Some(panic.to_string()),
                };
                if let Some(error) = failure {
                    tracing::error!(error, "a decision could not be stored: it is tried again");
                    farm.scheduler.transition(|dispatcher, _| dispatcher.put_off(effect));
                }
                farm.scheduler.performed();
            }
            Order::Report(done) => drop(done.send(())),
        }
    }
}

impl Farm {
    async fn perform(&self, effect: &Effect) -> Result<(), StoreError> {
        match effect {
            Effect::GiveUp { dictionary, job, reason, quarantined } => {
                self.store.give_up_job(*dictionary, *job, reason, *quarantined).await
            }
            Effect::NoteCheck(check) => self.store.note_check(check).await,
        }
    }

    /// Begins jobs again whose records the store has deleted, under the guard that is still held.
    pub(super) fn begin_again(&self, _held: &Exclusive<'_>, mut jobs: Vec<(DictionaryId, u32)>) {
        jobs.sort_unstable();
        for of_one in jobs.chunk_by(|a, b| a.0 == b.0) {
            let id = of_one[0].0;
            let numbers: Vec<u32> = of_one.iter().map(|(_, job)| *job).collect();
            self.scheduler.transition(|dispatcher, _| dispatcher.reopen(id, &numbers));
            self.fits.forget(id);
        }
    }
}
