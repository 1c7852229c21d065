mod full_disk;
mod incoming;

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{AssertSqlSafe, SqlitePool};

use super::*;

const PAGE_BYTES: usize = crate::store::PAGE_BYTES as usize;
/// A part of a profile, to be found again in the file.
const MARK: &[u8] = b"a mark that no page holds by chance";

fn newest() -> i64 {
    crate::store::migration::migrator().iter().map(|migration| migration.version).max().unwrap()
}

/// A database as the store opens it, except that it does not wait for the disk.
async fn open(file: &Path) -> SqlitePool {
    let options = SqliteConnectOptions::new()
        .filename(file)
        .create_if_missing(true)
        .page_size(PAGE_BYTES as u32)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Off);
    let pool = SqlitePoolOptions::new().max_connections(1).connect_with(options).await.unwrap();
    crate::store::migration::migrator().run(&pool).await.unwrap();
    pool
}

async fn reader(file: &Path) -> SqlitePool {
    let options = SqliteConnectOptions::new().filename(file).read_only(true);
    SqlitePoolOptions::new().max_connections(2).connect_with(options).await.unwrap()
}

async fn run(pool: &SqlitePool, sql: &str) {
    sqlx::raw_sql(AssertSqlSafe(sql)).execute(pool).await.unwrap();
}

/// A job with its two records, in one commit.
async fn add_job(pool: &SqlitePool, job: i64, profiles: &[u8]) {
    let mut transaction = pool.begin_with("BEGIN IMMEDIATE").await.unwrap();
    for sql in [
        "INSERT INTO points (id, identity) VALUES (?1 + 1, CAST(printf('%032d', ?1) AS BLOB))",
        "INSERT INTO jobs (dictionary_id, job, point_id, walks, records_digest) \
         VALUES (1, ?1, ?1 + 1, 5000, zeroblob(32))",
    ] {
        sqlx::query(sql).bind(job).execute(&mut *transaction).await.unwrap();
    }
    let records =
        "INSERT INTO records (point_id, albedo, profiles) VALUES (?1 + 1, 0.5, ?2), (?1 + 1, 0.9, ?2)";
    sqlx::query(records).bind(job).bind(profiles).execute(&mut *transaction).await.unwrap();
    transaction.commit().await.unwrap();
}

/// A database with 60 jobs, some megabyte large.
async fn filled(dir: &Path) -> SqlitePool {
    let pool = open(&dir.join("farm.db")).await;
    let dictionary = "INSERT INTO dictionaries (id, name, grid, grid_digest, created_unix_ms) \
                      VALUES (1, 'd', x'', zeroblob(32), 0)";
    run(&pool, dictionary).await;
    let mut profiles = vec![7; 8640];
    profiles[4000..4000 + MARK.len()].copy_from_slice(MARK);
    for job in 0..60 {
        add_job(&pool, job, &profiles).await;
    }
    pool
}

/// A folder with a backup, `copy`, of a filled database.
async fn with_backup() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let pool = filled(dir.path()).await;
    run(&pool, &format!("PRAGMA application_id = {APPLICATION_ID}")).await;
    let copy = dir.path().join("copy");
    backup(&pool, &copy, newest()).await.unwrap();
    pool.close().await;
    (dir, copy)
}

fn change(file: &Path, at: usize, change: impl Fn(u8) -> u8) {
    let mut bytes = std::fs::read(file).unwrap();
    bytes[at] = change(bytes[at]);
    std::fs::write(file, bytes).unwrap();
}

/// The error of a file that is refused. Restoring and verifying must give the same message, and the data directory must
/// stay empty.
async fn refusal(file: &Path) -> BackupError {
    let home = tempfile::tempdir().unwrap();
    let dir = DataDir::lock(home.path()).unwrap();
    let restored = restore(file, &dir, newest()).await.unwrap_err();
    let names: Vec<_> =
        std::fs::read_dir(home.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names, ["lock"]);
    let verified = verify(file, newest()).await.unwrap_err();
    assert_eq!(verified.to_string(), restored.to_string());
    verified
}

