//! Provides a worker that a test controls call by call.

use anyhow::Result;
use bytes::Bytes;
use farm_link::Link;
use farm_proto::PROTOCOL_VERSION;
use farm_proto::lease::Lease;
use farm_proto::wire::complete_request::Content;
use farm_proto::wire::leases_client::LeasesClient;
use farm_proto::wire::{
    AcquireRequest, CompleteRequest, CompletionKind, CompletionOutcome, FailRequest, HandBackRequest,
    HeldLease, RegisterRequest, RenewRequest, ResultHeader,
};
use optics_model::{PHYSICS_VERSION, Record};
use tonic::Status;

/// The encoded records, as delivered.
pub fn on_wire(records: &[Record]) -> Bytes {
    let mut bytes = Vec::new();
    for record in records {
        record.extend_le_bytes(&mut bytes);
    }
    bytes.into()
}

/// Encoded records with one number replaced, at a byte offset.
pub fn with_number(records: &Bytes, at: usize, number: f32) -> Bytes {
    let mut records = records.to_vec();
    records[at..][..4].copy_from_slice(&number.to_le_bytes());
    records.into()
}

/// Encoded records with a wrong first radiance factor.
pub fn falsified(records: &[Record]) -> Bytes {
    let first = records[0].profiles[0].radiance_factor.values()[0];
    with_number(&on_wire(records), 0, first + 1.0)
}

#[derive(Debug, Clone)]
pub struct TestWorker {
    client: LeasesClient<Link>,
    pub token: String,
}

impl TestWorker {
    /// Registers a worker; the label is also the instance.
    pub async fn register(link: Link, label: &str) -> Result<Self, Status> {
        let mut client = LeasesClient::new(link).max_decoding_message_size(16 << 20);
        let request = RegisterRequest {
            label: label.to_owned(),
            threads: 1,
            physics_version: PHYSICS_VERSION,
            protocol_version: PROTOCOL_VERSION,
            instance: label.to_owned(),
            version: "test".to_owned(),
            host: String::new(),
            facts: None,
        };
        let token = client.register(request).await?.into_inner().worker_token;
        Ok(Self { client, token })
    }

    pub async fn acquire(&mut self, max_leases: u32) -> Result<Vec<Lease>, Status> {
        let request =
            AcquireRequest { worker_token: self.token.clone(), max_leases, whole_sets: false, wait_ms: 0 };
        let leases = self.client.acquire(request).await?.into_inner().leases;
        leases
            .into_iter()
            .map(Lease::try_from)
            .collect::<Result<_, _>>()
            .map_err(|e| farm_proto::to_status(&e))
    }

    /// Renews a lease; returns whether it is still valid.
    pub async fn renew(&mut self, lease: &Lease, running: bool) -> Result<bool, Status> {
        let identity = lease.job.identity().as_bytes().to_vec();
        let held = HeldLease { key: Some(lease.key.into()), running, identity };
        let request = RenewRequest { worker_token: self.token.clone(), leases: vec![held] };
        Ok(self.client.renew(request).await?.into_inner().lost.is_empty())
    }

    /// The messages that deliver a result.
    pub fn messages(&self, lease: &Lease, records: Bytes) -> Vec<CompleteRequest> {
        let header = ResultHeader {
            worker_token: self.token.clone(),
            key: Some(lease.key.into()),
            identity: lease.job.identity().as_bytes().to_vec(),
        };
        let contents = [Content::Header(header), Content::Records(records)];
        contents.map(|content| CompleteRequest { content: Some(content) }).into()
    }

    pub async fn complete(&mut self, lease: &Lease, records: Bytes) -> Result<CompletionKind, Status> {
        let outcomes = self.deliver(self.messages(lease, records)).await?;
        Ok(outcomes[0].kind())
    }

    pub async fn deliver(
        &mut self,
        messages: Vec<CompleteRequest>,
    ) -> Result<Vec<CompletionOutcome>, Status> {
        Ok(self.client.complete(tokio_stream::iter(messages)).await?.into_inner().outcomes)
    }

    /// Reports that the job could not be computed.
    pub async fn fail(&mut self, lease: &Lease, reason: &str) -> Result<(), Status> {
        let (worker_token, reason) = (self.token.clone(), reason.to_owned());
        self.client.fail(FailRequest { worker_token, lease: Some(lease.key.into()), reason }).await.map(drop)
    }

    /// Deregisters the worker.
    pub async fn leave(mut self) -> Result<(), Status> {
        let request =
            HandBackRequest { worker_token: self.token, leases: vec![], leaving: true, stopping: true };
        self.client.hand_back(request).await.map(drop)
    }
}
