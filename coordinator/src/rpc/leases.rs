//! Service `farm.v1.Leases`.

use std::time::Duration;

use farm_proto::ids::WorkerId;
use farm_proto::job::LeaseKey;
use farm_proto::profile::RecordShape;
use farm_proto::wire::complete_request::Part;
use farm_proto::wire::leases_server::Leases;
use farm_proto::wire::{
    AcquireRequest, AcquireResponse, CompleteRequest, CompleteResponse, FailRequest, FailResponse,
    HandBackRequest, HandBackResponse, RegisterRequest, RegisterResponse, RenewRequest, RenewResponse,
};
use farm_proto::{Invalid, Record, RequestLimits};
use tonic::{Request, Response, Status, Streaming};

use super::Context;
use super::status::required;
use crate::farm::detached;

/// Longest label and failure reason kept, in bytes.
const TEXT_BYTES: usize = 1000;

#[tonic::async_trait]
impl Leases for Context {
    async fn register(
        &self,
        request: Request<RegisterRequest>,
    ) -> Result<Response<RegisterResponse>, Status> {
        let request = request.into_inner();
        let label = shortened(request.label);
        let (id, settings) = self.farm.register(label, request.threads, request.physics_version)?;
        let lease_ms = settings.lease.as_millis() as u64;
        Ok(Response::new(RegisterResponse { worker_id: id.0, lease_ms }))
    }

    async fn acquire(&self, request: Request<AcquireRequest>) -> Result<Response<AcquireResponse>, Status> {
        let request = request.into_inner();
        let worker = WorkerId(request.worker_id);
        let max = request.max_leases;
        if !(1..=RequestLimits::LEASES).contains(&max) {
            let allowed = format!("allowed are 1 to {}", RequestLimits::LEASES);
            return Err(Invalid::new("max_leases", max, allowed).to_status());
        }
        let wait = tokio::time::sleep(Duration::from_millis(request.wait_ms.min(RequestLimits::WAIT_MS)));
        tokio::pin!(wait);
        let mut changes = self.farm.changes();
        loop {
            let leases = self.farm.acquire(&worker, max as usize)?;
            if !leases.is_empty() {
                return Ok(Response::new(AcquireResponse {
                    leases: leases.into_iter().map(Into::into).collect(),
                }));
            }
            tokio::select! {
                () = &mut wait => return Ok(Response::new(AcquireResponse::default())),
                () = self.shutdown.cancelled() => return Err(Status::unavailable("the coordinator is stopping")),
                changed = changes.changed() => if changed.is_err() {
                    return Ok(Response::new(AcquireResponse::default()));
                },
            }
        }
    }

    async fn renew(&self, request: Request<RenewRequest>) -> Result<Response<RenewResponse>, Status> {
        let request = request.into_inner();
        let lost = self.farm.renew(&WorkerId(request.worker_id), keys(request.leases))?;
        Ok(Response::new(RenewResponse { lost: lost.into_iter().map(Into::into).collect() }))
    }

    async fn complete(
        &self,
        request: Request<Streaming<CompleteRequest>>,
    ) -> Result<Response<CompleteResponse>, Status> {
        let mut parts = request.into_inner();
        let key = match parts.message().await?.and_then(|m| m.part) {
            Some(Part::Lease(key)) => LeaseKey::from(key),
            _ => return Err(Invalid::new("part", "no lease", "the lease comes first").to_status()),
        };
        let grid = self.farm.grid_of(&key)?;
        let (first, count) = (grid.first_record(key.job as usize), grid.albedo().len());
        let records = receive(&mut parts, RecordShape::of(&grid), first, count).await?;
        let farm = self.farm.clone();
        let duplicate = detached(async move { farm.complete(&key, &records).await }).await?;
        Ok(Response::new(CompleteResponse { duplicate }))
    }

    async fn hand_back(
        &self,
        request: Request<HandBackRequest>,
    ) -> Result<Response<HandBackResponse>, Status> {
        let request = request.into_inner();
        self.farm.hand_back(&WorkerId(request.worker_id), &keys(request.leases), request.leaving);
        Ok(Response::new(HandBackResponse {}))
    }

    async fn fail(&self, request: Request<FailRequest>) -> Result<Response<FailResponse>, Status> {
        let request = request.into_inner();
        let key = LeaseKey::from(required("lease", request.lease)?);
        let (farm, reason) = (self.farm.clone(), shortened(request.reason));
        detached(async move { farm.failed(&key, &reason).await }).await?;
        Ok(Response::new(FailResponse {}))
    }
}

/// All records of a job, in order, none too many and none of another shape.
async fn receive(
    parts: &mut Streaming<CompleteRequest>,
    shape: RecordShape,
    first: usize,
    count: usize,
) -> Result<Vec<Record>, Status> {
    let mut records = Vec::with_capacity(count);
    while let Some(message) = parts.message().await? {
        let Some(Part::Record(record)) = message.part else {
            return Err(Invalid::new("part", "no record", "records follow the lease").to_status());
        };
        let record = Record::try_from(record)?;
        let expected = first + records.len();
        if records.len() == count || record.index != expected {
            let allowed = format!("records {first} to {} are wanted, in order", first + count - 1);
            return Err(Invalid::new("record.index", record.index, allowed).to_status());
        }
        shape.check(&record)?;
        records.push(record);
    }
    if records.len() < count {
        let allowed = format!("{count} are needed");
        return Err(Invalid::new("records", records.len(), allowed).to_status());
    }
    Ok(records)
}

fn keys(keys: Vec<farm_proto::wire::LeaseKey>) -> Vec<LeaseKey> {
    keys.into_iter().map(Into::into).collect()
}

fn shortened(mut text: String) -> String {
    text.truncate(text.floor_char_boundary(TEXT_BYTES));
    text
}
