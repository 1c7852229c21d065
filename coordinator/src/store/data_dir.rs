//! Prepares the data directory: creates it, closes it to other users, proves it writable and locks it before SQLite
//! touches it.

use std::fs::{DirBuilder, File, Permissions, TryLockError};
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use super::{Result, StoreError, filesystem};

/// File with the address at which the coordinator that holds the lock listens.
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
        DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(fault("cannot be created"))?;
        for taken in [path.to_owned(), path.join("farm.db")] {
            refuse_other_users(&taken)?;
        }
        close_folder(path);
        let lock = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .mode(0o600)
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
        for name in ["farm.db", "farm.db-wal", "farm.db-shm", "lock"] {
            let _ = close_to_others(&path.join(name), 0o600);
        }
        Ok(dir)
    }

    /// Creates an empty database file that only its owner can read, if there is none: SQLite would let others read it.
    /// SQLite gives its log the same permissions.
    pub fn create_database(&self) -> Result<()> {
        let file = File::options().create(true).append(true).mode(0o600).open(self.database_file());
        let fault =
            |source| StoreError::DataDir { dir: self.path.clone(), what: "cannot be written to", source };
        file.map(drop).map_err(fault)
    }

    /// The address at which the coordinator that holds this directory listens, if it has published one.
    pub fn address(path: &Path) -> Option<String> {
        std::fs::read_to_string(path.join(ADDRESS_FILE)).ok().filter(|a| !a.is_empty())
    }

    /// Prefix of the names of backups that are on their way to a client.
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

    /// Publishes the address at which this coordinator listens, whole or not at all.
    pub fn publish_address(&self, address: std::net::SocketAddr) -> Result<()> {
        let fault =
            |source| StoreError::DataDir { dir: self.path.clone(), what: "cannot be written to", source };
        let draft = self.path.join(format!("{ADDRESS_FILE}.new"));
        let mut file = File::create(&draft).map_err(fault)?;
        file.write_all(address.to_string().as_bytes()).map_err(fault)?;
        std::fs::rename(draft, self.path.join(ADDRESS_FILE)).map_err(fault)
    }

    pub fn forget_address(&self) {
        // A missing file need not be removed, and a stale address is noticed when there is no answer.
        let _ = std::fs::remove_file(self.path.join(ADDRESS_FILE));
    }
}

/// Refuses a file or folder of another user, who could read and change its contents. Root may use everything, and a
/// folder of root may be meant for this user, as a volume of a container is.
fn refuse_other_users(path: &Path) -> Result<()> {
    let own = rustix::process::geteuid().as_raw();
    match std::fs::metadata(path).map(|about| about.uid()) {
        Ok(owner) if own != 0 && owner != own && owner != 0 => {
            Err(StoreError::OtherUser { path: path.to_owned(), owner })
        }
        _ => Ok(()),
    }
}

/// Closes the folder to other users if it contains only the farm's files. One with other files, such as a home or `/tmp`,
/// stays as it is: there only the farm's files are closed, and a warning reports if others can replace them.
fn close_folder(path: &Path) {
    let own = ["farm.db", "lock", ADDRESS_FILE, "backup"];
    let is_own = |name: &str| own.iter().any(|own| name.starts_with(own));
    let Ok(mut entries) = std::fs::read_dir(path) else { return };
    let only_own = entries.all(|entry| entry.is_ok_and(|entry| is_own(&entry.file_name().to_string_lossy())));
    let closed = only_own && close_to_others(path, 0o700);
    if !closed && mode_of(path).is_some_and(|mode| mode & 0o022 != 0) {
        let dir = path.display();
        tracing::warn!(%dir, "other users of this machine can put files in here: give the farm a folder of its own");
    }
}

/// Restricts the permissions of an existing file or folder to `most`, so that other users have none. False if that is not
/// permitted.
fn close_to_others(path: &Path, most: u32) -> bool {
    let Some(now) = mode_of(path) else { return true };
    if now & !most == 0 {
        return true;
    }
    let shown = path.display();
    match std::fs::set_permissions(path, Permissions::from_mode(now & most)) {
        Ok(()) => tracing::info!(path = %shown, "closed to other users of this machine"),
        Err(error) => {
            tracing::warn!(path = %shown, %error, "other users of this machine may read or change this");
            return false;
        }
    }
    true
}

fn mode_of(path: &Path) -> Option<u32> {
    std::fs::metadata(path).ok().map(|about| about.permissions().mode() & 0o777)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mode(path: &Path) -> u32 {
        mode_of(path).unwrap()
    }

    /// A new data folder and its files can be read by their owner only.
    #[test]
    fn new_folder_and_files_are_private() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("new/farm-data");
        let dir = DataDir::lock(&path).unwrap();
        dir.create_database().unwrap();
        assert_eq!(mode(&path), 0o700);
        assert_eq!([mode(&path.join("lock")), mode(&dir.database_file())], [0o600, 0o600]);
    }

    /// A data folder that other users could read is closed to them.
    #[test]
    fn open_folder_is_closed_to_others() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("farm-data");
        std::fs::create_dir(&path).unwrap();
        std::fs::set_permissions(&path, Permissions::from_mode(0o755)).unwrap();
        for name in ["farm.db", "farm.db-wal", "lock"] {
            std::fs::write(path.join(name), "").unwrap();
            std::fs::set_permissions(path.join(name), Permissions::from_mode(0o644)).unwrap();
        }
        let _dir = DataDir::lock(&path).unwrap();
        assert_eq!(mode(&path), 0o700);
        assert_eq!(["farm.db", "farm.db-wal", "lock"].map(|name| mode(&path.join(name))), [0o600; 3]);
    }

    /// A folder with other files, such as a home or `/tmp`, keeps its permissions.
    #[test]
    fn folder_with_other_files_is_left_alone() {
        let home = tempfile::tempdir().unwrap();
        std::fs::set_permissions(home.path(), Permissions::from_mode(0o755)).unwrap();
        std::fs::write(home.path().join("thesis.tex"), "").unwrap();
        for _ in 0..2 {
            let dir = DataDir::lock(home.path()).unwrap();
            dir.create_database().unwrap();
            assert_eq!([mode(home.path()), mode(&dir.database_file())], [0o755, 0o600]);
        }
    }
}
