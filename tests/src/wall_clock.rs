//! A wall clock that jumps, for processes that are started with it: libfaketime, which Debian has as `libfaketime`.
//!
//! The clock that measures times, which never jumps, stays as it is: so it is when somebody sets a machine's clock.

use std::path::PathBuf;

/// Debian has the library for programs with threads here, in the folder of the machine's kind.
const KINDS: &str = "/usr/lib";
const LIBRARY: &str = "faketime/libfaketimeMT.so.1";

/// How far off the wall clock is stands in a file, which every look at the clock reads.
#[derive(Debug)]
pub struct WallClock {
    library: PathBuf,
    folder: tempfile::TempDir,
}

impl WallClock {
    /// A clock that is right; None if the library is not installed.
    ///
    /// # Panics
    /// If its file cannot be written.
    pub fn find() -> Option<Self> {
        let kinds = std::fs::read_dir(KINDS).ok()?.filter_map(Result::ok);
        let library = kinds.map(|kind| kind.path().join(LIBRARY)).find(|place| place.exists())?;
        let clock = Self { library, folder: tempfile::tempdir().expect("a folder can be made") };
        clock.set_off_by_days(0);
        Some(clock)
    }

    /// From now on the clock is this many days ahead, or behind.
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

    /// What a process that shall have this clock finds in its environment.
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
