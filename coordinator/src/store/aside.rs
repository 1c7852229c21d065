//! Sets results aside that are no longer trusted, until they have been computed again (tables `set_aside` and
//! `jobs_set_aside`).
//!
//! A suspected machine may be right, so nothing is deleted on suspicion: the points of a machine that is fenced off get a
//! random identity, so that no lookup finds them, and their jobs begin again. A job's records are deleted when it has
//! been done again; if the fence is lifted before, they are restored.

use farm_proto::ids::DictionaryId;
use optics_model::Digest;
use sqlx::SqliteConnection;

use super::points::{self, begin_jobs_again, delete_points, rows_of};
use super::{Exclusive, Result, doing, jobs};
use crate::stored::{EndedJob, Origin};
use optics_model::Walks;

/// Sets points aside, by their rows, on account of a machine. Returns the jobs that they had ended.
pub(super) async fn set_aside(
    tx: &mut SqliteConnection,
    points: &[i64],
    of: Option<Origin>,
) -> Result<Vec<(DictionaryId, u32)>> {
    let what = "setting records aside";
    if points.is_empty() {
        return Ok(Vec::new());
    }
    let rows = rows_of(points);
    sqlx::query(
        "INSERT INTO set_aside (point_id, identity, worker_id) \
         SELECT id, identity, ? FROM points WHERE id IN (SELECT value FROM json_each(?))",
    )
    .bind(of.map(|origin| origin.0))
    .bind(&rows)
    .execute(&mut *tx)
    .await
    .map_err(doing(what))?;
    for statement in [
        "UPDATE points SET identity = randomblob(32) WHERE id IN (SELECT value FROM json_each(?))",
        "INSERT INTO jobs_set_aside (point_id, dictionary_id, job, walks, records_digest) \
         SELECT point_id, dictionary_id, job, walks, records_digest FROM jobs \
         WHERE point_id IN (SELECT value FROM json_each(?)) AND records_digest IS NOT NULL",
    ] {
        sqlx::query(statement).bind(&rows).execute(&mut *tx).await.map_err(doing(what))?;
    }
    begin_jobs_again(tx, &rows).await
}

/// Deletes the results that were set aside of jobs that have been done again, and the blocks that were gathered for them.
pub(super) async fn done_again(
    tx: &mut SqliteConnection,
    jobs: impl Iterator<Item = (DictionaryId, u32)>,
    gathered: impl Iterator<Item = Digest>,
) -> Result<()> {
    let what = "deleting what was set aside";
    for (dictionary, job) in jobs {
        sqlx::query("DELETE FROM jobs_set_aside WHERE dictionary_id = ? AND job = ?")
            .bind(dictionary.0)
            .bind(job)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
    }
    let mut useless: Vec<i64> = sqlx::query_scalar(
        "SELECT point_id FROM set_aside WHERE point_id NOT IN (SELECT point_id FROM jobs_set_aside) \
         AND point_id NOT IN (SELECT point_id FROM sums)",
    )
    .fetch_all(&mut *tx)
    .await
    .map_err(doing(what))?;
    for identity in gathered {
        let of_blocks: Vec<i64> = sqlx::query_scalar("SELECT point_id FROM set_aside WHERE identity = ?")
            .bind(&identity.as_bytes()[..])
            .fetch_all(&mut *tx)
            .await
            .map_err(doing(what))?;
        useless.extend(of_blocks);
    }
    delete_points(tx, &useless).await?;
    Ok(())
}

struct AsideRow {
    dictionary_id: i64,
    job: i64,
    walks: Option<i64>,
    records_digest: Vec<u8>,
}

from_row!(AsideRow { dictionary_id, job, walks, records_digest });

