//! Refuses filesystems on which SQLite's locks and shared memory cannot be relied upon.
//!
//! A write-ahead log needs memory that all its users share and locks that hold: several machines, or a server in
//! between, give neither, which leads to silent corruption.

use std::path::{Path, PathBuf};

#[derive(Debug, thiserror::Error)]
pub enum FilesystemError {
    #[error(
        "{path} is on {name}, which several machines can share: a database is not safe there; choose a folder on a \
         local disk with --data"
    )]
    Network { path: PathBuf, name: &'static str },
    #[error("asking for the filesystem of {path}: {source}")]
    Ask { path: PathBuf, source: std::io::Error },
}

/// The kind of a filesystem, as far as it matters for a database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Local,
    /// A program in user space, whose storage cannot be determined.
    Fuse,
    /// Served by, or shared with, other machines.
    Network(&'static str),
}

/// `f_type` of `statfs` for filesystems that are served or shared, with their common names.
const NETWORK: [(u32, &str); 20] = [
    // linux/magic.h
    (0x0000_6969, "NFS"),
    (0x0000_517B, "SMB"),
    (0xFF53_4D42, "SMB (CIFS)"),
    (0xFE53_4D42, "SMB 2 or later"),
    (0x00C3_6400, "Ceph"),
    (0x5346_414F, "AFS"),
    (0x6B41_4653, "AFS (kAFS)"),
    (0x0102_1997, "9p"),
    (0x7375_7245, "Coda"),
    (0x7461_636F, "OCFS2"),
    (0x0000_564C, "NCP (NetWare)"),
    // linux/gfs2_ondisk.h: GFS2_MAGIC
    (0x0116_1970, "GFS2"),
    // Linux, fs/orangefs/protocol.h: ORANGEFS_SUPER_MAGIC, once PVFS2_SUPER_MAGIC
    (0x2003_0528, "OrangeFS (PVFS2)"),
    // Lustre, lustre_user.h: LL_SUPER_MAGIC; servers' disks have LUSTRE_SUPER_MAGIC
    (0x0BD0_0BD0, "Lustre"),
    (0x0BD0_0BD1, "Lustre"),
    // IBM Spectrum Scale: "GPFS"; named S_MAGIC_GPFS in GNU coreutils' stat, as are those below
    (0x4750_4653, "GPFS (Spectrum Scale)"),
    // ThinkParQ: BEEGFS_MAGIC, once FHGFS_MAGIC
    (0x1983_0326, "BeeGFS"),
    // Panasas: S_MAGIC_PANFS
    (0xAAD7_AAEA, "PanFS"),
    // Quantum StorNext: S_MAGIC_SNFS
    (0xBEEF_DEAD, "StorNext"),
    // HPE IBRIX: S_MAGIC_IBRIX
    (0x0131_11A8, "IBRIX"),
];

/// linux/magic.h: FUSE_SUPER_MAGIC; block devices mounted through FUSE, such as NTFS, have it too.
const FUSE: u32 = 0x6573_5546;

/// Classifies a filesystem by its `f_type`; an unknown one counts as local.
pub fn classify(f_type: u32) -> Kind {
    if f_type == FUSE {
        return Kind::Fuse;
    }
    NETWORK.iter().find(|(magic, _)| *magic == f_type).map_or(Kind::Local, |(_, name)| Kind::Network(name))
}

/// Refuses a folder (or where it would be created) on a network filesystem; may return a warning to log.
///
/// Checks on Linux alone; other systems' filesystems are all accepted. The storage under an overlay, a loop device or a
/// network block device is not examined.
pub fn refuse_network_filesystem(path: &Path) -> Result<Option<String>, FilesystemError> {
    let existing = nearest_existing(path);
    let asked = f_type(&existing).map_err(|source| FilesystemError::Ask { path: existing, source })?;
    match asked.map_or(Kind::Local, classify) {
        Kind::Local => Ok(None),
        Kind::Fuse => Ok(Some(fuse_warning(path))),
        Kind::Network(name) => Err(FilesystemError::Network { path: path.to_owned(), name }),
    }
}

fn fuse_warning(path: &Path) -> String {
    format!(
        "{} is on a FUSE filesystem: if files of another machine are behind it (sshfs, s3fs, …), the database is not \
         safe there; choose a folder on a local disk with --data",
        path.display()
    )
}

/// The folder itself, or the one in which it would be created.
fn nearest_existing(path: &Path) -> PathBuf {
    let named = path.ancestors().filter(|folder| !folder.as_os_str().is_empty());
    named.into_iter().find(|folder| folder.exists()).unwrap_or(Path::new(".")).to_owned()
}

#[cfg(target_os = "linux")]
fn f_type(path: &Path) -> std::io::Result<Option<u32>> {
    // The type of the field differs between machines, and extends the sign on some; all constants fit 32 bits.
    Ok(Some(rustix::fs::statfs(path)?.f_type as u32))
}

#[cfg(not(target_os = "linux"))]
fn f_type(_path: &Path) -> std::io::Result<Option<u32>> {
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Network filesystems and shared disks are distinguished from local filesystems, each by a number of its own.
    #[test]
    fn filesystems_are_classified_as_local_or_not() {
        let local = [0xEF53, 0x5846_5342, 0x9123_683E, 0x0102_1994, 0x794C_7630, 0x2FC1_2FC1, 0xF2F5_2010, 0];
        for f_type in local {
            assert_eq!(classify(f_type), Kind::Local, "{f_type:#x}");
        }
        for (f_type, name) in NETWORK {
            assert_eq!(classify(f_type), Kind::Network(name), "{f_type:#x}");
        }
        // As stat of GNU coreutils names them.
        for (f_type, name) in [(0x6969, "NFS"), (0x0BD0_0BD0, "Lustre"), (0x1983_0326, "BeeGFS")] {
            assert_eq!(classify(f_type), Kind::Network(name), "{f_type:#x}");
        }
        assert_eq!(classify(0x6573_5546), Kind::Fuse);
    }

    /// The filesystem of the folder is examined, or of its nearest existing parent.
    #[test]
    fn nearest_existing_folder_is_examined() {
        let dir = tempfile::tempdir().unwrap();
        refuse_network_filesystem(dir.path()).unwrap();
        refuse_network_filesystem(&dir.path().join("not/there/yet")).unwrap();
        refuse_network_filesystem(Path::new("not-there-yet")).unwrap();
        assert_eq!(nearest_existing(&dir.path().join("not/there/yet")), dir.path());
        assert_eq!(nearest_existing(Path::new("not-there-yet")), Path::new("."));
    }

    /// The kernel reports `/proc` with its magic number.
    #[cfg(target_os = "linux")]
    #[test]
    fn proc_is_recognised_by_its_number() {
        assert_eq!(f_type(Path::new("/proc")).unwrap(), Some(0x9FA0));
    }
}
