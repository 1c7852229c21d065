//! Makes backups on a schedule.
//!
//! Each is like one that `farmctl backup` makes: verified, with its checksum. Their names contain the time, so that they
//! are in order by name, and the oldest are removed when there are enough. One that fails is retried before long; the
//! existing ones stay.

use std::io;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio_util::sync::CancellationToken;

use super::{Farm, blocking};
use crate::actor::Actor;
use crate::clock::Clock;
use crate::config::BackupSchedule;
use crate::dispatch::EventKind;
use crate::store::StoreError;

/// Prefix and suffix of the names.
const PREFIX: &str = "farm-";
const SUFFIX: &str = ".db";
/// Longest time until a failed backup is retried.
const AGAIN: Duration = Duration::from_mins(10);

impl Farm {
    /// Makes backups until `shutdown`.
    pub(crate) async fn keep_backups(self: Arc<Self>, schedule: BackupSchedule, shutdown: CancellationToken) {
        let mut pause = self.until_first(&schedule).await;
        loop {
            tokio::select! {
                () = shutdown.cancelled() => return,
                () = tokio::time::sleep(pause) => {}
            }
            // A stop does not wait for a large database to be copied: an unfinished copy is removed.
            let made = tokio::select! {
                () = shutdown.cancelled() => return,
                made = self.scheduled_backup(&schedule) => made,
            };
            pause = match made {
                Ok(()) => schedule.every,
                Err(error) => {
                    let (folder, again) = (schedule.folder.display(), schedule.every.min(AGAIN));
                    tracing::error!(%error, %folder, again_s = again.as_secs(), "the scheduled backup failed");
                    self.scheduler.note(&Actor::default(), EventKind::BackupFailed, error.to_string());
                    again
                }
            };
        }
    }

    /// Time until the first backup is due: one of an earlier run may be recent enough.
    async fn until_first(&self, schedule: &BackupSchedule) -> Duration {
        let folder = schedule.folder.clone();
        let newest = blocking(move || {
            let newest = scheduled(&folder).ok()?.pop()?;
            std::fs::metadata(newest).ok()?.modified().ok()?.elapsed().ok()
        });
        let Some(age) = newest.await else { return Duration::ZERO };
        self.last_backup.is_old(age);
        schedule.every.saturating_sub(age)
    }

    async fn scheduled_backup(&self, schedule: &BackupSchedule) -> Result<(), StoreError> {
        let file = schedule.folder.join(name(Clock::unix_ms()));
        let folder = schedule.folder.clone();
        let fault = |source| StoreError::DataDir {
            dir: schedule.folder.clone(),
            what: "cannot be used for backups",
            source,
        };
        blocking(move || prepare(&folder)).await.map_err(fault)?;
        let report = self.store.backup(&file).await?;
        self.last_backup.is_old(Duration::ZERO);
        let message =
            format!("{}: {} records, {} bytes", file.display(), report.counts.records, report.bytes);
        self.scheduler.note(&Actor::default(), EventKind::BackupMade, message);
        let (folder, keep) = (schedule.folder.clone(), schedule.keep);
        if let Err(error) = blocking(move || forget_old(&folder, keep, &file)).await {
            tracing::warn!(%error, folder = %schedule.folder.display(), "old backups could not be removed");
        }
        Ok(())
    }
}

/// The time of the last scheduled backup, on a clock that never jumps.
#[derive(Debug)]
pub(super) struct LastBackup {
    clock: Clock,
    /// Its age at a time of the clock.
    age_at: Mutex<Option<(Duration, Duration)>>,
}

impl Default for LastBackup {
    fn default() -> Self {
        Self { clock: Clock::start(), age_at: Mutex::default() }
    }
}

impl LastBackup {
    fn is_old(&self, age: Duration) {
        *self.age_at.lock().unwrap_or_else(PoisonError::into_inner) = Some((age, self.clock.now()));
    }

