//! A flipped bit on the disk, and a disk that cannot be read.

use std::os::unix::fs::FileExt;

use farm_proto::wire::ExportRequest;
use farm_tests::farm::Farm;
use farm_tests::grids::{grid_of, traced, undisturbed};
use farm_tests::process::{SOON, Signal, wait_for};

use super::{GRID, LONG_JOBS};

const DAMAGED: u32 = 5;

/// Flips one bit of a profile of a job's first record, in the file.
fn flip(farm: &Farm) {
    let records = traced(&grid_of(GRID), DAMAGED as usize);
    let estimate = &records[0].profiles[0].radiance_factor;
    // Later bytes may be on another page of the file.
    let bytes: Vec<u8> = estimate.values()[..50].iter().flat_map(|v| v.to_le_bytes()).collect();
    let mut file = std::fs::read(farm.database()).unwrap();
    let found: Vec<_> = file.windows(bytes.len()).enumerate().filter(|(_, w)| *w == bytes).collect();
    assert_eq!(found.len(), 1, "the record is in the file once");
    let place = found[0].0 + 4 * 25;
    // The lowest bit of a number, which stays finite and in range.
    file[place] ^= 1;
    std::fs::write(farm.database(), file).unwrap();
}

/// A farm with a finished dictionary, stopped, damaged, and started again.
fn damaged() -> Farm {
    let mut farm = Farm::start(&["--verify-share", "0"]);
    farm.submit("grid", GRID);
    let worker = farm.worker("worker", &[]);
    farm.done("grid");
    drop(worker);
    assert_eq!(farm.stop_coordinator(), 0);
    flip(&farm);
    farm.start_coordinator();
    farm
}

fn mended(farm: &Farm) {
    let worker = farm.worker("mender", &[]);
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    let exported = farm.farmctl(&["export", "grid", "-o", "all.csv"]);
    assert_eq!(exported.code, 0, "{}", exported.stderr);
    let doctor = farm.farmctl(&["doctor"]);
    assert_eq!(doctor.code, 0, "{}", doctor.stdout);
    drop(worker);
}

/// Damaged records are never exported: the export fails with data loss.
#[tokio::test(flavor = "multi_thread")]
async fn damaged_records_are_reported_and_recomputed() {
    let farm = damaged();
    let request = ExportRequest { name: "grid".to_owned(), ..Default::default() };
    let exported = async {
        let mut records = farm.dictionaries().export(request).await?.into_inner();
        while records.message().await?.is_some() {}
        Ok::<(), tonic::Status>(())
    };
    let refused = exported.await.unwrap_err();
    assert_eq!(refused.code(), tonic::Code::DataLoss, "{refused}");
    let expected = format!("job {DAMAGED} of dictionary grid was damaged");
    assert!(refused.message().contains(&expected), "{refused}");
    assert_eq!(farm.show("grid")["jobs_done"].as_u64(), Some(super::JOBS - 1));
    wait_for("the event", SOON, || (farm.events("JOB_DAMAGED").len() == 1).then_some(()));
    mended(&farm);
}

/// The doctor finds a flipped bit, and repairs it only with `--repair`.
#[test]
fn doctor_repairs_a_flipped_bit_on_request() {
    let farm = damaged();
    for _ in 0..2 {
        // A check without repair changes nothing.
        let doctor = farm.farmctl(&["doctor"]);
        assert_eq!(doctor.code, 3, "{}", doctor.stdout);
        assert!(doctor.stdout.contains(&format!("job {DAMAGED} of grid")), "{}", doctor.stdout);
    }
    assert_eq!(farm.farmctl(&["doctor", "--repair"]).code, 3);
    mended(&farm);
}

/// The records are in the database's log, which is truncated and later restored.
#[tokio::test(flavor = "multi_thread")]
async fn unreadable_log_is_reported_and_kept() {
    let farm = Farm::start(&["--verify-share", "0", "--lease", "3600"]);
    // The log is merged at a moment without leases: another dictionary has one all the time.
    farm.submit("held", LONG_JOBS);
    let mut holder = farm.test_worker("holder").await.unwrap();
    assert_eq!(holder.acquire(1).await.unwrap().len(), 1);
    assert_eq!(farm.farmctl(&["pause", "held"]).code, 0);
    farm.submit("grid", GRID);
    let worker = farm.worker("worker", &[]);
    let digest = farm.done("grid");
    let log = farm.database().with_extension("db-wal");
    farm.coordinator().signal(Signal::STOP);
    let bytes = std::fs::read(&log).unwrap();
    let file = std::fs::File::options().write(true).open(&log).unwrap();
    file.set_len(32).unwrap();
    farm.coordinator().signal(Signal::CONT);
    let doctor = farm.farmctl(&["doctor", "--repair"]);
    assert_eq!(doctor.code, 3, "{} {}", doctor.stdout, doctor.stderr);
    let expected = format!("{} jobs of grid could not be read", super::JOBS);
    assert!(doctor.stdout.contains(&expected), "{}", doctor.stdout);
    assert!(doctor.stdout.contains("nothing was deleted"), "{}", doctor.stdout);
    // The coordinator's later writes follow these.
    file.write_all_at(&bytes, 0).unwrap();
    let doctor = farm.farmctl(&["doctor", "--repair"]);
    assert_eq!(doctor.code, 0, "{}", doctor.stdout);
    assert_eq!(farm.done("grid"), digest);
    assert!(farm.events("JOB_DAMAGED").is_empty());
    drop(worker);
}
