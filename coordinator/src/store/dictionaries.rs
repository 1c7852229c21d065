//! Stores and reads dictionaries (table `dictionaries`).

use std::sync::Arc;

use farm_proto::ids::DictionaryId;
use farm_proto::{DictionaryName, wire};
use optics_model::{Digest, Grid};
use prost::Message;

use super::{Result, Store, StoreError, doing};
use crate::stored::{DesiredState, StoredDictionary};

struct DictionaryRow {
    id: i64,
    name: String,
    grid: Vec<u8>,
    grid_digest: Vec<u8>,
    created_unix_ms: i64,
    priority: i64,
    desire: String,
    reason: String,
    owner: String,
}

from_row!(DictionaryRow { id, name, grid, grid_digest, created_unix_ms, priority, desire, reason, owner });

impl TryFrom<DictionaryRow> for StoredDictionary {
    type Error = StoreError;

    fn try_from(row: DictionaryRow) -> Result<Self> {
        let corrupt =
            |column, why: String| StoreError::Corrupt { table: "dictionaries", row: row.id, column, why };
        let grid = wire::Grid::decode(&row.grid[..]).map_err(|e| corrupt("grid", e.to_string()))?;
        let digest = <[u8; 32]>::try_from(&row.grid_digest[..])
            .map_err(|_| corrupt("grid_digest", format!("{} bytes", row.grid_digest.len())))?;
        let grid = Grid::try_from(grid).map_err(|e| corrupt("grid", e.to_string()))?;
        let grid_digest = Digest::from_bytes(digest);
        // The records do not contain the scene in which they were computed.
        if grid_digest.physics_version_of(&grid).is_none() {
            return Err(corrupt("grid", "it is not the one that was stored: its digest differs".to_owned()));
        }
        let desire = [DesiredState::Run, DesiredState::Pause, DesiredState::Cancel]
            .into_iter()
            .find(|d| d.as_str() == row.desire);
        Ok(Self {
            id: DictionaryId(row.id),
            name: DictionaryName::new(row.name.clone()).map_err(|e| corrupt("name", e.to_string()))?,
            grid: Arc::new(grid),
            grid_digest,
            created_unix_ms: row.created_unix_ms as u64,
            priority: row.priority as i32,
            desire: desire.ok_or_else(|| corrupt("desire", row.desire.clone()))?,
            reason: row.reason.clone(),
            owner: row.owner.clone(),
        })
    }
}

impl Store {
    pub async fn dictionaries(&self) -> Result<Vec<StoredDictionary>> {
        let rows: Vec<DictionaryRow> = sqlx::query_as(
            "SELECT id, name, grid, grid_digest, created_unix_ms, priority, desire, reason, owner \
             FROM dictionaries ORDER BY id",
        )
        .fetch_all(&self.read)
        .await
        .map_err(doing("reading the dictionaries"))?;
        rows.into_iter().map(TryInto::try_into).collect()
    }

    /// Creates a dictionary. Fails with [`StoreError::NameTaken`] if there is one of this name.
    pub async fn create_dictionary(
        &self,
        name: DictionaryName,
        grid: Grid,
        priority: i32,
        owner: &str,
        created_unix_ms: u64,
    ) -> Result<StoredDictionary> {
        let grid_digest = Digest::of_grid(&grid);
        // A number that was used before may occur in a late result: it must not be used again.
        let insert = sqlx::query(
            "INSERT INTO dictionaries (id, name, grid, grid_digest, created_unix_ms, priority, owner) \
             VALUES (max(?1, (SELECT coalesce(max(id), 0) + 1 FROM dictionaries)), ?2, ?3, ?4, ?1, ?5, ?6)",
        )
        .bind(created_unix_ms as i64)
        .bind(name.as_str())
        .bind(wire::Grid::from(&grid).encode_to_vec())
        .bind(&grid_digest.as_bytes()[..])
        .bind(priority)
        .bind(owner)
        .execute(self.writer()?)
        .await;
        let done = insert.map_err(|source| match &source {
            sqlx::Error::Database(e) if e.is_unique_violation() => StoreError::NameTaken,
            _ => doing("creating the dictionary")(source),
        })?;
        Ok(StoredDictionary {
            id: DictionaryId(done.last_insert_rowid()),
            name,
            grid: Arc::new(grid),
            grid_digest,
            created_unix_ms,
            priority,
            desire: DesiredState::Run,
            reason: String::new(),
            owner: owner.to_owned(),
        })
    }

    pub async fn set_desire(&self, id: DictionaryId, desire: DesiredState, reason: &str) -> Result<()> {
        sqlx::query("UPDATE dictionaries SET desire = ?, reason = ? WHERE id = ?")
            .bind(desire.as_str())
            .bind(reason)
            .bind(id.0)
            .execute(self.writer()?)
            .await
            .map_err(doing("storing the desired state of a dictionary"))?;
        Ok(())
    }

    pub async fn set_priority(&self, id: DictionaryId, priority: i32) -> Result<()> {
        sqlx::query("UPDATE dictionaries SET priority = ? WHERE id = ?")
            .bind(priority)
            .bind(id.0)
            .execute(self.writer()?)
            .await
            .map_err(doing("storing a priority"))?;
        Ok(())
    }
}
