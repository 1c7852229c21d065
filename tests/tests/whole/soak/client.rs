//! A client that submits, watches, fits, cancels, resumes and deletes dictionaries, and checks every answer.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use farm_link::Link;
use farm_proto::wire;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_proto::wire::farm_client::FarmClient;
use farm_proto::wire::fits_client::FitsClient;
use farm_proto::wire::{
    CancelRequest, DeleteRequest, DictionaryState, FitRequest, ListEventsRequest, ListRequest, ResumeRequest,
    StatusRequest, SubmitRequest, WatchRequest,
};
use farm_tests::grids::traced;
use farm_tests::statistics::Normal;
use optics_model::grid::Axes;
use optics_model::scene::Scene;
use optics_model::{Digest, Grid, MeasuredProfile, Measurement, Walks};
use tokio_util::sync::CancellationToken;
use tonic::{Code, Request, Status};

/// Records of one dictionary.
pub const RECORDS: u64 = 12;
/// 3 channels of 360 pixels with errors.
pub const RECORD_BYTES: u64 = 3 * 360 * 2 * 4;
/// Dictionaries that a client keeps.
const KEPT: usize = 4;
/// Time limit of a call, after which it is repeated.
const CALL: Duration = Duration::from_secs(10);
/// Time limit of a dictionary.
const PATIENCE: Duration = Duration::from_mins(2);

/// Counts of completed actions.
#[derive(Debug, Default)]
pub struct Tally {
    done: AtomicU64,
    cancelled: AtomicU64,
    resumed: AtomicU64,
    deleted: AtomicU64,
    fits: AtomicU64,
    calls_repeated: AtomicU64,
}

impl Tally {
    pub fn done(&self) -> u64 {
        self.done.load(Ordering::Relaxed)
    }
}

fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

/// Counts a change that was made; if it was not, the reason has this code.
fn note<T>(answer: Result<T, Status>, otherwise: Code, counter: &AtomicU64) {
    match answer {
        Ok(_) => count(counter),
        Err(status) => assert_eq!(status.code(), otherwise, "{status}"),
    }
}

/// A dictionary that is complete.
#[derive(Debug, Clone)]
pub struct Live {
    name: String,
    seed: u64,
    digest: Digest,
}

pub struct Client {
    number: u64,
    chance: Normal,
    tally: Arc<Tally>,
    dictionaries: DictionariesClient<Link>,
    fits: FitsClient<Link>,
    farm: FarmClient<Link>,
    live: VecDeque<Live>,
}

fn grid(seed: u64) -> Grid {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0, 4.0],
        albedo: vec![0.5, 0.9, 0.99],
        g: vec![0.0, 0.4],
        thickness_mm: vec![0.5],
        sample_ior: vec![1.53],
    };
    Grid::new(Scene::paper(), axes, Walks::new(5000).unwrap(), seed, false).unwrap()
}

impl Client {
    pub fn new(link: Link, number: u64, seed: u64, tally: Arc<Tally>) -> Self {
        Self {
            number,
            chance: Normal::new(1000 * seed + number),
            tally,
            dictionaries: DictionariesClient::new(link.clone()),
            fits: FitsClient::new(link.clone()),
            farm: FarmClient::new(link),
            live: VecDeque::new(),
        }
    }

    /// Works until it is stopped; returns the remaining dictionaries.
    pub async fn run(mut self, stop: CancellationToken) -> Vec<Live> {
        for round in 0.. {
            if stop.is_cancelled() {
                break;
            }
            // Some grids are repeated under another name, so that their records are reused.
            let repeated = self.live.front().filter(|_| round % 4 == 3).map(|live| live.seed);
            let seed = repeated.unwrap_or(1_000_000 * (self.number + 1) + round);
            self.round(format!("client-{}.{round}", self.number), seed).await;
            tokio::time::sleep(Duration::from_millis(100).mul_f64(self.chance.uniform())).await;
        }
        self.live.into()
    }

    async fn round(&mut self, name: String, seed: u64) {
        let grid = grid(seed);
        self.submit(&name, &grid).await;
        let mood = self.chance.uniform();
        if mood < 0.3 {
            self.cancel(&name).await;
        }
        if mood < 0.15 {
            self.delete(&name).await;
            return;
        }
        if mood < 0.3 {
            self.resume(&name).await;
        }
        let found = tokio::time::timeout(PATIENCE, self.done(&name)).await;
        let found = found.unwrap_or_else(|_| panic!("{name} is not done after {PATIENCE:?}"));
        let records: Vec<_> = (0..grid.job_count()).map(|job| traced(&grid, job)).collect();
        let digest = Digest::of_jobs(records.iter().map(|records| Digest::of_records(records)));
        assert_eq!(found, digest, "{name} has other records than the tracer computes");
        count(&self.tally.done);
        self.fit(&name, &grid, &records.concat()).await;
        self.live.push_back(Live { name, seed, digest });
        if self.live.len() > KEPT
            && let Some(oldest) = self.live.pop_front()
        {
            self.delete(&oldest.name).await;
        }
        self.last_event().await;
    }

    async fn submit(&self, name: &str, grid: &Grid) {
        let request = SubmitRequest { name: name.to_owned(), grid: Some(grid.into()), priority: 0 };
        self.answered(|| async { self.dictionaries.clone().submit(timed(request.clone())).await })
            .await
            .unwrap();
    }

