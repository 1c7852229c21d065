//! Service `farm.v1.Leases`.

use std::time::Duration;

use farm_proto::ids::WorkerId;
use farm_proto::lease::LeaseKey;
use farm_proto::wire::leases_server::Leases;
use farm_proto::wire::{
    AcquireRequest, AcquireResponse, CompleteRequest, CompleteResponse, FailRequest, FailResponse,
    HandBackRequest, HandBackResponse, RegisterRequest, RegisterResponse, RenewRequest, RenewResponse,
};
use farm_proto::{RequestLimits, to_status};
use optics_model::{Digest, Invalid};
use tonic::{Request, Response, Status, Streaming};

use super::Context;
use super::results;
use super::status::{OrStatus, required};
use crate::dispatch::Registration;
use crate::farm::{Versions, detached};

/// Longest instance that a worker may choose.
const INSTANCE_BYTES: usize = 64;

#[tonic::async_trait]
impl Leases for Context {
    async fn register(
        &self,
        request: Request<RegisterRequest>,
    ) -> Result<Response<RegisterResponse>, Status> {
        let request = request.into_inner();
        if !(1..=INSTANCE_BYTES).contains(&request.instance.len()) {
            let given = format!("{} bytes", request.instance.len());
            let allowed = format!("1 to {INSTANCE_BYTES} are allowed");
            return Err(to_status(&Invalid::new("instance", given, allowed)));
        }
        let about = Registration {
            label: shortened(request.label),
            threads: request.threads,
            version: shortened(request.version),
        };
        let farm = self.farm.clone();
        let versions = Versions { physics: request.physics_version, protocol: request.protocol_version };
        let registered = detached(async move { farm.register(&request.instance, about, versions).await });
        let (id, settings) = registered.await?;
        Ok(Response::new(RegisterResponse { worker_id: id.0, lease_ms: settings.lease.as_millis() as u64 }))
    }

    async fn acquire(&self, request: Request<AcquireRequest>) -> Result<Response<AcquireResponse>, Status> {
        let request = request.into_inner();
        let worker = WorkerId(request.worker_id);
        let max = request.max_leases;
        if !(1..=RequestLimits::LEASES).contains(&max) {
            let allowed = format!("allowed are 1 to {}", RequestLimits::LEASES);
            return Err(to_status(&Invalid::new("max_leases", max, allowed)));
        }
        let wait = tokio::time::sleep(Duration::from_millis(request.wait_ms.min(RequestLimits::WAIT_MS)));
        tokio::pin!(wait);
        let mut work = self.farm.work();
        loop {
            let grant = self.farm.acquire(&worker, max as usize)?;
            if !grant.leases.is_empty() || grant.drain {
                let leases = grant.leases.into_iter().map(Into::into).collect();
                return Ok(Response::new(AcquireResponse { leases, drain: grant.drain }));
            }
            tokio::select! {
                () = &mut wait => return Ok(Response::new(AcquireResponse::default())),
                () = self.shutdown.cancelled() => return Err(Status::unavailable("the coordinator is stopping")),
                changed = work.changed() => if changed.is_err() {
                    return Ok(Response::new(AcquireResponse::default()));
                },
            }
        }
    }

    async fn renew(&self, request: Request<RenewRequest>) -> Result<Response<RenewResponse>, Status> {
        let request = request.into_inner();
        let most = 2 * RequestLimits::LEASES as usize;
        if request.leases.len() > most {
            let allowed = format!("at most {most} are allowed");
            return Err(to_status(&Invalid::new("leases", request.leases.len(), allowed)));
        }
        let held = request.leases.into_iter().map(|lease| {
            let key = LeaseKey::from(required("key", lease.key)?);
            Ok((key, lease.running, identity(&lease.identity).or_status()?))
        });
        let held = held.collect::<Result<_, Status>>()?;
        let (lost, drain) = self.farm.renew(&WorkerId(request.worker_id), held)?;
        Ok(Response::new(RenewResponse { lost: lost.into_iter().map(Into::into).collect(), drain }))
    }

    async fn complete(
        &self,
        request: Request<Streaming<CompleteRequest>>,
    ) -> Result<Response<CompleteResponse>, Status> {
        let outcomes = results::receive(self, request.into_inner()).await?;
        Ok(Response::new(CompleteResponse { outcomes }))
    }

    async fn hand_back(
        &self,
        request: Request<HandBackRequest>,
    ) -> Result<Response<HandBackResponse>, Status> {
        let request = request.into_inner();
        let keys: Vec<LeaseKey> = request.leases.into_iter().map(Into::into).collect();
        let (farm, worker) = (self.farm.clone(), WorkerId(request.worker_id));
        // What it settles may be the business of others: it must not stop half-way if this worker goes away.
        detached(async move { farm.hand_back(&worker, &keys, request.leaving).await }).await;
        Ok(Response::new(HandBackResponse {}))
    }

    async fn fail(&self, request: Request<FailRequest>) -> Result<Response<FailResponse>, Status> {
        let request = request.into_inner();
        let key = LeaseKey::from(required("lease", request.lease)?);
        let (farm, worker, reason) =
            (self.farm.clone(), WorkerId(request.worker_id), shortened(request.reason));
        detached(async move { farm.failed(&worker, &key, &reason).await }).await?;
        Ok(Response::new(FailResponse {}))
    }
}

/// What a job's records depend on, as it was sent with the job.
pub(super) fn identity(bytes: &[u8]) -> Result<Digest, Invalid> {
    let digest = bytes.try_into().map(Digest::from_bytes);
    digest.map_err(|_| Invalid::new("identity", format_args!("{} bytes", bytes.len()), "32 are needed"))
}

fn shortened(mut text: String) -> String {
    text.truncate(text.floor_char_boundary(RequestLimits::TEXT_BYTES));
    text
}
