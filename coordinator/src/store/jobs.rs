//! Stores and reads the jobs that have ended (table `jobs`).

use farm_proto::ids::DictionaryId;
use optics_model::{Digest, Grid, Walks};

use super::{Result, Store, StoreError, doing};
use crate::stored::{EndedJob, Origin};

struct JobRow {
    job: i64,
    walks: Option<i64>,
    records_digest: Option<Vec<u8>>,
    reused: bool,
    failure: Option<String>,
    quarantined: bool,
    worker: Option<i64>,
    verified: bool,
}

from_row!(JobRow { job, walks, records_digest, reused, failure, quarantined, worker, verified });

impl JobRow {
    fn decode(self, grid: &Grid) -> Result<EndedJob> {
        let job = self.job as u32;
        match (self.records_digest, self.failure) {
            (Some(digest), None) => {
                // The first schema did not note the walks: all jobs had those of the grid.
                let walks = self.walks.map_or_else(
                    || Ok(grid.walks_of(job as usize)),
                    |walks| Walks::new(walks as u64).map_err(|e| corrupt(self.job, "walks", e.to_string())),
                )?;
                let records = decode_digest(self.job, &digest)?;
                let Self { reused, verified, .. } = self;
                Ok(EndedJob::Done { job, walks, records, by: self.worker.map(Origin), verified, reused })
            }
            (None, Some(reason)) => Ok(EndedJob::GivenUp { job, reason, quarantined: self.quarantined }),
            _ => Err(corrupt(self.job, "records_digest", "neither done nor failed".to_owned())),
        }
    }
}

fn corrupt(row: i64, column: &'static str, why: String) -> StoreError {
    StoreError::Corrupt { table: "jobs", row, column, why }
}

pub(super) fn decode_digest(job: i64, bytes: &[u8]) -> Result<Digest> {
    let bytes =
        bytes.try_into().map_err(|_| corrupt(job, "records_digest", format!("{} bytes", bytes.len())))?;
    Ok(Digest::from_bytes(bytes))
}

impl Store {
    /// Jobs that have ended with the records of a point.
    pub async fn jobs_of_point(&self, identity: Digest) -> Result<Vec<(DictionaryId, u32)>> {
        let rows: Vec<(i64, i64)> = sqlx::query_as(
            "SELECT dictionary_id, job FROM jobs JOIN points ON points.id = point_id WHERE identity = ?",
        )
        .bind(&identity.as_bytes()[..])
        .fetch_all(&self.read)
        .await
        .map_err(doing("looking for jobs of a point"))?;
        Ok(rows.into_iter().map(|(dictionary, job)| (DictionaryId(dictionary), job as u32)).collect())
    }

    /// Jobs of a dictionary that have ended.
    pub async fn ended_jobs(&self, dictionary: DictionaryId, grid: &Grid) -> Result<Vec<EndedJob>> {
        let rows: Vec<JobRow> = sqlx::query_as(
            "SELECT job, walks, records_digest, reused, failure, quarantined, verified, \
             (SELECT CASE count(*) WHEN 1 THEN min(worker_id) END FROM contributions \
              WHERE contributions.point_id = jobs.point_id) AS worker FROM jobs WHERE dictionary_id = ? ORDER BY job",
        )
        .bind(dictionary.0)
        .fetch_all(&self.read)
        .await
        .map_err(doing("reading the jobs"))?;
        rows.into_iter().map(|row| row.decode(grid)).collect()
    }

    /// Notes that the records of a job are those that the coordinator itself has computed.
    pub async fn note_verified(&self, dictionary: DictionaryId, job: u32) -> Result<()> {
        sqlx::query("UPDATE jobs SET verified = 1 WHERE dictionary_id = ? AND job = ? AND failure IS NULL")
            .bind(dictionary.0)
            .bind(job)
            .execute(self.writer()?)
            .await
            .map_err(doing("noting that a result was checked"))?;
        Ok(())
    }

    pub async fn give_up_job(
        &self,
        dictionary: DictionaryId,
        job: u32,
        reason: &str,
        quarantined: bool,
    ) -> Result<()> {
        sqlx::query(
            "INSERT OR IGNORE INTO jobs (dictionary_id, job, failure, quarantined) VALUES (?, ?, ?, ?)",
        )
        .bind(dictionary.0)
        .bind(job)
        .bind(reason)
        .bind(quarantined)
        .execute(self.writer()?)
        .await
        .map_err(doing("storing the failure of a job"))?;
        Ok(())
    }

    /// Deletes the failures of jobs that were given up.
    pub async fn retry_jobs(&self, dictionary: DictionaryId) -> Result<u64> {
        let deleted = sqlx::query("DELETE FROM jobs WHERE dictionary_id = ? AND failure IS NOT NULL")
            .bind(dictionary.0)
            .execute(self.writer()?)
            .await
            .map_err(doing("trying jobs again"))?;
        Ok(deleted.rows_affected())
    }
}
