//! Tests a farm on a store of its own, without network: how it handles a disk that returns other bytes than were written,
//! and how dictionaries share records.

mod fitting;
mod judge;
mod result_stream;
mod waiting;

use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::lease::Lease;
use farm_proto::status::DictionaryState;
use farm_proto::{DictionaryName, METHODS, PROTOCOL_VERSION};
use optics_model::job::JobSpec;
use optics_model::{Estimate, Grid, PHYSICS_VERSION, PackedRecords, Profile, Record};
use sqlx::Connection;
use tempfile::TempDir;

use super::{Farm, FarmError, Versions};
use crate::actor::Actor;
use crate::config::Config;
use crate::metrics::{BuildInfo, Metrics};
use crate::store::{DataDir, Store};
use crate::stored::{Completion, DesiredState, JobResult, Machine, Origin, Outcome, OutcomeKind};
use crate::testing::{self, process};

const JOBS: u32 = 40;
/// The fewest pixels that a fit may have.
const PIXELS: usize = 8;

/// A grid of forty jobs.
fn grid_of(walks: u64) -> Grid {
    let sigma_t: Vec<f64> = (1..=JOBS).map(f64::from).collect();
    testing::grid(Some(PIXELS as u32), &sigma_t, &[0.5, 0.9], walks)
}

fn grid() -> Grid {
    grid_of(5000)
}

/// All numbers of a job's records are this one.
fn value(job: u32) -> f32 {
    job as f32 / 64.0 + 0.001
}

/// Records of a job whose numbers are all the same.
fn content(job: &JobSpec, value: f32) -> JobResult {
    let estimate = || Estimate::new(vec![value; PIXELS], vec![0.125; PIXELS]).unwrap();
    let profile = || Profile { radiance_factor: estimate(), derivatives: None };
    let record = |index| Record { index, profiles: (0..3).map(|_| profile()).collect() };
    let first = job.first_record();
    JobResult::Records(PackedRecords::pack(job, &(first..first + 2).map(record).collect::<Vec<_>>()))
}

fn completion(dictionary: DictionaryId, worker: Origin, job_number: u32) -> Completion {
    let job = JobSpec::of(&grid(), job_number as usize);
    let content = content(&job, value(job_number));
    Completion { dictionary, job_number, job, worker, content, quality: None }
}

fn name() -> DictionaryName {
    testing::name("d")
}

async fn store() -> (TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = open(&dir).await;
    (dir, store)
}

async fn open(dir: &TempDir) -> Store {
    Store::open(DataDir::lock(dir.path()).unwrap(), |_| {}).await.unwrap()
}

/// A farm without dictionaries.
async fn empty() -> (Arc<Farm>, TempDir) {
    let (dir, store) = store().await;
    (load(store, 0.0).await, dir)
}

/// A farm with a dictionary, and a worker.
async fn begun(check_share: f64) -> (Arc<Farm>, WorkerId, TempDir) {
    let (dir, store) = store().await;
    let farm = load(store, check_share).await;
    farm.submit(&Actor::default(), name(), grid(), 0).await.unwrap();
    let worker = worker(&farm, "worker").await;
    (farm, worker, dir)
}

/// A farm that checks this share of the results, and itself finds the value of each job.
async fn load(store: Store, check_share: f64) -> Arc<Farm> {
    let recompute = |job: &JobSpec| Ok(content(job, value(job.first_record() as u32 / 2)));
    let config = Config { check_share, recompute, ..Config::new("") };
    load_with(store, &config).await
}

async fn load_with(store: Store, config: &Config) -> Arc<Farm> {
    let build = BuildInfo { version: String::new(), physics_version: String::new() };
    Farm::load(store, config, Metrics::new(build, METHODS.iter().copied())).await.unwrap()
}

/// A farm with a dictionary that is done. Its records lie in the database's log.
async fn done() -> (Arc<Farm>, TempDir) {
    let (dir, store) = store().await;
    let worker = store.register_worker(&Machine::at("instance"), "label").await.unwrap();
    let dictionary = store.create_dictionary(name(), grid(), 0, "", 7).await.unwrap();
    for job in 0..JOBS {
        store.complete(completion(dictionary.id, worker, job)).await.unwrap();
    }
    let farm = load(store, 0.0).await;
    // Nothing else is written during the test.
    farm.scheduler.close().await;
    (farm, dir)
}

