//! Tests a farm on a store of its own, without network: how it handles a disk that returns other bytes than were written,
//! and how dictionaries share records.

mod fitting;
mod result_stream;
mod waiting;

use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::status::{DictionaryState, MachineFacts};
use farm_proto::{DictionaryName, METHODS, PROTOCOL_VERSION};
use optics_model::grid::Axes;
use optics_model::job::JobSpec;
use optics_model::scene::{Scene, Sensor};
use optics_model::{Estimate, Grid, PHYSICS_VERSION, PackedRecords, Profile, Record, Walks};
use sqlx::Connection;

use super::{Farm, FarmError, Versions};
use crate::actor::Actor;
use crate::config::Config;
use crate::dispatch::Registration;
use crate::metrics::{BuildInfo, Metrics};
use crate::store::{DataDir, Store};
use crate::stored::{Completion, DesiredState, JobResult, Machine, Origin, Outcome, OutcomeKind};

const JOBS: u32 = 40;
/// The fewest pixels that a fit may have.
const PIXELS: usize = 8;

fn grid() -> Grid {
    let axes = Axes {
        sigma_t_per_mm: (1..=JOBS).map(f64::from).collect(),
        albedo: vec![0.5, 0.9],
        g: vec![0.0],
        thickness_mm: vec![1.0],
        sample_ior: vec![1.5],
    };
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, PIXELS as u32, 0.0).unwrap());
    Grid::new(scene, axes, Walks::new(5000).unwrap(), 1, false).unwrap()
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
    DictionaryName::new("d").unwrap()
}

/// A farm that checks no results.
async fn load(store: Store) -> Arc<Farm> {
    load_with(store, 0.0).await
}

async fn load_with(store: Store, check_share: f64) -> Arc<Farm> {
    let build = BuildInfo { version: String::new(), physics_version: String::new() };
    let config = Config { check_share, ..Config::new("") };
    Farm::load(store, &config, Metrics::new(build, METHODS.iter().copied())).await.unwrap()
}

/// A farm with a dictionary that is done. Its records lie in the database's log.
async fn done() -> (Arc<Farm>, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(DataDir::lock(dir.path()).unwrap(), |_| {}).await.unwrap();
    let worker = store.register_worker(&Machine::at("instance"), "label").await.unwrap();
    let dictionary = store.create_dictionary(name(), grid(), 0, "", 7).await.unwrap();
    for job in 0..JOBS {
        store.complete(completion(dictionary.id, worker, job)).await.unwrap();
    }
    let farm = load(store).await;
    // Nothing else is written during the test.
    farm.scheduler.close().await;
    (farm, dir)
}

fn jobs_done(farm: &Farm) -> u32 {
    farm.status(&name()).unwrap().jobs_done as u32
}

/// Path and contents of the database's log.
fn log(dir: &tempfile::TempDir) -> (PathBuf, Vec<u8>) {
    let path = dir.path().join("farm.db-wal");
    let bytes = std::fs::read(&path).unwrap();
    (path, bytes)
}

/// Writes bytes back to the start of a file; the bytes after them stay.
fn restore(path: &Path, bytes: &[u8]) {
    std::fs::File::options().write(true).open(path).unwrap().write_all_at(bytes, 0).unwrap();
}

