use farm_proto::grid::Axes;
use farm_proto::profile::RecordShape;
use farm_proto::scene::{Scene, Sensor};
use farm_proto::{DictionaryName, Digest, Estimate, Grid, Profile, Record, Walks};

use super::{Completion, DataDir, EndedJob, Store, StoreError};

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
    Store::open(DataDir::lock(dir).unwrap()).await.unwrap()
}

#[tokio::test]
async fn what_was_committed_is_there_after_reopening() {
    let dir = tempfile::tempdir().unwrap();
    let name = DictionaryName::new("d").unwrap();
    let store = open(dir.path()).await;
    let created = store.create_dictionary(name.clone(), grid(), 7).await.unwrap();
    let (done, digest) = (records(2, 0.25), Digest::of_records(&records(2, 0.25)));
    assert_eq!(store.complete_job(created.id, 1, digest, &done).await.unwrap(), Completion::Stored);
    store.fail_job(created.id, 0, "no luck").await.unwrap();
    store.close().await;
    drop(store);

    let store = open(dir.path()).await;
    assert_eq!(store.dictionaries().await.unwrap(), std::slice::from_ref(&created));
    assert_eq!(
        store.ended_jobs(created.id).await.unwrap(),
        [
            EndedJob::Failed { job: 0, reason: "no luck".to_owned() },
            EndedJob::Done { job: 1, records: digest }
        ]
    );
    let shape = RecordShape::of(&created.grid);
    assert_eq!(store.records(created.id, 0..4, shape).await.unwrap(), done);
    let again = store.create_dictionary(name, grid(), 8).await;
    assert!(matches!(again, Err(StoreError::NameTaken)));
}

#[tokio::test]
async fn a_second_completion_is_a_duplicate_or_a_conflict_and_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    let d = store.create_dictionary(DictionaryName::new("d").unwrap(), grid(), 7).await.unwrap();
    let (first, other) = (records(0, 0.25), records(0, 0.5));
    let digest = Digest::of_records(&first);
    assert_eq!(store.complete_job(d.id, 0, digest, &first).await.unwrap(), Completion::Stored);
    assert_eq!(store.complete_job(d.id, 0, digest, &first).await.unwrap(), Completion::Duplicate);
    let conflict = store.complete_job(d.id, 0, Digest::of_records(&other), &other).await.unwrap();
    assert_eq!(conflict, Completion::Conflict);
    store.fail_job(d.id, 0, "too late").await.unwrap();
    assert_eq!(store.ended_jobs(d.id).await.unwrap(), [EndedJob::Done { job: 0, records: digest }]);
    assert_eq!(store.records(d.id, 0..4, RecordShape::of(&d.grid)).await.unwrap(), first);
}

#[tokio::test]
async fn a_record_of_the_wrong_size_is_reported_with_table_row_and_column() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    let d = store.create_dictionary(DictionaryName::new("d").unwrap(), grid(), 7).await.unwrap();
    sqlx::query("INSERT INTO records (dictionary_id, record, profiles) VALUES (?, 0, x'00')")
        .bind(d.id.0)
        .execute(&store.write)
        .await
        .unwrap();
    let error = store.records(d.id, 0..1, RecordShape::of(&d.grid)).await.unwrap_err().to_string();
    assert_eq!(error, "table records, row 1, column profiles is corrupt: 1 bytes instead of 96");
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
    let d = store.create_dictionary(DictionaryName::new("d").unwrap(), grid(), 7).await.unwrap();
    sqlx::query("PRAGMA max_page_count = 1").execute(&store.write).await.unwrap();
    let large: Vec<Record> = (0..2)
        .map(|index| {
            let values = vec![0.5; 100_000];
            let radiance_factor = Estimate::new(values.clone(), values).unwrap();
            Record { index, profiles: vec![Profile { radiance_factor, derivatives: None }] }
        })
        .collect();
    let full = store.complete_job(d.id, 0, Digest::of_records(&large), &large).await.unwrap_err();
    assert!(full.to_string().contains("database or disk is full"), "{full}");
    assert!(store.ended_jobs(d.id).await.unwrap().is_empty());
    let records = records(0, 0.25);
    let stored = store.complete_job(d.id, 0, Digest::of_records(&records), &records).await.unwrap();
    assert_eq!(stored, Completion::Stored);
    assert_eq!(store.records(d.id, 0..4, RecordShape::of(&d.grid)).await.unwrap(), records);
}
