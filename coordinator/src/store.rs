//! Stores dictionaries, ended jobs, points and their records, workers, kept measurements and events in an SQLite database.
//!
//! One connection writes, a read-only pool reads. A job's records and its end are committed together, with
//! `synchronous=FULL`, before it is acknowledged.

#[macro_use]
mod row;

pub mod backup;
mod batch;
mod checks;
mod data_dir;
mod deletion;
mod dictionaries;
mod events;
pub mod filesystem;
mod jobs;
mod ledger;
mod measurements;
mod migration;
mod place;
mod points;
mod records;
mod reuse;
mod room;
mod sums;
mod workers;
mod writer;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use sqlx::sqlite::{
    SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Connection, Row, SqliteConnection, SqlitePool};
use tokio::sync::{RwLock, mpsc};

pub use data_dir::{ADDRESS_FILE, DataDir};
pub use events::StoredEvent;
pub use ledger::{Exclusive, Ledger, LedgerGuard, Shared};
pub use measurements::StoredMeasurement;
use place::Place;
pub use records::{Damaged, Found, JobRecords};
pub use writer::Commit;

/// Older versions can corrupt a WAL database at a reset of the log.
const OLDEST_SQLITE: &str = "3.51.3";
/// A transaction writes the last page of each table and index again, however little it adds: small pages make that cheap.
/// A record that is larger than its page leaves less than half a page of this size empty, whatever its scene.
const PAGE_BYTES: u32 = 4096;

