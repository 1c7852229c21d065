use farm_proto::grid::Axes;
use farm_proto::job::JobSpec;
use farm_proto::scene::{Scene, Sensor};
use farm_proto::sums::Sums;
use farm_proto::{DictionaryName, Digest, Estimate, Grid, Profile, Quality, Record, Walks};
use prost::Message;

use super::{
    Commit, Completion, Content, DataDir, Desire, EndedJob, Store, StoreError, Stored, StoredDictionary,
    StoredEvent,
};

fn grid() -> Grid {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0, 2.0],
        albedo: vec![0.5, 0.9],
        g: vec![0.0],
        thickness_mm: vec![1.0],
        sample_ior: vec![1.5],
    };
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, 4, 0.0).unwrap());
    Grid::new(scene, axes, Walks::new(5000).unwrap(), 1, false).unwrap()
}

fn records(first: usize, value: f32) -> Vec<Record> {
    let profile = || Profile {
        radiance_factor: Estimate::new(vec![value; 4], vec![0.1; 4]).unwrap(),
        derivatives: None,
    };
    (first..first + 2).map(|index| Record { index, profiles: (0..3).map(|_| profile()).collect() }).collect()
}

async fn open(dir: &std::path::Path) -> Store {
    Store::open(DataDir::lock(dir).unwrap(), |_| {}).await.unwrap()
}

async fn dictionary(store: &Store) -> StoredDictionary {
    store.create_dictionary(DictionaryName::new("d").unwrap(), grid(), 0, 7).await.unwrap()
}

/// A result of a job by worker 1 of the table.
fn completion(dictionary: &StoredDictionary, job: u32, value: f32) -> Completion {
    let spec = JobSpec::of(&dictionary.grid, job as usize);
    let content = Content::Records(records(spec.first_record(), value));
    Completion { dictionary: dictionary.id, job_number: job, job: spec, worker: 1, content, quality: None }
}

async fn complete(store: &Store, dictionary: &StoredDictionary, job: u32, value: f32) -> Stored {
    store.complete(completion(dictionary, job, value)).await.unwrap()
}

async fn all_records(store: &Store, dictionary: &StoredDictionary) -> Vec<Record> {
    let jobs = store.jobs_with_records(dictionary.id, &dictionary.grid, 0..2).await.unwrap();
    assert!(jobs.iter().all(|job| job.damage(2).is_none()));
    jobs.into_iter().flat_map(|job| job.records).collect()
}

fn done(job: u32, records: Digest) -> EndedJob {
    EndedJob::Done { job, walks: Walks::new(5000).unwrap(), records, by: Some(1), reused: false }
}

#[tokio::test]
async fn what_was_committed_is_there_after_reopening() {
    let dir = tempfile::tempdir().unwrap();
    let name = DictionaryName::new("d").unwrap();
    let store = open(dir.path()).await;
    assert_eq!(store.worker("instance", "label").await.unwrap(), 1);
    let created = dictionary(&store).await;
    let records_of = records(2, 0.25);
    let digest = Digest::of_records(&records_of);
    assert_eq!(complete(&store, &created, 1, 0.25).await, Stored::Finished { records: digest });
    store.give_up_job(created.id, 0, "no luck", true).await.unwrap();
    store.set_desire(created.id, Desire::Pause, "lunch").await.unwrap();
    store.set_priority(created.id, -3).await.unwrap();
    store.close().await;
    drop(store);

    let store = open(dir.path()).await;
    let expected = StoredDictionary {
        desire: Desire::Pause,
        reason: "lunch".to_owned(),
        priority: -3,
        ..created.clone()
    };
    assert_eq!(store.dictionaries().await.unwrap(), [expected]);
    assert_eq!(
        store.ended_jobs(created.id, created.grid.walks()).await.unwrap(),
        [EndedJob::GivenUp { job: 0, reason: "no luck".to_owned(), quarantined: true }, done(1, digest)]
    );
    assert_eq!(all_records(&store, &created).await, records_of);
    let again = store.create_dictionary(name, grid(), 0, 8).await;
    assert!(matches!(again, Err(StoreError::NameTaken)));
}

#[tokio::test]
async fn a_second_completion_tells_the_first_and_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("instance", "label").await.unwrap();
    let d = dictionary(&store).await;
    let digest = Digest::of_records(&records(0, 0.25));
    assert_eq!(complete(&store, &d, 0, 0.25).await, Stored::Finished { records: digest });
    assert_eq!(complete(&store, &d, 0, 0.25).await, Stored::Before { records: digest });
    assert_eq!(complete(&store, &d, 0, 0.5).await, Stored::Before { records: digest });
    store.give_up_job(d.id, 0, "too late", false).await.unwrap();
    assert_eq!(store.ended_jobs(d.id, d.grid.walks()).await.unwrap(), [done(0, digest)]);
    assert_eq!(all_records(&store, &d).await, records(0, 0.25));
}

