//! Table `dictionaries`.

use farm_proto::ids::DictionaryId;
use farm_proto::{DictionaryName, Digest, Grid, wire};
use prost::Message;

use super::{Result, Store, StoreError, doing};

#[derive(Debug, Clone, PartialEq)]
pub struct StoredDictionary {
    pub id: DictionaryId,
    pub name: DictionaryName,
    pub grid: Grid,
    pub grid_digest: Digest,
    pub created_unix_ms: u64,
}

#[derive(sqlx::FromRow)]
struct DictionaryRow {
    id: i64,
    name: String,
    grid: Vec<u8>,
    grid_digest: Vec<u8>,
    created_unix_ms: i64,
}

impl TryFrom<DictionaryRow> for StoredDictionary {
    type Error = StoreError;

    fn try_from(row: DictionaryRow) -> Result<Self> {
        let corrupt =
            |column, why: String| StoreError::Corrupt { table: "dictionaries", row: row.id, column, why };
        let grid = wire::Grid::decode(&row.grid[..]).map_err(|e| corrupt("grid", e.to_string()))?;
        let digest = <[u8; 32]>::try_from(&row.grid_digest[..])
            .map_err(|_| corrupt("grid_digest", format!("{} bytes", row.grid_digest.len())))?;
        Ok(Self {
            id: DictionaryId(row.id),
            name: DictionaryName::new(row.name.clone()).map_err(|e| corrupt("name", e.to_string()))?,
            grid: Grid::try_from(grid).map_err(|e| corrupt("grid", e.to_string()))?,
            grid_digest: Digest::from_bytes(digest),
            created_unix_ms: row.created_unix_ms as u64,
        })
    }
}

impl Store {
    pub async fn dictionaries(&self) -> Result<Vec<StoredDictionary>> {
        let rows: Vec<DictionaryRow> = sqlx::query_as(
            "SELECT id, name, grid, grid_digest, created_unix_ms FROM dictionaries ORDER BY id",
        )
        .fetch_all(&self.read)
        .await
        .map_err(doing("reading the dictionaries"))?;
        rows.into_iter().map(TryInto::try_into).collect()
    }

    /// Fails with [`StoreError::NameTaken`] if there is one of this name.
    pub async fn create_dictionary(
        &self,
        name: DictionaryName,
        grid: Grid,
        created_unix_ms: u64,
    ) -> Result<StoredDictionary> {
        let grid_digest = Digest::of_grid(&grid);
        let insert = sqlx::query(
            "INSERT INTO dictionaries (name, grid, grid_digest, created_unix_ms) VALUES (?, ?, ?, ?)",
        )
        .bind(name.as_str())
        .bind(wire::Grid::from(&grid).encode_to_vec())
        .bind(&grid_digest.as_bytes()[..])
        .bind(created_unix_ms as i64)
        .execute(&self.write)
        .await;
        let done = insert.map_err(|source| match &source {
            sqlx::Error::Database(e) if e.is_unique_violation() => StoreError::NameTaken,
            _ => doing("creating the dictionary")(source),
        })?;
        Ok(StoredDictionary {
            id: DictionaryId(done.last_insert_rowid()),
            name,
            grid,
            grid_digest,
            created_unix_ms,
        })
    }
}
