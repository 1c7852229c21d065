//! Reading records, and what is done when the disk gives back others than were stored.

use std::ops::Range;

use farm_proto::ids::DictionaryId;
use farm_proto::{DictionaryName, Grid, Invalid, Record};

use super::{Farm, FarmError, Result, blocking};
use crate::dispatch::{Event, EventKind};
use crate::fit::FitDictionary;
use crate::store::{StoreError, StoredJob};

impl Farm {
    /// Finished records of a dictionary among the numbers of a range, in order. Every one is compared with its digest.
    pub(crate) async fn records(&self, name: &DictionaryName, range: Range<usize>) -> Result<Vec<Record>> {
        let (id, grid) = self.found(name)?;
        let albedos = grid.albedo().len();
        let jobs = range.start / albedos..range.end.div_ceil(albedos);
        let stored = self.checked_jobs(name, id, &grid, jobs).await?;
        let wanted = stored.into_iter().flat_map(|job| job.records).filter(|r| range.contains(&r.index));
        Ok(wanted.collect())
    }

    async fn checked_jobs(
        &self,
        name: &DictionaryName,
        id: DictionaryId,
        grid: &Grid,
        jobs: Range<usize>,
    ) -> Result<Vec<StoredJob>> {
        let stored = match self.store.jobs_with_records(id, grid, jobs.clone()).await {
            Err(StoreError::Corrupt { table: "records", .. }) => {
                self.readable_jobs(name, id, grid, jobs).await?
            }
            stored => stored?,
        };
        for job in &stored {
            if let Some(what) = job.damage(grid.albedo().len()) {
                return Err(self.damaged(name, id, job.job, what).await);
            }
        }
        Ok(stored)
    }

    /// One by one, to find which job cannot be read.
    async fn readable_jobs(
        &self,
        name: &DictionaryName,
        id: DictionaryId,
        grid: &Grid,
        jobs: Range<usize>,
    ) -> Result<Vec<StoredJob>> {
        let mut found = Vec::new();
        for job in jobs {
            match self.store.jobs_with_records(id, grid, job..job + 1).await {
                Ok(stored) => found.extend(stored),
                Err(error) => return Err(self.damaged(name, id, job as u32, error.to_string()).await),
            }
        }
        Ok(found)
    }

    /// Lets a damaged job be computed again, if its dictionary goes on, and tells so.
    async fn damaged(&self, name: &DictionaryName, id: DictionaryId, job: u32, what: String) -> FarmError {
        self.recorder.record(
            name.as_str(),
            &Event { job: Some(job), ..Event::of_dictionary(EventKind::JobDamaged, id, what.clone()) },
        );
        match self.forget_job(id, job).await {
            Ok(()) => {
                self.work.send_replace(());
                self.changed.send_replace(());
                FarmError::Damaged { name: name.clone(), job, what }
            }
            Err(error) => error.into(),
        }
    }

    /// Compares all records with their digests: jobs, records, and the jobs that are damaged. These are computed again
    /// if `repair` says so.
    pub(crate) async fn inspect(&self, repair: bool) -> Result<Inspection> {
        let all: Vec<_> = {
            let dispatch = self.dispatch();
            dispatch.dictionaries().map(|d| (d.name().clone(), d.id(), d.grid().clone())).collect()
        };
        let mut inspection = Inspection { faults: self.store.faults().await?, ..Inspection::default() };
        for (name, id, grid) in all {
            let step = (read_chunk(&grid) / grid.albedo().len()).max(1);
            for first in (0..grid.job_count()).step_by(step) {
                for job in first..(first + step).min(grid.job_count()) {
                    let stored = self.store.jobs_with_records(id, &grid, job..job + 1).await;
                    let what = match stored {
                        Ok(stored) => {
                            inspection.jobs += stored.len();
                            inspection.records += stored.iter().map(|j| j.records.len()).sum::<usize>();
                            stored.iter().find_map(|j| j.damage(grid.albedo().len()))
                        }
                        Err(error) => Some(error.to_string()),
                    };
                    let Some(what) = what else { continue };
                    if repair {
                        let _ = self.damaged(&name, id, job as u32, what.clone()).await;
                    }
                    inspection.damaged.push((name.clone(), job as u32, what));
                }
            }
        }
        Ok(inspection)
    }

    /// Answers a question to a complete dictionary, off the async threads.
    pub(crate) async fn ask<T: Send + 'static>(
        &self,
        name: &DictionaryName,
        question: impl FnOnce(&FitDictionary) -> Result<T, Invalid> + Send + 'static,
    ) -> Result<T> {
        let (id, grid) = self.found(name)?;
        let status = self.status(name)?;
        if status.records_digest.is_none() {
            let (done, total) = (status.records_done(), status.records_total());
            return Err(FarmError::NotComplete { name: name.clone(), done, total });
        }
        let dictionary = match self.fits.get(&self.store, name, id, grid).await {
            Err(FarmError::Damaged { job, what, .. }) => return Err(self.damaged(name, id, job, what).await),
            dictionary => dictionary?,
        };
        Ok(blocking(move || question(&dictionary)).await?)
    }
}

/// What a look at the whole database found.
#[derive(Debug, Default)]
pub(crate) struct Inspection {
    pub jobs: usize,
    pub records: usize,
    pub damaged: Vec<(DictionaryName, u32, String)>,
    /// What SQLite finds wrong with the file.
    pub faults: Vec<String>,
}

/// Records of a grid that are read at a time: some 8 MiB.
pub(crate) fn read_chunk(grid: &Grid) -> usize {
    ((8 << 20) / grid.record_bytes()).clamp(1, 1024)
}
