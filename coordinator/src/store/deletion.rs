//! Deleting points, with all that belongs to them.

use farm_proto::ids::DictionaryId;
use optics_model::Digest;
use sqlx::SqliteConnection;

use super::{Result, Store, aside, doing, points};
use crate::stored::Origin;

/// What went with some points.
#[derive(Debug, Default)]
pub(super) struct Deleted {
    /// Jobs that had ended with their records, in all dictionaries that share them.
    pub jobs: Vec<(DictionaryId, u32)>,
    pub records: u64,
}

/// Rows as one text, however many there are: a statement takes a limited number of values.
pub(super) fn rows_of(points: &[i64]) -> String {
    format!("[{}]", points.iter().map(ToString::to_string).collect::<Vec<_>>().join(","))
}

/// Deletes points by their rows, with their records and sums, who computed them, and the jobs that they ended.
pub(super) async fn delete_points(tx: &mut SqliteConnection, points: &[i64]) -> Result<Deleted> {
    let what = "deleting points";
    if points.is_empty() {
        return Ok(Deleted::default());
    }
    let rows = rows_of(points);
    let jobs: Vec<(i64, i64)> = sqlx::query_as(
        "DELETE FROM jobs WHERE point_id IN (SELECT value FROM json_each(?)) RETURNING dictionary_id, job",
    )
    .bind(&rows)
    .fetch_all(&mut *tx)
    .await
    .map_err(doing(what))?;
    let records = sqlx::query("DELETE FROM records WHERE point_id IN (SELECT value FROM json_each(?))")
        .bind(&rows)
        .execute(&mut *tx)
        .await
        .map_err(doing(what))?
        .rows_affected();
    // Last the points: the others refer to them.
    for delete in [
        "DELETE FROM jobs_set_aside WHERE point_id IN (SELECT value FROM json_each(?))",
        "DELETE FROM set_aside WHERE point_id IN (SELECT value FROM json_each(?))",
        "DELETE FROM sums WHERE point_id IN (SELECT value FROM json_each(?))",
        "DELETE FROM contributions WHERE point_id IN (SELECT value FROM json_each(?))",
        "DELETE FROM points WHERE id IN (SELECT value FROM json_each(?))",
    ] {
        sqlx::query(delete).bind(&rows).execute(&mut *tx).await.map_err(doing(what))?;
    }
    let jobs = jobs.into_iter().map(|(dictionary, job)| (DictionaryId(dictionary), job as u32)).collect();
    Ok(Deleted { jobs, records })
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

    /// Sets the records of a point aside: the jobs to be computed again.
    pub async fn set_point_aside(&self, identity: Digest) -> Result<Vec<(DictionaryId, u32)>> {
        let mut tx = self.begin().await?;
        let point: Vec<i64> =
            points::find(&mut tx, &[identity]).await?.into_iter().map(|(_, id)| id).collect();
        let jobs = aside::set_aside(&mut tx, &point, None).await?;
        tx.commit().await.map_err(doing("setting a point's records aside"))?;
        Ok(jobs)
    }

    /// Forgets the records of a point: the jobs to be computed again.
    pub async fn forget_point(&self, identity: Digest) -> Result<Vec<(DictionaryId, u32)>> {
        let mut tx = self.begin().await?;
        let point: Vec<i64> =
            points::find(&mut tx, &[identity]).await?.into_iter().map(|(_, id)| id).collect();
        let deleted = delete_points(&mut tx, &point).await?;
        tx.commit().await.map_err(doing("forgetting a point's records"))?;
        Ok(deleted.jobs)
    }

    /// Sets the records of a job aside, in all dictionaries that share them: the jobs to be computed again.
    pub async fn set_job_aside(
        &self,
        dictionary: DictionaryId,
        job: u32,
    ) -> Result<Vec<(DictionaryId, u32)>> {
        let what = "setting a job's records aside";
        let mut tx = self.begin().await?;
        let point: Vec<i64> = sqlx::query_scalar(
            "SELECT point_id FROM jobs WHERE dictionary_id = ? AND job = ? AND point_id IS NOT NULL",
        )
        .bind(dictionary.0)
        .bind(job)
        .fetch_all(&mut *tx)
        .await
        .map_err(doing(what))?;
        let jobs = aside::set_aside(&mut tx, &point, None).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(jobs)
    }

    /// Fences a machine off, and sets all aside that it has computed: the jobs to be computed again. What others have
    /// confirmed stays, in their name.
    pub async fn fence(&self, worker: Origin, reason: &str) -> Result<Vec<(DictionaryId, u32)>> {
        let what = "fencing a worker off";
        let mut tx = self.begin().await?;
        sqlx::query("UPDATE workers SET fenced = ? WHERE id = ?")
            .bind(reason)
            .bind(worker.0)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
        for statement in [
            // One of those who have confirmed it takes its place.
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
        let jobs = aside::set_aside(&mut tx, &its, Some(worker)).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(jobs)
    }

    /// Deletes a dictionary, the records that no other one uses, and the blocks that some points gather; returns the
    /// number of records.
    pub async fn delete_dictionary(&self, id: DictionaryId, gathered: &[Digest]) -> Result<u64> {
        let what = "deleting a dictionary";
        let mut tx = self.begin().await?;
        let mut unused: Vec<i64> = sqlx::query_scalar(
            "SELECT point_id FROM jobs WHERE dictionary_id = ?1 AND point_id IS NOT NULL \
             EXCEPT SELECT point_id FROM jobs WHERE dictionary_id <> ?1 AND point_id IS NOT NULL",
        )
        .bind(id.0)
        .fetch_all(&mut *tx)
        .await
        .map_err(doing(what))?;
        unused.extend(points::find(&mut tx, gathered).await?.into_iter().map(|(_, point)| point));
        for delete in [
            "DELETE FROM votes WHERE dictionary_id = ?",
            "DELETE FROM jobs_set_aside WHERE dictionary_id = ?",
            "DELETE FROM jobs WHERE dictionary_id = ?",
            "DELETE FROM dictionaries WHERE id = ?",
        ] {
            sqlx::query(delete).bind(id.0).execute(&mut *tx).await.map_err(doing(what))?;
        }
        let deleted = delete_points(&mut tx, &unused).await?;
        aside::done_again(&mut tx, std::iter::empty(), gathered.iter().copied()).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(deleted.records)
    }
}
