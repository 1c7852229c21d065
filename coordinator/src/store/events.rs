//! Stores and reads the event log (table `events`).

use super::{Result, Store, doing};

/// Number of events that are kept.
const KEPT: i64 = 100_000;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredEvent {
    pub id: i64,
    pub unix_ms: i64,
    pub kind: String,
    pub dictionary: String,
    pub job: Option<i64>,
    pub worker: String,
    pub message: String,
    /// Name and address of the caller that caused it; empty if the farm did.
    pub actor: String,
}

from_row!(StoredEvent { id, unix_ms, kind, dictionary, job, worker, message, actor });

impl Store {
    /// Appends events, whose numbers the store assigns, and deletes the oldest if there are too many.
    pub async fn add_events(&self, events: &[StoredEvent]) -> Result<()> {
        let what = "storing events";
        let mut tx = self.begin().await?;
        let mut last = 0;
        for event in events {
            let inserted = sqlx::query(
                "INSERT INTO events (unix_ms, kind, dictionary, job, worker, message, actor) VALUES (?, ?, ?, ?, ?, ?, ?)",
            )
            .bind(event.unix_ms)
            .bind(&event.kind)
            .bind(&event.dictionary)
            .bind(event.job)
            .bind(&event.worker)
            .bind(&event.message)
            .bind(&event.actor)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
            last = inserted.last_insert_rowid();
        }
        sqlx::query("DELETE FROM events WHERE id <= ?")
            .bind(last - KEPT)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
        tx.commit().await.map_err(doing(what))
    }

    /// Events after a number, the oldest first, of one dictionary or of all.
    pub async fn events_after(&self, after: i64, dictionary: &str, most: u32) -> Result<Vec<StoredEvent>> {
        sqlx::query_as(
            "SELECT id, unix_ms, kind, dictionary, job, worker, message, actor FROM events \
             WHERE id > ?1 AND (?2 = '' OR dictionary = ?2) ORDER BY id LIMIT ?3",
        )
        .bind(after)
        .bind(dictionary)
        .bind(most)
        .fetch_all(&self.read)
        .await
        .map_err(doing("reading events"))
    }

    /// The newest events, the oldest of them first.
    pub async fn newest_events(&self, dictionary: &str, most: u32) -> Result<Vec<StoredEvent>> {
        let mut events: Vec<StoredEvent> = sqlx::query_as(
            "SELECT id, unix_ms, kind, dictionary, job, worker, message, actor FROM events \
             WHERE ?1 = '' OR dictionary = ?1 ORDER BY id DESC LIMIT ?2",
        )
        .bind(dictionary)
        .bind(most)
        .fetch_all(&self.read)
        .await
        .map_err(doing("reading events"))?;
        events.reverse();
        Ok(events)
    }
}
