//! Tests jobs that are divided into blocks.

use farm_proto::DictionaryName;
use optics_model::grid::Axes;
use optics_model::job::JobSpec;
use optics_model::sums::Sums;
use optics_model::{Digest, Grid, Walks};

use super::{completion, dictionary, grid, open};
use crate::store::{Store, StoreError};
use crate::stored::{Completion, JobResult, Machine, Origin, Outcome, StoredDictionary};

/// Sums that stand for a block: numbers with rounding errors, so that the order of additions shows.
fn block_sums(job: &JobSpec, block: u32) -> Sums {
    let mut sums = Sums::new(job);
    for (i, sum) in sums.sums.iter_mut().enumerate() {
        *sum = 1.0 / (3.0 + i as f64 + 7.0 * f64::from(block));
    }
    for (i, square) in sums.deviations.iter_mut().enumerate() {
        *square = 1.0 / (0.3 + i as f64 * f64::from(block + 1));
    }
    Sums::from_le_bytes(job, job.walks().batches_of_block(block), &sums.to_le_bytes()).unwrap()
}

/// The blocks sum to the same bytes in any order, also with a restart in between.
#[tokio::test]
async fn blocks_sum_to_the_undivided_job() {
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
        store.register_worker(&Machine::at("instance"), "label").await.unwrap();
        let name = DictionaryName::new("d").unwrap();
        let d = store.create_dictionary(name, large.clone(), 0, "", 7).await.unwrap();
        for (n, block) in order.into_iter().enumerate() {
            if n == 3 {
                store.close().await;
                drop(store);
                store = open(dir.path()).await;
                let there = order[..3].iter().copied().collect();
                assert_eq!(store.stored_blocks(&whole).await.unwrap(), there, "after a restart");
            }
            let job = whole.clone().with_block(block).unwrap();
            let content = JobResult::Sums(block_sums(&job, block).to_le_bytes().into());
            let completion = Completion {
                dictionary: d.id,
                job_number: 0,
                job,
                worker: Origin(1),
                content,
                quality: None,
            };
            let stored = store.complete(completion).await.unwrap();
            let last = if n == 4 { Outcome::Finished { records: expected } } else { Outcome::Part };
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
    (store.create_dictionary(DictionaryName::new(name).unwrap(), grid, 0, "", 7).await.unwrap(), job)
}

async fn complete_block(
    store: &Store,
    (dictionary, job): &(StoredDictionary, JobSpec),
    block: u32,
    worker: Origin,
) -> Outcome {
    complete_with(store, dictionary, job, block, worker, &block_sums(job, block)).await
}

async fn complete_with(
    store: &Store,
    dictionary: &StoredDictionary,
    job: &JobSpec,
    block: u32,
    worker: Origin,
    sums: &Sums,
) -> Outcome {
    let job = job.clone().with_block(block).unwrap();
    let content = JobResult::Sums(sums.to_le_bytes().into());
    let completion =
        Completion { dictionary: dictionary.id, job_number: 0, job, worker, content, quality: None };
    store.complete(completion).await.unwrap()
}

/// The first of two copies of a block stays: it may be the subject of a check.
#[tokio::test]
async fn first_of_two_block_copies_stays() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.register_worker(&Machine::at("instance"), "label").await.unwrap();
    let d = divided(&store, "d", vec![0.5]).await;
    let (first, other) = (block_sums(&d.1, 0), block_sums(&d.1, 1));
    complete_block(&store, &d, 1, Origin(1)).await;
    assert_eq!(complete_with(&store, &d.0, &d.1, 1, Origin(1), &first).await, Outcome::Part);
    let mut total = Sums::new(&d.1);
    total.merge(&first);
    total.merge(&other);
    let records = Digest::of_records(&total.into_records(&d.1));
    assert_eq!(complete_block(&store, &d, 0, Origin(1)).await, Outcome::Finished { records });
}

/// Blocks with the same walks but other albedos are not mixed.
#[tokio::test]
async fn blocks_of_other_albedos_are_not_mixed() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.register_worker(&Machine::at("instance"), "label").await.unwrap();
    let (a, b) = (divided(&store, "a", vec![0.5]).await, divided(&store, "b", vec![0.9]).await);
    assert_eq!(complete_block(&store, &a, 0, Origin(1)).await, Outcome::Part);
    assert!(store.stored_blocks(&b.1).await.unwrap().is_empty());
    assert_eq!(complete_block(&store, &b, 1, Origin(1)).await, Outcome::Part);
    assert!(matches!(complete_block(&store, &a, 1, Origin(1)).await, Outcome::Finished { .. }));
    assert_eq!(store.stored_blocks(&b.1).await.unwrap(), [1].into());
    assert!(matches!(complete_block(&store, &b, 0, Origin(1)).await, Outcome::Finished { .. }));
}

/// A late block of a finished job is not needed: its records are of all blocks, so there is nothing to compare it with.
#[tokio::test]
async fn late_block_of_finished_job_is_unwanted() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.register_worker(&Machine::at("instance"), "label").await.unwrap();
    let d = divided(&store, "d", vec![0.5]).await;
    complete_block(&store, &d, 0, Origin(1)).await;
    assert!(matches!(complete_block(&store, &d, 1, Origin(1)).await, Outcome::Finished { .. }));
    assert_eq!(complete_block(&store, &d, 1, Origin(1)).await, Outcome::Unwanted);
}

