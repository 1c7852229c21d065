//! The key of a coordinator that listens on loopback and has no access file.
//!
//! Every user of a machine reaches every port of its loopback. So such a coordinator asks for a random token, which it puts
//! where its own user alone can read it: `/tmp/resin-farm-UID/PORT`, or in the folder that FARM_KEYS names. That user's
//! programs find it there by themselves; nobody has to set up anything. The coordinator holds a lock on the file for as
//! long as it lives. Without that lock a program shows no token: whoever listens on the port by then is somebody else.

use std::fs::{DirBuilder, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rustix::fs::{Timespec, Timestamps, UTIME_NOW, futimens};

use crate::tokens::Tokens;
use crate::{Role, TOKEN_BYTES};

/// The name of the one whom the key lets in, in logs and events.
const NAME: &str = "local";
/// How long a coordinator waits for the lock that one before it on the same port, or a program that looks, still holds.
const WAIT: Duration = Duration::from_secs(2);
const STEP: Duration = Duration::from_millis(10);

/// A coordinator's key, while it serves.
#[derive(Debug)]
pub struct LocalKey {
    path: PathBuf,
    /// Holds the lock.
    file: File,
    tokens: Arc<Tokens>,
}

impl LocalKey {
    /// Makes a key for the coordinator on a port. `secret` is random, and of no other use.
    pub fn publish(port: u16, secret: [u8; 32]) -> io::Result<Self> {
        Self::publish_in(&folder(), port, secret)
    }

    fn publish_in(folder: &Path, port: u16, secret: [u8; 32]) -> io::Result<Self> {
        let fault = |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", folder.display()));
        DirBuilder::new().recursive(true).mode(0o700).create(folder).map_err(fault)?;
        check_folder(folder)?;
        remove_dead(folder);
        let path = folder.join(port.to_string());
        let mut file = locked(&path)?;
        let token = secret.map(|byte| format!("{byte:02x}")).concat();
        file.set_len(0)?;
        file.rewind()?;
        file.write_all(token.as_bytes())?;
        Ok(Self { path, file, tokens: Arc::new(Tokens::of_one(Role::Admin, NAME, &token)) })
    }

    /// Whom the key lets in: who shows it may do everything.
    pub fn tokens(&self) -> Arc<Tokens> {
        self.tokens.clone()
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Shows that the file is in use to those who tidy up `/tmp` by age. To be called now and then.
    pub fn touch(&self) {
        let now = Timespec { tv_sec: 0, tv_nsec: UTIME_NOW };
        let _ = futimens(&self.file, &Timestamps { last_access: now, last_modification: now });
    }
}

impl Drop for LocalKey {
    fn drop(&mut self) {
        // The lock is still held, so that it is this file and no follower's.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// The token of the coordinator of this user that serves on a port, if there is one.
pub(crate) fn token(port: u16) -> Option<String> {
    token_in(&folder(), port)
}

fn token_in(folder: &Path, port: u16) -> Option<String> {
    check_folder(folder).ok()?;
    let mut file = File::open(folder.join(port.to_string())).ok()?;
    match file.try_lock_shared() {
        Err(TryLockError::WouldBlock) => {}
        // Nobody holds it: the coordinator is gone.
        Ok(()) | Err(TryLockError::Error(_)) => return None,
    }
    let mut token = String::new();
    Read::by_ref(&mut file).take(*TOKEN_BYTES.end() as u64).read_to_string(&mut token).ok()?;
    TOKEN_BYTES.contains(&token.len()).then_some(token)
}

fn folder() -> PathBuf {
    // For where nothing can be written to `/tmp`.
    if let Some(folder) = std::env::var_os("FARM_KEYS").filter(|folder| !folder.is_empty()) {
        return folder.into();
    }
    // Not the environment's folder for temporary files, which differs between the sessions of a user.
    PathBuf::from(format!("/tmp/resin-farm-{}", rustix::process::getuid().as_raw()))
}

/// Whether a folder is this user's and closed to others: anybody can make one in `/tmp`.
fn check_folder(folder: &Path) -> io::Result<()> {
    let about = std::fs::symlink_metadata(folder)?;
    if !about.is_dir() || about.uid() != rustix::process::getuid().as_raw() || about.mode() & 0o077 != 0 {
        let problem = format!("{} is not a folder of this user's alone: remove it", folder.display());
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, problem));
    }
    Ok(())
}

/// Removes the keys of coordinators that were killed. One whose lock is taken in the same moment is made again: see
/// [`locked`].
fn remove_dead(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for path in entries.flatten().map(|entry| entry.path()) {
        let is_key = path.file_name().is_some_and(|name| name.to_string_lossy().parse::<u16>().is_ok());
        if is_key && File::open(&path).is_ok_and(|file| file.try_lock().is_ok()) {
            let _ = std::fs::remove_file(&path);
        }
    }
}

/// The file at a path, made if need be and locked.
fn locked(path: &Path) -> io::Result<File> {
    for _ in 0..WAIT.as_millis() / STEP.as_millis() {
        let file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).mode(0o600).open(path)?;
        let locked = match file.try_lock() {
            Ok(()) => true,
            Err(TryLockError::WouldBlock) => false,
            Err(TryLockError::Error(error)) => return Err(error),
        };
        // One that ended may have removed it meanwhile.
        if locked && std::fs::metadata(path).is_ok_and(|named| same(&named, &file)) {
            return Ok(file);
        }
        std::thread::sleep(STEP);
    }
    let problem = format!("{} is held by another coordinator", path.display());
    Err(io::Error::new(io::ErrorKind::WouldBlock, problem))
}

fn same(named: &std::fs::Metadata, file: &File) -> bool {
    file.metadata().is_ok_and(|own| (own.dev(), own.ino()) == (named.dev(), named.ino()))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    fn mode(path: &Path) -> u32 {
        std::fs::metadata(path).unwrap().mode() & 0o777
    }

    #[test]
    fn a_key_is_found_while_its_coordinator_lives() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("resin-farm");
        assert_eq!(token_in(&folder, 7700), None);
        let key = LocalKey::publish_in(&folder, 7700, [7; 32]).unwrap();
        assert_eq!([mode(&folder), mode(key.path())], [0o700, 0o600]);
        let token = token_in(&folder, 7700).unwrap();
        assert_eq!(key.tokens().role_of(&token), Some((Role::Admin, "local")));
        assert_eq!(token_in(&folder, 7701), None);
        assert!(LocalKey::publish_in(&folder, 7700, [8; 32]).is_err(), "the port is another's");
        assert_eq!(token_in(&folder, 7700).as_ref(), Some(&token));
        let path = key.path().to_owned();
        drop(key);
        assert!(!path.exists() && token_in(&folder, 7700).is_none());
    }

    /// A coordinator that was killed leaves its file, and another user may take the port.
    #[test]
    fn what_a_killed_coordinator_left_is_shown_to_nobody() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("resin-farm");
        let key = LocalKey::publish_in(&folder, 7700, [7; 32]).unwrap();
        let left = std::fs::read(key.path()).unwrap();
        drop(key);
        std::fs::write(folder.join("7700"), left).unwrap();
        assert_eq!(token_in(&folder, 7700), None);
        std::fs::write(folder.join("7701"), "dead").unwrap();
        std::fs::write(folder.join("notes"), "not ours").unwrap();
        let next = LocalKey::publish_in(&folder, 7700, [8; 32]).unwrap();
        assert_eq!(token_in(&folder, 7700).unwrap(), "08".repeat(32));
        assert!(!folder.join("7701").exists() && folder.join("notes").exists());
        let other = LocalKey::publish_in(&folder, 7701, [9; 32]).unwrap();
        assert_eq!(token_in(&folder, 7700).unwrap(), "08".repeat(32), "one that lives is left alone");
        drop((next, other));
    }

    #[test]
    fn a_folder_that_others_can_open_is_not_trusted() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("resin-farm");
        let key = LocalKey::publish_in(&folder, 7700, [7; 32]).unwrap();
        std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o755)).unwrap();
        assert_eq!(token_in(&folder, 7700), None);
        let error = LocalKey::publish_in(&folder, 7701, [7; 32]).unwrap_err().to_string();
        assert!(error.contains("not a folder of this user's alone"), "{error}");
        let link = home.path().join("link");
        std::os::unix::fs::symlink(&folder, &link).unwrap();
        assert!(check_folder(&link).is_err());
        drop(key);
    }
}
