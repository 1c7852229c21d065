//! Stores and finds points (table `points`): sets of walks, independent of the dictionaries that need them.

use std::collections::HashMap;

use farm_proto::ids::DictionaryId;
use optics_model::Digest;
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::{Result, Store, doing};
use crate::stored::Origin;

/// Identities that one query looks up.
const LOOKUP: usize = 500;

/// Row of a point, inserted if there is none.
pub(super) async fn point(connection: &mut SqliteConnection, identity: Digest) -> Result<i64> {
    let what = "storing a point";
    let found: Option<(i64,)> = sqlx::query_as("SELECT id FROM points WHERE identity = ?")
        .bind(&identity.as_bytes()[..])
        .fetch_optional(&mut *connection)
        .await
        .map_err(doing(what))?;
    if let Some((id,)) = found {
        return Ok(id);
    }
    let inserted = sqlx::query("INSERT INTO points (identity) VALUES (?)")
        .bind(&identity.as_bytes()[..])
        .execute(&mut *connection)
        .await
        .map_err(doing(what))?;
    Ok(inserted.last_insert_rowid())
}

pub(super) async fn contribute(connection: &mut SqliteConnection, point: i64, worker: Origin) -> Result<()> {
    sqlx::query("INSERT OR IGNORE INTO contributions (point_id, worker_id) VALUES (?, ?)")
        .bind(point)
        .bind(worker.0)
        .execute(connection)
        .await
        .map_err(doing("storing who computed a point"))?;
    Ok(())
}

/// Credits the machines that computed a point's blocks with another point.
pub(super) async fn credit(connection: &mut SqliteConnection, gathered: i64, point: i64) -> Result<()> {
    sqlx::query(
        "INSERT OR IGNORE INTO contributions (point_id, worker_id) \
         SELECT ?, worker_id FROM contributions WHERE point_id = ?",
    )
    .bind(point)
    .bind(gathered)
    .execute(connection)
    .await
    .map_err(doing("storing who computed a point"))?;
    Ok(())
}

/// Rows of those points that are stored.
pub(super) async fn find(
    connection: &mut SqliteConnection,
    identities: &[Digest],
) -> Result<Vec<(Digest, i64)>> {
    let mut found = Vec::new();
    for some in identities.chunks(LOOKUP) {
        let mut query = QueryBuilder::<Sqlite>::new("SELECT identity, id FROM points WHERE identity IN (");
        let mut marks = query.separated(",");
        for identity in some {
            marks.push_bind(identity.as_bytes().to_vec());
        }
        query.push(")");
        let rows = query.build_query_as().fetch_all(&mut *connection).await;
        found.extend(rows.map_err(doing("looking for points"))?.into_iter().filter_map(identified));
    }
    Ok(found)
}

pub(super) fn identified((identity, id): (Vec<u8>, i64)) -> Option<(Digest, i64)> {
    <[u8; 32]>::try_from(identity).ok().map(|bytes| (Digest::from_bytes(bytes), id))
}

impl Store {
    /// Rows of those points that are stored, by their identities.
    pub(super) async fn points_of(&self, identities: &[Digest]) -> Result<HashMap<Digest, i64>> {
        let mut connection = self.read.acquire().await.map_err(doing("looking for points"))?;
        Ok(find(&mut connection, identities).await?.into_iter().collect())
    }
}

/// The jobs and records that were deleted with some points.
#[derive(Debug, Default)]
pub(super) struct Deleted {
    /// Jobs that had ended with their records, in all dictionaries that share them.
    pub jobs: Vec<(DictionaryId, u32)>,
    pub records: u64,
}

/// Rows as one text, however many there are: a statement takes a limited number of values.
pub(super) fn rows_of(points: &[i64]) -> String {
    format!("[{}]", points.iter().map(ToString::to_string).collect::<Vec<_>>().join(","))
}

/// Deletes points by their rows, with their records, sums and contributions, and the ends of their jobs.
pub(super) async fn delete_points(tx: &mut SqliteConnection, points: &[i64]) -> Result<Deleted> {
    let what = "deleting points";
    if points.is_empty() {
        return Ok(Deleted::default());
    }
    let rows = rows_of(points);
    let jobs = begin_jobs_again(tx, &rows).await?;
    let records = sqlx::query("DELETE FROM records WHERE point_id IN (SELECT value FROM json_each(?))")
        .bind(&rows)
        .execute(&mut *tx)
        .await
        .map_err(doing(what))?
        .rows_affected();
    // The points come last, since the other rows refer to them.
    for delete in [
        "DELETE FROM sums WHERE point_id IN (SELECT value FROM json_each(?))",
        "DELETE FROM contributions WHERE point_id IN (SELECT value FROM json_each(?))",
        "DELETE FROM points WHERE id IN (SELECT value FROM json_each(?))",
    ] {
        sqlx::query(delete).bind(&rows).execute(&mut *tx).await.map_err(doing(what))?;
    }
    Ok(Deleted { jobs, records })
}

/// Reopens the jobs that points have ended, and returns them.
pub(super) async fn begin_jobs_again(
    tx: &mut SqliteConnection,
    rows: &str,
) -> Result<Vec<(DictionaryId, u32)>> {
    let jobs: Vec<(i64, i64)> = sqlx::query_as(
        "DELETE FROM jobs WHERE point_id IN (SELECT value FROM json_each(?)) RETURNING dictionary_id, job",
    )
    .bind(rows)
    .fetch_all(tx)
    .await
    .map_err(doing("beginning jobs again"))?;
    Ok(jobs.into_iter().map(|(dictionary, job)| (DictionaryId(dictionary), job as u32)).collect())
}