/// A backup is restored byte for byte, with the application id. Backup and restored database are private, whatever the mode
/// of the file that is restored.
#[tokio::test]
async fn backup_is_restored_byte_for_byte() {
    let (dir, copy) = with_backup().await;
    assert_eq!(std::fs::read(&copy).unwrap()[68..72], *b"FARM");
    let report = verify(&copy, newest()).await.unwrap();
    assert_eq!(report.checksum, Checksum::Agrees);
    let counts = BackupCounts { schema_version: newest(), dictionaries: 1, jobs: 60, records: 120 };
    assert_eq!(report.counts, counts);
    let mode = |file: &Path| std::fs::metadata(file).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(&copy), 0o600);
    std::fs::set_permissions(&copy, std::fs::Permissions::from_mode(0o644)).unwrap();
    let home = dir.path().join("home");
    let restored = restore(&copy, &DataDir::lock(&home).unwrap(), newest()).await.unwrap();
    assert_eq!((restored.counts, restored.checksum), (counts, Checksum::Agrees));
    assert_eq!(mode(&restored.database), 0o600);
    assert_eq!(std::fs::read(&copy).unwrap(), std::fs::read(home.join("farm.db")).unwrap());
    let pool = open(&home.join("farm.db")).await;
    add_job(&pool, 60, b"it can be written to").await;
    pool.close().await;
}

/// A backup contains every transaction that was committed before the call, and none in part.
#[tokio::test]
async fn backups_of_a_busy_database_are_complete() {
    let dir = tempfile::tempdir().unwrap();
    let pool = filled(dir.path()).await;
    let committed = Arc::new(AtomicI64::new(60));
    let (writing, count) = (pool.clone(), Arc::clone(&committed));
    let writer = tokio::spawn(async move {
        loop {
            let job = count.load(Ordering::SeqCst);
            add_job(&writing, job, &[1; 8640]).await;
            count.store(job + 1, Ordering::SeqCst);
        }
    });
    let read = reader(&dir.path().join("farm.db")).await;
    for round in 0..5 {
        let last = committed.load(Ordering::SeqCst);
        while committed.load(Ordering::SeqCst) == last {
            tokio::task::yield_now().await;
        }
        let before = committed.load(Ordering::SeqCst);
        let copy = dir.path().join(format!("copy {round}%?#"));
        let report = backup(&read, &copy, newest()).await.unwrap();
        let jobs = report.counts.jobs as i64;
        assert!(jobs >= before, "{jobs} of {before} jobs");
        assert_eq!(report.counts.records, 2 * report.counts.jobs, "a job came without its records");
        let copied = reader(&copy).await;
        let last: i64 = sqlx::query_scalar("SELECT max(job) FROM jobs").fetch_one(&copied).await.unwrap();
        assert_eq!(last, jobs - 1, "a job before the last is missing");
        copied.close().await;
    }
    writer.abort();
}

#[tokio::test]
async fn changed_page_header_is_refused() {
    // The page's kind, and its count of stray bytes: no query fails because of the latter.
    for (offset, message) in [(0, ""), (7, "ragmentation")] {
        let (_dir, copy) = with_backup().await;
        change(&copy, 3 * PAGE_BYTES + offset, |byte| byte ^ 0x1F);
        assert!(matches!(refusal(&copy).await, BackupError::Checksum { .. }));
        std::fs::remove_file(checksum::sidecar(&copy)).unwrap();
        let error = refusal(&copy).await;
        assert!(matches!(&error, BackupError::Damaged { first, .. } if !first.is_empty()), "{error}");
        assert!(error.to_string().contains(message), "{error}");
    }
}