#[tokio::test]
async fn results_that_come_together_are_committed_together_and_a_bad_one_stops_no_other() {
    let dir = tempfile::tempdir().unwrap();
    let (sender, commits) = std::sync::mpsc::channel();
    let store =
        Store::open(DataDir::lock(dir.path()).unwrap(), move |c: Commit| sender.send(c.results).unwrap());
    let store = store.await.unwrap();
    store.worker("instance", "label").await.unwrap();
    let d = dictionary(&store).await;
    let nobodys = Completion { worker: 99, ..completion(&d, 1, 0.5) };
    // Polled in turn before the writer runs: all wait when it wakes up.
    let (a, b, c) = tokio::join!(
        store.complete(completion(&d, 0, 0.25)),
        store.complete(nobodys),
        store.complete(completion(&d, 0, 0.25)),
    );
    assert!(matches!(a, Ok(Stored::Finished { .. })), "{a:?}");
    assert!(b.unwrap_err().to_string().contains("FOREIGN KEY"), "no worker 99 has registered");
    assert!(matches!(c, Ok(Stored::Before { .. })), "{c:?}");
    assert_eq!(commits.try_iter().collect::<Vec<_>>(), [3]);
}

#[tokio::test]
async fn a_result_of_a_deleted_dictionary_is_no_fault_and_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("instance", "label").await.unwrap();
    let d = dictionary(&store).await;
    store.delete_dictionary(d.id).await.unwrap();
    assert_eq!(complete(&store, &d, 0, 0.25).await, Stored::Unwanted);
    let points = store.points_of(&[completion(&d, 0, 0.25).job.identity()]).await.unwrap();
    assert!(points.is_empty(), "nobody would ever delete its records");
}

#[tokio::test]
async fn a_dictionary_that_overlaps_uses_the_records_that_are_there() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("instance", "label").await.unwrap();
    let d = dictionary(&store).await;
    complete(&store, &d, 0, 0.25).await;
    complete(&store, &d, 1, 0.5).await;
    // sigma_t 2 is shared, 3 is new; of the albedos one is asked for, or one that is not there.
    let other = |albedo: f64| {
        let axes = Axes {
            sigma_t_per_mm: vec![2.0, 3.0],
            albedo: vec![albedo],
            g: vec![0.0],
            thickness_mm: vec![1.0],
            sample_ior: vec![1.5],
        };
        Grid::new(grid().scene().clone(), axes, Walks::new(5000).unwrap(), 1, false).unwrap()
    };
    let identities = |grid: &Grid| (0..2).map(|job| JobSpec::of(grid, job).identity()).collect::<Vec<_>>();
    let finer = store.create_dictionary(DictionaryName::new("e").unwrap(), other(0.9), 0, 8).await.unwrap();
    assert_eq!(store.reuse(finer.id, &finer.grid, &identities(&finer.grid)).await.unwrap(), 1);
    let reused = all_records_of(&store, &finer).await;
    assert_eq!(reused.len(), 1);
    assert_eq!((reused[0].index, &reused[0].profiles), (0, &records(0, 0.5)[0].profiles));
    let missing = store.create_dictionary(DictionaryName::new("f").unwrap(), other(0.7), 0, 9).await.unwrap();
    assert_eq!(store.reuse(missing.id, &missing.grid, &identities(&missing.grid)).await.unwrap(), 0);

    assert_eq!(store.delete_dictionary(d.id).await.unwrap(), 2, "those that the other one uses stay");
    assert_eq!(all_records_of(&store, &finer).await, reused);
    assert_eq!(store.delete_dictionary(finer.id).await.unwrap(), 2);
    assert!(store.faults().await.unwrap().is_empty());
}

async fn all_records_of(store: &Store, dictionary: &StoredDictionary) -> Vec<Record> {
    let jobs = store.jobs_with_records(dictionary.id, &dictionary.grid, 0..2).await.unwrap();
    jobs.into_iter().flat_map(|job| job.records).collect()
}

