//! Service `farm.v1.Admin`.

use std::time::Duration;

use farm_proto::wire::admin_server::Admin;
use farm_proto::wire::backup_piece::Content;
use farm_proto::wire::{
    BackupHeader, BackupPiece, BackupRequest, DamagedJob, DrainWorkerRequest, DrainWorkerResponse,
    InspectRequest, InspectResponse, UnreadableJobs,
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::Context;
use crate::farm::{Backup, detached};
use crate::store::backup::BackupReport;

/// Bytes of one piece of a backup.
const PIECE: usize = 1 << 20;
/// How long a client may take to read a piece.
const PATIENCE: Duration = Duration::from_mins(2);

#[tonic::async_trait]
impl Admin for Context {
    async fn drain_worker(
        &self,
        request: Request<DrainWorkerRequest>,
    ) -> Result<Response<DrainWorkerResponse>, Status> {
        let (farm, worker) = (self.farm.clone(), request.into_inner().worker);
        let worker_id = detached(async move { farm.drain(&worker).await }).await?.0;
        Ok(Response::new(DrainWorkerResponse { worker_id }))
    }

    type BackupStream = ReceiverStream<Result<BackupPiece, Status>>;

    async fn backup(&self, _: Request<BackupRequest>) -> Result<Response<Self::BackupStream>, Status> {
        let place = self.limits.stream()?;
        let (backup, report) = self.farm.backup().await?;
        let (sender, receiver) = mpsc::channel(2);
        tokio::spawn(async move {
            send(&backup, &report, &sender).await;
            drop((backup, place));
        });
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    async fn inspect(&self, request: Request<InspectRequest>) -> Result<Response<InspectResponse>, Status> {
        let (farm, repair) = (self.farm.clone(), request.into_inner().repair);
        let found = detached(async move { farm.inspect(repair).await }).await;
        let damaged = found.damaged.into_iter();
        let unreadable = found.unreadable.into_iter().map(|u| UnreadableJobs {
            dictionary: u.name.to_string(),
            jobs: u.jobs as u64,
            first_job: u.first,
            what: u.what,
        });
        Ok(Response::new(InspectResponse {
            jobs: found.jobs as u64,
            records: found.records as u64,
            damaged: damaged
                .map(|(name, job, what)| DamagedJob { dictionary: name.to_string(), job, what })
                .collect(),
            faults: found.faults,
            unreadable: unreadable.collect(),
            unchecked: found.unchecked.unwrap_or_default(),
        }))
    }
}

/// Sends a backup, header first, as fast as the client takes it.
async fn send(backup: &Backup, report: &BackupReport, sender: &mpsc::Sender<Result<BackupPiece, Status>>) {
    let header = BackupHeader {
        bytes: report.bytes,
        digest: report.blake3_hex.clone(),
        dictionaries: report.counts.dictionaries,
        jobs: report.counts.jobs,
        records: report.counts.records,
    };
    let mut next = Some(Ok(Content::Header(header)));
    let mut offset = 0;
    while let Some(piece) = next.take() {
        let piece = piece.map(|content| BackupPiece { content: Some(content) });
        let failed = piece.is_err();
        let sent = tokio::time::timeout(PATIENCE, sender.send(piece)).await;
        if failed || !matches!(sent, Ok(Ok(()))) {
            return;
        }
        next = match backup.piece(offset, PIECE).await {
            Ok(data) if data.is_empty() => None,
            Ok(data) => {
                offset += data.len() as u64;
                Some(Ok(Content::Data(data)))
            }
            Err(error) => Some(Err(Status::internal(format!("reading the backup: {error}")))),
        };
    }
}
