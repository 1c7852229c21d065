//! Checks whether a file is a whole database of a farm that this program can read.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};

use super::checksum::{self, sidecar};
use super::{APPLICATION_ID, BackupError, Result, blocking, draft, failed};

const HEADER_BYTES: usize = 100;
const MAGIC: &[u8] = b"SQLite format 3\0";
/// Most messages of SQLite that are reported.
const MOST_MESSAGES: usize = 5;
const SQLITE_CORRUPT: i32 = 11;
const SQLITE_NOTADB: i32 = 26;

/// The schema version and the row counts of a database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BackupCounts {
    pub schema_version: i64,
    pub dictionaries: u64,
    pub jobs: u64,
    pub records: u64,
}

/// Whether there was a checksum to compare with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Checksum {
    Agrees,
    /// Then a changed bit within a record would not be found.
    Absent,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verified {
    pub bytes: u64,
    pub digest: blake3::Hash,
    pub checksum: Checksum,
    pub counts: BackupCounts,
}

/// Checks a database that is not written to: form, checksum (if there is a `.b3` next to it), schema, SQLite's own
/// checks. Nothing is written, not even a lock.
pub async fn verify(file: &Path, newest_schema: i64) -> Result<Verified> {
    let path = file.to_owned();
    let (bytes, digest, checksum) = blocking(move || verify_bytes(&path)).await?;
    let counts = verify_tables(file, newest_schema).await?;
    Ok(Verified { bytes, digest, checksum, counts })
}

fn verify_bytes(path: &Path) -> Result<(u64, blake3::Hash, Checksum)> {
    let unreadable = |error| failed(path, "cannot be read")(error);
    let mut file = File::open(path).map_err(unreadable)?;
    let meta = file.metadata().map_err(unreadable)?;
    if !meta.is_file() {
        return Err(not_ours(path, "it is not a file"));
    }
    let mut header = Vec::with_capacity(HEADER_BYTES);
    file.by_ref().take(HEADER_BYTES as u64).read_to_end(&mut header).map_err(unreadable)?;
    check_header(path, &header, meta.len())?;
    refuse_log(path)?;
    file.rewind().map_err(unreadable)?;
    let digest = checksum::of(&file).map_err(unreadable)?;
    let checksum = compare(path, digest)?;
    Ok((meta.len(), digest, checksum))
}

/// Offsets are those of SQLite's file format, section 1.3.
fn check_header(path: &Path, header: &[u8], file_bytes: u64) -> Result<()> {
    if header.is_empty() {
        return Err(not_ours(path, "it is empty"));
    }
    if header.len() < HEADER_BYTES || !header.starts_with(MAGIC) {
        return Err(not_ours(path, "it is not an SQLite database"));
    }
    let word = |at: usize| header[at..at + 4].iter().fold(0_u32, |word, &byte| word << 8 | u32::from(byte));
    let application = word(68);
    // Databases of the first schema were written without a number.
    if application != APPLICATION_ID && application != 0 {
        return Err(not_ours(
            path,
            &format!("its application_id is {application:#010x}, not {APPLICATION_ID:#010x}"),
        ));
    }
    let page_bytes = match u16::from_be_bytes([header[16], header[17]]) {
        1 => 65_536,
        bytes => u64::from(bytes),
    };
    // The count of pages is valid if the same change wrote both counters.
    let counted = word(24) == word(92);
    let expected = u64::from(word(28)) * page_bytes;
    if counted && file_bytes < expected {
        return Err(damaged(path, format!("it is cut short: {file_bytes} of {expected} bytes are there")));
    }
    Ok(())
}

fn refuse_log(path: &Path) -> Result<()> {
    for suffix in ["-wal", "-journal"] {
        let log = draft::with_suffix(path, suffix);
        if log.metadata().is_ok_and(|meta| meta.len() > 0) {
            return Err(BackupError::Unmerged { file: path.to_owned(), log });
        }
    }
    Ok(())
}

fn compare(path: &Path, digest: blake3::Hash) -> Result<Checksum> {
    let sidecar = sidecar(path);
    match checksum::read(&sidecar)? {
        None => Ok(Checksum::Absent),
        Some(expected) if expected == digest => Ok(Checksum::Agrees),
        Some(expected) => Err(BackupError::Checksum {
            file: path.to_owned(),
            sidecar,
            expected: expected.to_string(),
            found: digest.to_string(),
        }),
    }
}

async fn verify_tables(path: &Path, newest_schema: i64) -> Result<BackupCounts> {
    let reader = Reader { path };
    let options = SqliteConnectOptions::new().filename(path).read_only(true).immutable(true);
    let options = options.pragma("trusted_schema", "OFF");
    let mut connection = reader.outcome("opening", options.connect().await)?;
    let counts = reader.check(&mut connection, newest_schema).await;
    // All is read by now; a connection that cannot be closed changes nothing about the file.
    let _ = connection.close().await;
    counts
}

