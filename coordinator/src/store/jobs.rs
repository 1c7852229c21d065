//! Table `jobs`: those that have ended.

use farm_proto::ids::DictionaryId;
use farm_proto::{Digest, Record};
use sqlx::{Connection, SqliteConnection};

use super::{Result, Store, StoreError, doing, records};

/// How a job ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum EndedJob {
    Done { job: u32, records: Digest },
    Failed { job: u32, reason: String },
}

/// What became of a job's records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Completion {
    /// They are stored, durably.
    Stored,
    /// The same records were stored before.
    Duplicate,
    /// Other records were stored before; these are refused.
    Conflict,
}

#[derive(sqlx::FromRow)]
struct JobRow {
    job: i64,
    records_digest: Option<Vec<u8>>,
    failure: Option<String>,
}

impl TryFrom<JobRow> for EndedJob {
    type Error = StoreError;

    fn try_from(row: JobRow) -> Result<Self> {
        let job = row.job as u32;
        match (row.records_digest, row.failure) {
            (Some(digest), None) => Ok(Self::Done { job, records: decode_digest(row.job, &digest)? }),
            (None, Some(reason)) => Ok(Self::Failed { job, reason }),
            _ => Err(corrupt(row.job, "neither done nor failed".to_owned())),
        }
    }
}

fn corrupt(row: i64, why: String) -> StoreError {
    StoreError::Corrupt { table: "jobs", row, column: "records_digest", why }
}

fn decode_digest(job: i64, bytes: &[u8]) -> Result<Digest> {
    let bytes = bytes.try_into().map_err(|_| corrupt(job, format!("{} bytes", bytes.len())))?;
    Ok(Digest::from_bytes(bytes))
}

impl Store {
    pub async fn ended_jobs(&self, dictionary: DictionaryId) -> Result<Vec<EndedJob>> {
        let rows: Vec<JobRow> = sqlx::query_as(
            "SELECT job, records_digest, failure FROM jobs WHERE dictionary_id = ? ORDER BY job",
        )
        .bind(dictionary.0)
        .fetch_all(&self.read)
        .await
        .map_err(doing("reading the jobs"))?;
        rows.into_iter().map(TryInto::try_into).collect()
    }

    /// Commits a job's records and its end in one transaction. A job that is done already keeps the records it
    /// has; one that was given up becomes done.
    pub async fn complete_job(
        &self,
        dictionary: DictionaryId,
        job: u32,
        digest: Digest,
        records: &[Record],
    ) -> Result<Completion> {
        let mut connection = self.write.acquire().await.map_err(doing("waiting for the database"))?;
        let completed = complete_in(&mut connection, dictionary, job, digest, records).await;
        if completed.is_err() {
            // On a full disk SQLite ends the transaction by itself and sqlx still counts it as open: the connection
            // would refuse every later one.
            connection.close_on_drop();
        }
        completed
    }

    pub async fn fail_job(&self, dictionary: DictionaryId, job: u32, reason: &str) -> Result<()> {
        sqlx::query("INSERT OR IGNORE INTO jobs (dictionary_id, job, failure) VALUES (?, ?, ?)")
            .bind(dictionary.0)
            .bind(job)
            .bind(reason)
            .execute(&self.write)
            .await
            .map_err(doing("storing the failure of a job"))?;
        Ok(())
    }
}

async fn complete_in(
    connection: &mut SqliteConnection,
    dictionary: DictionaryId,
    job: u32,
    digest: Digest,
    records: &[Record],
) -> Result<Completion> {
    let mut tx =
        connection.begin_with("BEGIN IMMEDIATE").await.map_err(doing("beginning to store records"))?;
    let stored: Option<(Option<Vec<u8>>,)> =
        sqlx::query_as("SELECT records_digest FROM jobs WHERE dictionary_id = ? AND job = ?")
            .bind(dictionary.0)
            .bind(job)
            .fetch_optional(&mut *tx)
            .await
            .map_err(doing("looking for the job"))?;
    if let Some((Some(stored),)) = stored {
        let same = decode_digest(i64::from(job), &stored)? == digest;
        return Ok(if same { Completion::Duplicate } else { Completion::Conflict });
    }
    sqlx::query("INSERT OR REPLACE INTO jobs (dictionary_id, job, records_digest) VALUES (?, ?, ?)")
        .bind(dictionary.0)
        .bind(job)
        .bind(&digest.as_bytes()[..])
        .execute(&mut *tx)
        .await
        .map_err(doing("storing the end of a job"))?;
    records::insert(&mut tx, dictionary, records).await?;
    tx.commit().await.map_err(doing("committing records"))?;
    Ok(Completion::Stored)
}
