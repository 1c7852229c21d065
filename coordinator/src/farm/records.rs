//! Reads records, and has them computed again when the disk returns others than were stored.
//!
//! Records are deleted only if two readings differ from what was stored: a read that fails is no evidence about them,
//! and a difference at one reading alone stems from memory, a cable or a cache.

use std::ops::Range;

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use optics_fit::{FitDictionary, Stop};
use optics_model::scene::Channel;
use optics_model::{Grid, Invalid, Record};
use tokio::task::JoinError;

use super::asked_grid::AskedGrid;
use super::{Farm, FarmError, Result};
use crate::dispatch::EventKind;
use crate::store::{Damaged, JobRecords, StoreError};

/// The message about records that were damaged at the first reading, and not at the second.
pub(super) const UNSTEADY: &str = "it differed from what was stored at one reading, and not at the next";

impl Farm {
    /// Finished records of a dictionary among the numbers of a range, in order. Every one is compared with its digest.
    pub(crate) async fn records(&self, name: &DictionaryName, range: Range<usize>) -> Result<Vec<Record>> {
        let (id, grid) = self.found(name)?;
        let albedos = grid.albedo().len();
        let jobs = range.start / albedos..range.end.div_ceil(albedos);
        let mut wanted = Vec::with_capacity(range.len());
        for found in self.store.finished_jobs(id, &grid, jobs).await? {
            match found {
                Ok(JobRecords { records, .. }) => {
                    let numbers = records.numbers().filter(|number| range.contains(number));
                    wanted.extend(numbers.map(|number| records.record(number)));
                }
                Err(Damaged { job, .. }) => return Err(self.confirm_damage(name, id, &grid, job).await),
            }
        }
        Ok(wanted)
    }

    /// The error of a job that was damaged when it was read: it is read again, and computed again if it is damaged then too.
    async fn confirm_damage(
        &self,
        name: &DictionaryName,
        id: DictionaryId,
        grid: &Grid,
        job: u32,
    ) -> FarmError {
        let name = name.clone();
        match self.forget_if_damaged(id, grid, job).await {
            Ok(Some(what)) => FarmError::Damaged { name, job, what },
            Ok(None) => FarmError::Unreadable { name, job, what: UNSTEADY.to_owned() },
            Err(error) => FarmError::Unreadable { name, job, what: error.to_string() },
        }
    }

    /// The damage that a separate reading of a job's records finds; None if they are intact.
    pub(super) async fn damage_of(
        &self,
        id: DictionaryId,
        grid: &Grid,
        job: u32,
    ) -> Result<Option<String>, StoreError> {
        Ok(self.store.job_read_again(id, grid, job).await?.err().map(|damaged| damaged.what))
    }

    /// Reads a job once more. If that finds damage too, the job is computed again unless its dictionary is paused or
    /// cancelled.
    pub(super) async fn forget_if_damaged(
        &self,
        id: DictionaryId,
        grid: &Grid,
        job: u32,
    ) -> Result<Option<String>, StoreError> {
        let exclusive = self.store.ledger().exclusive().await;
        let Some(what) = self.damage_of(id, grid, job).await? else { return Ok(None) };
        let mut again = exclusive.delete_job(id, job).await?;
        // A job that has lost its end has no records to be deleted.
        again.push((id, job));
        self.begin_again(&exclusive, again);
        drop(exclusive);
        self.scheduler
            .transition(|dispatcher, _| dispatcher.note(id, Some(job), EventKind::JobDamaged, what.as_str()));
        Ok(Some(what))
    }

    /// Answers a question to a complete dictionary, off the async threads. The question is about the channels of these
    /// names, or the first if none is given; over the boards of `boards`, if the dictionary is for all boards. When the
    /// answer is no longer awaited, the work ends soon.
    pub(crate) async fn ask<T: Send + 'static>(
        &self,
        name: &DictionaryName,
        (channels, boards): (&[String], Vec<Channel>),
        question: impl FnOnce(&FitDictionary) -> Result<T, Invalid> + Send + 'static,
    ) -> Result<T> {
        let (id, grid) = self.found(name)?;
        let status = self.status(name)?;
        if status.records_digest.is_none() {
            let (done, total) = (status.records_done(), status.records_total());
            return Err(FarmError::NotComplete { name: name.clone(), done, total });
        }
        let asked = AskedGrid::new(grid.clone(), boards)?;
        let channels = optics_fit::channels_called(&asked.grid, channels.iter().map(String::as_str));
        let dictionary = match self.fits.get(&self.store, (name, id), &asked, &channels).await {
            Err(FarmError::Damaged { job, .. }) => {
                return Err(self.confirm_damage(name, id, &grid, job).await);
            }
            dictionary => dictionary?,
        };
        let (wanted, metrics) = (Wanted::default(), self.metrics().clone());
        let stop = wanted.0.clone();
        let answer = tokio::task::spawn_blocking(move || {
            dictionary.ask(&stop, question).map_err(|_| {
                metrics.fit_stopped();
                FarmError::Stopping
            })
        });
        Ok(answer.await.map_err(|error| ended_early(&error))???)
    }
}

/// The error of work that has ended without a result. A panic is in the log.
pub(super) fn ended_early(error: &JoinError) -> FarmError {
    if error.is_panic() { FarmError::Defect } else { FarmError::Stopping }
}

/// A question whose answer is awaited, until this is dropped.
#[derive(Debug, Default)]
struct Wanted(Stop);

impl Drop for Wanted {
    fn drop(&mut self) {
        self.0.stop();
    }
}
