//! Table `records`: the numbers of finished jobs as bytes, held against what was stored.
//!
//! A job's records are those that were stored if all are there, each has the form that the grid prescribes, and together
//! they have the digest that the job's row tells. Whoever reads records reads them here, so that all mean the same by
//! damage.
//!
//! Damage found at one reading may lie in memory, a cable or a cache: only a second one, on a connection of its own, tells
//! that the disk has other records than were stored. An error of reading says nothing about records.

use std::ops::Range;

use farm_proto::ids::DictionaryId;
use optics_model::job::JobSpec;
use optics_model::profile::RecordShape;
use optics_model::{Grid, PackedRecords};
use sqlx::{Connection, FromRow, SqliteConnection};

use super::{Result, Store, StoreError, doing, jobs};

/// The records of a finished job, which are those that were stored.
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

/// What a reading found of a job.
pub type Found = std::result::Result<JobRecords, Damaged>;

/// A record of a job that is done; a job that has lost all of its records has one row without any.
#[derive(FromRow)]
struct RecordRow<'r> {
    job: i64,
    records_digest: &'r [u8],
    id: Option<i64>,
    albedo: Option<f64>,
    profiles: Option<&'r [u8]>,
}

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

    /// Reads a job that is known to be finished by itself, on a connection of its own: what others keep in memory may be
    /// what is wrong.
    pub async fn job_read_again(&self, dictionary: DictionaryId, grid: &Grid, job: u32) -> Result<Found> {
        let range = job as usize..job as usize + 1;
        let mut connection = self.fresh_connection().await?;
        let found = read(&mut connection, dictionary, grid, range.clone()).await;
        // It has only read.
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
    let rows = sqlx::query(
        "SELECT job, records_digest, records.id, albedo, profiles \
         FROM jobs LEFT JOIN records ON records.point_id = jobs.point_id \
         WHERE dictionary_id = ? AND job >= ? AND job < ? AND records_digest IS NOT NULL ORDER BY job, albedo",
    )
    .bind(dictionary.0)
    .bind(range.start as i64)
    .bind(range.end.min(grid.job_count()) as i64)
    .fetch_all(connection)
    .await
    .map_err(doing(what))?;
    let rows: sqlx::Result<Vec<RecordRow<'_>>> = rows.iter().map(RecordRow::from_row).collect();
    let rows = rows.map_err(doing(what))?;
    Ok(rows.chunk_by(|a, b| a.job == b.job).map(|of_job| check(grid, of_job)).collect())
}

/// Puts a job's records together and compares them with what was stored.
fn check(grid: &Grid, rows: &[RecordRow<'_>]) -> Found {
    let job = rows[0].job as u32;
    let damaged = |what: String| Damaged { job, what };
    let digest = jobs::decode_digest(rows[0].job, rows[0].records_digest);
    let digest = digest.map_err(|error| damaged(error.to_string()))?;
    let bytes = put_together(grid, rows).map_err(damaged)?;
    let records = PackedRecords::new(&JobSpec::of(grid, job as usize), bytes.into());
    let records = records.map_err(|error| damaged(format!("its records cannot be: {error}")))?;
    if records.digest() != digest {
        return Err(damaged("its records differ from what was stored".to_owned()));
    }
    Ok(JobRecords { job, records })
}

/// The bytes of all records that the grid asks for, or why there are none.
fn put_together(grid: &Grid, rows: &[RecordRow<'_>]) -> Result<Vec<u8>, String> {
    let (albedo, record_bytes) = (grid.albedo(), RecordShape::of(grid).bytes());
    let mut bytes = Vec::with_capacity(albedo.len() * record_bytes);
    // Rows come with rising albedos, as the grid has them.
    for RecordRow { id, albedo: of_row, profiles, .. } in rows {
        // The point may hold more albedos than this dictionary asks for.
        let (Some(of_row), Some(profiles)) = (of_row, profiles) else { continue };
        if !albedo.contains(of_row) {
            continue;
        }
        if profiles.len() != record_bytes {
            let row = id.unwrap_or_default();
            let why = format!("it has {} bytes: {record_bytes} are needed", profiles.len());
            return Err(StoreError::Corrupt { table: "records", row, column: "profiles", why }.to_string());
        }
        bytes.extend_from_slice(profiles);
    }
    let found = bytes.len() / record_bytes;
    if found == albedo.len() {
        Ok(bytes)
    } else {
        Err(format!("{found} records of {} are there", albedo.len()))
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