/// A changed bit within a profile is found by the checksum only, and a checksum file with other content is refused.
#[tokio::test]
async fn only_the_checksum_finds_a_flipped_bit() {
    let (_dir, copy) = with_backup().await;
    let at = std::fs::read(&copy).unwrap().windows(MARK.len()).position(|window| window == MARK).unwrap();
    change(&copy, at, |byte| byte ^ 1);
    let error = refusal(&copy).await;
    assert!(matches!(error, BackupError::Checksum { .. }), "{error}");
    assert!(error.to_string().contains("copy.b3 says"), "{error}");
    std::fs::write(checksum::sidecar(&copy), "not a checksum").unwrap();
    assert!(matches!(refusal(&copy).await, BackupError::NotAChecksum { .. }));
    std::fs::remove_file(checksum::sidecar(&copy)).unwrap();
    assert_eq!(verify(&copy, newest()).await.unwrap().checksum, Checksum::Absent);
}

/// A file that was cut short, or is not a farm's database, is refused with the reason.
#[tokio::test]
async fn foreign_file_is_refused_with_reason() {
    let (dir, copy) = with_backup().await;
    std::fs::remove_file(checksum::sidecar(&copy)).unwrap();
    let whole = std::fs::read(&copy).unwrap();
    let cut = |bytes: usize| {
        let reason = format!("damaged: it is cut short: {bytes} of {} bytes are there", whole.len());
        (whole[..bytes].to_vec(), reason)
    };
    let foreign =
        |bytes: &[u8], reason: &str| (bytes.to_vec(), format!("is not a farm's database: {reason}"));
    for (bytes, reason) in [
        cut(whole.len() - 1),
        cut(whole.len() / 2),
        cut(4096),
        cut(100),
        foreign(b"", "it is empty"),
        foreign(b"some text", "it is not an SQLite database"),
        foreign(&[b'x'; 5000], "it is not an SQLite database"),
    ] {
        std::fs::write(&copy, bytes).unwrap();
        let error = refusal(&copy).await.to_string();
        assert!(error.ends_with(&reason), "{error} instead of {reason}");
    }
    assert!(refusal(dir.path()).await.to_string().ends_with("it is not a file"));
    assert!(matches!(refusal(&dir.path().join("nowhere")).await, BackupError::File { .. }));
}

/// The database of another program is refused, and one with broken references. Triggers and views act when others read
/// and write, and no farm has one.
#[tokio::test]
async fn foreign_database_is_refused() {
    let cases = [
        ("DROP TABLE records", "a farm's tables are not in it"),
        ("PRAGMA application_id = 7", "its application_id is 0x00000007, not 0x4641524d"),
        (
            "CREATE TRIGGER t AFTER INSERT ON jobs BEGIN DELETE FROM records; END",
            "which would act on what is read or written",
        ),
        ("CREATE VIEW v AS SELECT * FROM records", "which would act on what is read or written"),
        (
            "PRAGMA foreign_keys = OFF; DELETE FROM dictionaries",
            "60 rows of table jobs refer to rows of dictionaries that are missing",
        ),
    ];
    let (dir, copy) = with_backup().await;
    let file = dir.path().join("other.db");
    for (change, reason) in cases {
        std::fs::copy(&copy, &file).unwrap();
        let pool = open(&file).await;
        run(&pool, change).await;
        pool.close().await;
        let error = refusal(&file).await.to_string();
        assert!(error.contains(reason), "{change}: {error}");
    }
}

/// A database with a newer schema is refused, and the message requests a newer version of the program.
#[tokio::test]
async fn newer_schema_asks_for_newer_version() {
    let (_dir, copy) = with_backup().await;
    let error = verify(&copy, newest() - 1).await.unwrap_err();
    assert!(matches!(error, BackupError::NewerSchema { .. }), "{error}");
    let (has, knows) = (newest(), newest() - 1);
    let told = format!("has schema {has}, but this version knows schemas up to {knows}: install the version");
    assert!(error.to_string().contains(&told), "{error}");
}