#[tokio::test]
async fn a_fenced_workers_records_are_forgotten_and_no_others() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("good", "label").await.unwrap();
    let bad = store.worker("bad", "label").await.unwrap();
    assert_eq!(store.worker("bad", "renamed").await.unwrap(), bad, "one row a process");
    let d = dictionary(&store).await;
    complete(&store, &d, 0, 0.25).await;
    store.complete(Completion { worker: bad, ..completion(&d, 1, 0.5) }).await.unwrap();
    assert_eq!(store.fence(bad, "wrong").await.unwrap(), [(d.id, 1)]);
    assert_eq!(store.fenced().await.unwrap(), [(bad, "wrong".to_owned())]);
    assert_eq!(all_records(&store, &d).await, records(0, 0.25));
    assert!(matches!(complete(&store, &d, 1, 0.25).await, Stored::Finished { .. }), "it can be done again");
}

/// Sums that stand for a block: numbers with rounding errors, so that the order of additions shows.
fn block_sums(job: &JobSpec, block: u32) -> Sums {
    let mut sums = Sums::new(job);
    for (i, sum) in sums.sums.iter_mut().enumerate() {
        *sum = 1.0 / (3.0 + i as f64 + 7.0 * f64::from(block));
    }
    for (i, square) in sums.squares.iter_mut().enumerate() {
        *square = 1.0 / (0.3 + i as f64 * f64::from(block + 1));
    }
    Sums::from_le_bytes(job, job.walks().batches_of_block(block), &sums.to_le_bytes()).unwrap()
}

#[tokio::test]
async fn blocks_that_come_in_any_order_make_the_records_of_the_undivided_job() {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0],
        albedo: vec![0.5, 0.9],
        g: vec![0.0],
        thickness_mm: vec![1.0],
        sample_ior: vec![1.5],
    };
    let large = Grid::new(grid().scene().clone(), axes, Walks::new(4_500_000).unwrap(), 1, false).unwrap();
    let whole = JobSpec::of(&large, 0);
    let mut total = Sums::new(&whole);
    (0..5).for_each(|block| total.merge(&block_sums(&whole, block)));
    let expected = Digest::of_records(&total.into_records(&whole));
    for (i, order) in [[0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [2, 0, 4, 1, 3]].into_iter().enumerate() {
        let dir = tempfile::tempdir().unwrap();
        let mut store = open(dir.path()).await;
        store.worker("instance", "label").await.unwrap();
        let name = DictionaryName::new("d").unwrap();
        let d = store.create_dictionary(name, large.clone(), 0, 7).await.unwrap();
        for (n, block) in order.into_iter().enumerate() {
            if n == 3 {
                store.close().await;
                drop(store);
                store = open(dir.path()).await;
                let there = order[..3].iter().copied().collect();
                assert_eq!(store.stored_blocks(&whole).await.unwrap(), there, "after a restart");
            }
            let job = whole.clone().with_block(block).unwrap();
            let content = Content::Sums(block_sums(&job, block).to_le_bytes());
            let completion =
                Completion { dictionary: d.id, job_number: 0, job, worker: 1, content, quality: None };
            let stored = store.complete(completion).await.unwrap();
            let last = if n == 4 { Stored::Finished { records: expected } } else { Stored::Part };
            assert_eq!(stored, last, "order {i}, block {block}");
        }
        assert!(store.stored_blocks(&whole).await.unwrap().is_empty(), "sums are gone");
    }
}

/// A dictionary of one job of two blocks, with these albedos.
async fn divided(store: &Store, name: &str, albedo: Vec<f64>) -> (StoredDictionary, JobSpec) {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0],
        albedo,
        g: vec![0.0],
        thickness_mm: vec![1.0],
        sample_ior: vec![1.5],
    };
    let grid = Grid::new(grid().scene().clone(), axes, Walks::new(2_000_000).unwrap(), 1, false).unwrap();
    let job = JobSpec::of(&grid, 0);
    (store.create_dictionary(DictionaryName::new(name).unwrap(), grid, 0, 7).await.unwrap(), job)
}

async fn complete_block(
    store: &Store,
    (dictionary, job): &(StoredDictionary, JobSpec),
    block: u32,
    worker: i64,
) -> Stored {
    let job = job.clone().with_block(block).unwrap();
    let content = Content::Sums(block_sums(&job, block).to_le_bytes());
    let completion =
        Completion { dictionary: dictionary.id, job_number: 0, job, worker, content, quality: None };
    store.complete(completion).await.unwrap()
}

