//! Stores and reads kept measurements (table `measurements`). Their content is opaque here; a digest finds damage.

use optics_model::Digest;
use sqlx::SqliteConnection;

use super::{Result, Store, StoreError, doing};

/// A kept measurement without its content.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredMeasurement {
    /// Its place in the list: the newest has the greatest number. The store assigns it.
    pub number: i64,
    pub id: String,
    pub kept_unix_ms: i64,
    pub owner: String,
    pub title: String,
    pub note: String,
    pub source: String,
    pub command: String,
    pub dictionary: String,
    /// One name per line.
    pub materials: String,
    pub channels: i64,
}

from_row!(StoredMeasurement {
    number,
    id,
    kept_unix_ms,
    owner,
    title,
    note,
    source,
    command,
    dictionary,
    materials,
    channels
});

struct ContentRow {
    number: i64,
    content: Vec<u8>,
    content_digest: Vec<u8>,
}

from_row!(ContentRow { number, content, content_digest });

impl ContentRow {
    fn checked(self) -> Result<Vec<u8>> {
        if Digest::of_bytes(&self.content).as_bytes()[..] == self.content_digest[..] {
            return Ok(self.content);
        }
        let why = "it is not the one that was stored: its digest differs".to_owned();
        Err(StoreError::Corrupt { table: "measurements", row: self.number, column: "content", why })
    }
}

/// Selects what is listed of measurements.
macro_rules! listed {
    ($which:literal) => {
        concat!(
            "SELECT number, id, kept_unix_ms, owner, title, note, source, command, dictionary, materials, channels \
             FROM measurements ",
            $which
        )
    };
}

async fn content(connection: &mut SqliteConnection, id: &str) -> Result<Option<Vec<u8>>> {
    let select = "SELECT number, content, content_digest FROM measurements WHERE id = ?";
    let row: Option<ContentRow> =
        sqlx::query_as(select).bind(id).fetch_optional(connection).await.map_err(doing(READING))?;
    row.map(ContentRow::checked).transpose()
}

const WHAT: &str = "storing a measurement";
const READING: &str = "reading the kept measurements";

impl Store {
    /// Keeps a measurement as the newest one, in the place of one with the same id, whose title and note stay where the new
    /// ones are empty. A new one without a title has its materials as title.
    pub async fn keep_measurement(&self, kept: &StoredMeasurement, content: &[u8]) -> Result<()> {
        let mut tx = self.begin().await?;
        let before: Option<(String, String)> =
            sqlx::query_as("DELETE FROM measurements WHERE id = ? RETURNING title, note")
                .bind(&kept.id)
                .fetch_optional(&mut *tx)
                .await
                .map_err(doing(WHAT))?;
        let (title, note) = before.unwrap_or_else(|| (kept.materials.replace('\n', ", "), String::new()));
        sqlx::query(
            "INSERT INTO measurements (id, kept_unix_ms, owner, title, note, source, command, dictionary, materials, \
             channels, content, content_digest) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(&kept.id)
        .bind(kept.kept_unix_ms)
        .bind(&kept.owner)
        .bind(if kept.title.is_empty() { &title } else { &kept.title })
        .bind(if kept.note.is_empty() { &note } else { &kept.note })
        .bind(&kept.source)
        .bind(&kept.command)
        .bind(&kept.dictionary)
        .bind(&kept.materials)
        .bind(kept.channels)
        .bind(content)
        .bind(&Digest::of_bytes(content).as_bytes()[..])
        .execute(&mut *tx)
        .await
        .map_err(doing(WHAT))?;
        tx.commit().await.map_err(doing(WHAT))
    }

    /// Measurements with smaller numbers than this, the newest first.
    pub async fn measurements_before(&self, number: i64, most: u32) -> Result<Vec<StoredMeasurement>> {
        sqlx::query_as(listed!("WHERE number < ? ORDER BY number DESC LIMIT ?"))
            .bind(number)
            .bind(most)
            .fetch_all(&self.read)
            .await
            .map_err(doing(READING))
    }

    pub async fn measurement(&self, id: &str) -> Result<Option<StoredMeasurement>> {
        let found = sqlx::query_as(listed!("WHERE id = ?")).bind(id).fetch_optional(&self.read);
        found.await.map_err(doing(READING))
    }

    /// A measurement and its content as they are at one time.
    pub async fn measurement_with_content(&self, id: &str) -> Result<Option<(StoredMeasurement, Vec<u8>)>> {
        let mut tx = self.read.begin().await.map_err(doing(READING))?;
        let listed = sqlx::query_as(listed!("WHERE id = ?")).bind(id).fetch_optional(&mut *tx);
        let listed: Option<StoredMeasurement> = listed.await.map_err(doing(READING))?;
        Ok(listed.zip(content(&mut tx, id).await?))
    }

    /// The content of a measurement, compared with its digest.
    pub async fn measurement_content(&self, id: &str) -> Result<Option<Vec<u8>>> {
        let mut connection = self.read.acquire().await.map_err(doing(READING))?;
        content(&mut connection, id).await
    }

    /// Number of measurements that an owner keeps, and the bytes of their contents.
    pub async fn measurements_of(&self, owner: &str) -> Result<(u64, u64)> {
        let select = "SELECT count(*), coalesce(sum(length(content)), 0) FROM measurements WHERE owner = ?";
        let (count, bytes): (i64, i64) =
            sqlx::query_as(select).bind(owner).fetch_one(&self.read).await.map_err(doing(READING))?;
        Ok((count as u64, bytes as u64))
    }

    /// Replaces what is given.
    pub async fn annotate_measurement(
        &self,
        id: &str,
        title: Option<&str>,
        note: Option<&str>,
    ) -> Result<()> {
        sqlx::query(
            "UPDATE measurements SET title = coalesce(?, title), note = coalesce(?, note) WHERE id = ?",
        )
        .bind(title)
        .bind(note)
        .bind(id)
        .execute(self.writer()?)
        .await
        .map_err(doing("annotating a measurement"))?;
        Ok(())
    }

    pub async fn delete_measurement(&self, id: &str) -> Result<()> {
        sqlx::query("DELETE FROM measurements WHERE id = ?")
            .bind(id)
            .execute(self.writer()?)
            .await
            .map_err(doing("deleting a measurement"))?;
        Ok(())
    }

    /// Ids of the measurements whose content is damaged.
    pub async fn damaged_measurements(&self) -> Result<Vec<String>> {
        let mut damaged = Vec::new();
        let mut before = i64::MAX;
        while let Some(kept) = self.measurements_before(before, 1).await?.pop() {
            before = kept.number;
            match self.measurement_content(&kept.id).await {
                Ok(_) => {}
                Err(StoreError::Corrupt { .. }) => damaged.push(kept.id),
                Err(error) => return Err(error),
            }
        }
        Ok(damaged)
    }
}
