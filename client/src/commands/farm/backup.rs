//! Backs up and restores the whole database.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use clap::Args;
use farm_coordinator::store::{DataDir, backup, newest_schema};
use farm_proto::wire::backup_piece::Content;
use farm_proto::wire::{BackupHeader, BackupRequest};
use serde::Serialize;

use crate::cli::Global;
use crate::connection::{Connection, Purpose, patient, with_farm};
use crate::output::{Output, grouped};

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  farmctl backup /backups/farm-2026-11-21.db")]
pub(crate) struct BackupArgs {
    /// File to write; it must not exist yet. Its checksum is written to FILE.b3.
    file: PathBuf,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  farmctl restore /backups/farm-2026-11-21.db --data restored-data")]
pub(crate) struct RestoreArgs {
    /// Backup to restore; it becomes the database of the folder given by --data.
    file: PathBuf,
}

#[derive(Debug, Serialize)]
struct BackupJson {
    file: String,
    bytes: u64,
    blake3: String,
    dictionaries: u64,
    jobs: u64,
    records: u64,
}

pub(crate) async fn backup(global: &Global, args: BackupArgs, output: &Output) -> Result<()> {
    let file = args.file;
    ensure!(!file.exists(), "{} exists: name another file, or move it away", file.display());
    let header = with_farm(global, Purpose::Ask, async |connection| receive(connection, &file).await).await?;
    let data = BackupJson {
        file: file.display().to_string(),
        bytes: header.bytes,
        blake3: header.digest,
        dictionaries: header.dictionaries,
        jobs: header.jobs,
        records: header.records,
    };
    output.print("backup", &data, || {
        format!(
            "{}: {} records of {} dictionaries, {} bytes, verified\nBLAKE3 {}",
            data.file,
            grouped(data.records),
            grouped(data.dictionaries),
            grouped(data.bytes),
            data.blake3
        )
    })
}

/// Receives a backup, which is renamed and gets its checksum once it is complete.
async fn receive(connection: &Connection, file: &Path) -> Result<BackupHeader> {
    let mut incoming = backup::Incoming::create(file)?;
    let mut pieces = connection.admin().backup(patient(BackupRequest {})).await?.into_inner();
    let Some(Content::Header(header)) = pieces.message().await?.and_then(|piece| piece.content) else {
        bail!("the coordinator sent no header");
    };
    while let Some(piece) = pieces.message().await? {
        let Some(Content::Data(data)) = piece.content else { bail!("the coordinator sent two headers") };
        incoming.write(&data)?;
    }
    incoming.publish(&header.digest, newest_schema()).await?;
    Ok(header)
}

pub(crate) async fn restore(global: &Global, args: RestoreArgs, output: &Output) -> Result<()> {
    ensure!(
        global.server.is_none() && global.access.is_none() || global.local,
        "a backup is restored on the coordinator's machine, while it does not run: name its folder with --data and add \
         --local"
    );
    let dir = DataDir::lock(&global.data)?;
    let report = backup::restore(&args.file, &dir, newest_schema()).await?;
    let data = BackupJson {
        file: report.database.display().to_string(),
        bytes: report.bytes,
        blake3: report.blake3_hex,
        dictionaries: report.counts.dictionaries,
        jobs: report.counts.jobs,
        records: report.counts.records,
    };
    let unchecked = report.checksum == backup::Checksum::Absent;
    output.print("restore", &data, || {
        let mut text = format!(
            "{}: {} records of {} dictionaries restored",
            data.file,
            grouped(data.records),
            grouped(data.dictionaries)
        );
        if unchecked {
            text +=
                "\nthere was no checksum (.b3) next to the backup: `farmctl doctor` looks at every record";
        }
        text
    })
}