#[tokio::test]
async fn blocks_of_the_same_walks_with_other_albedos_are_not_mixed() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("instance", "label").await.unwrap();
    let (a, b) = (divided(&store, "a", vec![0.5]).await, divided(&store, "b", vec![0.9]).await);
    assert_eq!(complete_block(&store, &a, 0, 1).await, Stored::Part);
    assert!(store.stored_blocks(&b.1).await.unwrap().is_empty());
    assert_eq!(complete_block(&store, &b, 1, 1).await, Stored::Part);
    assert!(matches!(complete_block(&store, &a, 1, 1).await, Stored::Finished { .. }));
    assert_eq!(store.stored_blocks(&b.1).await.unwrap(), [1].into());
    assert!(matches!(complete_block(&store, &b, 0, 1).await, Stored::Finished { .. }));
}

#[tokio::test]
async fn a_late_block_of_a_job_that_is_done_is_not_compared_with_its_records() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("instance", "label").await.unwrap();
    let d = divided(&store, "d", vec![0.5]).await;
    complete_block(&store, &d, 0, 1).await;
    assert!(matches!(complete_block(&store, &d, 1, 1).await, Stored::Finished { .. }));
    assert_eq!(complete_block(&store, &d, 1, 1).await, Stored::Unwanted);
}

#[tokio::test]
async fn what_a_fenced_worker_sent_before_is_not_stored_after() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("good", "label").await.unwrap();
    let bad = store.worker("bad", "label").await.unwrap();
    let d = divided(&store, "divided", vec![0.5]).await;
    assert_eq!(complete_block(&store, &d, 0, bad).await, Stored::Part);
    assert_eq!(store.fence(bad, "wrong").await.unwrap(), []);
    assert!(store.stored_blocks(&d.1).await.unwrap().is_empty(), "its blocks are gone");
    assert_eq!(complete_block(&store, &d, 0, bad).await, Stored::Unwanted);
    complete_block(&store, &d, 0, 1).await;
    assert!(matches!(complete_block(&store, &d, 1, 1).await, Stored::Finished { .. }));
    let other = dictionary(&store).await;
    let late = Completion { worker: bad, ..completion(&other, 1, 0.5) };
    assert_eq!(store.complete(late).await.unwrap(), Stored::Unwanted);
}

#[tokio::test]
async fn whoever_computed_a_block_is_fenced_off_with_the_whole_job() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("good", "label").await.unwrap();
    let bad = store.worker("bad", "label").await.unwrap();
    let d = divided(&store, "divided", vec![0.5]).await;
    complete_block(&store, &d, 0, bad).await;
    assert!(matches!(complete_block(&store, &d, 1, 1).await, Stored::Finished { .. }));
    assert_eq!(store.fence(bad, "wrong").await.unwrap(), [(d.0.id, 0)]);
}

#[tokio::test]
async fn more_walks_are_asked_for_until_the_noise_is_low_enough() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("instance", "label").await.unwrap();
    let d = dictionary(&store).await;
    // Values 0.25 with errors 0.1: 40 % of noise.
    let quality = |target| Some(Quality::new(target, Walks::new(50_000).unwrap()).unwrap());
    let result = |target| Completion { quality: quality(target), ..completion(&d, 0, 0.25) };
    // (0.4 / 0.2)² · 1.1 = 4.4 times 5000 walks, rounded up to batches.
    let more = Stored::MoreWalks(Walks::new(22_500).unwrap());
    assert_eq!(store.complete(result(0.2)).await.unwrap(), more);
    assert!(store.ended_jobs(d.id, d.grid.walks()).await.unwrap().is_empty());
    let most = Stored::MoreWalks(Walks::new(50_000).unwrap());
    assert_eq!(store.complete(result(0.01)).await.unwrap(), most, "but no more than allowed");
    assert!(matches!(store.complete(result(0.41)).await.unwrap(), Stored::Finished { .. }));
}

#[tokio::test]
async fn events_are_kept_in_order_and_found_by_dictionary() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    let event = |dictionary: &str, message: &str| StoredEvent {
        id: 0,
        unix_ms: 5,
        kind: "DONE".to_owned(),
        dictionary: dictionary.to_owned(),
        job: Some(3),
        worker: "w".to_owned(),
        message: message.to_owned(),
    };
    store.add_events(&[event("a", "1"), event("b", "2"), event("a", "3")]).await.unwrap();
    let messages = |events: Vec<StoredEvent>| events.into_iter().map(|e| e.message).collect::<Vec<_>>();
    assert_eq!(messages(store.events_after(0, "", 10).await.unwrap()), ["1", "2", "3"]);
    assert_eq!(messages(store.events_after(1, "a", 10).await.unwrap()), ["3"]);
    assert_eq!(messages(store.newest_events("", 2).await.unwrap()), ["2", "3"]);
}