impl Exclusive<'_> {
    /// Sets the records of a point aside; returns the jobs to be computed again.
    pub async fn set_point_aside(&self, identity: Digest) -> Result<Vec<(DictionaryId, u32)>> {
        let mut tx = self.store.begin().await?;
        let point: Vec<i64> =
            points::find(&mut tx, &[identity]).await?.into_iter().map(|(_, id)| id).collect();
        let jobs = set_aside(&mut tx, &point, None).await?;
        tx.commit().await.map_err(doing("setting a point's records aside"))?;
        Ok(jobs)
    }

    /// Sets the records of a job aside, in all dictionaries that share them; returns the jobs to be computed again.
    pub async fn set_job_aside(
        &self,
        dictionary: DictionaryId,
        job: u32,
    ) -> Result<Vec<(DictionaryId, u32)>> {
        let what = "setting a job's records aside";
        let mut tx = self.store.begin().await?;
        let point: Vec<i64> = sqlx::query_scalar(
            "SELECT point_id FROM jobs WHERE dictionary_id = ? AND job = ? AND point_id IS NOT NULL",
        )
        .bind(dictionary.0)
        .bind(job)
        .fetch_all(&mut *tx)
        .await
        .map_err(doing(what))?;
        let jobs = set_aside(&mut tx, &point, None).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(jobs)
    }

    /// Fences a machine off, and sets its results aside; returns the jobs to be computed again. Results that others have
    /// confirmed stay, credited to them.
    pub async fn fence(&self, worker: Origin, reason: &str) -> Result<Vec<(DictionaryId, u32)>> {
        let what = "fencing a worker off";
        let mut tx = self.store.begin().await?;
        sqlx::query("UPDATE workers SET fenced = ? WHERE id = ?")
            .bind(reason)
            .bind(worker.0)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
        for statement in [
            // One of the machines that have confirmed a point takes its place.
            "UPDATE contributions SET confirmed = 0 WHERE confirmed = 1 AND worker_id <> ?1 \
             AND point_id IN (SELECT point_id FROM contributions WHERE worker_id = ?1 AND confirmed = 0) \
             AND worker_id = (SELECT min(worker_id) FROM contributions AS others \
                              WHERE others.point_id = contributions.point_id AND confirmed = 1 AND worker_id <> ?1 \
                              AND worker_id NOT IN (SELECT id FROM workers WHERE fenced IS NOT NULL))",
            "DELETE FROM contributions WHERE worker_id = ?1 AND (confirmed = 1 OR point_id IN \
             (SELECT jobs.point_id FROM jobs JOIN contributions AS others ON others.point_id = jobs.point_id \
              WHERE walks <= 1000000 AND others.worker_id <> ?1 AND others.confirmed = 0))",
        ] {
            sqlx::query(statement).bind(worker.0).execute(&mut *tx).await.map_err(doing(what))?;
        }
        let its: Vec<i64> = sqlx::query_scalar(
            "SELECT point_id FROM contributions WHERE worker_id = ? \
             AND point_id NOT IN (SELECT point_id FROM set_aside)",
        )
        .bind(worker.0)
        .fetch_all(&mut *tx)
        .await
        .map_err(doing(what))?;
        let jobs = set_aside(&mut tx, &its, Some(worker)).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(jobs)
    }

    /// Readmits a machine, and restores the results that were set aside on its account, unless they have been computed
    /// again meanwhile. Returns the jobs that are done by that.
    pub async fn lift_fence(&self, machine: Origin) -> Result<Vec<(DictionaryId, EndedJob)>> {
        let what = "letting a machine in again";
        let mut tx = self.store.begin().await?;
        sqlx::query("UPDATE workers SET fenced = NULL WHERE id = ?")
            .bind(machine.0)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
        let points: Vec<i64> = sqlx::query_scalar(
            "SELECT point_id FROM set_aside WHERE worker_id = ? AND identity NOT IN (SELECT identity FROM points)",
        )
        .bind(machine.0)
        .fetch_all(&mut *tx)
        .await
        .map_err(doing(what))?;
        let rows = rows_of(&points);
        let taken: Vec<AsideRow> = sqlx::query_as(
            "INSERT INTO jobs (dictionary_id, job, point_id, walks, records_digest) \
             SELECT dictionary_id, job, point_id, walks, records_digest FROM jobs_set_aside \
             WHERE point_id IN (SELECT value FROM json_each(?)) \
             ON CONFLICT DO NOTHING RETURNING dictionary_id, job, walks, records_digest",
        )
        .bind(&rows)
        .fetch_all(&mut *tx)
        .await
        .map_err(doing(what))?;
        for statement in [
            "UPDATE points SET identity = (SELECT identity FROM set_aside WHERE point_id = points.id) \
             WHERE id IN (SELECT value FROM json_each(?))",
            "DELETE FROM jobs_set_aside WHERE point_id IN (SELECT value FROM json_each(?))",
            "DELETE FROM set_aside WHERE point_id IN (SELECT value FROM json_each(?))",
        ] {
            sqlx::query(statement).bind(&rows).execute(&mut *tx).await.map_err(doing(what))?;
        }
        tx.commit().await.map_err(doing(what))?;
        let ended = |row: AsideRow| {
            let (job, records) = (row.job as u32, jobs::decode_digest(row.job, &row.records_digest)?);
            let walks = row.walks.and_then(|walks| Walks::new(walks as u64).ok());
            Ok(walks.map(|walks| {
                let confirmed = Vec::new();
                let done =
                    EndedJob::Done { job, walks, records, by: Some(machine), confirmed, reused: false };
                (DictionaryId(row.dictionary_id), done)
            }))
        };
        taken.into_iter().map(ended).filter_map(Result::transpose).collect()
    }
}