    /// It may be done already.
    async fn cancel(&self, name: &str) {
        let request = CancelRequest { name: name.to_owned(), reason: "a change of mind".to_owned() };
        let call = || async { self.dictionaries.clone().cancel(timed(request.clone())).await };
        note(self.answered(call).await, Code::FailedPrecondition, &self.tally.cancelled);
    }

    async fn resume(&self, name: &str) {
        let request = ResumeRequest { name: name.to_owned() };
        let call = || async { self.dictionaries.clone().resume(timed(request.clone())).await };
        note(self.answered(call).await, Code::FailedPrecondition, &self.tally.resumed);
    }

    /// The answer to a first attempt may be lost.
    async fn delete(&self, name: &str) {
        let request = DeleteRequest { name: name.to_owned() };
        let call = || async { self.dictionaries.clone().delete(timed(request.clone())).await };
        note(self.answered(call).await, Code::NotFound, &self.tally.deleted);
    }

    /// Watches until the dictionary is done; returns the digest of its records.
    async fn done(&self, name: &str) -> Digest {
        loop {
            let request = WatchRequest { name: name.to_owned() };
            let watched = self
                .answered(|| async { self.dictionaries.clone().watch(request.clone()).await })
                .await
                .unwrap();
            let mut updates = watched.into_inner();
            let mut last = None;
            // A stream that breaks, or is silent because the coordinator is stopped, is opened again.
            while let Ok(Ok(Some(update))) = tokio::time::timeout(CALL, updates.message()).await {
                last = Some(update);
            }
            if let Some(last) = last.filter(|d| d.state() == DictionaryState::Done) {
                return Digest::from_hex(&last.records_digest).expect("a finished dictionary has a digest");
            }
        }
    }

    /// Fits a record of the dictionary; the best fit must be its own medium.
    async fn fit(&self, name: &str, grid: &Grid, records: &[optics_model::Record]) {
        let (sensor, index) = (grid.scene().sensor(), grid.record_at(0, 1, 1, 0, 2));
        let x = (0..sensor.pixels()).map(|i| sensor.centre_mm(i)).collect();
        let channel = grid.scene().channels()[0].name();
        let profile = &records[index].profiles[0].radiance_factor;
        let values = profile.values().iter().map(|v| f64::from(*v)).collect();
        let profile = MeasuredProfile::new(channel, 0.5, x, values, None).unwrap();
        let measurement = Measurement::new("m", vec![profile]).unwrap();
        let options = Some(wire::FitOptions { top: Some(1), ..Default::default() });
        let request =
            FitRequest { dictionary: name.to_owned(), measurement: Some((&measurement).into()), options };
        let answer =
            self.answered(|| async { self.fits.clone().fit(timed(request.clone())).await }).await.unwrap();
        let best = answer.into_inner().fit.unwrap().channels[0].candidates[0].clone();
        let medium = wire::Medium { sigma_t_per_mm: 4.0, albedo: 0.99, g: 0.4 };
        assert_eq!(best.medium, Some(medium), "{name} is fitted with another medium");
        count(&self.tally.fits);
    }

    /// Number of the newest event.
    pub async fn last_event(&self) -> u64 {
        let request = ListEventsRequest { page_size: 100, newest: true, ..Default::default() };
        let answer = self
            .answered(|| async { self.farm.clone().list_events(timed(request.clone())).await })
            .await
            .unwrap();
        answer.into_inner().events.last().map_or(0, |event| event.id)
    }

    /// Numbers of verified results since the coordinator's start: confirmed and disputed.
    pub async fn checks(&self) -> (u64, u64) {
        let answer = self
            .answered(|| async { self.farm.clone().status(timed(StatusRequest {})).await })
            .await
            .unwrap()
            .into_inner();
        (answer.checks_agreed, answer.checks_disputed)
    }

    /// Checks that exactly these dictionaries exist, all complete.
    pub async fn assert_exactly(&self, live: &[Live]) {
        let request = ListRequest::default();
        let answer = self
            .answered(|| async { self.dictionaries.clone().list(timed(request.clone())).await })
            .await
            .unwrap();
        let key = |name: &str, digest: String| (name.to_owned(), digest);
        let mut found: Vec<_> =
            answer.into_inner().dictionaries.iter().map(|d| key(&d.name, d.records_digest.clone())).collect();
        let mut expected: Vec<_> = live.iter().map(|l| key(&l.name, l.digest.to_string())).collect();
        found.sort();
        expected.sort();
        assert_eq!(found, expected);
    }

    /// Repeats a call until the coordinator answers it.
    async fn answered<T, F: Future<Output = Result<T, Status>>>(
        &self,
        call: impl Fn() -> F,
    ) -> Result<T, Status> {
        let start = Instant::now();
        loop {
            match call().await {
                Err(status) if is_passing(&status) => {
                    assert!(start.elapsed() < PATIENCE, "no answer for {PATIENCE:?}: {status}");
                    count(&self.tally.calls_repeated);
                    tokio::time::sleep(Duration::from_millis(50)).await;
                }
                answer => return answer,
            }
        }
    }
}

fn timed<T>(message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.set_timeout(CALL);
    request
}

fn is_passing(status: &Status) -> bool {
    matches!(
        status.code(),
        Code::Unavailable | Code::Unknown | Code::Cancelled | Code::DeadlineExceeded | Code::Internal
    )
}
