//! Provides the Unix socket of a coordinator without an access file: the programs of its user reach it there, and no
//! others.
//!
//! Every user of a machine reaches every port of its loopback, and may take one whose coordinator has ended. A socket
//! in a folder that is closed to others cannot be taken, and both ends check the other's user by the kernel's
//! credentials.

use std::fs::DirBuilder;
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::net::{UnixListener, UnixStream};
use tokio::time::{Interval, MissedTickBehavior};

/// Interval at which the socket's name is checked: `/tmp` may be cleaned up, and a session's folder is removed with the
/// session.
const LOOK: Duration = Duration::from_secs(1);

/// A coordinator's socket, while it serves. It is named by the number of its port.
#[derive(Debug)]
pub struct LocalSocket {
    listener: UnixListener,
    path: PathBuf,
    inode: u64,
    port: u16,
    look: Interval,
}

impl LocalSocket {
    /// Opens the socket of the coordinator on a port. Must be called within a tokio runtime.
    pub fn open(port: u16) -> io::Result<Self> {
        let (listener, path, inode) = bind(&folders(), port)?;
        let mut look = tokio::time::interval(LOOK);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Ok(Self { listener, path, inode, port, look })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The next connection of a program of this user. Creates the socket again if its name is gone.
    pub fn poll_accept(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<UnixStream>> {
        while self.look.poll_tick(cx).is_ready() {
            if inode_of(&self.path) != Some(self.inode) {
                self.open_again();
            }
        }
        loop {
            let (stream, _) = ready!(self.listener.poll_accept(cx))?;
            if is_own(&stream)? {
                return Poll::Ready(Ok(stream));
            }
        }
    }

    fn open_again(&mut self) {
        match bind(&folders(), self.port) {
            Ok((listener, path, inode)) => {
                tracing::warn!(path = %path.display(), "the socket for this user's programs was removed: it is there again");
                (self.listener, self.path, self.inode) = (listener, path, inode);
            }
            Err(error) => tracing::error!(%error, "the socket for this user's programs was removed"),
        }
    }
}

impl Drop for LocalSocket {
    fn drop(&mut self) {
        if inode_of(&self.path) == Some(self.inode) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Connects to this user's coordinator on a port; None if there is none.
pub(crate) async fn connect(port: u16) -> io::Result<Option<UnixStream>> {
    connect_in(&folders(), port).await
}

async fn connect_in(folders: &[PathBuf], port: u16) -> io::Result<Option<UnixStream>> {
    for folder in folders.iter().filter(|folder| check_folder(folder).is_ok()) {
        match UnixStream::connect(folder.join(port.to_string())).await {
            Ok(stream) if is_own(&stream)? => return Ok(Some(stream)),
            Ok(_) => {}
            // There is none, or one of a coordinator that was killed.
            Err(error) if is_absent(&error) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(None)
}

fn is_absent(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused)
}

fn is_own(stream: &UnixStream) -> io::Result<bool> {
    Ok(stream.peer_cred()?.uid() == rustix::process::geteuid().as_raw())
}

/// Folders for sockets, best first. They do not depend on the session, which cron, Slurm and a login do not share.
fn folders() -> Vec<PathBuf> {
    if let Some(folder) = std::env::var_os("FARM_SOCKETS").filter(|folder| !folder.is_empty()) {
        return vec![folder.into()];
    }
    let user = rustix::process::geteuid().as_raw();
    [format!("/run/user/{user}/resin-farm"), format!("/tmp/resin-farm-{user}")].map(PathBuf::from).into()
}

/// A socket in the first folder that takes one, its path and inode.
fn bind(folders: &[PathBuf], port: u16) -> io::Result<(UnixListener, PathBuf, u64)> {
    let mut problem = io::Error::from(io::ErrorKind::NotFound);
    for folder in folders {
        match bind_in(folder, port) {
            Ok((listener, path)) => {
                let inode = std::fs::symlink_metadata(&path)?.ino();
                return Ok((listener, path, inode));
            }
            Err(error) => problem = io::Error::new(error.kind(), format!("{}: {error}", folder.display())),
        }
    }
    Err(problem)
}

fn bind_in(folder: &Path, port: u16) -> io::Result<(UnixListener, PathBuf)> {
    match DirBuilder::new().mode(0o700).create(folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => check_folder(folder)?,
    }
    remove_dead(folder);
    let path = folder.join(port.to_string());
    if std::os::unix::net::UnixStream::connect(&path).is_ok() {
        return Err(io::Error::new(
            io::ErrorKind::AddrInUse,
            format!("{port} is held by another coordinator"),
        ));
    }
    // The socket gets its name only when it listens.
    let draft = folder.join(format!("{port}.{}", std::process::id()));
    let _ = std::fs::remove_file(&draft);
    let listener = UnixListener::bind(&draft)?;
    std::fs::rename(&draft, &path)?;
    Ok((listener, path))
}

/// Checks that a folder belongs to this user and is closed to others: every user can create one in `/tmp`.
fn check_folder(folder: &Path) -> io::Result<()> {
    let about = std::fs::symlink_metadata(folder)?;
    if !about.is_dir() || about.uid() != rustix::process::geteuid().as_raw() || about.mode() & 0o077 != 0 {
        let problem = "not a folder of this user's alone (mode 700)";
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, problem));
    }
    Ok(())
}

/// Removes the sockets of coordinators that were killed.
fn remove_dead(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for path in entries.flatten().map(|entry| entry.path()) {
        let is_ours = path.file_name().is_some_and(|name| name.as_encoded_bytes()[0].is_ascii_digit());
        let refuses = |error: io::Error| error.kind() == io::ErrorKind::ConnectionRefused;
        if is_ours && std::os::unix::net::UnixStream::connect(&path).is_err_and(refuses) {
            let _ = std::fs::remove_file(&path);
        }
    }
}

fn inode_of(path: &Path) -> Option<u64> {
    std::fs::symlink_metadata(path).ok().map(|about| about.ino())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    use super::*;

    fn mode(path: &Path) -> u32 {
        std::fs::metadata(path).unwrap().mode() & 0o777
    }

    async fn finds(folders: &[PathBuf], port: u16) -> bool {
        connect_in(folders, port).await.unwrap().is_some()
    }

    /// The local socket is found as long as its coordinator runs.
    #[tokio::test]
    async fn socket_is_found_while_its_owner_lives() {
        let home = tempfile::tempdir().unwrap();
        // The first cannot be created, as for a user without a session.
        let folders = [home.path().join("none/farm"), home.path().join("farm")];
        assert!(!finds(&folders, 7700).await);
        let (listener, path, inode) = bind(&folders, 7700).unwrap();
        assert_eq!((path.as_path(), mode(&folders[1])), (folders[1].join("7700").as_path(), 0o700));
        assert_eq!(inode_of(&path), Some(inode));
        let mut client = connect_in(&folders, 7700).await.unwrap().unwrap();
        let (mut server, _) = listener.accept().await.unwrap();
        client.write_all(b"here").await.unwrap();
        let mut heard = [0; 4];
        server.read_exact(&mut heard).await.unwrap();
        assert!(is_own(&server).unwrap() && is_own(&client).unwrap() && &heard == b"here");
        assert!(!finds(&folders, 7701).await);
        assert!(bind(&folders, 7700).is_err(), "another coordinator's, which lives, is left alone");
        drop(listener);
        assert!(path.exists() && !finds(&folders, 7700).await, "one that was killed leaves its name");
        let _next = bind(&folders, 7701).unwrap();
        assert!(!path.exists(), "the next coordinator tidies up");
    }

    /// A folder that other users can open is not trusted.
    #[tokio::test]
    async fn folder_open_to_others_is_not_trusted() {
        let home = tempfile::tempdir().unwrap();
        let folders = [home.path().join("farm")];
        let socket = bind(&folders, 7700).unwrap();
        std::fs::set_permissions(&folders[0], std::fs::Permissions::from_mode(0o755)).unwrap();
        assert!(!finds(&folders, 7700).await);
        let error = bind(&folders, 7701).unwrap_err().to_string();
        assert!(error.contains("not a folder of this user's alone"), "{error}");
        std::fs::set_permissions(&folders[0], std::fs::Permissions::from_mode(0o700)).unwrap();
        assert!(finds(&folders, 7700).await);
        let link = home.path().join("link");
        std::os::unix::fs::symlink(&folders[0], &link).unwrap();
        assert!(!finds(&[link], 7700).await);
        drop(socket);
    }
}
