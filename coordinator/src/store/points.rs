//! Tables `points` and `records`: what was computed, whoever asked for it.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use farm_proto::ids::DictionaryId;
use optics_model::profile::RecordShape;
use optics_model::{Digest, Grid, Profile, Record};
use sqlx::{Connection, QueryBuilder, Sqlite, SqliteConnection};

use super::{Result, Store, StoreError, doing, jobs};

/// Identities that one query looks up.
const LOOKUP: usize = 500;

/// A job's records as they were read, with the digest that they had when they were stored.
#[derive(Debug)]
pub struct StoredJob {
    pub job: u32,
    pub records: Vec<Record>,
    digest: Option<Digest>,
    /// Why some of its bytes could not be decoded.
    undecodable: Option<String>,
}

impl StoredJob {
    fn new(job: i64, digest: &[u8]) -> Self {
        let decoded = jobs::decode_digest(job, digest);
        let undecodable = decoded.as_ref().err().map(ToString::to_string);
        Self { job: job as u32, records: Vec::new(), digest: decoded.ok(), undecodable }
    }

    /// Why the records are not those that were stored.
    pub fn damage(&self, albedos: usize) -> Option<String> {
        if self.undecodable.is_some() {
            return self.undecodable.clone();
        }
        if self.records.len() != albedos {
            return Some(format!("{} records of {albedos} are there", self.records.len()));
        }
        let found = Digest::of_records(&self.records);
        (Some(found) != self.digest).then(|| "its records differ from what was stored".to_owned())
    }

    fn add(&mut self, record: Result<Record>) {
        match record {
            Ok(record) => self.records.push(record),
            Err(error) => drop(self.undecodable.get_or_insert_with(|| error.to_string())),
        }
    }
}

/// A record of a job that is done; a job that has lost all of its records has one row without any.
#[derive(sqlx::FromRow)]
struct RecordRow {
    job: i64,
    records_digest: Vec<u8>,
    id: Option<i64>,
    albedo: Option<f64>,
    profiles: Option<Vec<u8>>,
}

/// Row of a point, made if need be.
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

pub(super) async fn contribute(connection: &mut SqliteConnection, point: i64, worker: i64) -> Result<()> {
    sqlx::query("INSERT OR IGNORE INTO contributions (point_id, worker_id) VALUES (?, ?)")
        .bind(point)
        .bind(worker)
        .execute(connection)
        .await
        .map_err(doing("storing who computed a point"))?;
    Ok(())
}

/// Lets a point that only gathered blocks go: who computed these has computed `point`.
pub(super) async fn hand_over(connection: &mut SqliteConnection, gathered: i64, point: i64) -> Result<()> {
    sqlx::query(
        "INSERT OR IGNORE INTO contributions (point_id, worker_id) \
         SELECT ?, worker_id FROM contributions WHERE point_id = ?",
    )
    .bind(point)
    .bind(gathered)
    .execute(&mut *connection)
    .await
    .map_err(doing("storing who computed a point"))?;
    forget_gathered(connection, gathered).await
}

/// Forgets a point that only gathered blocks, which are merged.
pub(super) async fn forget_gathered(connection: &mut SqliteConnection, gathered: i64) -> Result<()> {
    for delete in ["DELETE FROM contributions WHERE point_id = ?", "DELETE FROM points WHERE id = ?"] {
        let deleted = sqlx::query(delete).bind(gathered).execute(&mut *connection).await;
        deleted.map_err(doing("forgetting merged blocks"))?;
    }
    Ok(())
}

/// Rows of the points that the store has.
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

/// Makes rows of points that the store does not have.
pub(super) async fn insert(
    connection: &mut SqliteConnection,
    identities: &[Digest],
) -> Result<Vec<(Digest, i64)>> {
    let mut made = Vec::new();
    for some in identities.chunks(LOOKUP) {
        let mut query = QueryBuilder::<Sqlite>::new("INSERT INTO points (identity) ");
        query.push_values(some, |mut row, identity| {
            row.push_bind(identity.as_bytes().to_vec());
        });
        query.push(" RETURNING identity, id");
        let rows = query.build_query_as().fetch_all(&mut *connection).await;
        made.extend(rows.map_err(doing("storing points"))?.into_iter().filter_map(identified));
    }
    Ok(made)
}

pub(super) fn identified((identity, id): (Vec<u8>, i64)) -> Option<(Digest, i64)> {
    <[u8; 32]>::try_from(identity).ok().map(|bytes| (Digest::from_bytes(bytes), id))
}

