//! Backups on their way to a client: made beside the database, sent, and removed.

use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;

use super::{Farm, Result, blocking};
use crate::clock::random_token;
use crate::dispatch::{Event, EventKind};
use crate::store::DataDir;
use crate::store::backup::BackupReport;

/// A verified copy of the database, which goes with this.
#[derive(Debug)]
pub(crate) struct Backup {
    file: PathBuf,
}

impl Drop for Backup {
    fn drop(&mut self) {
        // What cannot be removed now is at the next start.
        let _ = std::fs::remove_file(&self.file);
        let _ = std::fs::remove_file(self.file.with_extension("db.b3"));
    }
}

impl Backup {
    /// Up to `most` bytes from an offset on; none at the end.
    pub(crate) async fn piece(&self, offset: u64, most: usize) -> std::io::Result<Vec<u8>> {
        let file = self.file.clone();
        blocking(move || {
            let mut file = std::fs::File::open(file)?;
            file.seek(SeekFrom::Start(offset))?;
            let mut piece = Vec::with_capacity(most);
            file.take(most as u64).read_to_end(&mut piece)?;
            Ok(piece)
        })
        .await
    }
}

impl Farm {
    /// A copy of the database as it is now, verified.
    pub(crate) async fn backup(&self) -> Result<(Backup, BackupReport)> {
        let name = format!("{}{}.db", DataDir::BACKUP_PREFIX, &random_token()[..8]);
        let backup = Backup { file: self.store.dir().path().join(name) };
        let report = self.store.backup(&backup.file).await?;
        let message = format!("{} records, {} bytes", report.counts.records, report.bytes);
        self.recorder.record("", &Event::of_farm(EventKind::BackupMade, message));
        Ok((backup, report))
    }
}
