//! Writes files atomically, and writes to devices and pipes without replacing them.

use std::ffi::OsString;
use std::fs::{File, Permissions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use tempfile::{Builder, NamedTempFile};

/// Permissions of a new file, before the process's umask.
const NEW_FILE: u32 = 0o666;

/// A file that is written in the destination's folder under a temporary name; [`DraftFile::finish`] renames it. Dropped
/// before, it leaves nothing. Output to a device or a pipe is collected in a temporary file.
#[derive(Debug)]
pub struct DraftFile {
    file: BufWriter<NamedTempFile>,
    place: Destination,
}

/// The destination of a finished draft.
#[derive(Debug)]
enum Destination {
    Name(PathBuf),
    Node(File),
}

impl DraftFile {
    pub fn create(path: &Path) -> io::Result<Self> {
        if let Some(node) = open_node(path)? {
            let file = BufWriter::new(NamedTempFile::new()?);
            return Ok(Self { file, place: Destination::Node(node) });
        }
        // The target of a link is replaced, not the link.
        let path = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let Some(name) = path.file_name() else {
            return Err(io::Error::new(io::ErrorKind::IsADirectory, "this is no name for a file"));
        };
        let mut prefix = OsString::from(".");
        prefix.push(name);
        prefix.push(".");
        let folder = folder_of(&path);
        let mut builder = Builder::new();
        builder.prefix(&prefix).suffix(".partial").permissions(Permissions::from_mode(NEW_FILE));
        let file = builder.tempfile_in(folder)?;
        if let Ok(before) = std::fs::metadata(&path) {
            file.as_file().set_permissions(before.permissions())?;
        }
        Ok(Self { file: BufWriter::new(file), place: Destination::Name(path) })
    }

    /// Renames the file to its destination, after all of it is synced to the disk.
    pub fn finish(self) -> io::Result<()> {
        let mut file = self.file.into_inner().map_err(io::IntoInnerError::into_error)?;
        match self.place {
            Destination::Name(path) => {
                file.as_file().sync_all()?;
                file.persist(&path).map_err(|error| error.error)?;
                // The rename is on the disk once the folder is synced.
                sync_folder(folder_of(&path))
            }
            Destination::Node(mut node) => {
                file.rewind()?;
                io::copy(&mut file, &mut node).map(drop)
            }
        }
    }
}

impl Write for DraftFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for DraftFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// Writes a file atomically.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut draft = DraftFile::create(path)?;
    draft.write_all(bytes)?;
    draft.finish()
}

/// Opens a character device or a pipe for writing; `None` if the path is a regular file or absent. Block devices,
/// sockets and folders are refused.
pub fn open_node(path: &Path) -> io::Result<Option<File>> {
    let Ok(found) = std::fs::metadata(path) else { return Ok(None) };
    let kind = found.file_type();
    let refused = |what: &str| {
        let allowed = "name a regular file, a character device or a pipe";
        Err(io::Error::new(io::ErrorKind::InvalidInput, format!("is {what}: {allowed}")))
    };
    if kind.is_file() {
        return Ok(None);
    }
    if kind.is_dir() {
        return refused("a folder");
    }
    if kind.is_block_device() {
        return refused("a block device");
    }
    if kind.is_socket() {
        return refused("a socket");
    }
    let node = File::options().write(true).open(path)?;
    let opened = node.metadata()?;
    if (opened.dev(), opened.ino()) != (found.dev(), found.ino()) {
        return refused("another file than a moment ago");
    }
    Ok(Some(node))
}

/// Syncs the names in a folder to the disk. Network filesystems and those in user space may return EINVAL or ENOTSUP for
/// every folder: these errors are ignored.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    let synced = File::open(folder)?.sync_all();
    match synced.as_ref().map_err(io::Error::kind) {
        Err(io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
        _ => synced,
    }
}