impl Store {
    /// The finished jobs of a dictionary among a range of jobs, with their records in the order of their numbers. What
    /// is wrong with one of them [`StoredJob::damage`] tells; an error means that the database could not be read.
    pub async fn jobs_with_records(
        &self,
        dictionary: DictionaryId,
        grid: &Grid,
        range: Range<usize>,
    ) -> Result<Vec<StoredJob>> {
        let mut connection = self.read.acquire().await.map_err(doing("reading records"))?;
        read_jobs(&mut connection, dictionary, grid, range).await
    }

    /// Reads a job by itself, through a connection of its own: what others keep in memory may be what is wrong.
    pub async fn job_read_afresh(
        &self,
        dictionary: DictionaryId,
        grid: &Grid,
        job: usize,
    ) -> Result<Option<StoredJob>> {
        let mut connection = self.fresh_connection().await?;
        let read = read_jobs(&mut connection, dictionary, grid, job..job + 1).await;
        // It has only read.
        let _ = connection.close().await;
        Ok(read?.pop())
    }

    /// Points that the store has, by their identities.
    pub(super) async fn points_of(&self, identities: &[Digest]) -> Result<HashMap<Digest, i64>> {
        let mut connection = self.read.acquire().await.map_err(doing("looking for points"))?;
        Ok(find(&mut connection, identities).await?.into_iter().collect())
    }

    /// Ends those open jobs of a dictionary whose records are there already. `jobs` are their numbers and identities;
    /// `grids` those of all dictionaries. Returns the jobs with the digests of their records.
    pub async fn reuse(
        &self,
        dictionary: DictionaryId,
        grid: &Grid,
        jobs: &[(u32, Digest)],
        grids: &HashMap<DictionaryId, Arc<Grid>>,
    ) -> Result<Vec<(u32, Digest)>> {
        let identities: Vec<Digest> = jobs.iter().map(|(_, identity)| *identity).collect();
        let points = self.points_of(&identities).await?;
        let mut there_are = Vec::new();
        for (job, identity) in jobs {
            let Some(point) = points.get(identity) else { continue };
            let there = self.checked_records(*point, grids).await?;
            if let Some(records) = records_for(grid, *job as usize, &there) {
                there_are.push((*job, *point, Digest::of_records(&records)));
            }
        }
        let mut reused = Vec::with_capacity(there_are.len());
        let mut tx = self.begin().await?;
        for (job, point, digest) in &there_are {
            // A result of its own may have ended the job a moment ago.
            let ended = sqlx::query(
                "INSERT OR IGNORE INTO jobs (dictionary_id, job, point_id, walks, records_digest, reused) \
                 VALUES (?, ?, ?, ?, ?, 1)",
            )
            .bind(dictionary.0)
            .bind(*job)
            .bind(point)
            .bind(grid.walks().get() as i64)
            .bind(&digest.as_bytes()[..])
            .execute(&mut *tx)
            .await
            .map_err(doing("storing a job that needs no computing"))?;
            if ended.rows_affected() > 0 {
                reused.push((*job, *digest));
            }
        }
        tx.commit().await.map_err(doing("storing jobs that need no computing"))?;
        Ok(reused)
    }

    /// Records of a point, with their albedos: those of jobs whose records are the ones that were stored. What is
    /// damaged is computed again.
    async fn checked_records(
        &self,
        point: i64,
        grids: &HashMap<DictionaryId, Arc<Grid>>,
    ) -> Result<Vec<(f64, Vec<Profile>)>> {
        let jobs: Vec<(i64, i64)> = sqlx::query_as("SELECT dictionary_id, job FROM jobs WHERE point_id = ?")
            .bind(point)
            .fetch_all(&self.read)
            .await
            .map_err(doing("looking for jobs of a point"))?;
        let mut found = Vec::new();
        for (dictionary, job) in jobs {
            let id = DictionaryId(dictionary);
            let Some(grid) = grids.get(&id) else { continue };
            let stored = self.jobs_with_records(id, grid, job as usize..job as usize + 1).await?;
            match stored.into_iter().find(|stored| stored.damage(grid.albedo().len()).is_none()) {
                Some(stored) => {
                    let profiles = stored.records.into_iter().map(|record| record.profiles);
                    found.extend(grid.albedo().iter().copied().zip(profiles));
                }
                None => {
                    tracing::warn!(dictionary, job, "the job's records are damaged: they are not used again");
                }
            }
        }
        Ok(found)
    }

    /// Forgets the records of a point: the jobs to be computed again.
    pub async fn forget_point(&self, identity: Digest) -> Result<Vec<(DictionaryId, u32)>> {
        let Some(point) = self.points_of(&[identity]).await?.remove(&identity) else { return Ok(Vec::new()) };
        let mut tx = self.begin().await?;
        let forgotten = forget_points(&mut tx, "VALUES (?)", [point]).await?;
        tx.commit().await.map_err(doing("forgetting a point's records"))?;
        Ok(forgotten)
    }

