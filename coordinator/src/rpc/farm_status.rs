//! Service `farm.v1.Farm`.

use farm_proto::PHYSICS_VERSION;
use farm_proto::wire::farm_server::Farm;
use farm_proto::wire::{StatusRequest, StatusResponse};
use tonic::{Request, Response, Status};

use super::Context;

#[tonic::async_trait]
impl Farm for Context {
    async fn status(&self, _: Request<StatusRequest>) -> Result<Response<StatusResponse>, Status> {
        let (pending, leased) = self.farm.job_counts();
        Ok(Response::new(StatusResponse {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            physics_version: PHYSICS_VERSION,
            workers: self.farm.workers().into_iter().map(Into::into).collect(),
            jobs_pending: pending as u64,
            jobs_leased: leased as u64,
            dictionaries: self.farm.statuses().len() as u64,
        }))
    }
}
