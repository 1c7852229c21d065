mod blocks;
mod checks;
mod damage;
mod damaged_backup;
mod fences;
mod measurements;

use std::sync::mpsc::Receiver;

use farm_proto::ids::DictionaryId;
use optics_model::job::JobSpec;
use optics_model::{Digest, Estimate, Grid, PackedRecords, Profile, Quality, Record, Walks};
use sqlx::{AssertSqlSafe, SqlitePool};
use tempfile::TempDir;

use super::{Commit, DataDir, Store, StoreError, StoredEvent};
use crate::stored::{
    Claim, Completion, DesiredState, EndedJob, JobResult, Machine, OpenCheck, Origin, Outcome, Secret,
    StoredDictionary,
};
use crate::testing::{self, name};

fn grid() -> Grid {
    testing::grid(Some(4), &[1.0, 2.0], &[0.5, 0.9], 5000)
}

pub(super) fn records(first: usize, value: f32) -> Vec<Record> {
    let profile = || Profile {
        radiance_factor: Estimate::new(vec![value; 4], vec![0.125; 4]).unwrap(),
        derivatives: None,
    };
    (first..first + 2).map(|index| Record { index, profiles: (0..3).map(|_| profile()).collect() }).collect()
}

pub(super) async fn open(dir: &std::path::Path) -> Store {
    Store::open(DataDir::lock(dir).unwrap(), |_| {}).await.unwrap()
}

/// A store in a folder of its own.
pub(super) async fn empty() -> (TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    (dir, store)
}

/// A store in which one worker is registered.
async fn with_worker() -> (TempDir, Store) {
    let (dir, store) = empty().await;
    assert_eq!(store.register_worker(&Machine::at("instance"), "label").await.unwrap(), Origin(1));
    (dir, store)
}

/// A store in which one worker is registered, with a dictionary.
pub(super) async fn begun() -> (TempDir, Store, StoredDictionary) {
    let (dir, store) = with_worker().await;
    let dictionary = dictionary(&store).await;
    (dir, store, dictionary)
}

/// The store after a restart.
pub(super) async fn reopened(store: Store, dir: &TempDir) -> Store {
    store.close().await;
    drop(store);
    open(dir.path()).await
}

async fn create(store: &Store, of: &str, grid: Grid) -> StoredDictionary {
    store.create_dictionary(name(of), grid, 0, "", 7).await.unwrap()
}

async fn dictionary(store: &Store) -> StoredDictionary {
    create(store, "d", grid()).await
}

/// Changes rows behind the store's back.
pub(super) async fn run(store: &Store, query: &'static str) {
    sqlx::query(query).execute(&store.write).await.unwrap();
}

async fn count(store: &Store, table: &str) -> i64 {
    let query = AssertSqlSafe(format!("SELECT count(*) FROM {table}"));
    sqlx::query_scalar(query).fetch_one(&store.read).await.unwrap()
}

async fn delete(store: &Store, dictionary: DictionaryId) -> u64 {
    store.ledger().exclusive().await.delete_dictionary(dictionary, &[]).await.unwrap()
}

async fn fence(store: &Store, worker: Origin) -> Vec<(DictionaryId, u32)> {
    store.ledger().exclusive().await.fence(&[worker], "wrong", &[]).await.unwrap()
}

/// A result of a job by worker 1 of the table.
fn completion(dictionary: &StoredDictionary, job_number: u32, value: f32) -> Completion {
    let job = JobSpec::of(&dictionary.grid, job_number as usize);
    let content = JobResult::Records(PackedRecords::pack(&job, &records(job.first_record(), value)));
    Completion { dictionary: dictionary.id, job_number, job, worker: Origin(1), content, quality: None }
}

/// With a result of this quality the writer panics before it commits.
pub(super) fn defect() -> Quality {
    Quality::new(1.0, Walks::new(2_500_000).unwrap()).unwrap()
}

impl Store {
    /// Stores a result as the farm does.
    pub async fn complete(&self, completion: Completion) -> super::Result<Outcome> {
        self.ledger().shared().await.complete(completion).await
    }
}

pub(super) async fn complete(store: &Store, dictionary: &StoredDictionary, job: u32, value: f32) -> Outcome {
    store.complete(completion(dictionary, job, value)).await.unwrap()
}

