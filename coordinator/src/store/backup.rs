//! Makes backups of a running database and restores them: never half a file, never an unverified one.
//!
//! A backup is one SQLite file with a checksum next to it (`FILE.b3`, as `b3sum` writes and checks it). SQLite's own
//! check finds broken pages and indexes, but not a changed bit within a profile: the checksum does.

mod checksum;
mod draft;
mod verify;

#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};

use sqlx::SqlitePool;

use self::checksum::sidecar;
use self::draft::Draft;
use super::DataDir;

pub use self::verify::{BackupCounts, Checksum, Verified, verify};

/// "FARM" in the header of a database (`PRAGMA application_id`), by which `file` and this program recognise it.
pub const APPLICATION_ID: u32 = 0x4641_524D;

#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    #[error("{file}: {what}: {source}")]
    File { file: PathBuf, what: &'static str, source: std::io::Error },
    #[error("{file}: {what}: {source}")]
    Query { file: PathBuf, what: &'static str, source: sqlx::Error },
    #[error("{file} exists already: choose another name, or move it away")]
    Exists { file: PathBuf },
    #[error("{file}: another backup is being written to it")]
    Busy { file: PathBuf },
    #[error("{file} is not a farm's database: {why}")]
    NotADatabase { file: PathBuf, why: String },
    #[error(
        "{file} has schema {found}, but this version knows schemas up to {newest}: install the version of the farm that \
         wrote it, or a later one"
    )]
    NewerSchema { file: PathBuf, found: i64, newest: i64 },
    #[error("{file} is damaged: {}", first.join("; "))]
    Damaged { file: PathBuf, first: Vec<String> },
    #[error(
        "{file} has a log next to it, {log}, with changes that are not in it yet: make a backup of the running farm, or \
         start and stop the coordinator on it once"
    )]
    Unmerged { file: PathBuf, log: PathBuf },
    #[error("{file}: BLAKE3 is {found}, but {sidecar} says {expected}: the file was changed or damaged")]
    Checksum { file: PathBuf, sidecar: PathBuf, expected: String, found: String },
    #[error("{sidecar} is not a checksum: a line as b3sum writes it is needed, or no such file")]
    NotAChecksum { sidecar: PathBuf },
    #[error("data directory {dir} holds a database already: move {} away", files.join(" and "))]
    HoldsDatabase { dir: PathBuf, files: Vec<String> },
}

type Result<T, E = BackupError> = std::result::Result<T, E>;

