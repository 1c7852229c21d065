//! Implements the gRPC service `farm.v1.Admin`.

use farm_proto::wire::admin_server::Admin;
use farm_proto::wire::backup_piece::Content;
use farm_proto::wire::{
    BackupHeader, BackupPiece, BackupRequest, DamagedJob, DrainWorkerRequest, DrainWorkerResponse,
    InspectRequest, InspectResponse, UnreadableJobs,
};
use tonic::{Request, Response, Status};

use super::Context;
use super::outgoing::Outgoing;
use crate::authorisation::actor;
use crate::farm::{BackupPart, detached};

#[tonic::async_trait]
impl Admin for Context {
    async fn drain_worker(
        &self,
        request: Request<DrainWorkerRequest>,
    ) -> Result<Response<DrainWorkerResponse>, Status> {
        let by = actor(request.extensions());
        let worker_id = self.farm.drain(&by, &request.into_inner().worker)?.0;
        Ok(Response::new(DrainWorkerResponse { worker_id }))
    }

    type BackupStream = Outgoing<BackupPiece>;

    async fn backup(&self, request: Request<BackupRequest>) -> Result<Response<Self::BackupStream>, Status> {
        let by = actor(request.extensions());
        let backup = self.farm.backup(&by).await?;
        Ok(Response::new(self.stream(&by, backup, piece)?))
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

fn piece(part: BackupPart) -> BackupPiece {
    let content = match part {
        BackupPart::Report(report) => Content::Header(BackupHeader {
            bytes: report.bytes,
            digest: report.blake3_hex,
            dictionaries: report.counts.dictionaries,
            jobs: report.counts.jobs,
            records: report.counts.records,
        }),
        BackupPart::Data(data) => Content::Data(data),
    };
    BackupPiece { content: Some(content) }
}
