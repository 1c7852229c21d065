//! A flipped bit on the disk, and a disk that cannot be read.

use std::os::unix::fs::FileExt;

use farm_tests::farm::Farm;
use farm_tests::grids::{grid_of, traced, undisturbed};
use farm_tests::process::{SOON, Signal, wait_for};

use super::GRID;

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

/// Damaged records are never exported.
#[test]
fn damaged_records_are_reported_and_recomputed() {
    let farm = damaged();
    let refused = farm.farmctl(&["export", "grid"]);
    assert_eq!(refused.code, 1, "{}", refused.stderr);
    assert!(
        refused.stderr.contains(&format!("job {DAMAGED} of dictionary grid was damaged")),
        "{}",
        refused.stderr
    );
    assert_eq!(farm.show("grid")["jobs_done"].as_u64(), Some(super::JOBS - 1));
    wait_for("the event", SOON, || (farm.events("JOB_DAMAGED").len() == 1).then_some(()));
    mended(&farm);
}

/// A fit that needs damaged records is refused as data loss.
#[tokio::test(flavor = "multi_thread")]
async fn fit_with_damaged_records_is_refused() {
    use farm_proto::wire::fits_client::FitsClient;
    use optics_model::{MeasuredProfile, Measurement};
    let farm = damaged();
    let link = farm.link();
    let (grid, records) = (grid_of(GRID), traced(&grid_of(GRID), 0));
    let sensor = grid.scene().sensor();
    let x = (0..sensor.pixels()).map(|i| sensor.centre_mm(i)).collect();
    let values = records[0].profiles[0].radiance_factor.values().iter().map(|v| f64::from(*v)).collect();
    let channel = grid.scene().channels()[0].name().to_owned();
    let profile = MeasuredProfile::new(&channel, grid.thickness_mm()[0], x, values, None).unwrap();
    let measurement = Measurement::new("m", vec![profile]).unwrap();
    let request = farm_proto::wire::FitRequest {
        dictionary: "grid".to_owned(),
        measurement: Some((&measurement).into()),
        options: None,
    };
    let refused = FitsClient::new(link).fit(request).await.unwrap_err();
    assert_eq!(refused.code(), tonic::Code::DataLoss, "{refused}");
    assert!(refused.message().contains(&format!("job {DAMAGED} of dictionary grid")), "{refused}");
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
#[test]
fn unreadable_log_is_reported_and_kept() {
    let farm = Farm::start(&["--verify-share", "0"]);
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
