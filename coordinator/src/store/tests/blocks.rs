//! Tests jobs that are divided into blocks.

use optics_model::sums::Sums;

use super::*;
use crate::testing::grid;

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

/// A dictionary of one divided job, with these albedos.
async fn divided(store: &Store, name: &str, albedo: &[f64], walks: u64) -> (StoredDictionary, JobSpec) {
    let grid = grid(Some(4), &[1.0], albedo, walks);
    let job = JobSpec::of(&grid, 0);
    (create(store, name, grid).await, job)
}

/// A store with a dictionary of one job of two blocks.
async fn two_blocks() -> (TempDir, Store, (StoredDictionary, JobSpec)) {
    let (dir, store) = with_worker().await;
    let d = divided(&store, "d", &[0.5], 2_000_000).await;
    (dir, store, d)
}

type Divided = (StoredDictionary, JobSpec);

fn block_of((dictionary, job): &Divided, block: u32, worker: Origin, sums: &Sums) -> Completion {
    let (dictionary, job) = (dictionary.id, job.clone().with_block(block).unwrap());
    let content = JobResult::Sums(sums.to_le_bytes().into());
    Completion { dictionary, job_number: 0, job, worker, content, quality: None }
}

async fn complete_block(store: &Store, d: &Divided, block: u32, worker: Origin) -> Outcome {
    store.complete(block_of(d, block, worker, &block_sums(&d.1, block))).await.unwrap()
}

fn total(job: &JobSpec, blocks: impl IntoIterator<Item = u32>) -> Digest {
    let mut total = Sums::new(job);
    blocks.into_iter().for_each(|block| total.merge(&block_sums(job, block)));
    Digest::of_records(&total.into_records(job))
}