/// Events are stored in batches, and a question about them has those of what was answered before.
#[tokio::test]
async fn events_follow_their_causes_at_once() {
    let (farm, _dir) = empty().await;
    for (count, name) in ["a", "b", "c"].map(testing::name).into_iter().enumerate() {
        farm.submit(&Actor::default(), name, grid(), 0).await.unwrap();
        assert_eq!(farm.events(0, "", 10).await.unwrap().len(), count + 1);
    }
}

fn jobs_done(farm: &Farm) -> u32 {
    farm.status(&name()).unwrap().jobs_done as u32
}

/// Path and contents of the database's log.
fn log(dir: &TempDir) -> (PathBuf, Vec<u8>) {
    let path = dir.path().join("farm.db-wal");
    let bytes = std::fs::read(&path).unwrap();
    (path, bytes)
}

/// Writes bytes back to the start of a file; the bytes after them stay.
fn restore(path: &Path, bytes: &[u8]) {
    std::fs::File::options().write(true).open(path).unwrap().write_all_at(bytes, 0).unwrap();
}

/// A page that was read wrongly once stays in the memory of the connection that read it.
#[tokio::test]
async fn transient_read_damage_keeps_the_record() {
    let (farm, dir) = done().await;
    let (path, bytes) = log(&dir);
    let known = value(17).to_le_bytes().repeat(4);
    let mut wrong = bytes.clone();
    let places: Vec<usize> =
        (0..bytes.len() - known.len()).filter(|i| bytes[*i..].starts_with(&known)).collect();
    assert!(!places.is_empty());
    for place in places {
        wrong[place] ^= 1;
    }
    restore(&path, &wrong);
    let found = farm.inspect(false).await;
    assert_eq!(found.damaged.iter().map(|(_, job, _)| *job).collect::<Vec<_>>(), [17], "{found:?}");
    restore(&path, &bytes);
    // The second reading, on a connection of its own, finds the record as it was stored.
    let (id, grid) = farm.found(&name()).unwrap();
    assert_eq!(farm.forget_if_damaged(id, &grid, 17).await.unwrap(), None);
    let found = farm.inspect(true).await;
    assert!(found.damaged.is_empty(), "{found:?}");
    for job in &found.unreadable {
        assert_eq!((job.jobs, job.first, job.what.as_str()), (1, 17, super::records::UNSTEADY));
    }
    // Another connection than the one that read it wrongly may be used.
    if let Err(unsteady) = farm.records(&name(), 0..80).await {
        assert!(matches!(unsteady, FarmError::Unreadable { job: 17, .. }), "{unsteady:?}");
    }
    assert_eq!(jobs_done(&farm), JOBS);
}

async fn change(dir: &TempDir, query: &'static str) {
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(dir.path().join("farm.db"));
    let mut other = sqlx::SqliteConnection::connect_with(&options).await.unwrap();
    sqlx::query(query).execute(&mut other).await.unwrap();
    other.close().await.unwrap();
}

/// A fit that meets a damaged job drops this job only, so that it is computed again.
#[tokio::test]
async fn fit_drops_only_the_damaged_job() {
    for damage in [
        "UPDATE records SET profiles = x'00' WHERE id = 36",
        "UPDATE records SET profiles = zeroblob(96) WHERE id = 36",
        "DELETE FROM records WHERE id IN (35, 36)",
    ] {
        let (farm, dir) = done().await;
        change(&dir, damage).await;
        let refused = farm.ask(&name(), (&[], Vec::new()), |_| Ok(())).await;
        assert!(matches!(refused, Err(FarmError::Damaged { job: 17, .. })), "{damage}: {refused:?}");
        assert_eq!(jobs_done(&farm), JOBS - 1, "{damage}");
        let found = farm.inspect(false).await;
        assert!(found.damaged.is_empty(), "{damage}: {found:?}");
        assert_eq!(found.jobs as u32, JOBS - 1, "{damage}");
    }
}

/// Forty points of a thousand thousand blocks each.
fn too_large() -> Grid {
    grid_of(1_000_000_000_000)
}