#[tokio::test]
async fn a_record_that_is_not_what_was_stored_is_noticed() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("instance", "label").await.unwrap();
    let d = dictionary(&store).await;
    complete(&store, &d, 0, 0.25).await;
    let read = async || store.jobs_with_records(d.id, &d.grid, 0..2).await;
    let flip = "UPDATE records SET profiles = cast(x'0000803f' || substr(profiles, 5) AS BLOB) WHERE id = 1";
    sqlx::query(flip).execute(&store.write).await.unwrap();
    let damage = read().await.unwrap()[0].damage(2).expect("one number is another");
    assert!(damage.contains("differ"), "{damage}");
    sqlx::query("UPDATE records SET profiles = x'00' WHERE id = 1").execute(&store.write).await.unwrap();
    let error = read().await.unwrap_err().to_string();
    assert_eq!(error, "table records, row 1, column profiles is corrupt: 1 bytes instead of 96");
    assert_eq!(store.forget_job(d.id, 0).await.unwrap(), [(d.id, 0)]);
    assert!(matches!(complete(&store, &d, 0, 0.25).await, Stored::Finished { .. }), "it can be done again");
}

#[tokio::test]
async fn a_data_directory_has_one_coordinator_at_a_time() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.dir().publish_address("127.0.0.1:7".parse().unwrap()).unwrap();
    let error = DataDir::lock(dir.path()).unwrap_err().to_string();
    assert!(error.contains("in use by another coordinator (at 127.0.0.1:7)"), "{error}");
}

/// A full disk, played by SQLite's own limit: the error tells it, nothing of the job is stored, and once there is room
/// the same store works on.
#[tokio::test]
async fn after_a_full_disk_the_store_works_on() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.worker("instance", "label").await.unwrap();
    let d = dictionary(&store).await;
    sqlx::query("PRAGMA max_page_count = 1").execute(&store.write).await.unwrap();
    let large: Vec<Record> = (0..2)
        .map(|index| {
            let values = vec![0.5; 100_000];
            let radiance_factor = Estimate::new(values.clone(), values).unwrap();
            Record { index, profiles: vec![Profile { radiance_factor, derivatives: None }] }
        })
        .collect();
    let too_large = Completion { content: Content::Records(large), ..completion(&d, 0, 0.25) };
    let full = store.complete(too_large).await.unwrap_err();
    assert!(full.to_string().contains("database or disk is full"), "{full}");
    assert!(store.ended_jobs(d.id, d.grid.walks()).await.unwrap().is_empty());
    assert!(matches!(complete(&store, &d, 0, 0.25).await, Stored::Finished { .. }));
    assert_eq!(all_records(&store, &d).await, records(0, 0.25));
}

/// A database as the first version of this program left it.
#[tokio::test]
async fn a_database_of_the_first_schema_keeps_its_records() {
    let dir = tempfile::tempdir().unwrap();
    {
        let options = sqlx::sqlite::SqliteConnectOptions::new()
            .filename(dir.path().join("farm.db"))
            .create_if_missing(true);
        let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
        let mut first = sqlx::migrate!();
        first.migrations.to_mut().truncate(1);
        first.run(&pool).await.unwrap();
        sqlx::query("INSERT INTO dictionaries VALUES (1, 'd', ?, ?, 7)")
            .bind(farm_proto::wire::Grid::from(&grid()).encode_to_vec())
            .bind(vec![3_u8; 32])
            .execute(&pool)
            .await
            .unwrap();
        for record in records(2, 0.25) {
            sqlx::query("INSERT INTO records (dictionary_id, record, profiles) VALUES (1, ?, ?)")
                .bind(record.index as i64)
                .bind(super::codec::encode(&record))
                .execute(&pool)
                .await
                .unwrap();
        }
        sqlx::query("INSERT INTO jobs VALUES (1, 0, NULL, 'no luck'), (1, 1, ?, NULL)")
            .bind(&Digest::of_records(&records(2, 0.25)).as_bytes()[..])
            .execute(&pool)
            .await
            .unwrap();
        pool.close().await;
    }
    for _ in 0..2 {
        let store = open(dir.path()).await;
        let d = store.dictionaries().await.unwrap().remove(0);
        assert_eq!(all_records(&store, &d).await, records(2, 0.25));
        assert_eq!(store.ended_jobs(d.id, d.grid.walks()).await.unwrap().len(), 2);
        store.close().await;
    }
}
