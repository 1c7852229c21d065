//! Sends several statements to SQLite together.

use sqlx::query_builder::Separated;
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::ROWS;
use crate::store::{Result, doing};

/// Most rows of a script that is likely to recur: a job of the paper's grid has 43.
const SMALL: usize = 64;

/// Gathers rows to be inserted, for several tables, and writes many of them at once.
pub(super) struct Script<'c> {
    tx: &'c mut SqliteConnection,
    query: QueryBuilder<Sqlite>,
    rows: usize,
}

impl<'c> Script<'c> {
    pub(super) fn new(tx: &'c mut SqliteConnection) -> Self {
        Self { tx, query: QueryBuilder::new(""), rows: 0 }
    }

    /// Inserts rows; `into` is the statement up to its values, `bind` binds the values of a row.
    pub(super) async fn insert<T: Sync>(
        &mut self,
        into: &str,
        rows: &[T],
        mut bind: impl FnMut(Separated<'_, Sqlite, &'static str>, &T) + Send,
    ) -> Result<()> {
        for some in rows.chunks(ROWS) {
            if self.rows + some.len() > ROWS {
                self.write().await?;
            }
            self.query.push(into).push(" ");
            self.query.push_values(some, &mut bind);
            self.query.push(";");
            self.rows += some.len();
        }
        Ok(())
    }

    /// The transaction, with all rows written to it.
    pub(super) async fn written(&mut self) -> Result<&mut SqliteConnection> {
        self.write().await?;
        Ok(self.tx)
    }

    /// Writes the remaining rows and commits the transaction.
    pub(super) async fn commit(mut self) -> Result<()> {
        self.query.push("COMMIT");
        self.write().await
    }

    async fn write(&mut self) -> Result<()> {
        if !self.query.sql().as_str().is_empty() {
            let mut query = std::mem::replace(&mut self.query, QueryBuilder::new(""));
            let rows = std::mem::take(&mut self.rows);
            // Scripts that recur are small or full; others, each of another length, would only fill the statement cache.
            query
                .build()
                .persistent(rows <= SMALL || rows == ROWS)
                .execute(&mut *self.tx)
                .await
                .map_err(doing("storing results"))?;
        }
        Ok(())
    }
}