    /// Forgets the records of a job, in all dictionaries that share them: the jobs to be computed again.
    pub async fn forget_job(&self, dictionary: DictionaryId, job: u32) -> Result<Vec<(DictionaryId, u32)>> {
        let mut tx = self.begin().await?;
        let points =
            "SELECT point_id FROM jobs WHERE dictionary_id = ?1 AND job = ?2 AND point_id IS NOT NULL";
        let forgotten = forget_points(&mut tx, points, [dictionary.0, i64::from(job)]).await?;
        tx.commit().await.map_err(doing("forgetting a job's records"))?;
        Ok(forgotten)
    }
}

/// Deletes all that belongs to the points that a query finds, and the jobs that they ended.
pub(super) async fn forget_points<const N: usize>(
    tx: &mut SqliteConnection,
    points: &str,
    parameters: [i64; N],
) -> Result<Vec<(DictionaryId, u32)>> {
    let what = "forgetting records";
    let query = |text: String| {
        let mut query = sqlx::query(sqlx::AssertSqlSafe(text));
        for parameter in parameters {
            query = query.bind(parameter);
        }
        query
    };
    query("CREATE TEMP TABLE IF NOT EXISTS forgotten (point_id INTEGER PRIMARY KEY)".to_owned())
        .execute(&mut *tx)
        .await
        .map_err(doing(what))?;
    sqlx::query("DELETE FROM forgotten").execute(&mut *tx).await.map_err(doing(what))?;
    query(format!("INSERT INTO forgotten {points}")).execute(&mut *tx).await.map_err(doing(what))?;
    let jobs: Vec<(i64, i64)> =
        sqlx::query_as("DELETE FROM jobs WHERE point_id IN forgotten RETURNING dictionary_id, job")
            .fetch_all(&mut *tx)
            .await
            .map_err(doing(what))?;
    for delete in [
        "DELETE FROM records WHERE point_id IN forgotten",
        "DELETE FROM sums WHERE point_id IN forgotten",
        "DELETE FROM contributions WHERE point_id IN forgotten",
        "DELETE FROM points WHERE id IN forgotten",
    ] {
        sqlx::query(delete).execute(&mut *tx).await.map_err(doing(what))?;
    }
    Ok(jobs.into_iter().map(|(dictionary, job)| (DictionaryId(dictionary), job as u32)).collect())
}

/// All records that a job asks for, if they are among these.
fn records_for(grid: &Grid, job: usize, there: &[(f64, Vec<Profile>)]) -> Option<Vec<Record>> {
    let record = |(albedo, index): (&f64, usize)| {
        let (_, profiles) = there.iter().find(|(a, _)| a == albedo)?;
        Some(Record { index, profiles: profiles.clone() })
    };
    grid.albedo().iter().zip(grid.first_record(job)..).map(record).collect()
}

async fn read_jobs(
    connection: &mut SqliteConnection,
    dictionary: DictionaryId,
    grid: &Grid,
    range: Range<usize>,
) -> Result<Vec<StoredJob>> {
    let rows: Vec<RecordRow> = sqlx::query_as(
        "SELECT job, records_digest, records.id, albedo, profiles \
         FROM jobs LEFT JOIN records ON records.point_id = jobs.point_id \
         WHERE dictionary_id = ? AND job >= ? AND job < ? AND records_digest IS NOT NULL ORDER BY job, albedo",
    )
    .bind(dictionary.0)
    .bind(range.start as i64)
    .bind(range.end as i64)
    .fetch_all(connection)
    .await
    .map_err(doing("reading records"))?;
    let shape = RecordShape::of(grid);
    let mut found: Vec<StoredJob> = Vec::new();
    for RecordRow { job, records_digest, id, albedo, profiles } in rows {
        if found.last().is_none_or(|last| i64::from(last.job) != job) {
            found.push(StoredJob::new(job, &records_digest));
        }
        // The point may hold more albedos than this dictionary asks for.
        let Some(place) = grid.albedo().iter().position(|a| Some(*a) == albedo) else { continue };
        let index = grid.first_record(job as usize) + place;
        let last = found.last_mut().expect("one was just pushed");
        last.add(record(index, id.unwrap_or_default(), &profiles.unwrap_or_default(), shape));
    }
    Ok(found)
}

fn record(index: usize, row: i64, profiles: &[u8], shape: RecordShape) -> Result<Record> {
    Record::from_le_bytes(index, profiles, shape).map_err(|error| StoreError::Corrupt {
        table: "records",
        row,
        column: "profiles",
        why: error.to_string(),
    })
}