/// The folder that contains a file or folder.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<_> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Two drafts of one file are separate; one that is abandoned leaves the earlier file.
    #[test]
    fn two_drafts_of_one_file_are_separate() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.csv");
        let [mut first, mut second, mut third] = [(); 3].map(|()| DraftFile::create(&path).unwrap());
        first.write_all(b"first").unwrap();
        second.write_all(b"the second").unwrap();
        third.write_all(b"half").unwrap();
        third.flush().unwrap();
        assert!(!path.exists(), "it has its name only when it is whole");
        second.finish().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"the second");
        first.finish().unwrap();
        drop(third);
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        assert_eq!(names(folder.path()), ["out.csv"]);
    }

    /// A pipe is written to and stays a pipe.
    #[test]
    fn pipe_stays_a_pipe() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let reader = std::thread::spawn({
            let path = path.clone();
            move || std::fs::read(path).unwrap()
        });
        let mut draft = DraftFile::create(&path).unwrap();
        draft.write_all(b"?irst").unwrap();
        // Writers seek back, for example for the directory of a ZIP archive; a pipe cannot.
        draft.rewind().unwrap();
        draft.write_all(b"f").unwrap();
        draft.finish().unwrap();
        assert_eq!(reader.join().unwrap(), b"first");
        assert!(std::fs::metadata(&path).unwrap().file_type().is_fifo());
        assert_eq!(names(folder.path()), ["pipe"]);
    }

    /// Character devices are written to and stay devices; block devices are refused.
    #[test]
    fn block_devices_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (null, disk) = (folder.path().join("null"), folder.path().join("disk"));
        let mknod = |path: &Path, numbers: [&str; 3]| {
            let made = std::process::Command::new("mknod").arg(path).args(numbers).output().unwrap();
            made.status.success() && File::options().write(true).open(path).is_ok()
        };
        // A device like /dev/null, and a disk that does not exist. Only root can create and open them.
        if !mknod(&null, ["c", "1", "3"]) {
            return;
        }
        mknod(&disk, ["b", "240", "0"]);
        write_whole(&null, b"anything").unwrap();
        assert!(std::fs::metadata(&null).unwrap().file_type().is_char_device());
        if disk.exists() {
            let refused = write_whole(&disk, b"anything").unwrap_err().to_string();
            assert_eq!(refused, "is a block device: name a regular file, a character device or a pipe");
        }
    }

    #[test]
    fn folders_and_sockets_are_refused_and_stay() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        for (path, what) in [(folder.path(), "is a folder"), (&socket, "is a socket")] {
            let refused = write_whole(path, b"anything").unwrap_err().to_string();
            assert!(refused.starts_with(what), "{refused}");
        }
        assert!(std::fs::metadata(&socket).unwrap().file_type().is_socket());
        assert_eq!(names(folder.path()), ["socket"]);
    }

    /// A replaced file keeps its permissions; a new one has the usual ones.
    #[test]
    fn replaced_file_keeps_its_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let mode = |name: &str| std::fs::metadata(folder.path().join(name)).unwrap().permissions().mode();
        std::fs::write(folder.path().join("usual"), "").unwrap();
        write_whole(&folder.path().join("new"), b"").unwrap();
        assert_eq!(mode("new"), mode("usual"));
        let own = Permissions::from_mode(0o640);
        std::fs::set_permissions(folder.path().join("new"), own).unwrap();
        write_whole(&folder.path().join("new"), b"again").unwrap();
        assert_eq!(mode("new") & 0o777, 0o640);
    }

    /// A symbolic link stays, and the file that it leads to is replaced.
    #[test]
    fn link_stays_and_its_target_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("there")).unwrap();
        std::fs::write(folder.path().join("there/real.csv"), "before").unwrap();
        std::os::unix::fs::symlink("there/real.csv", folder.path().join("link.csv")).unwrap();
        write_whole(&folder.path().join("link.csv"), b"after").unwrap();
        assert_eq!(std::fs::read_to_string(folder.path().join("there/real.csv")).unwrap(), "after");
        assert!(folder.path().join("link.csv").is_symlink());
    }
}
