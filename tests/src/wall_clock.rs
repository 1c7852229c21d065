//! Simulates a wall clock that jumps, for processes that are started with it, by Debian's `libfaketime`.
//!
//! The monotonic clock is unchanged, as when the clock of a machine is set.

use std::path::PathBuf;

/// Debian installs the library for threaded programs below this folder, in that of the architecture.
const ARCHITECTURES: &str = "/usr/lib";
const LIBRARY: &str = "faketime/libfaketimeMT.so.1";

/// The offset of the wall clock is in a file, which is read at each use of the clock.
#[derive(Debug)]
pub struct WallClock {
    library: PathBuf,
    folder: tempfile::TempDir,
}

impl WallClock {
    /// A clock without offset; None if the library is not installed.
    ///
    /// # Panics
    /// If its file cannot be written.
    pub fn find() -> Option<Self> {
        let architectures = std::fs::read_dir(ARCHITECTURES).ok()?.filter_map(Result::ok);
        let library = architectures.map(|folder| folder.path().join(LIBRARY)).find(|place| place.exists())?;
        let clock = Self { library, folder: tempfile::tempdir().expect("a folder can be made") };
        clock.set_off_by_days(0);
        Some(clock)
    }

    /// Sets the offset: days ahead, or behind if negative.
    ///
    /// # Panics
    /// If its file cannot be written.
    pub fn set_off_by_days(&self, days: i32) {
        let draft = self.folder.path().join("draft");
        std::fs::write(&draft, format!("{days:+}d\n")).expect("the file can be written");
        std::fs::rename(draft, self.file()).expect("the file can be replaced");
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("off")
    }

    /// Environment variables for a process with this clock.
    pub(crate) fn environment(&self) -> Vec<(&'static str, PathBuf)> {
        vec![
            ("LD_PRELOAD", self.library.clone()),
            ("FAKETIME_TIMESTAMP_FILE", self.file()),
            ("FAKETIME_NO_CACHE", "1".into()),
            ("FAKETIME_DONT_FAKE_MONOTONIC", "1".into()),
            ("NO_FAKE_STAT", "1".into()),
        ]
    }
}
