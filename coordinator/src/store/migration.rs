//! What SQL alone cannot migrate: the records of the first schema, which belonged to dictionaries, are moved to points.

use std::sync::Arc;

use farm_proto::ids::DictionaryId;
use optics_model::{Digest, Grid};
use sqlx::SqliteConnection;

use super::{Result, Store, doing, points};
use crate::stored::StoredDictionary;

const WHAT: &str = "moving records to the present schema";

impl Store {
    /// In one transaction, so that a process that is killed leaves everything as it was.
    pub(super) async fn move_records_of_first_schema(&self) -> Result<()> {
        let table: Option<(i64,)> = sqlx::query_as(
            "SELECT 1 FROM sqlite_schema WHERE type = 'table' AND name = 'records_of_dictionaries'",
        )
        .fetch_optional(self.writer()?)
        .await
        .map_err(doing(WHAT))?;
        if table.is_none() {
            return Ok(());
        }
        let dictionaries = self.dictionaries().await?;
        let mut tx = self.begin().await?;
        for StoredDictionary { id, grid, .. } in dictionaries {
            move_dictionary(&mut tx, id, &grid).await?;
        }
        sqlx::query("DROP TABLE records_of_dictionaries").execute(&mut *tx).await.map_err(doing(WHAT))?;
        tx.commit().await.map_err(doing(WHAT))
    }
}

async fn move_dictionary(tx: &mut SqliteConnection, id: DictionaryId, grid: &Arc<Grid>) -> Result<()> {
    let jobs: Vec<(i64,)> =
        sqlx::query_as("SELECT job FROM jobs WHERE dictionary_id = ? AND records_digest IS NOT NULL")
            .bind(id.0)
            .fetch_all(&mut *tx)
            .await
            .map_err(doing(WHAT))?;
    for (job,) in jobs {
        // Of an older physics version: nothing computed today has the same identity.
        let identity = Digest::of_bytes(format!("schema 1, dictionary {}, job {job}", id.0).as_bytes());
        let point = points::point(tx, identity).await?;
        let first = grid.first_record(job as usize);
        for (albedo, record) in grid.albedo().iter().zip(first..) {
            sqlx::query(
                "INSERT INTO records (point_id, albedo, profiles) \
                 SELECT ?, ?, profiles FROM records_of_dictionaries WHERE dictionary_id = ? AND record = ?",
            )
            .bind(point)
            .bind(albedo)
            .bind(id.0)
            .bind(record as i64)
            .execute(&mut *tx)
            .await
            .map_err(doing(WHAT))?;
        }
        sqlx::query("UPDATE jobs SET point_id = ?, walks = ? WHERE dictionary_id = ? AND job = ?")
            .bind(point)
            .bind(grid.walks_of(job as usize).get() as i64)
            .bind(id.0)
            .bind(job)
            .execute(&mut *tx)
            .await
            .map_err(doing(WHAT))?;
    }
    Ok(())
}