/// An I/O error is no damage: when it is gone, the records are intact.
#[tokio::test]
async fn unreadable_jobs_are_reported_and_not_deleted() {
    let (farm, dir) = done().await;
    let (path, bytes) = log(&dir);
    std::fs::File::options().write(true).open(&path).unwrap().set_len(32).unwrap();
    let found = farm.inspect(true).await;
    assert!(found.unchecked.as_ref().is_some_and(|why| why.contains("522")), "{found:?}");
    assert!(found.faults.is_empty(), "{found:?}");
    assert!(found.damaged.is_empty(), "{found:?}");
    assert_eq!(found.unreadable.len(), 1, "{found:?}");
    assert_eq!((found.unreadable[0].jobs, found.unreadable[0].first), (JOBS as usize, 0));
    assert!(found.unreadable[0].what.contains("disk I/O error"), "{found:?}");
    assert!(matches!(farm.records(&name(), 0..80).await, Err(FarmError::Store(_))));
    assert_eq!(jobs_done(&farm), JOBS);
    restore(&path, &bytes);
    let found = farm.inspect(true).await;
    assert_eq!((found.jobs, found.records), (JOBS as usize, 2 * JOBS as usize), "{found:?}");
    assert!(found.unreadable.is_empty() && found.unchecked.is_none(), "{found:?}");
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
    let found = farm.inspect(true).await;
    assert!(found.damaged.is_empty(), "{found:?}");
    assert_eq!(found.unreadable.len(), 1, "{found:?}");
    assert!(found.unreadable[0].what.contains("at one reading, and not at the next"), "{found:?}");
    // Another connection than the one that read it wrongly may be used.
    if let Err(unsteady) = farm.records(&name(), 0..80).await {
        assert!(matches!(unsteady, FarmError::Unreadable { job: 17, .. }), "{unsteady:?}");
    }
    assert_eq!(jobs_done(&farm), JOBS);
}

async fn change(dir: &tempfile::TempDir, query: &'static str) {
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
    let (axes, walks) = (grid(), Walks::new(1_000_000_000_000).unwrap());
    let axes = Axes {
        sigma_t_per_mm: axes.sigma_t_per_mm().to_vec(),
        albedo: axes.albedo().to_vec(),
        g: axes.g().to_vec(),
        thickness_mm: axes.thickness_mm().to_vec(),
        sample_ior: axes.sample_ior().to_vec(),
    };
    Grid::new(grid().scene().clone(), axes, walks, 1, false).unwrap()
}

/// A grid that is too large is refused before it is stored.
#[tokio::test]
async fn too_large_grid_is_refused_before_storing() {
    let (farm, _dir) = done().await;
    let refused = farm
        .submit(&Actor::default(), DictionaryName::new("large").unwrap(), too_large(), 0)
        .await
        .unwrap_err();
    let FarmError::Invalid(why) = &refused else { panic!("{refused}") };
    assert_eq!(why.field(), "walks");
    assert!(why.to_string().contains("1000000000000 is not valid: at most 25000000000 are allowed"), "{why}");
    assert_eq!(farm.store.dictionaries().await.unwrap().len(), 1);
}

/// A dictionary that is too large, which an earlier version may have stored, is cancelled with the reason and does not
/// prevent the start.
#[tokio::test]
async fn too_large_dictionary_is_cancelled_at_start() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(DataDir::lock(dir.path()).unwrap(), |_| {}).await.unwrap();
    let large = DictionaryName::new("large").unwrap();
    store.create_dictionary(large.clone(), too_large(), 0, "", 7).await.unwrap();
    store.create_dictionary(name(), grid(), 0, "", 8).await.unwrap();
    let farm = load(store).await;
    let status = farm.status(&large).unwrap();
    assert_eq!(status.state, DictionaryState::Cancelled);
    assert!(status.reason.contains("at most 25000000000 are allowed"), "{}", status.reason);
    assert_eq!(farm.explain(&large).unwrap()[0].code, "TOO_LARGE");
    assert!(matches!(farm.resume(&Actor::default(), &large).await, Err(FarmError::Invalid(_))));
    assert_eq!(farm.status(&name()).unwrap().state, DictionaryState::Running);
    assert_eq!(
        farm.scheduler.query(|d, _| d.schedule().load().0),
        JOBS as usize,
        "the other one's jobs wait"
    );
    farm.delete(&Actor::default(), &large).await.unwrap();
    assert!(matches!(farm.status(&large), Err(FarmError::NotFound { .. })));
}

async fn worker(farm: &Farm, label: &str) -> WorkerId {
    let (instance, machine) = (label.to_owned(), Machine::at(label));
    let about = Registration {
        instance,
        machine,
        label: label.to_owned(),
        threads: 1,
        version: String::new(),
        facts: MachineFacts::default(),
    };
    let versions = Versions { physics: PHYSICS_VERSION, protocol: PROTOCOL_VERSION };
    farm.register(about, versions, false).await.unwrap().0
}

