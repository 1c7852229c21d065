//! Table `workers`: processes that have registered, and those that are fenced off.

use farm_proto::ids::DictionaryId;

use super::{Result, Store, doing};
use crate::stored::Origin;

impl Store {
    /// Row of a worker's process, made if it is the first time.
    pub async fn register_worker(&self, instance: &str, label: &str) -> Result<Origin> {
        let (id,): (i64,) = sqlx::query_as(
            "INSERT INTO workers (instance, label) VALUES (?, ?) \
             ON CONFLICT (instance) DO UPDATE SET label = excluded.label RETURNING id",
        )
        .bind(instance)
        .bind(label)
        .fetch_one(&self.write)
        .await
        .map_err(doing("storing a worker"))?;
        Ok(Origin(id))
    }

    /// Workers that are fenced off, with the reasons.
    pub async fn fenced_workers(&self) -> Result<Vec<(Origin, String)>> {
        let rows: Vec<(i64, String)> =
            sqlx::query_as("SELECT id, fenced FROM workers WHERE fenced IS NOT NULL")
                .fetch_all(&self.read)
                .await
                .map_err(doing("reading the workers"))?;
        Ok(rows.into_iter().map(|(id, reason)| (Origin(id), reason)).collect())
    }

    /// Notes that a worker, too, has computed the records that a job has.
    pub async fn note_agreement(&self, dictionary: DictionaryId, job: u32, worker: Origin) -> Result<()> {
        sqlx::query(
            "INSERT OR IGNORE INTO contributions (point_id, worker_id) \
             SELECT point_id, ? FROM jobs WHERE dictionary_id = ? AND job = ? AND point_id IS NOT NULL",
        )
        .bind(worker.0)
        .bind(dictionary.0)
        .bind(job)
        .execute(&self.write)
        .await
        .map_err(doing("noting that a result was checked"))?;
        Ok(())
    }

    /// Forgets workers of which nothing is left. One that is still there registers again under a new number.
    pub(super) async fn forget_useless_workers(&self) -> Result<()> {
        sqlx::query(
            "DELETE FROM workers WHERE fenced IS NULL AND id NOT IN (SELECT worker_id FROM contributions)",
        )
        .execute(&self.write)
        .await
        .map_err(doing("forgetting workers of which nothing is left"))?;
        Ok(())
    }
}