    /// Age of the last backup; None if there is none.
    pub fn age(&self) -> Option<Duration> {
        let (age, at) = (*self.age_at.lock().unwrap_or_else(PoisonError::into_inner))?;
        Some(age + self.clock.now().saturating_sub(at))
    }
}

/// `farm-20261123T092000Z.db`.
fn name(unix_ms: u64) -> String {
    let time = jiff::Timestamp::from_millisecond(unix_ms as i64).unwrap_or_default();
    format!("{PREFIX}{}{SUFFIX}", time.strftime("%Y%m%dT%H%M%SZ"))
}

/// The scheduled backups of a folder, the oldest first. Other files in it have other names.
fn scheduled(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let is_one = |name: &str| {
        let time = name.strip_prefix(PREFIX).and_then(|name| name.strip_suffix(SUFFIX));
        time.is_some_and(|time| {
            time.len() == 16 && time.bytes().all(|b| b.is_ascii_digit() || b"TZ".contains(&b))
        })
    };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        if is_one(&entry.file_name().to_string_lossy()) {
            found.push(entry.path());
        }
    }
    found.sort();
    Ok(found)
}

/// Removes the oldest, with their checksums, until `keep` are left. A backup with a later name than the one just made was
/// made before the clock was set back, so it is older than all others.
fn forget_old(folder: &Path, keep: usize, just_made: &Path) -> io::Result<()> {
    let mut all = scheduled(folder)?;
    all.sort_by_key(|file| file.as_path() <= just_made);
    for old in &all[..all.len().saturating_sub(keep)] {
        std::fs::remove_file(old)?;
        let _ = std::fs::remove_file(old.with_extension("db.b3"));
    }
    Ok(())
}

/// Creates the folder if there is none, and removes unfinished backups of a coordinator that was killed.
fn prepare(folder: &Path) -> io::Result<()> {
    std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let begun = name.starts_with(PREFIX) && name.contains(".db.draft");
        // A draft that is being written is locked.
        if begun && std::fs::File::open(&path).is_ok_and(|file| file.try_lock().is_ok()) {
            std::fs::remove_file(&path)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Backups made after the clock was set back count as newer than those with later times in their names.
    #[test]
    fn backups_after_a_clock_change_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let make = |hour: u64| {
            let file = folder.path().join(name(hour * 3_600_000));
            std::fs::write(&file, "").unwrap();
            forget_old(folder.path(), 2, &file).unwrap();
        };
        let kept = |hours: [u64; 2]| {
            let names = hours.map(|hour| folder.path().join(name(hour * 3_600_000)));
            assert_eq!(scheduled(folder.path()).unwrap(), names);
        };
        make(7);
        make(8);
        kept([7, 8]);
        make(3);
        kept([3, 8]);
        make(4);
        kept([3, 4]);
    }

    /// Other files of the folder stay, except for abandoned drafts.
    #[test]
    fn old_backups_are_removed_in_name_order() {
        assert_eq!(name(1_795_425_600_000), "farm-20261123T092000Z.db");
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str| std::fs::write(folder.path().join(name), "").unwrap();
        let times = [3, 1, 2].map(|hour| name(hour * 3_600_000));
        for backup in &times {
            write(backup);
            write(&format!("{backup}.b3"));
        }
        let others = ["farm-before-the-upgrade.db", "farm.db", "farm-19700101T050000Z.db.draft"];
        for name in others {
            write(name);
        }
        forget_old(folder.path(), 2, &folder.path().join(&times[0])).unwrap();
        let left: Vec<PathBuf> = scheduled(folder.path()).unwrap();
        assert_eq!(left, [&times[2], &times[0]].map(|name| folder.path().join(name)));
        assert!(!folder.path().join(format!("{}.b3", times[1])).exists());
        assert!(others.iter().all(|name| folder.path().join(name).exists()));
        prepare(folder.path()).unwrap();
        assert!(others[..2].iter().all(|name| folder.path().join(name).exists()));
        assert!(!folder.path().join(others[2]).exists(), "it is not continued");
    }
}