/// A database whose write-ahead log is not merged is refused.
#[tokio::test]
async fn unmerged_log_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let pool = filled(dir.path()).await;
    assert!(matches!(refusal(&dir.path().join("farm.db")).await, BackupError::Unmerged { .. }));
    pool.close().await;
    verify(&dir.path().join("farm.db"), newest()).await.unwrap();
}

#[tokio::test]
async fn nothing_that_exists_is_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let pool = filled(dir.path()).await;
    let copy = dir.path().join("copy");
    std::fs::write(&copy, "dear").unwrap();
    let error = backup(&pool, &copy, newest()).await.unwrap_err();
    assert!(matches!(error, BackupError::Exists { .. }), "{error}");
    assert_eq!(std::fs::read(&copy).unwrap(), b"dear");
    assert!(!checksum::sidecar(&copy).exists() && !draft::with_suffix(&copy, ".draft").exists());
    let draft = Draft::create(&dir.path().join("late")).unwrap();
    std::fs::write(dir.path().join("late"), "dear").unwrap();
    assert!(matches!(draft.publish(&dir.path().join("late")), Err(BackupError::Exists { .. })));
    assert_eq!(std::fs::read(dir.path().join("late")).unwrap(), b"dear");
}

/// A restore refuses a data folder that holds a database or its log.
#[tokio::test]
async fn restore_spares_an_existing_database() {
    let (dir, copy) = with_backup().await;
    let home = dir.path().join("home");
    let locked = DataDir::lock(&home).unwrap();
    for name in ["farm.db", "farm.db-wal"] {
        std::fs::write(home.join(name), "dear").unwrap();
        let error = restore(&copy, &locked, newest()).await.unwrap_err().to_string();
        assert!(error.ends_with(&format!("holds a database already: move {name} away")), "{error}");
        std::fs::remove_file(home.join(name)).unwrap();
    }
    restore(&copy, &locked, newest()).await.unwrap();
}

/// The draft of a running backup stays, and a second backup to the same file is refused.
#[tokio::test]
async fn drafts_of_killed_backups_are_removed() {
    let dir = tempfile::tempdir().unwrap();
    let pool = filled(dir.path()).await;
    let copy = dir.path().join("copy");
    let leftover = draft::with_suffix(&copy, ".draft");
    std::fs::write(&leftover, "half a file").unwrap();
    std::fs::write(checksum::sidecar(&copy), "stale").unwrap();
    let running = Draft::create(&copy).unwrap();
    let error = backup(&pool, &copy, newest()).await.unwrap_err();
    assert!(matches!(error, BackupError::Busy { .. }), "{error}");
    assert!(leftover.exists());
    // A killed process releases its lock, but does not remove its draft.
    std::fs::copy(&leftover, dir.path().join("kept")).unwrap();
    drop(running);
    std::fs::rename(dir.path().join("kept"), &leftover).unwrap();
    backup(&pool, &copy, newest()).await.unwrap();
    assert!(!leftover.exists());
    assert_eq!(verify(&copy, newest()).await.unwrap().checksum, Checksum::Agrees);
}

/// A backup that is abandoned leaves no files.
#[test]
fn abandoned_backup_leaves_nothing() {
    let runtime = || tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let (dir, of_pool) = (tempfile::tempdir().unwrap(), runtime());
    let pool = of_pool.block_on(filled(dir.path()));
    let copy = dir.path().join("copy");
    let mut given_up = 0;
    for ms in [0, 1, 2, 5] {
        let (limit, own) = (Duration::from_millis(ms), runtime());
        let ended = own.block_on(async { tokio::time::timeout(limit, backup(&pool, &copy, newest())).await });
        given_up += u32::from(ended.is_err());
        // Waits for the step that was running.
        drop(own);
        assert!(!draft::with_suffix(&copy, ".draft").exists(), "after {ms} ms");
        assert!(!copy.exists() || checksum::sidecar(&copy).exists(), "after {ms} ms");
        let _ = (std::fs::remove_file(&copy), std::fs::remove_file(checksum::sidecar(&copy)));
    }
    assert!(given_up > 0, "no backup was given up");
}
