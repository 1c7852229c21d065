//! The data directory: created, proven writable and locked before SQLite touches it.

use std::fs::{File, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};

use super::{Result, StoreError, filesystem};

/// File that tells where the coordinator that holds the lock listens.
pub const ADDRESS_FILE: &str = "coordinator.addr";

/// A data directory with its lock, which ends with the process, however that ends.
#[derive(Debug)]
pub struct DataDir {
    path: PathBuf,
    _lock: File,
}

impl DataDir {
    pub fn lock(path: &Path) -> Result<Self> {
        let fault = |what| move |source| StoreError::DataDir { dir: path.to_owned(), what, source };
        if let Some(warning) = filesystem::refuse_network_filesystem(path)? {
            tracing::warn!("{warning}");
        }
        std::fs::create_dir_all(path).map_err(fault("cannot be created"))?;
        let lock = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(path.join("lock"))
            .map_err(fault("cannot be written to"))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let at = Self::address(path).map(|a| format!(" (at {a})")).unwrap_or_default();
                return Err(StoreError::InUse { dir: path.to_owned(), at });
            }
            Err(TryLockError::Error(source)) => return Err(fault("cannot be locked")(source)),
        }
        let dir = Self { path: path.to_owned(), _lock: lock };
        dir.forget_address();
        dir.remove_leftovers();
        Ok(dir)
    }

    /// Where the coordinator that holds this directory listens, if it has said so.
    pub fn address(path: &Path) -> Option<String> {
        std::fs::read_to_string(path.join(ADDRESS_FILE)).ok().filter(|a| !a.is_empty())
    }

    /// How the names of backups begin that are on their way to a client.
    pub const BACKUP_PREFIX: &str = "backup-";

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes backups that a coordinator which was killed has left behind.
    fn remove_leftovers(&self) {
        let Ok(entries) = std::fs::read_dir(&self.path) else { return };
        for entry in entries.flatten() {
            if entry.file_name().to_string_lossy().starts_with(Self::BACKUP_PREFIX) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    pub fn database_file(&self) -> PathBuf {
        self.path.join("farm.db")
    }

    /// Tells other processes where this coordinator listens; whole or not at all.
    pub fn publish_address(&self, address: std::net::SocketAddr) -> Result<()> {
        let fault =
            |source| StoreError::DataDir { dir: self.path.clone(), what: "cannot be written to", source };
        let draft = self.path.join(format!("{ADDRESS_FILE}.new"));
        let mut file = File::create(&draft).map_err(fault)?;
        file.write_all(address.to_string().as_bytes()).map_err(fault)?;
        std::fs::rename(draft, self.path.join(ADDRESS_FILE)).map_err(fault)
    }

    pub fn forget_address(&self) {
        // What is not there need not be removed, and a stale address is noticed when nobody answers.
        let _ = std::fs::remove_file(self.path.join(ADDRESS_FILE));
    }
}
