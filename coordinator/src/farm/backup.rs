//! Makes backups next to the database, sends them to clients, and removes them.

use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;
use std::sync::PoisonError;

use tokio::time::Instant;

use super::{Farm, FarmError, Result, blocking};
use crate::actor::Actor;
use crate::clock::random_token;
use crate::dispatch::EventKind;
use crate::store::DataDir;
use crate::store::backup::BackupReport;

/// Bytes of a piece.
const PIECE: usize = 1 << 20;

/// A verified copy of the database that is sent to a client. Its file is removed when this is dropped.
#[derive(Debug)]
pub(crate) struct Backup {
    file: PathBuf,
    /// The report, which comes first, if it has not been taken yet.
    report: Option<BackupReport>,
    offset: u64,
}

/// A part of a backup: a report first, and then the bytes in pieces.
#[derive(Debug)]
pub(crate) enum BackupPart {
    Report(BackupReport),
    Data(Vec<u8>),
}

impl Drop for Backup {
    fn drop(&mut self) {
        // A file that cannot be removed now is removed at the next start.
        let _ = std::fs::remove_file(&self.file);
        let _ = std::fs::remove_file(self.file.with_extension("db.b3"));
    }
}

impl Backup {
    pub(crate) async fn next(&mut self) -> Result<Option<BackupPart>> {
        if let Some(report) = self.report.take() {
            return Ok(Some(BackupPart::Report(report)));
        }
        let (file, offset) = (self.file.clone(), self.offset);
        let piece = blocking(move || {
            let mut file = std::fs::File::open(file)?;
            file.seek(SeekFrom::Start(offset))?;
            let mut piece = Vec::with_capacity(PIECE);
            file.take(PIECE as u64).read_to_end(&mut piece)?;
            Ok(piece)
        });
        let piece = piece.await.map_err(FarmError::Backup)?;
        self.offset += piece.len() as u64;
        Ok((!piece.is_empty()).then_some(BackupPart::Data(piece)))
    }
}

impl Farm {
    /// A copy of the database as it is now, verified.
    pub(crate) async fn backup(&self, by: &Actor) -> Result<Backup> {
        let name = format!("{}{}.db", DataDir::BACKUP_PREFIX, &random_token()[..8]);
        let mut backup = Backup { file: self.store.dir().path().join(name), report: None, offset: 0 };
        let report = match self.store.backup(&backup.file).await {
            Ok(report) => report,
            Err(error) => {
                self.scheduler.note(by, EventKind::BackupFailed, error.to_string());
                return Err(error.into());
            }
        };
        *self.last_backup.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        let message = format!("{} records, {} bytes", report.counts.records, report.bytes);
        self.scheduler.note(by, EventKind::BackupMade, message);
        backup.report = Some(report);
        Ok(backup)
    }
}
