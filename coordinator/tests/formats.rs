//! Checks that databases of every schema, as programs of their time wrote them, can be read.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::path::PathBuf;

use farm_coordinator::load_dictionary;
use farm_coordinator::store::{DataDir, Store, newest_schema};
use farm_coordinator::stored::{DesiredState, EndedJob, Origin, StoredDictionary};
use farm_proto::wire;
use optics_model::fit::FitOptions;
use optics_model::profile::RecordShape;
use optics_model::{Digest, Grid, MeasuredProfile, Measurement};
use prost::Message;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection};

/// Digests of the records, as those programs reported them: walks give the same bits with all of them.
const TINY: &str = "489ae2e8843061d76675c4e449b2dcbc915686ec2e5af42c958c1c5c58a9b441";
const SLOPES: &str = "e055f3e4960318c9b5d568cdde3e97e0a16d22a2f871f97b8cf2ff86cebcb44f";

const BYTES: &str = "630a8a7c9bde119ced73150c6695e6d1cc69c2c8d619476218de3e1cbae79755";

/// Version of the physics of the program that wrote the fixture of each schema.
const PHYSICS_VERSIONS: [u32; 8] = [2, 3, 3, 3, 3, 3, 3, 3];

/// The digest that a grid had in the program that wrote a fixture.
fn grid_digest(grid: &Grid, schema: i64) -> Digest {
    let mut hasher = blake3::Hasher::new_derive_key("farm.v1 grid");
    hasher.update(&PHYSICS_VERSIONS[schema as usize - 1].to_le_bytes());
    hasher.update(&wire::Grid::from(grid).encode_to_vec());
    Digest::from_bytes(hasher.finalize().into())
}

/// A data directory with the database of a fixture.
async fn data_of(schema: i64) -> tempfile::TempDir {
    let fixture = format!("{}/../tests/data/formats/{schema}/farm.sql", env!("CARGO_MANIFEST_DIR"));
    let sql = std::fs::read_to_string(PathBuf::from(&fixture))
        .unwrap_or_else(|error| panic!("every schema has a fixture, {fixture}: {error}"));
    let dir = tempfile::tempdir().unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new()
        .filename(dir.path().join("farm.db"))
        .create_if_missing(true)
        // The fixture creates tables in the order of their names.
        .foreign_keys(false);
    let mut connection = options.connect().await.unwrap();
    sqlx::raw_sql(AssertSqlSafe(sql)).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
    dir
}

/// A store whose database comes from a fixture, in a folder of its own.
async fn store_of(schema: i64) -> (tempfile::TempDir, Store) {
    let dir = data_of(schema).await;
    let store = open(&dir).await;
    (dir, store)
}

async fn open(dir: &tempfile::TempDir) -> Store {
    Store::open(DataDir::lock(dir.path()).unwrap(), |_| {}).await.unwrap()
}

async fn dictionary(store: &Store, name: &str) -> StoredDictionary {
    store.dictionaries().await.unwrap().into_iter().find(|d| d.name.as_str() == name).unwrap()
}

/// Outcomes of a dictionary's jobs, and the digest of all of its records.
async fn ended(store: &Store, dictionary: &StoredDictionary) -> (Vec<EndedJob>, String) {
    let ended = store.ended_jobs(dictionary.id, &dictionary.grid).await.unwrap();
    let digest = |job: &EndedJob| match job {
        EndedJob::Done { records, .. } => *records,
        EndedJob::GivenUp { .. } => panic!("{job:?}"),
    };
    let digest = Digest::of_jobs(ended.iter().map(digest)).to_string();
    (ended, digest)
}

/// Record 4 in channel G, as a measurement.
fn measurement(dictionary: &optics_fit::FitDictionary) -> Measurement {
    let sensor = dictionary.grid().scene().sensor();
    let x = (0..sensor.pixels()).map(|pixel| sensor.centre_mm(pixel)).collect();
    let values = dictionary.values(4, 1).iter().map(|value| f64::from(*value)).collect();
    Measurement::new("fourth", vec![MeasuredProfile::new("G", 1.0, x, values, None).unwrap()]).unwrap()
}