/// A block that a worker sent before it was fenced is not stored afterwards.
#[tokio::test]
async fn fenced_blocks_are_not_stored_later() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.register_worker(&Machine::at("good"), "label").await.unwrap();
    let bad = store.register_worker(&Machine::at("bad"), "label").await.unwrap();
    let d = divided(&store, "divided", vec![0.5]).await;
    assert_eq!(complete_block(&store, &d, 0, bad).await, Outcome::Part);
    assert_eq!(store.ledger().exclusive().await.fence(bad, "wrong").await.unwrap(), []);
    assert!(store.stored_blocks(&d.1).await.unwrap().is_empty(), "its blocks are gone");
    assert_eq!(complete_block(&store, &d, 0, bad).await, Outcome::Unwanted);
    complete_block(&store, &d, 0, Origin(1)).await;
    assert!(matches!(complete_block(&store, &d, 1, Origin(1)).await, Outcome::Finished { .. }));
    let other = dictionary(&store).await;
    let late = Completion { worker: bad, ..completion(&other, 1, 0.5) };
    assert_eq!(store.complete(late).await.unwrap(), Outcome::Unwanted);
}

/// A fence on the author of one block sets aside the whole job.
#[tokio::test]
async fn fence_of_a_block_covers_the_job() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.register_worker(&Machine::at("good"), "label").await.unwrap();
    let bad = store.register_worker(&Machine::at("bad"), "label").await.unwrap();
    let d = divided(&store, "divided", vec![0.5]).await;
    complete_block(&store, &d, 0, bad).await;
    assert!(matches!(complete_block(&store, &d, 1, Origin(1)).await, Outcome::Finished { .. }));
    assert_eq!(store.ledger().exclusive().await.fence(bad, "wrong").await.unwrap(), [(d.0.id, 0)]);
}

/// Deleting a dictionary deletes its blocks and no others.
#[tokio::test]
async fn deletion_removes_only_its_own_blocks() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.register_worker(&Machine::at("instance"), "label").await.unwrap();
    let (a, b) = (divided(&store, "a", vec![0.5]).await, divided(&store, "b", vec![0.9]).await);
    complete_block(&store, &a, 0, Origin(1)).await;
    complete_block(&store, &b, 1, Origin(1)).await;
    store.ledger().exclusive().await.delete_dictionary(a.0.id, &[a.1.sums_identity()]).await.unwrap();
    let rows: Vec<(i64,)> = sqlx::query_as("SELECT block FROM sums").fetch_all(&store.read).await.unwrap();
    assert_eq!(rows, [(1,)]);
    assert_eq!(store.stored_blocks(&b.1).await.unwrap(), [1].into());
    assert!(store.faults().await.unwrap().is_empty());
}

/// A damaged block is found before it is merged.
#[tokio::test]
async fn damaged_block_is_found_before_merging() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    store.register_worker(&Machine::at("instance"), "label").await.unwrap();
    let d = divided(&store, "d", vec![0.5]).await;
    for (first, second) in [(0, 1), (1, 0)] {
        assert_eq!(complete_block(&store, &d, first, Origin(1)).await, Outcome::Part);
        assert_eq!(store.damaged_blocks(&d.1).await.unwrap(), None);
        let flip = "UPDATE sums SET sums = cast(x'01' || substr(sums, 2) AS BLOB)";
        sqlx::query(flip).execute(&store.write).await.unwrap();
        let job = d.1.clone().with_block(second).unwrap();
        let content = JobResult::Sums(block_sums(&job, second).to_le_bytes().into());
        let last =
            Completion { dictionary: d.0.id, job_number: 0, job, worker: Origin(1), content, quality: None };
        let error = store.complete(last).await.unwrap_err();
        assert!(matches!(error, StoreError::Corrupt { table: "sums", .. }), "{error}");
        assert_eq!(store.damaged_blocks(&d.1).await.unwrap(), Some(error.to_string()));
        assert_eq!(store.ledger().exclusive().await.delete_point(d.1.sums_identity()).await.unwrap(), []);
        assert!(store.stored_blocks(&d.1).await.unwrap().is_empty(), "all can be computed again");
    }
}

/// Sums with a flipped bit in an exponent are refused: they are finite as 64-bit floats, but not as the 32-bit floats of
/// a record.
#[tokio::test]
async fn sums_beyond_record_range_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path()).await;
    let (_, job) = divided(&store, "d", vec![0.5]).await;
    let mut bytes = block_sums(&job, 0).to_le_bytes();
    assert!(Sums::from_le_bytes(&job, 1, &bytes).is_ok());
    for wrong in [5e307, -5e307, f64::NAN, f64::INFINITY] {
        bytes[16..24].copy_from_slice(&wrong.to_le_bytes());
        let error = Sums::from_le_bytes(&job, 1, &bytes).unwrap_err().to_string();
        assert!(error.contains("sums[2]") && error.contains("at most 1e30"), "{error}");
    }
}