/// Names what was being done to a file when it failed.
fn failed(file: &Path, what: &'static str) -> impl FnOnce(std::io::Error) -> BackupError {
    move |source| BackupError::File { file: file.to_owned(), what, source }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BackupReport {
    pub file: PathBuf,
    pub bytes: u64,
    pub blake3_hex: String,
    pub counts: BackupCounts,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RestoreReport {
    pub database: PathBuf,
    pub bytes: u64,
    pub blake3_hex: String,
    pub checksum: Checksum,
    pub counts: BackupCounts,
}

/// Copies the database behind `pool` to a new file while it is being written to.
///
/// Everything that was committed before the call is in the copy. The log of the database cannot be merged while this
/// runs, and grows. `newest_schema` is the newest migration that this program supports. Ends early, with an error, when
/// the pool is closed.
pub async fn backup(pool: &SqlitePool, destination: &Path, newest_schema: i64) -> Result<BackupReport> {
    let destination =
        std::path::absolute(destination).map_err(failed(destination, "cannot be made absolute"))?;
    let target = destination.clone();
    let draft = blocking(move || Draft::create(&target)).await?;
    copy_database(pool, draft.path()).await.map_err(|source| BackupError::Query {
        file: destination.clone(),
        what: "copying the database",
        source,
    })?;
    let verified = publish_verified(draft, &destination, None, newest_schema).await?;
    Ok(BackupReport {
        file: destination,
        bytes: verified.bytes,
        blake3_hex: verified.digest.to_hex().to_string(),
        counts: verified.counts,
    })
}

/// Copies the database on a separate connection, which checks again and again whether the pool is being closed, so that a
/// stop does not wait for a slow disk.
async fn copy_database(pool: &SqlitePool, file: &Path) -> sqlx::Result<()> {
    /// Steps of SQLite's virtual machine between two of these checks: some tens of records.
    const STEPS: i32 = 100;
    let mut connection = pool.acquire().await?;
    connection.close_on_drop();
    let closing = pool.clone();
    connection.lock_handle().await?.set_progress_handler(STEPS, move || !closing.is_closed());
    let copied = sqlx::query("VACUUM INTO ?").bind(address(file)).execute(&mut *connection).await;
    connection.lock_handle().await?.remove_progress_handler();
    copied.map(drop)
}

/// A backup that is received piece by piece, in a draft next to its destination.
#[derive(Debug)]
pub struct Incoming {
    draft: Draft,
    destination: PathBuf,
}

impl Incoming {
    /// Refuses a name that is taken, or to which another backup is being written.
    pub fn create(destination: &Path) -> Result<Self> {
        let absolute =
            std::path::absolute(destination).map_err(failed(destination, "cannot be made absolute"))?;
        Ok(Self { draft: Draft::create(&absolute)?, destination: absolute })
    }

    pub fn write(&mut self, piece: &[u8]) -> Result<()> {
        self.draft.file().write_all(piece).map_err(failed(&self.destination, "writing to disk"))
    }

    /// Gives the file its name and its checksum if it is a whole backup with this BLAKE3, in hexadecimal.
    pub async fn publish(self, blake3_hex: &str, newest_schema: i64) -> Result<()> {
        publish_verified(self.draft, &self.destination, Some(blake3_hex), newest_schema).await.map(drop)
    }
}

/// Gives a draft its name, and a checksum next to it, if it is a whole database with the expected digest.
async fn publish_verified(
    draft: Draft,
    destination: &Path,
    expected: Option<&str>,
    newest_schema: i64,
) -> Result<Verified> {
    let verified = verify(draft.path(), newest_schema).await?;
    let digest = verified.digest;
    if let Some(expected) = expected.filter(|expected| *digest.to_hex() != **expected) {
        let why = format!("it came in with BLAKE3 {digest}, not {expected}");
        return Err(BackupError::Damaged { file: destination.to_owned(), first: vec![why] });
    }
    let target = destination.to_owned();
    blocking(move || publish_with_checksum(draft, &target, digest)).await?;
    Ok(verified)
}

/// Makes a backup the database of a data directory that has none, whose lock the caller holds.
pub async fn restore(file: &Path, dir: &DataDir, newest_schema: i64) -> Result<RestoreReport> {
    let database = dir.database_file();
    refuse_database(&database)?;
    let verified = verify(file, newest_schema).await?;
    let (source, target, digest) = (file.to_owned(), database.clone(), verified.digest);
    blocking(move || {
        let draft = Draft::create(&target)?;
        copy(&source, &draft, digest)?;
        draft.publish(&target)
    })
    .await?;
    Ok(RestoreReport {
        database,
        bytes: verified.bytes,
        blake3_hex: digest.to_hex().to_string(),
        checksum: verified.checksum,
        counts: verified.counts,
    })
}

/// The address of a draft for SQLite: without locks, which some cluster filesystems do not offer and no other program
/// would check; and without creating the file, since a backup that was given up may still be waiting for its connection.
fn address(file: &Path) -> String {
    use std::os::unix::ffi::OsStrExt;
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/-_.".contains(&byte);
    let bytes = file.as_os_str().as_bytes();
    let escaped: String = bytes
        .iter()
        .map(|&byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") })
        .collect();
    format!("file:{escaped}?nolock=1&mode=rw")
}

/// The checksum comes first, so that no backup is ever without one; a checksum without its file does no harm.
fn publish_with_checksum(draft: Draft, destination: &Path, digest: blake3::Hash) -> Result<()> {
    draft::refuse_existing(destination)?;
    let sidecar = sidecar(destination);
    checksum::write(&sidecar, destination, digest)?;
    draft.publish(destination).inspect_err(|_| {
        // Another program that took the name in the meantime may have written its own checksum.
        if checksum::read(&sidecar).is_ok_and(|there| there == Some(digest)) {
            let _ = std::fs::remove_file(&sidecar);
        }
    })
}

fn copy(source: &Path, draft: &Draft, digest: blake3::Hash) -> Result<()> {
    let mut from = File::open(source).map_err(failed(source, "cannot be read"))?;
    let mut to = draft.file();
    std::io::copy(&mut from, &mut to).map_err(failed(draft.path(), "copying"))?;
    to.sync_all().map_err(failed(draft.path(), "writing to disk"))?;
    to.rewind().map_err(failed(draft.path(), "reading again"))?;
    let found = checksum::of(to).map_err(failed(draft.path(), "reading again"))?;
    if found == digest {
        return Ok(());
    }
    let why = format!(
        "its copy has BLAKE3 {found} instead of {digest}; it changed meanwhile, or a disk is failing"
    );
    Err(BackupError::Damaged { file: source.to_owned(), first: vec![why] })
}

/// A log without its database would be merged into the restored one, and ruin it.
fn refuse_database(database: &Path) -> Result<()> {
    let there = ["", "-wal", "-shm", "-journal"]
        .map(|suffix| draft::with_suffix(database, suffix))
        .into_iter()
        .filter(|file| file.symlink_metadata().is_ok())
        .filter_map(|file| Some(file.file_name()?.to_string_lossy().into_owned()))
        .collect::<Vec<_>>();
    if there.is_empty() {
        return Ok(());
    }
    let dir = database.parent().unwrap_or(Path::new(".")).to_owned();
    Err(BackupError::HoldsDatabase { dir, files: there })
}

/// Runs work that waits for disks where it delays no other task.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => result,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            // Blocking work that has begun is not cancelled, and a runtime that is ending polls no task.
            Err(error) => unreachable!("blocking work ended without a result: {error}"),
        },
    }
}