/// The blocks sum to the same bytes in any order, also with a restart in between.
#[tokio::test]
async fn blocks_sum_to_the_undivided_job() {
    for order in [[0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [2, 0, 4, 1, 3]] {
        let (dir, mut store) = with_worker().await;
        let d = divided(&store, "d", &[0.5, 0.9], 4_500_000).await;
        let records = total(&d.1, 0..5);
        for (n, block) in order.into_iter().enumerate() {
            if n == 3 {
                store = reopened(store, &dir).await;
                let there = order[..3].iter().copied().collect();
                assert_eq!(store.stored_blocks(&d.1).await.unwrap(), there, "after a restart");
            }
            let last = if n == 4 { Outcome::Finished { records } } else { Outcome::Part };
            assert_eq!(complete_block(&store, &d, block, Origin(1)).await, last, "{order:?}, block {block}");
        }
        assert!(store.stored_blocks(&d.1).await.unwrap().is_empty(), "sums are gone");
    }
}

/// The first of two copies of a block stays: it may be the subject of a check. A late block of a finished job is not
/// needed: its records are of all blocks, so there is nothing to compare it with.
#[tokio::test]
async fn first_of_two_block_copies_stays() {
    let (_dir, store, d) = two_blocks().await;
    complete_block(&store, &d, 1, Origin(1)).await;
    let copy = block_of(&d, 1, Origin(1), &block_sums(&d.1, 0));
    assert_eq!(store.complete(copy).await.unwrap(), Outcome::Part);
    let records = total(&d.1, [0, 1]);
    assert_eq!(complete_block(&store, &d, 0, Origin(1)).await, Outcome::Finished { records });
    assert_eq!(complete_block(&store, &d, 1, Origin(1)).await, Outcome::Unwanted);
}

/// Blocks with the same walks but other albedos are not mixed, and deleting a dictionary deletes no others' blocks.
#[tokio::test]
async fn blocks_of_other_albedos_are_not_mixed() {
    for deleted in [false, true] {
        let (_dir, store, a) = two_blocks().await;
        let b = divided(&store, "b", &[0.9], 2_000_000).await;
        assert_eq!(complete_block(&store, &a, 0, Origin(1)).await, Outcome::Part);
        assert!(store.stored_blocks(&b.1).await.unwrap().is_empty());
        assert_eq!(complete_block(&store, &b, 1, Origin(1)).await, Outcome::Part);
        if deleted {
            let ledger = store.ledger().exclusive().await;
            ledger.delete_dictionary(a.0.id, &[a.1.sums_identity()]).await.unwrap();
        } else {
            assert!(matches!(complete_block(&store, &a, 1, Origin(1)).await, Outcome::Finished { .. }));
        }
        assert_eq!(store.stored_blocks(&b.1).await.unwrap(), [1].into());
        assert_eq!(count(&store, "sums").await, 1);
        assert!(matches!(complete_block(&store, &b, 0, Origin(1)).await, Outcome::Finished { .. }));
        assert!(store.faults().await.unwrap().is_empty());
    }
}

/// A block that a worker sent before it was fenced is not stored afterwards. A fence on the author of one block sets
/// aside the whole job.
#[tokio::test]
async fn fenced_blocks_are_not_stored_later() {
    let (_dir, store, d) = two_blocks().await;
    let bad = store.register_worker(&Machine::at("bad"), "label").await.unwrap();
    assert_eq!(complete_block(&store, &d, 0, bad).await, Outcome::Part);
    assert_eq!(fence(&store, bad).await, []);
    assert!(store.stored_blocks(&d.1).await.unwrap().is_empty(), "its blocks are gone");
    assert_eq!(complete_block(&store, &d, 0, bad).await, Outcome::Unwanted);
    complete_block(&store, &d, 0, Origin(1)).await;
    let worse = store.register_worker(&Machine::at("worse"), "label").await.unwrap();
    assert!(matches!(complete_block(&store, &d, 1, worse).await, Outcome::Finished { .. }));
    assert_eq!(fence(&store, worse).await, [(d.0.id, 0)]);
    let other = create(&store, "whole", super::grid()).await;
    let late = Completion { worker: bad, ..completion(&other, 1, 0.5) };
    assert_eq!(store.complete(late).await.unwrap(), Outcome::Unwanted);
}

/// A damaged block is found before it is merged.
#[tokio::test]
async fn damaged_block_is_found_before_merging() {
    let (_dir, store, d) = two_blocks().await;
    for (first, second) in [(0, 1), (1, 0)] {
        assert_eq!(complete_block(&store, &d, first, Origin(1)).await, Outcome::Part);
        assert_eq!(store.damaged_blocks(&d.1).await.unwrap(), None);
        run(&store, "UPDATE sums SET sums = cast(x'01' || substr(sums, 2) AS BLOB)").await;
        let last = block_of(&d, second, Origin(1), &block_sums(&d.1, second));
        let error = store.complete(last).await.unwrap_err();
        assert!(matches!(error, StoreError::Corrupt { table: "sums", .. }), "{error}");
        assert_eq!(store.damaged_blocks(&d.1).await.unwrap(), Some(error.to_string()));
        assert_eq!(store.ledger().exclusive().await.delete_point(d.1.sums_identity()).await.unwrap(), []);
        assert!(store.stored_blocks(&d.1).await.unwrap().is_empty(), "all can be computed again");
    }
}

/// Sums with a flipped bit in an exponent are refused: they are finite as 64-bit floats, but not as the 32-bit floats of
/// a record.
#[test]
fn sums_beyond_record_range_are_refused() {
    let job = JobSpec::of(&grid(Some(4), &[1.0], &[0.5], 2_000_000), 0);
    let mut bytes = block_sums(&job, 0).to_le_bytes();
    assert!(Sums::from_le_bytes(&job, 1, &bytes).is_ok());
    for wrong in [5e307, -5e307, f64::NAN, f64::INFINITY] {
        bytes[16..24].copy_from_slice(&wrong.to_le_bytes());
        let error = Sums::from_le_bytes(&job, 1, &bytes).unwrap_err().to_string();
        assert!(error.contains("sums[2]") && error.contains("at most 1e30"), "{error}");
    }
}