/// A finished dictionary of every schema is read, with its derivatives, and can be fitted to.
#[tokio::test]
async fn every_schema_can_be_read_and_fitted() {
    for schema in 1..=newest_schema() {
        let dir = data_of(schema).await;
        // In the second pass the database has the newest schema.
        for _ in 0..2 {
            let store = open(&dir).await;
            assert!(store.faults().await.unwrap().is_empty(), "schema {schema}");
            let tiny = dictionary(&store, "tiny").await;
            assert_eq!((tiny.grid.job_count(), tiny.grid.record_count()), (3, 9), "schema {schema}");
            assert_eq!(tiny.grid_digest, grid_digest(&tiny.grid, schema), "schema {schema}");
            let physics = tiny.grid_digest.physics_version_of(&tiny.grid);
            assert_eq!(physics, Some(PHYSICS_VERSIONS[schema as usize - 1]), "schema {schema}");
            assert_eq!(ended(&store, &tiny).await.1, TINY, "schema {schema}");
            for found in store.all_jobs(tiny.id, &tiny.grid, 0..3).await.unwrap() {
                found.unwrap_or_else(|damaged| panic!("schema {schema}: {damaged}"));
            }
            let loaded = load_dictionary(&store, &tiny.name, tiny.id, &tiny.grid).await.unwrap();
            let fit = optics_fit::fit(&loaded, &measurement(&loaded), &FitOptions::default()).unwrap();
            let best = &fit.channels[0].candidates[0];
            assert_eq!(best.thicknesses[0].record, Some(4), "schema {schema}");
            // In standard errors of a pixel. A descent ends where −2 ln L would fall by less than 1e-4, which here is some
            // blur of the step at the edge: its effect begins with an infinite slope.
            assert!(best.error < 1e-3, "schema {schema}: {}", best.error);
            let slopes = dictionary(&store, "slopes").await;
            assert_eq!(ended(&store, &slopes).await.1, SLOPES, "schema {schema}");
            let found = store.all_jobs(slopes.id, &slopes.grid, 0..1).await.unwrap().remove(0).unwrap();
            assert!(found.records.shape().derivatives, "schema {schema}");
            RecordShape::of(&slopes.grid).check(&found.records.record(0)).unwrap();
            store.close().await;
        }
    }
}

/// From the seventh schema on there is a kept measurement, which older databases do not have.
#[tokio::test]
async fn kept_measurements_of_every_schema_are_read() {
    for schema in 1..=newest_schema() {
        let (_dir, store) = store_of(schema).await;
        let kept = store.measurements_before(i64::MAX, 10).await.unwrap();
        assert_eq!(kept.len(), usize::from(schema >= 7), "schema {schema}");
        for one in kept {
            assert_eq!((one.title.as_str(), one.note.as_str()), ("first print", "of schema 7"));
            let content = store.measurement_content(&one.id).await.unwrap().unwrap();
            let kept = wire::KeptMeasurement::decode(&content[..]).unwrap();
            assert_eq!(kept.request.unwrap().materials[0].material, "resin", "schema {schema}");
            assert_eq!(kept.answer.unwrap().materials[0].channels.len(), 2, "schema {schema}");
            Grid::try_from(kept.grid.unwrap()).unwrap();
        }
    }
}

/// From the sixth schema on there are records whose standard errors are bytes, besides the older ones.
#[tokio::test]
async fn byte_errors_are_read_next_to_floats() {
    for schema in 6..=newest_schema() {
        let (_dir, store) = store_of(schema).await;
        let bytes = dictionary(&store, "bytes").await;
        assert_eq!(bytes.grid_digest.physics_version_of(&bytes.grid), Some(6), "schema {schema}");
        assert_eq!(ended(&store, &bytes).await.1, BYTES, "schema {schema}");
        let found = store.all_jobs(bytes.id, &bytes.grid, 0..1).await.unwrap().remove(0).unwrap();
        let errors = found.records.record(1).profiles[0].radiance_factor.std_errors().to_vec();
        let expected = (24, 1.5 / 512.0, 1.375 / 512.0);
        assert_eq!((errors.len(), errors[0], errors[11]), expected, "schema {schema}");
        let slopes = dictionary(&store, "slopes").await;
        assert_ne!(slopes.grid_digest.physics_version_of(&slopes.grid), Some(6), "schema {schema}");
        let loaded = load_dictionary(&store, &bytes.name, bytes.id, &bytes.grid).await.unwrap();
        assert_eq!(loaded.grid().record_count(), 2, "schema {schema}");
    }
}

