//! Runs many simulated workers in one thread, which deliver prepared results.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use farm_proto::PROTOCOL_VERSION;
use farm_proto::wire::complete_request::Content;
use farm_proto::wire::leases_client::LeasesClient;
use farm_proto::wire::{
    AcquireRequest, CompleteRequest, CompletionKind, Lease, RegisterRequest, ResultHeader,
};
use optics_model::job::JobSpec;
use optics_model::{Estimate, Grid, PHYSICS_VERSION, PackedRecords, Profile, Record};
use tonic::transport::Channel;

/// Longest wait for work: at the end of the load each worker waits once without result.
const WAIT: Duration = Duration::from_millis(500);

/// Times of calls.
#[derive(Debug, Default)]
pub struct Latencies {
    pub acquire: Vec<Duration>,
    pub complete: Vec<Duration>,
}

/// State that all workers share.
#[derive(Debug)]
pub struct Crew {
    jobs: usize,
    stored: AtomicUsize,
    at_once: u32,
    job: Duration,
    /// Records of one job, prepared once.
    records: Bytes,
}

#[derive(Debug)]
pub struct Worker {
    client: LeasesClient<Channel>,
    token: String,
}

impl Crew {
    pub fn new(jobs: usize, at_once: u32, job: Duration, grid: &Grid) -> Self {
        let first = JobSpec::of(grid, 0);
        let numbers = |from: f32| {
            let pixels = grid.scene().sensor().pixels();
            (0..pixels).map(|pixel| from + 1e-6 * pixel as f32).collect::<Vec<_>>()
        };
        let profile = |channel: usize| {
            let radiance_factor = Estimate::new(numbers(0.1 * channel as f32), numbers(1e-3)).unwrap();
            Profile { radiance_factor, derivatives: None }
        };
        let record =
            |index| Record { index, profiles: (0..grid.scene().channels().len()).map(profile).collect() };
        let all: Vec<Record> = (0..grid.albedo().len()).map(|i| record(first.first_record() + i)).collect();
        let records = PackedRecords::pack(&first, &all).bytes().clone();
        Self { jobs, stored: AtomicUsize::new(0), at_once, job, records }
    }

    pub fn stored_percent(&self) -> usize {
        100 * self.stored.load(Ordering::Relaxed) / self.jobs
    }

    fn is_done(&self) -> bool {
        self.stored.load(Ordering::Relaxed) >= self.jobs
    }

    /// Registers all workers at the same time, spread over the connections.
    pub async fn register(&self, links: &[Channel], count: usize) -> Vec<Worker> {
        let register = |number: usize| {
            let mut client =
                LeasesClient::new(links[number % links.len()].clone()).max_decoding_message_size(64 << 20);
            async move {
                let request = RegisterRequest {
                    label: format!("load {number}"),
                    threads: 1,
                    physics_version: PHYSICS_VERSION,
                    protocol_version: PROTOCOL_VERSION,
                    instance: format!("load-{number}"),
                    version: "simulated".to_owned(),
                    host: String::new(),
                    facts: None,
                };
                let token = client.register(request).await.unwrap().into_inner().worker_token;
                Worker { client, token }
            }
        };
        let tasks: Vec<_> = (0..count).map(|number| tokio::spawn(register(number))).collect();
        let mut workers = Vec::with_capacity(count);
        for task in tasks {
            workers.push(task.await.unwrap());
        }
        workers
    }

    /// Runs all workers until everything is stored.
    pub async fn work(self: &Arc<Self>, workers: Vec<Worker>) -> Latencies {
        let tasks: Vec<_> = workers
            .into_iter()
            .map(|worker| {
                let crew = self.clone();
                tokio::spawn(async move { crew.work_alone(worker).await })
            })
            .collect();
        let mut all = Latencies::default();
        for task in tasks {
            let one = task.await.unwrap();
            all.acquire.extend(one.acquire);
            all.complete.extend(one.complete);
        }
        all
    }

    #[expect(clippy::disallowed_methods, reason = "real time is what is measured")]
    async fn work_alone(&self, mut worker: Worker) -> Latencies {
        let mut latencies = Latencies::default();
        while !self.is_done() {
            let start = Instant::now();
            let leases = worker.acquire(self.at_once).await;
            if !leases.is_empty() {
                latencies.acquire.push(start.elapsed());
            }
            for some in leases.chunks(if self.job.is_zero() { leases.len().max(1) } else { 1 }) {
                tokio::time::sleep(self.job).await;
                let messages = some.iter().flat_map(|lease| self.messages(&worker, lease)).collect();
                let start = Instant::now();
                let stored = worker.complete(messages).await;
                latencies.complete.push(start.elapsed());
                self.stored.fetch_add(stored, Ordering::Relaxed);
            }
        }
        latencies
    }

    /// The messages that deliver the result of a lease.
    fn messages(&self, worker: &Worker, lease: &Lease) -> Vec<CompleteRequest> {
        let job = lease.job.as_ref().unwrap();
        let header = ResultHeader {
            worker_token: worker.token.clone(),
            key: lease.key.clone(),
            identity: job.identity.clone(),
        };
        let contents = [Content::Header(header), Content::Records(self.records.clone())];
        contents.map(|content| CompleteRequest { content: Some(content) }).into()
    }
}

impl Worker {
    async fn acquire(&mut self, max_leases: u32) -> Vec<Lease> {
        let request = AcquireRequest {
            worker_token: self.token.clone(),
            max_leases,
            whole_sets: false,
            wait_ms: WAIT.as_millis() as u64,
        };
        self.client.acquire(request).await.unwrap().into_inner().leases
    }

    /// Delivers results; returns the number of those that were new.
    async fn complete(&mut self, messages: Vec<CompleteRequest>) -> usize {
        let answer = self.client.complete(tokio_stream::iter(messages)).await.unwrap().into_inner();
        let kinds = answer.outcomes.iter().map(farm_proto::wire::CompletionOutcome::kind);
        let is_accepted = |kind| matches!(kind, CompletionKind::Stored | CompletionKind::Duplicate);
        assert!(kinds.clone().all(is_accepted), "{:?}", answer.outcomes);
        kinds.filter(|kind| *kind == CompletionKind::Stored).count()
    }
}
