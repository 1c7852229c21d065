//! Finds the photographs that arrive in a folder.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, Result};
use farm_lab::capture::is_photograph;

/// The new photographs of a folder.
#[derive(Debug)]
pub(super) struct NewPhotographs {
    folder: PathBuf,
    /// Files that were there before, or have been returned.
    known: BTreeMap<OsString, Version>,
    /// New files at the last look: a file that still changes is incomplete.
    changing: BTreeMap<OsString, Version>,
}

/// Size and time of the last change: a photograph may be replaced by another one of the same name.
type Version = (u64, Option<SystemTime>);

impl NewPhotographs {
    pub(super) fn new(folder: &Path) -> Result<Self> {
        let mut arrivals =
            Self { folder: folder.to_owned(), known: BTreeMap::new(), changing: BTreeMap::new() };
        arrivals.known = arrivals.files()?;
        Ok(arrivals)
    }

    /// New photographs that have not changed since the last look, in the order of their names.
    pub(super) fn complete(&mut self) -> Result<Vec<PathBuf>> {
        let mut now = self.files()?;
        now.retain(|name, version| self.known.get(name) != Some(version));
        let mut done = now.clone();
        done.retain(|name, version| version.0 > 0 && self.changing.get(name) == Some(version));
        self.changing = now;
        let paths = done.keys().map(|name| self.folder.join(name)).collect();
        self.known.extend(done);
        Ok(paths)
    }

    /// The photographs of the folder.
    fn files(&self) -> Result<BTreeMap<OsString, Version>> {
        let place = || format!("watching {}", self.folder.display());
        let mut files = BTreeMap::new();
        for entry in std::fs::read_dir(&self.folder).with_context(place)? {
            let entry = entry.with_context(place)?;
            // A file may be renamed or deleted between the two calls.
            let Ok(about) = entry.path().metadata() else { continue };
            if about.is_file() && is_photograph(&entry.path()) {
                files.insert(entry.file_name(), (about.len(), about.modified().ok()));
            }
        }
        Ok(files)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A photograph is returned once, when its file does not change any more, and again when another one has its name; older
    /// and other files are not.
    #[test]
    fn arrivals_are_complete_and_returned_once() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
        write("old.dng", b"1");
        let mut arrivals = NewPhotographs::new(folder.path()).unwrap();
        write("new.dng", b"");
        write("notes.txt", b"1");
        assert!(arrivals.complete().unwrap().is_empty(), "empty");
        assert!(arrivals.complete().unwrap().is_empty(), "still empty");
        write("new.dng", b"12");
        assert!(arrivals.complete().unwrap().is_empty(), "has grown");
        assert_eq!(arrivals.complete().unwrap(), [folder.path().join("new.dng")]);
        assert!(arrivals.complete().unwrap().is_empty(), "returned before");
        write("new.dng", b"345");
        assert!(arrivals.complete().unwrap().is_empty(), "just replaced");
        assert_eq!(arrivals.complete().unwrap(), [folder.path().join("new.dng")]);
        let gone = folder.path().join("gone");
        assert!(NewPhotographs::new(&gone).unwrap_err().to_string().contains("gone"));
    }
}
