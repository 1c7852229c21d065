//! Reads the records of finished jobs (table `records`), and verifies them against the digests that were stored with them.
//!
//! A job's records are those that were stored if all are present, each has the form that the grid prescribes, and
//! together they have the digest in the job's row. All records are read here, so that damage has one definition.
//!
//! Damage found at one reading may stem from memory, a cable or a cache: only a second reading, on a separate connection,
//! shows that the disk holds other records than were stored. A read error is no evidence of damage.

use std::ops::Range;

use farm_proto::ids::DictionaryId;
use optics_model::job::JobSpec;
use optics_model::profile::RecordShape;
use optics_model::{Grid, Layout, PackedRecords};
use sqlx::{Connection, FromRow, SqliteConnection};
use tokio_stream::StreamExt;

use super::{Result, Store, StoreError, doing, jobs};

/// The verified records of a finished job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobRecords {
    pub job: u32,
    pub records: PackedRecords,
}

/// The records of a job are not those that were stored.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("job {job}: {what}")]
pub struct Damaged {
    pub job: u32,
    pub what: String,
}

/// The result of reading a job.
pub type Found = std::result::Result<JobRecords, Damaged>;

/// A record of a job that is done; a job that has lost all of its records has one row without any.
struct RecordRow<'r> {
    job: i64,
    records_digest: &'r [u8],
    id: Option<i64>,
    albedo: Option<f64>,
    profiles: Option<&'r [u8]>,
}

from_row!(RecordRow<'r> { job, records_digest, id, albedo, profiles });

impl Store {
    /// The records of those jobs of a range that are finished, in their order.
    pub async fn finished_jobs(
        &self,
        dictionary: DictionaryId,
        grid: &Grid,
        range: Range<usize>,
    ) -> Result<Vec<Found>> {
        let mut connection = self.read.acquire().await.map_err(doing("reading records"))?;
        read(&mut connection, dictionary, grid, range).await
    }

    /// The records of all jobs of a range, which are known to be finished: one whose end is missing is damaged.
    pub async fn all_jobs(
        &self,
        dictionary: DictionaryId,
        grid: &Grid,
        range: Range<usize>,
    ) -> Result<Vec<Found>> {
        let found = self.finished_jobs(dictionary, grid, range.clone()).await?;
        Ok(with_missing(found, range))
    }

    /// Reads a job that is known to be finished by itself, on a separate connection: the cache of the others may be damaged.
    pub async fn job_read_again(&self, dictionary: DictionaryId, grid: &Grid, job: u32) -> Result<Found> {
        let range = job as usize..job as usize + 1;
        let mut connection = self.fresh_connection().await?;
        let found = read(&mut connection, dictionary, grid, range.clone()).await;
        // The connection has only read: an error in closing it does no harm.
        let _ = connection.close().await;
        Ok(with_missing(found?, range).remove(0))
    }
}

async fn read(
    connection: &mut SqliteConnection,
    dictionary: DictionaryId,
    grid: &Grid,
    range: Range<usize>,
) -> Result<Vec<Found>> {
    let what = "reading records";
    let mut rows = sqlx::query(
        "SELECT job, records_digest, records.id, albedo, profiles \
         FROM jobs LEFT JOIN records ON records.point_id = jobs.point_id \
         WHERE dictionary_id = ? AND job >= ? AND job < ? AND records_digest IS NOT NULL ORDER BY job, albedo",
    )
    .bind(dictionary.0)
    .bind(range.start as i64)
    .bind(range.end.min(grid.job_count()) as i64)
    .fetch(connection);
    let (mut found, mut gathered) = (Vec::new(), None::<Gathered>);
    while let Some(row) = rows.try_next().await.map_err(doing(what))? {
        let row = RecordRow::from_row(&row).map_err(doing(what))?;
        found.extend(gathered.take_if(|of_job| of_job.job != row.job).map(|of_job| of_job.check(grid)));
        gathered.get_or_insert_with(|| Gathered::new(&row, grid)).add(&row, grid);
    }
    found.extend(gathered.map(|of_job| of_job.check(grid)));
    Ok(found)
}

/// The records of a job, gathered from its rows in ascending order of albedo, which is that of the grid.
struct Gathered {
    job: i64,
    digest: Vec<u8>,
    /// The layout of the first record: all records of a point are of one program version.
    layout: Layout,
    bytes: Vec<u8>,
    /// The error of the first record with a wrong length.
    corrupt: Option<StoreError>,
}

impl Gathered {
    fn new(first: &RecordRow<'_>, grid: &Grid) -> Self {
        let shape = RecordShape::of(grid);
        let layout = first.profiles.and_then(|profiles| Layout::of_record(profiles.len(), shape));
        let layout = layout.unwrap_or(Layout::Bytes);
        let bytes = Vec::with_capacity(grid.albedo().len() * layout.record_bytes(shape));
        Self { job: first.job, digest: first.records_digest.to_owned(), layout, bytes, corrupt: None }
    }

    fn add(&mut self, row: &RecordRow<'_>, grid: &Grid) {
        let (Some(albedo), Some(profiles)) = (row.albedo, row.profiles) else { return };
        // The point may hold more albedos than this dictionary needs.
        if !grid.albedo().contains(&albedo) {
            return;
        }
        let wanted = self.layout.record_bytes(RecordShape::of(grid));
        if profiles.len() == wanted {
            self.bytes.extend_from_slice(profiles);
        } else {
            let why = format!("it has {} bytes: {wanted} are needed", profiles.len());
            let row = row.id.unwrap_or_default();
            let corrupt = || StoreError::Corrupt { table: "records", row, column: "profiles", why };
            self.corrupt.get_or_insert_with(corrupt);
        }
    }

    /// Compares the records with the stored digest.
    fn check(self, grid: &Grid) -> Found {
        let job = self.job as u32;
        self.verified(grid).map(|records| JobRecords { job, records }).map_err(|what| Damaged { job, what })
    }

    fn verified(self, grid: &Grid) -> Result<PackedRecords, String> {
        let digest = jobs::decode_digest(self.job, &self.digest).map_err(|error| error.to_string())?;
        if let Some(corrupt) = self.corrupt {
            return Err(corrupt.to_string());
        }
        let size = self.layout.record_bytes(RecordShape::of(grid));
        let (found, wanted) = (self.bytes.len() / size, grid.albedo().len());
        if found != wanted {
            return Err(format!("{found} records of {wanted} are there"));
        }
        let job = JobSpec::of(grid, self.job as usize);
        let records = PackedRecords::in_layout(self.layout, &job, self.bytes.into())
            .map_err(|error| format!("its records cannot be: {error}"))?;
        if records.digest() != digest {
            return Err("its records differ from what was stored".to_owned());
        }
        Ok(records)
    }
}

/// Adds those jobs of a range that were not found, as damaged.
fn with_missing(found: Vec<Found>, range: Range<usize>) -> Vec<Found> {
    let mut found = found.into_iter().peekable();
    let job_of = |found: &Found| found.as_ref().map_or_else(|damaged| damaged.job, |intact| intact.job);
    let each = |job: usize| {
        let job = job as u32;
        let missing = || Err(Damaged { job, what: "its end is missing".to_owned() });
        found.next_if(|found| job_of(found) == job).unwrap_or_else(missing)
    };
    range.map(each).collect()
}

#[cfg(test)]
mod tests;
