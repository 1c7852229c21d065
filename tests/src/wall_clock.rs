//! A wall clock that jumps, for processes that are started with it: libfaketime, which Debian has as `libfaketime`.
//!
//! The clock that measures times, which never jumps, stays as it is: so it is when somebody sets a machine's clock.

use std::path::{Path, PathBuf};

/// Where distributions put the library for programs with threads.
const PLACES: [&str; 4] = [
    "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib/aarch64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib64/faketime/libfaketimeMT.so.1",
    "/usr/lib/faketime/libfaketimeMT.so.1",
];

/// How far off the wall clock is stands in a file, which every look at the clock reads.
#[derive(Debug)]
pub struct WallClock {
    library: &'static str,
    folder: tempfile::TempDir,
}

impl WallClock {
    /// A clock that is right; None if the library is not installed.
    ///
    /// # Panics
    /// If its file cannot be written.
    pub fn find() -> Option<Self> {
        let library = PLACES.into_iter().find(|place| Path::new(place).exists())?;
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
    pub(crate) fn environment(&self) -> Vec<(&'static str, String)> {
        vec![
            ("LD_PRELOAD", self.library.to_owned()),
            ("FAKETIME_TIMESTAMP_FILE", self.file().to_str().expect("the path is text").to_owned()),
            ("FAKETIME_NO_CACHE", "1".to_owned()),
            ("FAKETIME_DONT_FAKE_MONOTONIC", "1".to_owned()),
            ("NO_FAKE_STAT", "1".to_owned()),
        ]
    }
}