#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("data directory {dir}: {what}: {source}")]
    DataDir { dir: PathBuf, what: &'static str, source: std::io::Error },
    #[error("data directory {dir} is in use by another coordinator{at}")]
    InUse { dir: PathBuf, at: String },
    #[error(
        "{path} belongs to another user of this machine (number {owner}), who could read and change what is in it: name \
         a folder of your own with --data"
    )]
    OtherUser { path: PathBuf, owner: u32 },
    #[error("database {file}: {what}: {source}")]
    Open { file: PathBuf, what: &'static str, source: sqlx::Error },
    #[error("database {file} cannot be brought to this version's schema: {source}")]
    Migrate { file: PathBuf, source: sqlx::migrate::MigrateError },
    #[error("SQLite {found} is too old: {OLDEST_SQLITE} or later is needed")]
    TooOld { found: String },
    #[error(
        "database {file}: it was deleted, moved or replaced while the coordinator had it open, so that nothing is stored \
         any more: put its folder back, or restore a backup, and start the coordinator again"
    )]
    Lost { file: PathBuf },
    #[error("{what}: {source}")]
    Query { what: &'static str, source: sqlx::Error },
    #[error("table {table}, row {row}, column {column} is corrupt: {why}")]
    Corrupt { table: &'static str, row: i64, column: &'static str, why: String },
    #[error("checking the database: not every page could be read: {0}")]
    PagesUnread(String),
    #[error(
        "the disk has {} MB left, and {} MB are kept for results and deletions: delete what is not needed, or enlarge it",
        free / 1_000_000, floor / 1_000_000
    )]
    LittleRoom { free: u64, floor: u64 },
    #[error("a dictionary with this name exists already")]
    NameTaken,
    /// The common error of several results that were stored together.
    #[error(transparent)]
    Together(#[from] Arc<StoreError>),
    #[error("internal error while a result was stored: see this program's log")]
    Defect,
    #[error("the database is closed")]
    Closed,
    #[error(transparent)]
    Backup(#[from] backup::BackupError),
    #[error(transparent)]
    Filesystem(#[from] filesystem::FilesystemError),
}

pub type Result<T, E = StoreError> = std::result::Result<T, E>;

/// Names what was being done when a query failed.
fn doing(what: &'static str) -> impl FnOnce(sqlx::Error) -> StoreError {
    move |source| StoreError::Query { what, source }
}

/// Clones share the database.
#[derive(Debug, Clone)]
pub struct Store {
    write: SqlitePool,
    read: SqlitePool,
    place: Place,
    dir: Arc<DataDir>,
    completions: mpsc::Sender<writer::Request>,
    /// Locked through the [`Ledger`].
    records: Arc<RwLock<()>>,
}

impl Store {
    /// Takes the lock of a data directory, opens or creates its database and brings the schema up to date. `committed`
    /// counts every commit of results.
    pub async fn open(dir: DataDir, committed: impl Fn(Commit) + Send + 'static) -> Result<Self> {
        let file = dir.database_file();
        dir.create_database()?;
        // Functions and virtual tables that a file's schema uses are not trusted.
        let options = SqliteConnectOptions::new()
            .filename(&file)
            .busy_timeout(Duration::from_secs(10))
            .pragma("trusted_schema", "OFF");
        let open = |what| {
            let file = file.clone();
            move |source| StoreError::Open { file, what, source }
        };
        let writer = options
            .clone()
            .page_size(PAGE_BYTES)
            .auto_vacuum(SqliteAutoVacuum::Incremental)
            .journal_mode(SqliteJournalMode::Wal)
            .pragma("journal_size_limit", room::LOG_BYTES.to_string())
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true);
        let write = SqlitePoolOptions::new()
            .max_connections(1)
            // The database is a local file: an error that a test would find fails the query too.
            .test_before_acquire(false)
            // On a full disk SQLite ends a transaction by itself and sqlx still counts it as open: such a connection
            // would refuse every later one.
            .after_release(|connection, _| Box::pin(async move { Ok(!connection.is_in_transaction()) }))
            .connect_with(writer)
            .await
            .map_err(open("opening for writing"))?;
        check_version(&write).await?;
        migration::migrator()
            .run(&write)
            .await
            .map_err(|source| StoreError::Migrate { file: file.clone(), source })?;
        let read = SqlitePoolOptions::new()
            .max_connections(4)
            .connect_with(options.read_only(true))
            .await
            .map_err(open("opening for reading"))?;
        let fault =
            |source| StoreError::DataDir { dir: dir.path().to_owned(), what: "cannot be looked at", source };
        let place = Place::of(&file).map_err(fault)?;
        let (completions, queue) = writer::queue();
        tokio::spawn(writer::run(write.clone(), place.clone(), queue, committed));
        let store = Self { write, read, place, dir: Arc::new(dir), completions, records: Arc::default() };
        store.move_records_of_first_schema().await?;
        store.forget_useless_workers().await?;
        Ok(store)
    }

    /// A transaction of the one connection that writes.
    async fn begin(&self) -> Result<sqlx::Transaction<'static, sqlx::Sqlite>> {
        self.writer()?.begin_with("BEGIN IMMEDIATE").await.map_err(doing("beginning to write"))
    }

    /// The one connection that writes, if the database's file is still in its place.
    fn writer(&self) -> Result<&SqlitePool> {
        self.place.check()?;
        Ok(&self.write)
    }

    /// An error if the database's file was deleted, moved or replaced.
    pub fn check_place(&self) -> Result<()> {
        self.place.check()
    }

    /// A new connection for reading, with an empty cache.
    async fn fresh_connection(&self) -> Result<SqliteConnection> {
        self.read.connect_options().connect().await.map_err(doing("opening the database once more"))
    }

    /// Size of the database on the disk, with its log.
    pub fn bytes(&self) -> u64 {
        let file = self.dir.database_file();
        let log = file.with_extension("db-wal");
        [file, log].iter().map(|f| std::fs::metadata(f).map_or(0, |m| m.len())).sum()
    }

    /// A verified copy of the database as it is now, in a new file.
    pub async fn backup(&self, destination: &Path) -> Result<backup::BackupReport> {
        self.check_room(self.bytes())?;
        let report = backup::backup(&self.read, destination, newest_schema()).await?;
        // The log has grown meanwhile.
        if let Err(error) = self.empty_log().await {
            tracing::warn!(%error, "the database's log is not shortened yet");
        }
        Ok(report)
    }

    /// The folder whose lock this store holds.
    pub fn dir(&self) -> &DataDir {
        &self.dir
    }

    /// The faults that SQLite's integrity check reports; empty if there are none.
    pub async fn faults(&self) -> Result<Vec<String>> {
        let rows: Vec<(String,)> = sqlx::query_as("PRAGMA integrity_check(20)")
            .fetch_all(&self.read)
            .await
            .map_err(doing("checking the database"))?;
        let lines = rows.iter().flat_map(|row| row.0.lines());
        let faults: Vec<&str> = lines.filter(|line| *line != "ok" && !line.starts_with("***")).collect();
        match faults.iter().find(|line| is_unread(line)) {
            // The other faults follow from the unread page.
            Some(unread) => Err(StoreError::PagesUnread((*unread).to_owned())),
            None => Ok(faults.into_iter().map(ToOwned::to_owned).collect()),
        }
    }

    /// Waits for running queries and closes the database, merging its log.
    pub async fn close(&self) {
        self.read.close().await;
        self.write.close().await;
    }
}

/// The newest schema that this program supports.
pub fn newest_schema() -> i64 {
    migration::migrator().iter().map(|m| m.version).max().unwrap_or(0)
}

/// Whether SQLite reports a page that it could not read; a page that it has read and found corrupt has the code 11.
fn is_unread(fault: &str) -> bool {
    const CORRUPT: i32 = 11;
    let code =
        fault.rsplit_once("unable to get the page. error code=").and_then(|(_, code)| code.parse().ok());
    code.is_some_and(|code: i32| code & 0xFF != CORRUPT)
}

async fn check_version(pool: &SqlitePool) -> Result<()> {
    let row = sqlx::query("SELECT sqlite_version()")
        .fetch_one(pool)
        .await
        .map_err(doing("asking SQLite's version"))?;
    let found: String = row.get(0);
    let parts = |v: &str| v.split('.').map(|p| p.parse().unwrap_or(0)).collect::<Vec<u32>>();
    if parts(&found) < parts(OLDEST_SQLITE) {
        return Err(StoreError::TooOld { found });
    }
    Ok(())
}

#[cfg(test)]
mod tests;