/// A grid that is too large is refused before it is stored.
#[tokio::test]
async fn too_large_grid_is_refused_before_storing() {
    let (farm, _dir) = empty().await;
    let refused = farm.submit(&Actor::default(), name(), too_large(), 0).await.unwrap_err();
    let FarmError::Invalid(why) = &refused else { panic!("{refused}") };
    assert_eq!(why.field(), "walks");
    assert!(why.to_string().contains("1000000000000 is not valid: at most 25000000000 are allowed"), "{why}");
    assert!(farm.store.dictionaries().await.unwrap().is_empty());
}

/// A dictionary that is too large, which an earlier version may have stored, is cancelled with the reason and does not
/// prevent the start.
#[tokio::test]
async fn too_large_dictionary_is_cancelled_at_start() {
    let (_dir, store) = store().await;
    let large = testing::name("large");
    store.create_dictionary(large.clone(), too_large(), 0, "", 7).await.unwrap();
    store.create_dictionary(name(), grid(), 0, "", 8).await.unwrap();
    let farm = load(store, 0.0).await;
    let status = farm.status(&large).unwrap();
    assert_eq!(status.state, DictionaryState::Cancelled);
    assert!(status.reason.contains("at most 25000000000 are allowed"), "{}", status.reason);
    assert_eq!(farm.explain(&large).unwrap()[0].code, "TOO_LARGE");
    assert!(matches!(farm.resume(&Actor::default(), &large).await, Err(FarmError::Invalid(_))));
    assert_eq!(farm.status(&name()).unwrap().state, DictionaryState::Running);
    let waiting = farm.scheduler.query(|d, _| d.schedule().load().0);
    assert_eq!(waiting, JOBS as usize, "the other one's jobs wait");
    farm.delete(&Actor::default(), &large).await.unwrap();
    assert!(matches!(farm.status(&large), Err(FarmError::NotFound { .. })));
}

async fn worker(farm: &Farm, label: &str) -> WorkerId {
    let versions = Versions { physics: PHYSICS_VERSION, protocol: PROTOCOL_VERSION };
    farm.register(process(Machine::at(label), label), versions).await.unwrap().0
}

/// Delivers records whose numbers are all the same.
async fn deliver(farm: &Farm, worker: &WorkerId, lease: &Lease, value: f32) -> Outcome {
    let admission = farm.admit(worker, &lease.key, lease.job.identity()).unwrap();
    let content = content(&lease.job, value);
    farm.complete(worker.clone(), lease.key, admission, content).await.unwrap()
}

fn lease(farm: &Farm, worker: &WorkerId) -> Option<Lease> {
    farm.acquire_now(worker, 1).unwrap().leases.pop()
}

/// A dictionary that overlaps another computes nothing twice, also if its records arrived while it was cancelled, or
/// before a restart.
#[tokio::test]
async fn overlapping_dictionaries_compute_nothing_twice() {
    for cancelled in [false, true] {
        let (mut farm, worker, dir) = begun(0.0).await;
        let second = testing::name("e");
        farm.submit(&Actor::default(), second.clone(), grid(), 0).await.unwrap();
        if cancelled {
            farm.cancel(&Actor::default(), &second, "later").await.unwrap();
        }
        let mut done = 0;
        while let Some(lease) = lease(&farm, &worker) {
            let outcome = deliver(&farm, &worker, &lease, value(lease.key.job)).await;
            assert!(matches!(outcome, Outcome::Finished { .. }));
            done += 1;
        }
        assert_eq!(done, JOBS);
        if cancelled {
            assert_eq!(farm.status(&second).unwrap().jobs_done, 0);
            // As if the coordinator had been killed before it resumed.
            let (id, _) = farm.found(&second).unwrap();
            farm.store.set_desire(id, DesiredState::Run, "").await.unwrap();
            farm.close().await;
            drop(farm);
            farm = load(open(&dir).await, 0.0).await;
        }
        let [first, second] = [&name(), &second].map(|name| farm.status(name).unwrap());
        assert_eq!((first.state, second.state), (DictionaryState::Done, DictionaryState::Done));
        assert_eq!((first.records_reused, second.records_reused), (0, 2 * JOBS as usize));
        assert_eq!(first.records_digest, second.records_digest);
        let found = farm.inspect(false).await;
        assert_eq!((found.jobs, found.damaged.len()), (2 * JOBS as usize, 0), "{found:?}");
    }
}
