//! Service `farm.v1.Admin`.

use farm_proto::wire::admin_server::Admin;
use farm_proto::wire::{
    BackupPiece, BackupRequest, DamagedJob, DrainWorkerRequest, DrainWorkerResponse, InspectRequest,
    InspectResponse,
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::Context;
use crate::farm::detached;

#[tonic::async_trait]
impl Admin for Context {
    async fn drain_worker(
        &self,
        request: Request<DrainWorkerRequest>,
    ) -> Result<Response<DrainWorkerResponse>, Status> {
        let worker_id = self.farm.drain(&request.into_inner().worker).await?.0;
        Ok(Response::new(DrainWorkerResponse { worker_id }))
    }

    type BackupStream = ReceiverStream<Result<BackupPiece, Status>>;

    async fn backup(&self, _: Request<BackupRequest>) -> Result<Response<Self::BackupStream>, Status> {
        Err(Status::unimplemented("backup"))
    }

    async fn inspect(&self, request: Request<InspectRequest>) -> Result<Response<InspectResponse>, Status> {
        let (farm, repair) = (self.farm.clone(), request.into_inner().repair);
        let found = detached(async move { farm.inspect(repair).await }).await?;
        let damaged = found.damaged.into_iter();
        Ok(Response::new(InspectResponse {
            jobs: found.jobs as u64,
            records: found.records as u64,
            damaged: damaged
                .map(|(name, job, what)| DamagedJob { dictionary: name.to_string(), job, what })
                .collect(),
            faults: found.faults,
        }))
    }
}