struct Reader<'a> {
    path: &'a Path,
}

impl Reader<'_> {
    async fn check(&self, connection: &mut SqliteConnection, newest_schema: i64) -> Result<BackupCounts> {
        let schema_version = self.schema(connection, newest_schema).await?;
        self.integrity(connection).await?;
        self.references(connection).await?;
        Ok(BackupCounts {
            schema_version,
            dictionaries: self.count(connection, "dictionaries").await?,
            jobs: self.count(connection, "jobs").await?,
            records: self.count(connection, "records").await?,
        })
    }

    async fn schema(&self, connection: &mut SqliteConnection, newest: i64) -> Result<i64> {
        let tables = "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name IN ('_sqlx_migrations', \
                      'dictionaries', 'jobs', 'records')";
        let tables: i64 = self.outcome(
            "reading the list of tables",
            sqlx::query_scalar(tables).fetch_one(&mut *connection).await,
        )?;
        if tables != 4 {
            return Err(not_ours(self.path, "a farm's tables are not in it"));
        }
        let foreign = "SELECT type || ' ' || name FROM sqlite_schema WHERE type NOT IN ('table', 'index') \
                       OR sql LIKE 'CREATE VIRTUAL%' LIMIT 1";
        let foreign: Option<String> = self.outcome(
            "reading the schema",
            sqlx::query_scalar(foreign).fetch_optional(&mut *connection).await,
        )?;
        if let Some(foreign) = foreign {
            let why =
                format!("{foreign:?} is in it, which would act on what is read or written; a farm has none");
            return Err(not_ours(self.path, &why));
        }
        let version = "SELECT coalesce(max(version), 0) FROM _sqlx_migrations";
        let found: i64 = self.outcome(
            "reading the schema's version",
            sqlx::query_scalar(version).fetch_one(connection).await,
        )?;
        if found > newest {
            return Err(BackupError::NewerSchema { file: self.path.to_owned(), found, newest });
        }
        if found < 1 {
            return Err(not_ours(self.path, "it says nothing about its schema"));
        }
        Ok(found)
    }

    async fn integrity(&self, connection: &mut SqliteConnection) -> Result<()> {
        let check = format!("PRAGMA integrity_check({MOST_MESSAGES})");
        let rows = sqlx::query_scalar(AssertSqlSafe(check)).fetch_all(connection).await;
        let messages: Vec<String> = self.outcome("checking its integrity", rows)?;
        if messages == ["ok"] {
            return Ok(());
        }
        // One message may hold several lines.
        let first = messages.iter().flat_map(|message| message.lines()).take(MOST_MESSAGES);
        Err(BackupError::Damaged { file: self.path.to_owned(), first: first.map(str::to_owned).collect() })
    }

    async fn references(&self, connection: &mut SqliteConnection) -> Result<()> {
        let check = "SELECT \"table\", parent, count(*) FROM pragma_foreign_key_check GROUP BY 1, 2 LIMIT 5";
        let rows = sqlx::query_as(check).fetch_all(connection).await;
        let broken: Vec<(String, String, i64)> = self.outcome("checking its references", rows)?;
        if broken.is_empty() {
            return Ok(());
        }
        let described = |(table, parent, rows)| {
            format!("{rows} rows of table {table} refer to rows of {parent} that are missing")
        };
        Err(BackupError::Damaged {
            file: self.path.to_owned(),
            first: broken.into_iter().map(described).collect(),
        })
    }

    async fn count(&self, connection: &mut SqliteConnection, table: &'static str) -> Result<u64> {
        let count = sqlx::query_scalar(AssertSqlSafe(format!("SELECT count(*) FROM {table}")));
        let rows: i64 = self.outcome("counting rows", count.fetch_one(connection).await)?;
        Ok(rows as u64)
    }

    /// Maps an error of SQLite, which detects some damage only when a query reads it.
    fn outcome<T>(&self, what: &'static str, result: sqlx::Result<T>) -> Result<T> {
        result.map_err(|source| {
            let database = source.as_database_error();
            let code = database.and_then(|error| error.code()?.parse::<i32>().ok()).unwrap_or(0);
            // The low byte is the kind, the rest the details.
            match (code & 0xFF, database) {
                (SQLITE_CORRUPT | SQLITE_NOTADB, Some(error)) => {
                    damaged(self.path, format!("{what}: {}", error.message()))
                }
                _ => BackupError::Query { file: self.path.to_owned(), what, source },
            }
        })
    }
}

fn not_ours(path: &Path, why: &str) -> BackupError {
    BackupError::NotADatabase { file: path.to_owned(), why: why.to_owned() }
}

fn damaged(path: &Path, why: String) -> BackupError {
    BackupError::Damaged { file: path.to_owned(), first: vec![why] }
}
