//! Table `workers`: processes that have registered, and those that are fenced off.

use farm_proto::ids::DictionaryId;

use super::{Result, Store, doing, points};

impl Store {
    /// Row of a worker's process, made if it is the first time.
    pub async fn worker(&self, instance: &str, label: &str) -> Result<i64> {
        let (id,): (i64,) = sqlx::query_as(
            "INSERT INTO workers (instance, label) VALUES (?, ?) \
             ON CONFLICT (instance) DO UPDATE SET label = excluded.label RETURNING id",
        )
        .bind(instance)
        .bind(label)
        .fetch_one(&self.write)
        .await
        .map_err(doing("storing a worker"))?;
        Ok(id)
    }

    /// Workers that are fenced off, with the reasons.
    pub async fn fenced(&self) -> Result<Vec<(i64, String)>> {
        sqlx::query_as("SELECT id, fenced FROM workers WHERE fenced IS NOT NULL")
            .fetch_all(&self.read)
            .await
            .map_err(doing("reading the workers"))
    }

    /// Fences a worker off and forgets all that it has computed: the jobs to be computed again.
    pub async fn fence(&self, worker: i64, reason: &str) -> Result<Vec<(DictionaryId, u32)>> {
        let mut tx = self.begin().await?;
        sqlx::query("UPDATE workers SET fenced = ? WHERE id = ?")
            .bind(reason)
            .bind(worker)
            .execute(&mut *tx)
            .await
            .map_err(doing("fencing a worker off"))?;
        let its = "SELECT point_id FROM contributions WHERE worker_id = ?1";
        let forgotten = points::forget_points(&mut tx, its, [worker]).await?;
        tx.commit().await.map_err(doing("fencing a worker off"))?;
        Ok(forgotten)
    }
}
