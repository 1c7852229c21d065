//! Implements the gRPC service `farm.v1.Leases`.

use std::time::Duration;

use farm_proto::lease::{HeldLease, LeaseKey, job_identity};
use farm_proto::status::MachineFacts;
use farm_proto::wire::complete_request::Content;
use farm_proto::wire::leases_server::Leases;
use farm_proto::wire::{
    AcquireRequest, AcquireResponse, CompleteRequest, CompleteResponse, CompletionKind, CompletionOutcome,
    FailRequest, FailResponse, HandBackRequest, HandBackResponse, RegisterRequest, RegisterResponse,
    RenewRequest, RenewResponse,
};
use farm_proto::{RequestLimits, to_status, wire};
use optics_model::Invalid;
use tokio_stream::StreamExt;
use tonic::{Request, Response, Status, Streaming};

use super::Context;
use super::status::{OrStatus, required};
use super::text::{one_line, short_line};
use crate::authorisation::machine;
use crate::dispatch::{Grant, LeaseRequest, Registration};
use crate::farm::{Farm, Header, Piece, Refusal, Versions, WorkerEnd};
use crate::stored::{Machine, Outcome, OutcomeKind};

/// Longest instance that a worker may choose, in bytes.
const INSTANCE_BYTES: usize = 64;
/// Longest text that distinguishes a worker's machine from others, in bytes.
const HOST_BYTES: usize = 64;

#[tonic::async_trait]
impl Leases for Context {
    async fn register(
        &self,
        request: Request<RegisterRequest>,
    ) -> Result<Response<RegisterResponse>, Status> {
        let machine = machine(request.extensions());
        self.limits.register(&machine)?;
        let request = request.into_inner();
        if request.host.len() > HOST_BYTES {
            let given = format!("{} bytes", request.host.len());
            return Err(to_status(&Invalid::new("host", given, format!("at most {HOST_BYTES} are allowed"))));
        }
        if !(1..=INSTANCE_BYTES).contains(&request.instance.len()) {
            let given = format!("{} bytes", request.instance.len());
            let allowed = format!("1 to {INSTANCE_BYTES} are allowed");
            return Err(to_status(&Invalid::new("instance", given, allowed)));
        }
        let about = Registration {
            instance: request.instance,
            machine: Machine { host: one_line(&request.host), ..machine },
            label: short_line(&request.label),
            threads: request.threads,
            version: short_line(&request.version),
            facts: facts(request.facts.unwrap_or_default()),
        };
        let versions = Versions { physics: request.physics_version, protocol: request.protocol_version };
        let (id, lease) = self.farm.register(about, versions).await?;
        let worker_token = self.farm.worker_token(&id);
        Ok(Response::new(RegisterResponse { worker_token, lease_ms: lease.as_millis() as u64 }))
    }

    async fn acquire(&self, request: Request<AcquireRequest>) -> Result<Response<AcquireResponse>, Status> {
        let request = request.into_inner();
        let worker = self.farm.verify_worker(&request.worker_token)?;
        let max = request.max_leases;
        if !(1..=RequestLimits::LEASES).contains(&max) {
            let allowed = format!("allowed are 1 to {}", RequestLimits::LEASES);
            return Err(to_status(&Invalid::new("max_leases", max, allowed)));
        }
        let patience = Duration::from_millis(request.wait_ms.min(RequestLimits::WAIT_MS));
        let wish = LeaseRequest { parts: max as usize, whole_sets: request.whole_sets };
        let grant = self.farm.acquire(&worker, wish, patience, &self.shutdown).await?;
        let Grant { leases, drain } = grant.unwrap_or_default();
        Ok(Response::new(AcquireResponse { leases: leases.into_iter().map(Into::into).collect(), drain }))
    }

    async fn renew(&self, request: Request<RenewRequest>) -> Result<Response<RenewResponse>, Status> {
        let request = request.into_inner();
        let most = 2 * RequestLimits::LEASES as usize;
        if request.leases.len() > most {
            let allowed = format!("at most {most} are allowed");
            return Err(to_status(&Invalid::new("leases", request.leases.len(), allowed)));
        }
        let held =
            request.leases.into_iter().map(HeldLease::try_from).collect::<Result<_, _>>().or_status()?;
        let (lost, drain) = self.farm.renew(&self.farm.verify_worker(&request.worker_token)?, held)?;
        Ok(Response::new(RenewResponse { lost: lost.into_iter().map(Into::into).collect(), drain }))
    }

    async fn complete(
        &self,
        request: Request<Streaming<CompleteRequest>>,
    ) -> Result<Response<CompleteResponse>, Status> {
        let machine = machine(request.extensions());
        let pieces = request.into_inner().map(|message| piece(message?, &self.farm));
        let delivered = self.farm.receive(&machine, pieces).await?;
        Ok(Response::new(CompleteResponse { outcomes: delivered.into_iter().map(outcome).collect() }))
    }

    async fn hand_back(
        &self,
        request: Request<HandBackRequest>,
    ) -> Result<Response<HandBackResponse>, Status> {
        let request = request.into_inner();
        let keys: Vec<LeaseKey> = request.leases.into_iter().map(Into::into).collect();
        let end = match (request.leaving, request.stopping) {
            (true, _) => Some(WorkerEnd::Left),
            (false, true) => Some(WorkerEnd::Stopping),
            (false, false) => None,
        };
        self.farm.hand_back(&self.farm.verify_worker(&request.worker_token)?, &keys, end);
        Ok(Response::new(HandBackResponse {}))
    }

    async fn fail(&self, request: Request<FailRequest>) -> Result<Response<FailResponse>, Status> {
        let request = request.into_inner();
        let key = LeaseKey::from(required("lease", request.lease)?);
        self.farm
            .failed(&self.farm.verify_worker(&request.worker_token)?, &key, &one_line(&request.reason))
            .await?;
        Ok(Response::new(FailResponse {}))
    }
}

fn facts(facts: wire::MachineFacts) -> MachineFacts {
    let wire::MachineFacts { cores, memory_bytes, kernel, log } = facts;
    MachineFacts { cores, memory_bytes, kernel: short_line(&kernel), log: one_line(&log) }
}

/// Decodes a piece of the stream that delivers results.
fn piece(message: CompleteRequest, farm: &Farm) -> Result<Piece, Status> {
    Ok(match required("content", message.content)? {
        Content::Header(header) => Piece::Header(Header {
            key: LeaseKey::from(required("key", header.key)?),
            identity: job_identity(&header.identity).or_status()?,
            worker: farm.verify_worker(&header.worker_token)?,
        }),
        Content::Records(bytes) => Piece::Records(bytes),
        Content::Sums(bytes) => Piece::Sums(bytes),
    })
}

/// The answer to a worker about one result.
fn outcome(delivered: Result<Outcome, Refusal>) -> CompletionOutcome {
    let (kind, message) = match delivered.map(Outcome::kind) {
        Err(Refusal::Unwanted(error)) => (CompletionKind::Refused, error.to_string()),
        Err(Refusal::NotStored(error)) => (CompletionKind::NotStored, error.to_string()),
        Ok(OutcomeKind::Stored) => (CompletionKind::Stored, String::new()),
        Ok(OutcomeKind::Duplicate) => (CompletionKind::Duplicate, String::new()),
        Ok(OutcomeKind::Conflict) => {
            let message =
                "other records than these are stored: this worker or an earlier one computes wrongly";
            (CompletionKind::Conflict, message.to_owned())
        }
        Ok(OutcomeKind::Unwanted) => (CompletionKind::Refused, "no longer needed".to_owned()),
    };
    CompletionOutcome { kind: kind.into(), message }
}
