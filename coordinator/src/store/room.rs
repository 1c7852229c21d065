//! Returns disk space that the database and its log do not need.
//!
//! The log grows while a backup or a long answer is read, since it cannot be merged into the file then. Once it is
//! merged, SQLite reuses it from its beginning, and cuts it to [`LOG_BYTES`]. At a quiet time, it is emptied.
//!
//! The file keeps the pages of deleted rows for later rows. A `VACUUM` would return them in one operation of unknown
//! length, which needs as much space again and blocks all writers meanwhile. So databases use incremental auto-vacuum:
//! SQLite moves the last pages to free places and cuts the file, a few pages at a time.

use sqlx::SqlitePool;

use super::{Result, Store, StoreError, doing};

/// Room on the disk that is kept for results and deletions: this, or a part of a small disk.
const FLOOR_BYTES: u64 = 1 << 30;
const FLOOR_SHARE: u64 = 20;
/// Size to which the log is cut when it begins again.
pub(super) const LOG_BYTES: u64 = 64 << 20;
/// Smaller logs are left as they are.
const LITTLE_LOG_BYTES: u64 = 1 << 20;
/// Pages that are returned in one transaction: 8 MiB.
const STEP: i64 = 2048;
/// Free pages that are kept for later rows: 4 MiB.
const FEW: i64 = 1024;
/// The value of `PRAGMA auto_vacuum` if pages can be returned.
const INCREMENTAL: i64 = 2;

impl Store {
    /// Returns the space that file and log do not need, in short steps between which others can write.
    pub async fn give_back_room(&self) -> Result<()> {
        let (mut shrunk, writer) = (false, self.writer()?);
        if number(writer, "PRAGMA auto_vacuum").await? == INCREMENTAL {
            while number(writer, "PRAGMA freelist_count").await? > FEW {
                let step = sqlx::AssertSqlSafe(format!("PRAGMA incremental_vacuum({STEP})"));
                sqlx::query(step).execute(self.writer()?).await.map_err(doing("shortening the database"))?;
                shrunk = true;
            }
        }
        if shrunk || self.log_bytes() > LITTLE_LOG_BYTES {
            self.empty_log().await?;
        }
        Ok(())
    }

    /// Refuses what would leave too little room on the disk after `more` bytes.
    pub fn check_room(&self, more: u64) -> Result<()> {
        let dir = self.dir.path();
        let asked = rustix::fs::statvfs(dir).map_err(|error| StoreError::DataDir {
            dir: dir.to_owned(),
            what: "asking for the room on the disk",
            source: error.into(),
        })?;
        let [free, all] = [asked.f_bavail, asked.f_blocks].map(|blocks| blocks * asked.f_frsize);
        leaves_room(free, all, more)
    }

    /// Merges the log into the file and empties it, if there is no reader at this moment.
    pub(super) async fn empty_log(&self) -> Result<()> {
        let what = doing("merging the log into the database");
        let mut connection = self.writer()?.acquire().await.map_err(doing("waiting for the database"))?;
        // A reader is not waited for: nothing could be written meanwhile.
        let merged = sqlx::raw_sql(
            "PRAGMA busy_timeout = 0; PRAGMA wal_checkpoint(TRUNCATE); PRAGMA busy_timeout = 10000",
        );
        merged.execute(&mut *connection).await.map(drop).map_err(what)
    }

    /// Size of the log.
    fn log_bytes(&self) -> u64 {
        let log = self.dir.database_file().with_extension("db-wal");
        std::fs::metadata(log).map_or(0, |about| about.len())
    }

    pub fn is_closed(&self) -> bool {
        self.write.is_closed()
    }
}

fn leaves_room(free: u64, all: u64, more: u64) -> Result<()> {
    let floor = FLOOR_BYTES.min(all / FLOOR_SHARE);
    if free >= floor.saturating_add(more) { Ok(()) } else { Err(StoreError::LittleRoom { free, floor }) }
}

