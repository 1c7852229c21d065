//! Shared by the unit tests: small jobs, and a coordinator in the same process with scripted answers.

mod coordinator;
mod network;

use std::sync::Arc;

use farm_proto::ids::{DictionaryId, Token};
use farm_proto::lease::{Lease, LeaseKey};
use farm_proto::status::MachineFacts;
use optics_model::grid::{BATCH_WALKS, Walks};
use optics_model::job::JobSpec;
use optics_model::medium::TransportPoint;
use optics_model::scene::{Scene, Sensor};
use tokio_util::sync::CancellationToken;

pub(crate) use coordinator::{Answer, Call, Coordinator, DeliveredResult, Method};

use crate::Error;
use crate::leases::{HeldLeases, JobSwitches, SetSwitch};
use crate::session::{CoordinatorSession, Introduction};

/// A job of a few milliseconds.
pub(crate) fn job(seed: u64) -> JobSpec {
    job_of_walks(seed, 2 * BATCH_WALKS)
}

/// Another job that shares the walks of [`job`].
pub(crate) fn as_thick_as(seed: u64) -> JobSpec {
    let one = job(seed);
    let point = TransportPoint::new(0.5, 0.0, 1.0, 1.53).unwrap();
    JobSpec::new(one.scene().clone(), point, one.albedo().to_vec(), one.walks(), seed, false).unwrap()
}

/// A job that ends only when it is stopped.
pub(crate) fn endless_job(seed: u64) -> JobSpec {
    job_of_walks(seed, 1_000_000 * BATCH_WALKS)
}

fn job_of_walks(seed: u64, walks: u64) -> JobSpec {
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, 8, 0.0).unwrap());
    let point = TransportPoint::new(1.0, 0.0, 0.5, 1.53).unwrap();
    JobSpec::new(scene, point, vec![0.5, 0.9], Walks::new(walks).unwrap(), seed, false).unwrap()
}

/// Adds the leases of jobs, which wait or run, and returns their switches.
pub(crate) fn hold<const N: usize>(held: &HeldLeases, runs: [bool; N]) -> [Arc<JobSwitches>; N] {
    let mut n = 0..;
    runs.map(|runs| {
        let switches = held.add(lease(n.next().unwrap()).key, job(1).identity(), SetSwitch::new(1));
        assert!(!runs || switches.start());
        switches
    })
}

/// A lease of [`job`] number `n`.
pub(crate) fn lease(n: u32) -> Lease {
    lease_of(n, job(n.into()))
}

pub(crate) fn lease_of(n: u32, job: JobSpec) -> Lease {
    let token = Token(u128::from(n) + 1);
    Lease { key: LeaseKey { dictionary: DictionaryId(1), job: n, attempt: 1, token, part: 0 }, job }
}

fn introduction() -> Introduction {
    Introduction { label: "test".to_owned(), host: String::new(), threads: 2, facts: MachineFacts::default() }
}

pub(crate) async fn open(
    coordinator: &Coordinator,
    held: Arc<HeldLeases>,
    shutdown: &CancellationToken,
) -> Result<Option<CoordinatorSession>, Error> {
    CoordinatorSession::open(coordinator.link(), "http://test", introduction(), held, shutdown).await
}

/// A session with a coordinator, and the leases that it announces.
pub(crate) async fn session(coordinator: &Coordinator) -> (Arc<CoordinatorSession>, Arc<HeldLeases>) {
    let held = Arc::<HeldLeases>::default();
    let session = open(coordinator, held.clone(), &CancellationToken::new()).await;
    (Arc::new(session.unwrap().expect("it is not shut down")), held)
}