/// From the second schema on, the machine that computed a job and the desired state of a dictionary are stored.
#[tokio::test]
async fn shared_points_and_desires_are_read() {
    for schema in 2..=newest_schema() {
        let (_dir, store) = store_of(schema).await;
        let (finer, tiny) = (dictionary(&store, "finer").await, dictionary(&store, "tiny").await);
        let ended_finer = ended(&store, &finer).await.0;
        let [EndedJob::Done { reused: true, .. }, EndedJob::Done { reused: false, by, .. }] =
            &ended_finer[..]
        else {
            panic!("schema {schema}: {ended_finer:?}")
        };
        assert_eq!(*by, Some(Origin(3)), "schema {schema}");
        let records_of = async |d: &StoredDictionary, job| {
            store.all_jobs(d.id, &d.grid, job..job + 1).await.unwrap().remove(0).unwrap().records
        };
        // σ_t = 2, α = 0.9.
        let (shared, its_own) = (records_of(&finer, 0).await.record(0), records_of(&tiny, 1).await.record(4));
        assert_eq!(shared.profiles, its_own.profiles, "schema {schema}");

        let open = dictionary(&store, "open").await;
        assert_eq!((open.desire, open.priority), (DesiredState::Pause, 5), "schema {schema}");
        assert!(ended(&store, &open).await.0.is_empty(), "schema {schema}");
        let events = store.events_after(0, "open", 10).await.unwrap();
        let kinds: Vec<&str> = events.iter().map(|event| &event.kind[..]).collect();
        assert_eq!(kinds, ["SUBMITTED", "PAUSED"], "schema {schema}");
        // From the fifth schema on, owners of dictionaries and actors of events are stored.
        let known = |who: &str| if schema >= 5 { who.to_owned() } else { String::new() };
        assert_eq!((tiny.owner, open.owner), (known("alice"), String::new()), "schema {schema}");
        assert_eq!(events[1].actor, known("alice at 127.0.0.1"), "schema {schema}");
    }
}

/// From the eighth schema on the results are marked that the coordinator has computed, and those that it is to compute.
#[tokio::test]
async fn checks_of_every_schema_are_read() {
    for schema in 1..=newest_schema() {
        let (_dir, store) = store_of(schema).await;
        let tiny = dictionary(&store, "tiny").await;
        let verified = |end: &EndedJob| matches!(end, EndedJob::Done { verified: true, .. });
        let expected = [schema >= 8, false, false];
        assert_eq!(
            ended(&store, &tiny).await.0.iter().map(verified).collect::<Vec<_>>(),
            expected,
            "{schema}"
        );
        let checks: Vec<u32> = store.open_checks().await.unwrap().iter().map(|check| check.job).collect();
        assert_eq!(checks, if schema >= 8 { vec![1] } else { vec![] }, "schema {schema}");
    }
}

/// Nothing is left of a deleted dictionary and its points, whatever the schema that it came from.
#[tokio::test]
async fn dictionaries_of_every_schema_are_deleted_whole() {
    for schema in 1..=newest_schema() {
        let (dir, store) = store_of(schema).await;
        let mut records = 0;
        for stored in store.dictionaries().await.unwrap() {
            records += store.ledger().exclusive().await.delete_dictionary(stored.id, &[]).await.unwrap();
        }
        assert_eq!(records, [10, 11, 11, 11, 11, 13, 13, 13][schema as usize - 1], "schema {schema}");
        assert!(store.faults().await.unwrap().is_empty(), "schema {schema}");
        store.close().await;
        let file = dir.path().join("farm.db");
        let report = farm_coordinator::store::backup::verify(&file, newest_schema()).await.unwrap();
        assert_eq!((report.counts.dictionaries, report.counts.jobs, report.counts.records), (0, 0, 0));
    }
}
