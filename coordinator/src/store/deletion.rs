//! Deletes dictionaries and points, with all that belongs to them.

use farm_proto::ids::DictionaryId;
use optics_model::Digest;
use optics_model::job::JobSpec;

use super::points::{self, delete_points};
use super::{Exclusive, LedgerGuard, Result, Store, doing};

impl LedgerGuard<'_> {
    /// Deletes the blocks that were gathered for a divided job. No job has ended with them.
    pub async fn delete_blocks(&self, job: &JobSpec) -> Result<()> {
        delete_point(self.store, job.sums_identity()).await.map(drop)
    }
}

impl Exclusive<'_> {
    /// Deletes the records of a point; returns the jobs to be computed again.
    pub async fn delete_point(&self, identity: Digest) -> Result<Vec<(DictionaryId, u32)>> {
        delete_point(self.store, identity).await
    }

    /// Deletes the records of a job, in all dictionaries that share them; returns the jobs to be computed again.
    pub async fn delete_job(&self, dictionary: DictionaryId, job: u32) -> Result<Vec<(DictionaryId, u32)>> {
        let what = "deleting a job's records";
        let mut tx = self.store.begin().await?;
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

    /// Deletes a dictionary, the records that no other one uses, and the blocks that some points gather; returns the
    /// number of records.
    pub async fn delete_dictionary(&self, id: DictionaryId, gathered: &[Digest]) -> Result<u64> {
        let what = "deleting a dictionary";
        let mut tx = self.store.begin().await?;
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
            "DELETE FROM claims WHERE dictionary_id = ?",
            "DELETE FROM jobs WHERE dictionary_id = ?",
            "DELETE FROM dictionaries WHERE id = ?",
        ] {
            sqlx::query(delete).bind(id.0).execute(&mut *tx).await.map_err(doing(what))?;
        }
        let deleted = delete_points(&mut tx, &unused).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(deleted.records)
    }
}

async fn delete_point(store: &Store, identity: Digest) -> Result<Vec<(DictionaryId, u32)>> {
    let mut tx = store.begin().await?;
    let point: Vec<i64> = points::find(&mut tx, &[identity]).await?.into_iter().map(|(_, id)| id).collect();
    let deleted = delete_points(&mut tx, &point).await?;
    tx.commit().await.map_err(doing("deleting a point's records"))?;
    Ok(deleted.jobs)
}