async fn number(pool: &SqlitePool, pragma: &'static str) -> Result<i64> {
    sqlx::query_scalar(pragma).fetch_one(pool).await.map_err(doing("asking for the size of the database"))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tempfile::TempDir;

    use super::*;
    use crate::store::tests::{empty, run};

    const MIB: u64 = 1 << 20;

    /// Clients leave 1 GiB, or a twentieth of a small disk, to results and deletions.
    #[test]
    fn disk_keeps_room_for_results() {
        let is_left = |free, all, more| leaves_room(free * MIB, all * MIB, more * MIB).is_ok();
        assert!(is_left(1024, 1 << 20, 0) && !is_left(1023, 1 << 20, 0) && !is_left(1024, 1 << 20, 1));
        assert!(is_left(60, 1000, 10) && !is_left(60, 1000, 11));
        let refused = leaves_room(MIB, 100 * MIB, 0).unwrap_err().to_string();
        assert!(refused.starts_with("the disk has 1 MB left, and 5 MB are kept"), "{refused}");
    }

    /// A table of `mib` MiB.
    async fn fill(store: &Store, mib: u32) {
        run(store, "CREATE TABLE filler (bytes BLOB)").await;
        let rows = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < ?) \
                    INSERT INTO filler SELECT zeroblob(1048576) FROM n";
        sqlx::query(rows).bind(mib).execute(&store.write).await.unwrap();
    }

    /// A transaction that reads until it is rolled back.
    async fn reader(store: &Store) -> sqlx::Transaction<'static, sqlx::Sqlite> {
        let mut reader = store.read.begin().await.unwrap();
        sqlx::query("SELECT count(*) FROM jobs").fetch_one(&mut *reader).await.unwrap();
        reader
    }

    fn size(dir: &TempDir, name: &str) -> u64 {
        std::fs::metadata(dir.path().join(name)).map_or(0, |about| about.len())
    }

    /// The space of deleted rows is returned to the disk.
    #[tokio::test]
    async fn deleted_space_is_returned_to_the_disk() {
        let (dir, store) = empty().await;
        fill(&store, 20).await;
        store.give_back_room().await.unwrap();
        assert!(size(&dir, "farm.db") > 20 * MIB);
        assert_eq!(size(&dir, "farm.db-wal"), 0);
        run(&store, "DROP TABLE filler").await;
        store.give_back_room().await.unwrap();
        assert!(size(&dir, "farm.db") < 5 * MIB, "{} bytes", size(&dir, "farm.db"));
        assert_eq!(size(&dir, "farm.db-wal"), 0);
        assert!(store.faults().await.unwrap().is_empty());
    }

    /// A reader that does not end keeps the log, and is not waited for.
    #[tokio::test]
    async fn long_reader_does_not_delay() {
        let (dir, store) = empty().await;
        let reader = reader(&store).await;
        fill(&store, 5).await;
        tokio::time::timeout(Duration::from_secs(5), store.give_back_room()).await.unwrap().unwrap();
        assert!(size(&dir, "farm.db-wal") > 5 * MIB);
        reader.rollback().await.unwrap();
        store.give_back_room().await.unwrap();
        assert_eq!(size(&dir, "farm.db-wal"), 0);
    }

    /// A long write-ahead log is truncated while work continues.
    #[tokio::test]
    async fn long_log_is_truncated_during_work() {
        let (dir, store) = empty().await;
        let reader = reader(&store).await;
        fill(&store, 80).await;
        assert!(size(&dir, "farm.db-wal") > 80 * MIB);
        reader.rollback().await.unwrap();
        run(&store, "CREATE TABLE one (a)").await;
        run(&store, "CREATE TABLE two (a)").await;
        assert!(size(&dir, "farm.db-wal") <= LOG_BYTES, "{} bytes", size(&dir, "farm.db-wal"));
    }

    /// A stop of the coordinator does not wait until a slow disk has taken the whole backup.
    #[tokio::test]
    async fn closing_the_store_ends_a_backup() {
        let (dir, store) = empty().await;
        fill(&store, 128).await;
        let copy = dir.path().join("copy.db");
        let (saved, to) = (store.clone(), copy.clone());
        let backup = tokio::spawn(async move { saved.backup(&to).await });
        let draft = |e: &std::fs::DirEntry| e.file_name().to_string_lossy().starts_with("copy.db.");
        let begun = || {
            let mut entries = std::fs::read_dir(dir.path()).unwrap().flatten();
            entries.any(|e| draft(&e) && e.metadata().unwrap().len() > MIB)
        };
        while !begun() {
            assert!(!backup.is_finished(), "{:?}", backup.await);
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        store.close().await;
        let error = backup.await.unwrap().unwrap_err().to_string();
        assert!(error.contains("interrupted"), "{error}");
        assert!(!copy.exists());
    }
}
