use optics_model::Digest;
use tempfile::TempDir;

use super::{Damaged, Found};
use crate::store::Store;
use crate::store::tests::{begun, complete, overlapping, records};
use crate::stored::{Outcome, StoredDictionary};

/// A store with a dictionary whose two jobs are done: rows 1 and 2 of the records are the first one's.
async fn finished() -> (TempDir, Store, StoredDictionary) {
    let (dir, store, d) = begun().await;
    complete(&store, &d, 0, 0.25).await;
    complete(&store, &d, 1, 0.5).await;
    (dir, store, d)
}

async fn change(store: &Store, query: &'static str) {
    assert_ne!(sqlx::query(query).execute(&store.write).await.unwrap().rows_affected(), 0, "{query}");
}

/// The damage of job 0, as every way of reading reports it; job 1 is intact.
async fn damage(store: &Store, d: &StoredDictionary) -> String {
    let finished = store.finished_jobs(d.id, &d.grid, 0..2).await.unwrap();
    assert_eq!(store.all_jobs(d.id, &d.grid, 0..2).await.unwrap(), finished);
    let again = store.job_read_again(d.id, &d.grid, 0).await.unwrap();
    let [Err(Damaged { job: 0, what }), Ok(intact)] = &finished[..] else { panic!("{finished:?}") };
    assert_eq!((intact.job, intact.records.unpack()), (1, records(2, 0.5)));
    assert_eq!(again, finished[0]);
    what.clone()
}

/// Stored jobs are read back unchanged and in order.
#[tokio::test]
async fn stored_jobs_are_read_back_in_order() {
    let (_dir, store, d) = finished().await;
    let found = store.all_jobs(d.id, &d.grid, 0..2).await.unwrap();
    let unpacked = |found: &Found| found.as_ref().map(|job| (job.job, job.records.unpack())).unwrap();
    assert_eq!(found.iter().map(unpacked).collect::<Vec<_>>(), [(0, records(0, 0.25)), (1, records(2, 0.5))]);
    assert_eq!(found[1].as_ref().unwrap().records.digest(), Digest::of_records(&records(2, 0.5)));
    assert_eq!(store.finished_jobs(d.id, &d.grid, 1..2).await.unwrap(), found[1..]);
    assert_eq!(store.job_read_again(d.id, &d.grid, 1).await.unwrap(), found[1]);
    assert_eq!(store.finished_jobs(d.id, &d.grid, 0..9).await.unwrap().len(), 2, "the grid has two jobs");
}

/// A point may hold more albedos than one of the dictionaries needs.
#[tokio::test]
async fn records_of_other_albedos_are_skipped() {
    let (_dir, store, _) = finished().await;
    let finer = overlapping(&store, "e", vec![0.9, 0.95]).await;
    assert!(matches!(complete(&store, &finer, 0, 0.5).await, Outcome::Finished { .. }));
    let found = store.all_jobs(finer.id, &finer.grid, 0..1).await.unwrap().remove(0).unwrap();
    assert_eq!(found.records.unpack(), records(0, 0.5));
}

/// Whatever is changed in the rows of a job is damage, with the place where there is one.
#[tokio::test]
async fn changed_rows_are_damage() {
    let table = |row| format!("table records, row {row}, column profiles is corrupt: it has ");
    let differ = || "its records differ from what was stored".to_owned();
    let nan = "its records cannot be: record 0.profiles[0].radiance_factor.values[1] = NaN is not valid";
    let cases: [(&[&'static str], String, &str); 9] = [
        (&["DELETE FROM records WHERE id = 2"], "1 records of 2 are there".to_owned(), ""),
        (&["DELETE FROM records WHERE id < 3"], "0 records of 2 are there".to_owned(), ""),
        (&["UPDATE records SET albedo = 0.75 WHERE id = 2"], "1 records of 2 are there".to_owned(), ""),
        // The lowest bit of the last standard error.
        (
            &["UPDATE records SET profiles = cast(substr(profiles, 1, 65) || x'FE' AS BLOB) WHERE id = 2"],
            differ(),
            "",
        ),
        (&["UPDATE jobs SET records_digest = zeroblob(32) WHERE job = 0"], differ(), ""),
        (
            &["UPDATE records SET profiles = substr(profiles, 1, 65) WHERE id = 2"],
            table(2),
            ": 66 are needed",
        ),
        (&["UPDATE records SET profiles = x'' WHERE id = 2"], table(2), ": 66 are needed"),
        // As many bytes in all, but at other places.
        (
            &[
                "UPDATE records SET profiles = zeroblob(60) WHERE id = 1",
                "UPDATE records SET profiles = zeroblob(72) WHERE id = 2",
            ],
            table(1),
            "",
        ),
        // An impossible number is damage, whatever the digest.
        (
            &["UPDATE records SET profiles = \
               cast(substr(profiles, 1, 4) || x'0000C07F' || substr(profiles, 9) AS BLOB) WHERE id = 1"],
            nan.to_owned(),
            "",
        ),
    ];
    for (changes, begins, ends) in cases {
        let (_dir, store, d) = finished().await;
        for query in changes {
            change(&store, query).await;
        }
        let what = damage(&store, &d).await;
        assert!(what.starts_with(&begins) && what.ends_with(ends), "{changes:?}: {what}");
        assert_eq!(store.ledger().exclusive().await.delete_job(d.id, 0).await.unwrap(), [(d.id, 0)]);
        let again = complete(&store, &d, 0, 0.25).await;
        assert!(matches!(again, Outcome::Finished { .. }), "{changes:?}: it can be done again");
    }
}

#[tokio::test]
async fn records_that_are_swapped_are_damage() {
    let (_dir, store, d) = finished().await;
    change(&store, "UPDATE jobs SET point_id = 3 - point_id").await;
    let found = store.all_jobs(d.id, &d.grid, 0..2).await.unwrap();
    assert!(found.iter().all(Result::is_err), "{found:?}");
}

/// The row that ends a job is missing. That is damage where all jobs are known to be finished; elsewhere the job is open.
#[tokio::test]
async fn missing_end_is_damage_in_finished_jobs() {
    let (_dir, store, d) = finished().await;
    change(&store, "DELETE FROM jobs WHERE job = 0").await;
    let finished = store.finished_jobs(d.id, &d.grid, 0..2).await.unwrap();
    assert_eq!(finished.iter().map(|found| found.as_ref().unwrap().job).collect::<Vec<_>>(), [1]);
    let missing = |job| Err(Damaged { job, what: "its end is missing".to_owned() });
    assert_eq!(store.all_jobs(d.id, &d.grid, 0..2).await.unwrap(), [missing(0), finished[0].clone()]);
    assert_eq!(store.job_read_again(d.id, &d.grid, 0).await.unwrap(), missing(0));
    store.give_up_job(d.id, 0, "no luck", false).await.unwrap();
    assert_eq!(store.finished_jobs(d.id, &d.grid, 0..2).await.unwrap(), finished);
    change(&store, "DELETE FROM jobs WHERE job = 1").await;
    assert_eq!(store.all_jobs(d.id, &d.grid, 0..2).await.unwrap(), [missing(0), missing(1)]);
}
