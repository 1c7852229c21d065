//! Tests disks that return other bytes than were written or are full, and databases that are held by others or lost.

use optics_model::scene::{Scene, Sensor};

use super::*;

/// A full disk, simulated by SQLite's own limit: the error reports it, nothing of the job is stored, and once there is
/// room the same store works on.
#[tokio::test]
async fn store_recovers_from_a_full_disk() {
    let (_dir, store, d) = begun().await;
    run(&store, "PRAGMA max_page_count = 1").await;
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, 4096, 0.0).unwrap());
    let small = completion(&d, 0, 0.25);
    let (point, albedo, walks) = (small.job.point(), small.job.albedo().to_vec(), small.job.walks());
    let job = JobSpec::new(scene, point, albedo, walks, 1, false).unwrap();
    let zeros = vec![0; PackedRecords::bytes_of(&job)];
    let content = JobResult::Records(PackedRecords::new(&job, zeros.into()).unwrap());
    let too_large = Completion { job, content, ..small };
    let full = store.complete(too_large).await.unwrap_err();
    assert!(full.to_string().contains("database or disk is full"), "{full}");
    assert!(store.ended_jobs(d.id, &d.grid).await.unwrap().is_empty());
    assert!(matches!(complete(&store, &d, 0, 0.25).await, Outcome::Finished { .. }));
    assert_eq!(all_records(&store, &d).await, records(0, 0.25));
}

/// Damaged records are not used for another dictionary.
#[tokio::test]
async fn damaged_records_are_not_reused() {
    let (_dir, store, d) = begun().await;
    complete(&store, &d, 1, 0.5).await;
    run(
        &store,
        "UPDATE records SET profiles = cast(x'0000803f' || substr(profiles, 5) AS BLOB) WHERE albedo = 0.5",
    )
    .await;
    // The digest of the undamaged record is the whole job's.
    for (name, albedo) in [("e", 0.5), ("f", 0.9)] {
        assert_eq!(reuse(&store, &overlapping(&store, name, vec![albedo]).await).await, 0, "{albedo}");
    }
}

/// Two dictionaries may compute the same walks at once: the later records are compared, and both jobs can be done again.
#[tokio::test]
async fn conflicting_records_for_shared_walks_are_refused() {
    let (_dir, store) = with_worker().await;
    let (d, e) = (dictionary(&store).await, overlapping(&store, "e", vec![0.9, 0.95]).await);
    let result = |value| {
        let job = JobSpec::of(&e.grid, 0);
        let content = JobResult::Records(PackedRecords::pack(&job, &records(0, value)));
        Completion { dictionary: e.id, job_number: 0, job, worker: Origin(1), content, quality: None }
    };
    // In one transaction, and in two.
    for together in [true, false] {
        let (first, second) = if together {
            let first = store.complete(completion(&d, 1, 0.25));
            tokio::join!(first, store.complete(result(0.5)))
        } else {
            (store.complete(completion(&d, 1, 0.25)).await, store.complete(result(0.5)).await)
        };
        assert!(matches!(first, Ok(Outcome::Finished { .. })), "{first:?}");
        assert_eq!(second.unwrap(), Outcome::Differs);
        assert!(store.ended_jobs(e.id, &e.grid).await.unwrap().is_empty());
        let point = completion(&d, 1, 0.25).job.identity();
        assert_eq!(store.ledger().exclusive().await.delete_point(point).await.unwrap(), [(d.id, 1)]);
    }
    let (first, second) = tokio::join!(store.complete(completion(&d, 1, 0.25)), store.complete(result(0.25)));
    assert!(matches!((first, second), (Ok(Outcome::Finished { .. }), Ok(Outcome::Finished { .. }))));
    assert_eq!(all_records(&store, &e).await, records(0, 0.25));
    assert_eq!(count(&store, "records").await, 3, "each record once");
}

/// A process that holds the database makes results wait once, not one after the other.
#[tokio::test]
async fn held_database_fails_all_results_at_once() {
    let ((dir, store, d), commits) = with_commits().await;
    run(&store, "PRAGMA busy_timeout = 200").await;
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(dir.path().join("farm.db"));
    let other = sqlx::SqlitePool::connect_with(options).await.unwrap();
    let held = other.begin_with("BEGIN IMMEDIATE").await.unwrap();
    let results = tokio::join!(
        store.complete(completion(&d, 0, 0.25)),
        store.complete(completion(&d, 1, 0.25)),
        store.complete(completion(&d, 1, 0.25)),
    );
    for result in [results.0, results.1, results.2] {
        let error = result.unwrap_err();
        assert!(matches!(error, StoreError::Together(_)), "{error:?}");
        assert!(error.to_string().contains("database is locked"), "{error}");
    }
    assert_eq!(commits.try_iter().count(), 1);
    held.rollback().await.unwrap();
    assert!(matches!(complete(&store, &d, 0, 0.25).await, Outcome::Finished { .. }));
}

/// A defect, simulated by a panic before a commit: only the result that causes it fails, and the writer continues.
#[tokio::test]
async fn panic_while_writing_leaves_nothing() {
    let (_dir, store, d) = begun().await;
    let bad = Completion { quality: Some(defect()), ..completion(&d, 0, 0.25) };
    let (bad, good) = tokio::join!(store.complete(bad), store.complete(completion(&d, 1, 0.5)));
    assert!(matches!(bad, Err(StoreError::Defect)), "{bad:?}");
    assert!(matches!(good, Ok(Outcome::Finished { .. })), "{good:?}");
    assert_eq!(all_records(&store, &d).await, records(2, 0.5));
    assert!(matches!(complete(&store, &d, 0, 0.25).await, Outcome::Finished { .. }));
}

/// Once the database file was moved or deleted, no result is acknowledged.
#[tokio::test]
async fn lost_database_acknowledges_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let [data, away] = ["data", "away"].map(|name| folder.path().join(name));
    let store = open(&data).await;
    store.register_worker(&Machine::at("instance"), "label").await.unwrap();
    let dictionary = dictionary(&store).await;
    store.complete(completion(&dictionary, 0, 0.5)).await.unwrap();
    std::fs::rename(&data, &away).unwrap();
    let error = store.complete(completion(&dictionary, 1, 0.5)).await.unwrap_err().to_string();
    assert!(error.contains("deleted, moved or replaced"), "{error}");
    let error = store.set_priority(dictionary.id, 3).await.unwrap_err();
    assert!(matches!(error, StoreError::Lost { .. }), "{error}");
    std::fs::rename(&away, &data).unwrap();
    store.complete(completion(&dictionary, 1, 0.5)).await.unwrap();
}