async fn all_records(store: &Store, dictionary: &StoredDictionary) -> Vec<Record> {
    let jobs = store.finished_jobs(dictionary.id, &dictionary.grid, 0..2).await.unwrap();
    jobs.into_iter().flat_map(|found| found.unwrap().records.unpack()).collect()
}

fn done(job: u32, records: Digest) -> EndedJob {
    testing::done(job, Walks::new(5000).unwrap(), records, Some(Origin(1)), false)
}

/// Everything that was committed is present after reopening.
#[tokio::test]
async fn committed_rows_survive_reopening() {
    let (dir, store, created) = begun().await;
    let (records_of, given_up) = (records(2, 0.25), "no luck".to_owned());
    let digest = Digest::of_records(&records_of);
    assert_eq!(complete(&store, &created, 1, 0.25).await, Outcome::Finished { records: digest });
    store.give_up_job(created.id, 0, &given_up, true).await.unwrap();
    store.set_desire(created.id, DesiredState::Pause, "lunch").await.unwrap();
    store.set_priority(created.id, -3).await.unwrap();
    assert_eq!(store.secret(Secret([1; 32])).await.unwrap().0, [1; 32]);
    let store = reopened(store, &dir).await;
    assert_eq!(store.secret(Secret([2; 32])).await.unwrap().0, [1; 32], "it is stored once");
    let (desire, reason) = (DesiredState::Pause, "lunch".to_owned());
    let expected = StoredDictionary { desire, reason, priority: -3, ..created.clone() };
    assert_eq!(store.dictionaries().await.unwrap(), [expected]);
    assert_eq!(
        store.ended_jobs(created.id, &created.grid).await.unwrap(),
        [EndedJob::GivenUp { job: 0, reason: given_up, quarantined: true }, done(1, digest)]
    );
    assert_eq!(all_records(&store, &created).await, records_of);
    let again = store.create_dictionary(name("d"), grid(), 0, "", 8).await;
    assert!(matches!(again, Err(StoreError::NameTaken)));
}

/// A second completion of a job returns the digest of the first and changes nothing.
#[tokio::test]
async fn second_completion_changes_nothing() {
    let (_dir, store, d) = begun().await;
    let digest = Digest::of_records(&records(0, 0.25));
    assert_eq!(complete(&store, &d, 0, 0.25).await, Outcome::Finished { records: digest });
    assert_eq!(complete(&store, &d, 0, 0.25).await, Outcome::Before { records: digest, new: digest });
    let new = Digest::of_records(&records(0, 0.5));
    assert_eq!(complete(&store, &d, 0, 0.5).await, Outcome::Before { records: digest, new });
    store.give_up_job(d.id, 0, "too late", false).await.unwrap();
    assert_eq!(store.ended_jobs(d.id, &d.grid).await.unwrap(), [done(0, digest)]);
    assert_eq!(all_records(&store, &d).await, records(0, 0.25));
}

/// A store as [`begun`], and the number of results of each of its commits.
async fn with_commits() -> ((TempDir, Store, StoredDictionary), Receiver<usize>) {
    let dir = tempfile::tempdir().unwrap();
    let (sender, commits) = std::sync::mpsc::channel();
    let noted = move |commit: Commit| sender.send(commit.results).unwrap();
    let store = Store::open(DataDir::lock(dir.path()).unwrap(), noted).await.unwrap();
    store.register_worker(&Machine::at("instance"), "label").await.unwrap();
    let dictionary = dictionary(&store).await;
    ((dir, store, dictionary), commits)
}

/// A result that cannot be stored does not stop the others.
#[tokio::test]
async fn simultaneous_results_share_one_commit() {
    let ((_dir, store, d), commits) = with_commits().await;
    let nobodys = Completion { worker: Origin(99), ..completion(&d, 1, 0.5) };
    // Polled in turn before the writer runs: all wait when it wakes up.
    let (a, b, c) = tokio::join!(
        store.complete(completion(&d, 0, 0.25)),
        store.complete(nobodys),
        store.complete(completion(&d, 0, 0.25)),
    );
    assert!(matches!(a, Ok(Outcome::Finished { .. })), "{a:?}");
    assert!(b.unwrap_err().to_string().contains("FOREIGN KEY"), "no worker 99 has registered");
    assert!(matches!(c, Ok(Outcome::Before { .. })), "{c:?}");
    assert_eq!(commits.try_iter().collect::<Vec<_>>(), [3]);
}

