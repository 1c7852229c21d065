//! Writes files that get their name only when they are complete.

use std::ffi::OsString;
use std::fs::{File, TryLockError};
use std::io::ErrorKind;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use farm_link::sync_folder;

use super::{BackupError, Result, failed};

pub(super) fn with_suffix(file: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(file);
    name.push(suffix);
    name.into()
}

/// Even a dangling link counts as existing.
pub(super) fn refuse_existing(file: &Path) -> Result<()> {
    match file.symlink_metadata() {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(failed(file, "cannot be looked up")(error)),
        Ok(_) => Err(BackupError::Exists { file: file.to_owned() }),
    }
}

/// An empty file next to its target, which no other user can read, locked while it is being filled, removed unless it is
/// published.
#[derive(Debug)]
pub(super) struct Draft {
    path: PathBuf,
    file: File,
    published: bool,
}

impl Draft {
    /// Creates a draft, and removes an earlier draft of the same target that was left behind.
    pub(super) fn create(target: &Path) -> Result<Self> {
        refuse_existing(target)?;
        let path = with_suffix(target, ".draft");
        remove_leftover(&path, target)?;
        let file = File::options()
            .create_new(true)
            .read(true)
            .write(true)
            .mode(0o600)
            .open(&path)
            .map_err(failed(&path, "cannot be created"))?;
        let draft = Self { path, file, published: false };
        lock(&draft.file, target)?;
        Ok(draft)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn file(&self) -> &File {
        &self.file
    }

    /// Gives the file its name once all of it is on disk; another file of that name is left alone.
    pub(super) fn publish(mut self, target: &Path) -> Result<()> {
        self.file.sync_all().map_err(failed(target, "writing to disk"))?;
        rename_new(&self.path, target).map_err(|error| match error.kind() {
            ErrorKind::AlreadyExists => BackupError::Exists { file: target.to_owned() },
            _ => failed(target, "cannot be given its name")(error),
        })?;
        self.published = true;
        let dir = target.parent().unwrap_or(Path::new("."));
        sync_folder(dir).map_err(failed(dir, "writing the folder to disk"))
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        if !self.published {
            // SQLite leaves a journal only where it was interrupted.
            let _ = std::fs::remove_file(&self.path);
            let _ = std::fs::remove_file(with_suffix(&self.path, "-journal"));
        }
    }
}

/// Removes a draft that was left behind. If its lock is free it has no writer any more: locks end with their process.
fn remove_leftover(path: &Path, target: &Path) -> Result<()> {
    let leftover = match File::options().write(true).open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(failed(path, "cannot be opened")(error)),
    };
    lock(&leftover, target)?;
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(failed(path, "cannot be removed")(error)),
        _ => Ok(()),
    }
}

/// Locks a draft. On a filesystem without locks, two backups to one file are not detected here: the second to end is
/// refused.
fn lock(file: &File, target: &Path) -> Result<()> {
    match file.try_lock() {
        Ok(()) | Err(TryLockError::Error(_)) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(BackupError::Busy { file: target.to_owned() }),
    }
}

/// Renames unless the name is taken; in one step where the filesystem can do that.
fn rename_new(from: &Path, to: &Path) -> std::io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        use rustix::io::Errno;
        match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
            Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => {}
            done => return Ok(done?),
        }
    }
    if to.symlink_metadata().is_ok() {
        return Err(ErrorKind::AlreadyExists.into());
    }
    std::fs::rename(from, to)
}
