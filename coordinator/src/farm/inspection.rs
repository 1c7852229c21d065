//! Inspects the whole database.

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use optics_model::Grid;

use super::Farm;
use super::records::UNSTEADY;
use crate::store::{JobRecords, StoreError};

/// The findings of an inspection of the whole database.
#[derive(Debug, Default)]
pub(crate) struct Inspection {
    pub jobs: usize,
    pub records: usize,
    /// Jobs whose records are not those that were stored, at two readings.
    pub damaged: Vec<(DictionaryName, u32, String)>,
    pub unreadable: Vec<Unreadable>,
    /// The faults of the file that SQLite reports, and damaged measurements.
    pub faults: Vec<String>,
    /// The reason why SQLite could not check the file.
    pub unchecked: Option<String>,
}

/// Jobs of a dictionary that could not be read, so that their state is not known; nothing of them was deleted.
#[derive(Debug)]
pub(crate) struct Unreadable {
    pub name: DictionaryName,
    pub jobs: usize,
    /// The first of them; `what` is the reason.
    pub first: u32,
    pub what: String,
}

/// The state of a job's records.
enum Look {
    /// The job is not done.
    Nothing,
    /// Number of its records.
    Good(usize),
    Damaged(String),
    Unreadable(String),
}

impl Farm {
    /// Compares all records with their digests. Jobs that are damaged are computed again if `repair` is set.
    pub(crate) async fn inspect(&self, repair: bool) -> Inspection {
        let all: Vec<_> = self.scheduler.query(|dispatcher, _| {
            dispatcher
                .schedule()
                .dictionaries()
                .map(|d| (d.name().clone(), d.id(), d.grid().clone()))
                .collect()
        });
        let mut inspection = Inspection::default();
        match self.store.faults().await {
            Ok(faults) => inspection.faults = faults,
            Err(error) => inspection.unchecked = Some(error.to_string()),
        }
        match self.store.damaged_measurements().await {
            Ok(damaged) => inspection.faults.extend(damaged.iter().map(|id| {
                format!(
                    "the content of kept measurement {id} is not what was stored (`farmctl measurements delete {id}` removes \
                     it)"
                )
            })),
            Err(error) => inspection.unchecked = Some(error.to_string()),
        }
        for (name, id, grid) in all {
            for job in 0..grid.job_count() as u32 {
                let look = self.look_at(id, &grid, job, repair).await;
                inspection.note(&name, job, look.unwrap_or_else(|error| Look::Unreadable(error.to_string())));
            }
        }
        for Unreadable { name, jobs, first, what } in &inspection.unreadable {
            tracing::error!(%name, jobs, first, what, "jobs could not be read");
        }
        inspection
    }

    async fn look_at(
        &self,
        id: DictionaryId,
        grid: &Grid,
        job: u32,
        repair: bool,
    ) -> Result<Look, StoreError> {
        let range = job as usize..job as usize + 1;
        match self.store.finished_jobs(id, grid, range).await?.pop() {
            None => return Ok(Look::Nothing),
            Some(Ok(JobRecords { records, .. })) => return Ok(Look::Good(records.numbers().len())),
            Some(Err(_)) => {}
        }
        let confirmed = if repair {
            self.forget_if_damaged(id, grid, job).await?
        } else {
            self.damage_of(id, grid, job).await?
        };
        Ok(confirmed.map_or_else(|| Look::Unreadable(UNSTEADY.to_owned()), Look::Damaged))
    }
}

impl Inspection {
    fn note(&mut self, name: &DictionaryName, job: u32, look: Look) {
        match look {
            Look::Nothing => {}
            Look::Good(records) => {
                self.jobs += 1;
                self.records += records;
            }
            Look::Damaged(what) => {
                self.jobs += 1;
                self.damaged.push((name.clone(), job, what));
            }
            Look::Unreadable(what) => match self.unreadable.last_mut().filter(|last| last.name == *name) {
                Some(last) => last.jobs += 1,
                None => self.unreadable.push(Unreadable { name: name.clone(), jobs: 1, first: job, what }),
            },
        }
    }
}