/// A result of a deleted dictionary is no error, and leaves no records behind that would never be deleted.
#[tokio::test]
async fn result_of_deleted_dictionary_is_ignored() {
    let (_dir, store, d) = begun().await;
    delete(&store, d.id).await;
    assert_eq!(complete(&store, &d, 0, 0.25).await, Outcome::Unwanted);
    let points = store.points_of(&[completion(&d, 0, 0.25).job.identity()]).await.unwrap();
    assert!(points.is_empty(), "its records would never be deleted");
}

/// A dictionary that shares the second point with [`grid`], and has one of its own.
pub(super) async fn overlapping(store: &Store, name: &str, albedo: Vec<f64>) -> StoredDictionary {
    create(store, name, testing::grid(Some(4), &[2.0, 3.0], &albedo, 5000)).await
}

/// Ends the jobs that need no computing; returns their number.
async fn reuse(store: &Store, dictionary: &StoredDictionary) -> usize {
    let jobs = [0, 1].map(|job| (job, JobSpec::of(&dictionary.grid, job as usize).identity()));
    let grids = store.dictionaries().await.unwrap().into_iter().map(|d| (d.id, d.grid)).collect();
    store.ledger().shared().await.reuse(dictionary.id, &dictionary.grid, &jobs, &grids).await.unwrap().len()
}

/// A dictionary that overlaps another one reuses the stored records.
#[tokio::test]
async fn overlapping_dictionary_reuses_records() {
    let (_dir, store, d) = begun().await;
    complete(&store, &d, 0, 0.25).await;
    complete(&store, &d, 1, 0.5).await;
    // sigma_t 2 is shared, 3 is new; the one albedo is stored in the first case, and not in the second.
    let finer = overlapping(&store, "e", vec![0.9]).await;
    assert_eq!(reuse(&store, &finer).await, 1);
    let reused = all_records(&store, &finer).await;
    assert_eq!(reused.len(), 1);
    assert_eq!((reused[0].index, &reused[0].profiles), (0, &records(0, 0.5)[0].profiles));
    assert_eq!(reuse(&store, &overlapping(&store, "f", vec![0.7]).await).await, 0);

    assert_eq!(delete(&store, d.id).await, 2, "those that the other one uses stay");
    assert_eq!(all_records(&store, &finer).await, reused);
    assert_eq!(delete(&store, finer.id).await, 2);
    assert!(store.faults().await.unwrap().is_empty());
}

/// More walks are requested until the noise is below the target.
#[tokio::test]
async fn walks_are_added_until_noise_is_low() {
    let (_dir, store, d) = begun().await;
    // Values 0.25 with errors 0.125: 50 % of noise.
    let quality = |target| Some(Quality::new(target, Walks::new(50_000).unwrap()).unwrap());
    let result = |target| Completion { quality: quality(target), ..completion(&d, 0, 0.25) };
    // (0.5 / 0.25)² · 1.1 = 4.4 times 5000 walks.
    let more = Outcome::MoreWalks(Walks::new(22_000).unwrap());
    assert_eq!(store.complete(result(0.25)).await.unwrap(), more);
    assert!(store.ended_jobs(d.id, &d.grid).await.unwrap().is_empty());
    let most = Outcome::MoreWalks(Walks::new(50_000).unwrap());
    assert_eq!(store.complete(result(0.01)).await.unwrap(), most, "but no more than allowed");
    assert!(matches!(store.complete(result(0.51)).await.unwrap(), Outcome::Finished { .. }));
}

