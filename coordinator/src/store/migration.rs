//! Brings a database to the present schema: runs the migrations in SQL, and moves the records of the first schema, which
//! belonged to dictionaries, to points, since SQL alone cannot migrate them.

use std::borrow::Cow;
use std::sync::Arc;

use farm_proto::ids::DictionaryId;
use optics_model::{Digest, Grid};
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::{SqlSafeStr, SqliteConnection};

use super::{Result, Store, doing, points};
use crate::stored::StoredDictionary;

macro_rules! migration {
    ($file:literal) => {
        ($file, include_str!(concat!("../../migrations/", $file, ".sql")))
    };
}

/// All files of `migrations`, in order: `NUMBER_DESCRIPTION` and its SQL.
const MIGRATIONS: [(&str, &str); 8] = [
    migration!("0001_dictionaries_jobs_records"),
    migration!("0002_points_workers_events"),
    migration!("0003_digests_of_sums"),
    migration!("0004_machines_votes_and_what_is_set_aside"),
    migration!("0005_owners_and_who_did_what"),
    migration!("0006_errors_in_bytes"),
    migration!("0007_measurements"),
    migration!("0008_one_judge"),
];

const WHAT: &str = "moving records to the present schema";

pub(super) fn migrator() -> Migrator {
    Migrator::with_migrations(MIGRATIONS.into_iter().filter_map(parse).collect())
}

/// None if the name has no number.
fn parse((name, sql): (&'static str, &'static str)) -> Option<Migration> {
    let (version, description) = name.split_once('_')?;
    let description = Cow::Owned(description.replace('_', " "));
    Some(Migration::new(version.parse().ok()?, description, MigrationType::Simple, sql.into_sql_str(), false))
}

impl Store {
    /// Moves the records of the first schema, in one transaction, so that a process that is killed leaves everything as
    /// it was.
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
        // The job is of an older physics version: no job of today has the same identity.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Every migration file is in the list: one that is not would never be applied.
    #[test]
    fn every_migration_file_is_applied() {
        let folder = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/migrations")).unwrap();
        let mut files: Vec<_> =
            folder.map(|f| f.unwrap().file_name().into_string().unwrap().replace(".sql", "")).collect();
        files.sort_unstable();
        assert_eq!(MIGRATIONS.map(|(name, _)| name).to_vec(), files);
        assert!(migrator().iter().map(|m| m.version).eq(1..=files.len() as i64));
    }
}
