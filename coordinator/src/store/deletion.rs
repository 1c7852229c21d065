//! Deleting points, with all that belongs to them.

use farm_proto::ids::DictionaryId;
use optics_model::Digest;
use sqlx::SqliteConnection;

use super::{Result, Store, doing, points};
use crate::stored::Origin;

/// What went with some points.
#[derive(Debug, Default)]
pub(super) struct Deleted {
    /// Jobs that had ended with their records, in all dictionaries that share them.
    pub jobs: Vec<(DictionaryId, u32)>,
    pub records: u64,
}

/// Deletes points by their rows, with their records and sums, who computed them, and the jobs that they ended.
pub(super) async fn delete_points(tx: &mut SqliteConnection, points: &[i64]) -> Result<Deleted> {
    let what = "deleting points";
    if points.is_empty() {
        return Ok(Deleted::default());
    }
    // One text, however many there are: a statement takes a limited number of values.
    let rows = format!("[{}]", points.iter().map(ToString::to_string).collect::<Vec<_>>().join(","));
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
    /// Forgets the records of a point: the jobs to be computed again.
    pub async fn forget_point(&self, identity: Digest) -> Result<Vec<(DictionaryId, u32)>> {
        let mut tx = self.begin().await?;
        let point: Vec<i64> =
            points::find(&mut tx, &[identity]).await?.into_iter().map(|(_, id)| id).collect();
        let deleted = delete_points(&mut tx, &point).await?;
        tx.commit().await.map_err(doing("forgetting a point's records"))?;
        Ok(deleted.jobs)
    }

    /// Forgets the records of a job, in all dictionaries that share them: the jobs to be computed again.
    pub async fn forget_job(&self, dictionary: DictionaryId, job: u32) -> Result<Vec<(DictionaryId, u32)>> {
        let what = "forgetting a job's records";
        let mut tx = self.begin().await?;
        let point: Vec<i64> = sqlx::query_scalar(
            "SELECT point_id FROM jobs WHERE dictionary_id = ? AND job = ? AND point_id IS NOT NULL",
        )
        .bind(dictionary.0)
        .bind(job)
        .fetch_all(&mut *tx)
        .await
        .map_err(doing(what))?;
        let deleted = delete_points(&mut tx, &point).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(deleted.jobs)
    }

    /// Fences a worker off and forgets all that it has computed: the jobs to be computed again.
    pub async fn fence(&self, worker: Origin, reason: &str) -> Result<Vec<(DictionaryId, u32)>> {
        let what = "fencing a worker off";
        let mut tx = self.begin().await?;
        sqlx::query("UPDATE workers SET fenced = ? WHERE id = ?")
            .bind(reason)
            .bind(worker.0)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
        let its: Vec<i64> = sqlx::query_scalar("SELECT point_id FROM contributions WHERE worker_id = ?")
            .bind(worker.0)
            .fetch_all(&mut *tx)
            .await
            .map_err(doing(what))?;
        let deleted = delete_points(&mut tx, &its).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(deleted.jobs)
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
        for delete in ["DELETE FROM jobs WHERE dictionary_id = ?", "DELETE FROM dictionaries WHERE id = ?"] {
            sqlx::query(delete).bind(id.0).execute(&mut *tx).await.map_err(doing(what))?;
        }
        let deleted = delete_points(&mut tx, &unused).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(deleted.records)
    }
}