/// Events are kept in order and can be selected by dictionary.
#[tokio::test]
async fn events_are_ordered_by_dictionary() {
    let (_dir, store) = empty().await;
    let event = |dictionary: &str, message: &str| StoredEvent {
        id: 0,
        unix_ms: 5,
        kind: "DONE".to_owned(),
        dictionary: dictionary.to_owned(),
        job: Some(3),
        worker: "w".to_owned(),
        message: message.to_owned(),
        actor: "alice at ::1".to_owned(),
    };
    store.add_events(&[event("a", "1"), event("b", "2"), event("a", "3")]).await.unwrap();
    let messages = |events: Vec<StoredEvent>| events.into_iter().map(|e| e.message).collect::<Vec<_>>();
    assert_eq!(messages(store.events_after(0, "", 10).await.unwrap()), ["1", "2", "3"]);
    assert_eq!(messages(store.events_after(1, "a", 10).await.unwrap()), ["3"]);
    assert_eq!(messages(store.newest_events("", 2).await.unwrap()), ["2", "3"]);
}

/// A data folder has one coordinator at a time.
#[tokio::test]
async fn data_folder_has_one_coordinator() {
    let (dir, store) = empty().await;
    store.dir().publish_address("127.0.0.1:7".parse().unwrap()).unwrap();
    let error = DataDir::lock(dir.path()).unwrap_err().to_string();
    assert!(error.contains("in use by another coordinator (at 127.0.0.1:7)"), "{error}");
}

/// A store whose database has had only the first migrations, with these rows.
async fn migrated(migrations: usize, rows: &'static str) -> (TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("farm.db");
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file).create_if_missing(true);
    let pool = SqlitePool::connect_with(options).await.unwrap();
    let mut past = crate::store::migration::migrator();
    past.migrations.to_mut().truncate(migrations);
    past.run(&pool).await.unwrap();
    sqlx::raw_sql(rows).execute(&pool).await.unwrap();
    pool.close().await;
    let store = open(dir.path()).await;
    assert!(store.faults().await.unwrap().is_empty());
    (dir, store)
}

/// Blocks in the format of the second schema are computed again.
#[tokio::test]
async fn second_schema_blocks_are_recomputed() {
    let rows = "INSERT INTO points VALUES (1, zeroblob(32)); \
                INSERT INTO workers VALUES (1, 'instance', 'label', NULL); \
                INSERT INTO contributions VALUES (1, 1); INSERT INTO sums VALUES (1, 0, x'00')";
    let (_dir, store) = migrated(2, rows).await;
    assert_eq!(count(&store, "sums").await + count(&store, "points").await, 0);
}

/// Votes of the seventh schema become claims, and what was set aside is computed again.
#[tokio::test]
async fn seventh_schema_votes_become_claims() {
    let rows = "DROP TABLE records_of_dictionaries; \
                INSERT INTO dictionaries VALUES (1, 'd', x'', zeroblob(32), 0, 0, 'run', '', ''); \
                INSERT INTO workers (id, identity, label) VALUES (1, 'a', 'a'), (2, 'b', 'b'); \
                INSERT INTO points VALUES (1, zeroblob(32)), (2, randomblob(32)); \
                INSERT INTO records VALUES (1, 1, 0.5, x'00'), (2, 2, 0.5, x'00'); \
                INSERT INTO contributions VALUES (1, 1, 0), (1, 2, 1), (2, 2, 0); \
                INSERT INTO jobs (dictionary_id, job, point_id, walks, records_digest) VALUES (1, 0, 1, 9, zeroblob(32)); \
                INSERT INTO set_aside VALUES (2, zeroblob(32), 2); \
                INSERT INTO jobs_set_aside VALUES (2, 1, 1, 9, zeroblob(32)); \
                INSERT INTO votes VALUES (1, 0, 0, 0, 1, zeroblob(32)), (1, 0, 0, 1, 2, zeroblob(32))";
    let (_dir, store) = migrated(7, rows).await;
    let claims = [1, 2].map(|by| Claim { by: Some(Origin(by)), digest: Digest::from_bytes([0; 32]) });
    let check = OpenCheck { dictionary: DictionaryId(1), job: 0, block: 0, claims: claims.to_vec() };
    assert_eq!(store.open_checks().await.unwrap(), [check]);
    let left = [("points", 1), ("records", 1), ("contributions", 1), ("jobs", 1), ("workers", 2)];
    for (table, rows) in left {
        assert_eq!(count(&store, table).await, rows, "{table}");
    }
}
