//! Checks that the database is still in its place. A file that was deleted or moved can be written to as before, but the
//! data have no name and are gone when the program ends, or are not where they are expected.

use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use super::{Result, StoreError};

/// A name, and the file that had it when the database was opened.
#[derive(Debug, Clone)]
pub(super) struct Place {
    name: PathBuf,
    /// Device and inode.
    file: (u64, u64),
}

impl Place {
    pub fn of(name: &Path) -> io::Result<Self> {
        Ok(Self { name: name.to_owned(), file: file_at(name)? })
    }

    /// Returns an error if the name is gone or another file's. A file that merely cannot be examined may still be there.
    pub fn check(&self) -> Result<()> {
        let lost = match file_at(&self.name) {
            Ok(file) => file != self.file,
            Err(error) => matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory),
        };
        if lost { Err(StoreError::Lost { file: self.name.clone() }) } else { Ok(()) }
    }
}

fn file_at(name: &Path) -> io::Result<(u64, u64)> {
    let about = std::fs::metadata(name)?;
    Ok((about.dev(), about.ino()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A database file that is moved, deleted or replaced counts as lost.
    #[test]
    fn moved_deleted_or_replaced_file_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let [data, away] = ["data", "away"].map(|name| folder.path().join(name));
        let file = data.join("farm.db");
        std::fs::create_dir(&data).unwrap();
        std::fs::write(&file, "").unwrap();
        let place = Place::of(&file).unwrap();
        place.check().unwrap();
        let is_lost = || matches!(place.check(), Err(StoreError::Lost { .. }));
        std::fs::rename(&data, &away).unwrap();
        assert!(is_lost());
        std::fs::create_dir(&data).unwrap();
        assert!(is_lost());
        std::fs::write(&file, "").unwrap();
        assert!(is_lost());
        std::fs::remove_dir_all(&data).unwrap();
        std::fs::write(&data, "").unwrap();
        assert!(is_lost());
        std::fs::remove_file(&data).unwrap();
        std::fs::rename(&away, &data).unwrap();
        place.check().unwrap();
    }
}
