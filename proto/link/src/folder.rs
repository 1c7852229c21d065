//! Syncs folders, so that the names in them survive a loss of power.

use std::fs::File;
use std::io;
use std::path::Path;

/// Writes the names in a folder to the disk, if its filesystem supports that.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    where_supported(File::open(folder)?.sync_all())
}

/// Ignores EINVAL and ENOTSUP, with which network filesystems and those in user space may answer for every folder:
/// there is nothing to sync.
fn where_supported(synced: io::Result<()>) -> io::Result<()> {
    match synced.as_ref().map_err(io::Error::kind) {
        Err(io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
        _ => synced,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A filesystem that does not support the syncing of folders is not a failure.
    #[test]
    fn missing_folder_sync_is_no_failure() {
        let folder = tempfile::tempdir().unwrap();
        assert!(sync_folder(folder.path()).is_ok());
        assert!(sync_folder(&folder.path().join("none")).is_err());
        let answer = |code: i32| where_supported(Err(io::Error::from_raw_os_error(code)));
        let (einval, enosys, enotsup, eio) = (22, 38, 95, 5);
        #[cfg(target_os = "linux")]
        assert!([einval, enosys, enotsup].into_iter().all(|code| answer(code).is_ok()));
        assert!(answer(eio).is_err(), "the disk is broken");
    }
}