/// Gives a worker one job, and delivers records whose numbers are all the same.
async fn deliver(farm: &Farm, worker: &WorkerId, value: f32) -> Outcome {
    let lease = farm.acquire_now(worker, 1).unwrap().leases.remove(0);
    let admission = farm.admit(worker, &lease.key, lease.job.identity()).unwrap();
    let content = content(&lease.job, value);
    farm.complete(worker.clone(), lease.key, admission, content).await.unwrap()
}

#[tokio::test]
async fn dispute_wakes_workers_that_wait() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(DataDir::lock(dir.path()).unwrap(), |_| {}).await.unwrap();
    store.create_dictionary(name(), grid(), 0, "", 8).await.unwrap();
    let farm = load_with(store, 1.0).await;
    let (first, second) = (worker(&farm, "first").await, worker(&farm, "second").await);
    assert!(matches!(deliver(&farm, &first, 0.25).await, Outcome::Finished { .. }));
    let lease = farm.acquire_now(&second, 1).unwrap().leases.remove(0);
    let third = farm.scheduler.work();
    let admission = farm.admit(&second, &lease.key, lease.job.identity()).unwrap();
    let other = content(&lease.job, 0.5);
    let outcome = farm.complete(second, lease.key, admission, other).await.unwrap();
    assert_eq!(outcome.kind(), OutcomeKind::Conflict);
    assert!(third.has_changed().unwrap(), "there is something to decide");
}

/// Lets a worker do all jobs that are given out; returns their number.
async fn work(farm: &Farm, worker: &WorkerId) -> usize {
    let mut done = 0;
    while let Some(lease) = farm.acquire_now(worker, 1).unwrap().leases.pop() {
        let admission = farm.admit(worker, &lease.key, lease.job.identity()).unwrap();
        let content = content(&lease.job, value(lease.key.job));
        let outcome = farm.complete(worker.clone(), lease.key, admission, content).await.unwrap();
        assert!(matches!(outcome, Outcome::Finished { .. }));
        done += 1;
    }
    done
}

#[tokio::test]
async fn overlapping_dictionaries_compute_nothing_twice() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(DataDir::lock(dir.path()).unwrap(), |_| {}).await.unwrap();
    let farm = load(store).await;
    let (first, second) = (name(), DictionaryName::new("e").unwrap());
    for name in [&first, &second] {
        farm.submit(&Actor::default(), name.clone(), grid(), 0).await.unwrap();
    }
    let worker = worker(&farm, "worker").await;
    assert_eq!(work(&farm, &worker).await, JOBS as usize);
    let [first, second] = [&first, &second].map(|name| farm.status(name).unwrap());
    assert_eq!((first.state, second.state), (DictionaryState::Done, DictionaryState::Done));
    assert_eq!((first.records_reused, second.records_reused), (0, 2 * JOBS as usize));
    assert_eq!(first.records_digest, second.records_digest);
    let found = farm.inspect(false).await;
    assert_eq!((found.jobs, found.damaged.len()), (2 * JOBS as usize, 0), "{found:?}");
}

/// Records that arrived for another dictionary while this one was cancelled, or before a restart, are not computed again.
#[tokio::test]
async fn resume_and_restart_reuse_records_of_others() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(DataDir::lock(dir.path()).unwrap(), |_| {}).await.unwrap();
    let farm = load(store).await;
    let (first, second) = (name(), DictionaryName::new("e").unwrap());
    for name in [&first, &second] {
        farm.submit(&Actor::default(), name.clone(), grid(), 0).await.unwrap();
    }
    farm.cancel(&Actor::default(), &second, "later").await.unwrap();
    let of_farm = worker(&farm, "worker").await;
    assert_eq!(work(&farm, &of_farm).await, JOBS as usize);
    assert_eq!(farm.status(&second).unwrap().jobs_done, 0);
    // As if the coordinator had been killed before it resumed.
    let (id, _) = farm.found(&second).unwrap();
    farm.store.set_desire(id, DesiredState::Run, "").await.unwrap();
    farm.close().await;
    drop(farm);
    let store = Store::open(DataDir::lock(dir.path()).unwrap(), |_| {}).await.unwrap();
    let farm = load(store).await;
    assert_eq!(farm.status(&second).unwrap().state, DictionaryState::Done);
}
