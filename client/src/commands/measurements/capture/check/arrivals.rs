//! Finds the photographs that arrive in a folder.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// Endings of files that lie next to photographs, and of incomplete ones.
const OTHERS: [&str; 12] =
    ["csv", "crdownload", "html", "json", "md", "part", "pdf", "svg", "tmp", "toml", "txt", "xmp"];

/// The new photographs of a folder.
#[derive(Debug)]
pub(super) struct NewPhotographs {
    folder: PathBuf,
    /// Files that were there before, or have been returned.
    known: BTreeSet<OsString>,
    /// Sizes of new files at the last look: a file that still grows is incomplete.
    growing: BTreeMap<OsString, u64>,
}

impl NewPhotographs {
    pub(super) fn new(folder: &Path) -> Result<Self> {
        let mut arrivals =
            Self { folder: folder.to_owned(), known: BTreeSet::new(), growing: BTreeMap::new() };
        arrivals.known = arrivals.files()?.into_keys().collect();
        Ok(arrivals)
    }

    /// New photographs whose size is that of the last look, in the order of their names.
    pub(super) fn complete(&mut self) -> Result<Vec<PathBuf>> {
        let mut now = self.files()?;
        now.retain(|name, _| !self.known.contains(name));
        let same = |(name, size): &(&OsString, &u64)| **size > 0 && self.growing.get(*name) == Some(*size);
        let done: Vec<OsString> = now.iter().filter(same).map(|(name, _)| name.clone()).collect();
        self.growing = now;
        self.known.extend(done.iter().cloned());
        Ok(done.into_iter().map(|name| self.folder.join(name)).collect())
    }

    /// Names and sizes of the photographs.
    fn files(&self) -> Result<BTreeMap<OsString, u64>> {
        let place = || format!("watching {}", self.folder.display());
        let mut files = BTreeMap::new();
        for entry in std::fs::read_dir(&self.folder).with_context(place)? {
            let entry = entry.with_context(place)?;
            // A file may be renamed or deleted between the two calls.
            let Ok(about) = entry.path().metadata() else { continue };
            if about.is_file() && is_photograph(&entry.path()) {
                files.insert(entry.file_name(), about.len());
            }
        }
        Ok(files)
    }
}

/// Whether a file may be a photograph. Formats that cannot be read are checked too, since their refusal has the remedy.
fn is_photograph(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    !name.starts_with('.') && !name.ends_with('~') && !OTHERS.contains(&ending.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A photograph is returned once, when its file does not grow any more; older and other files are not.
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
        let gone = folder.path().join("gone");
        assert!(NewPhotographs::new(&gone).unwrap_err().to_string().contains("gone"));
    }
}
