use std::time::Duration;

use farm_proto::grid::Axes;
use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::job::{Lease, LeaseKey};
use farm_proto::status::DictionaryState;
use farm_proto::{DictionaryName, Digest, Grid, Scene, Walks};

use super::{Dictionary, DispatchError, Farm, Settings};
use crate::store::{EndedJob, StoredDictionary};

const DIGEST: Digest = Digest::from_bytes([7; 32]);

fn seconds(s: u64) -> Duration {
    Duration::from_secs(s)
}

fn stored() -> StoredDictionary {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0, 2.0, 30.0],
        albedo: vec![0.5, 0.9],
        g: vec![0.0],
        thickness_mm: vec![1.0],
        sample_ior: vec![1.5],
    };
    let grid = Grid::new(Scene::paper(), axes, Walks::PAPER, 1, false).unwrap();
    StoredDictionary {
        id: DictionaryId(1),
        name: DictionaryName::new("d").unwrap(),
        grid_digest: Digest::of_grid(&grid),
        grid,
        created_unix_ms: 0,
    }
}

struct Bench {
    farm: Farm,
    tokens: u32,
}

impl Bench {
    fn new(ended: Vec<EndedJob>) -> Self {
        let mut farm = Farm::new(Settings { lease: seconds(30), max_attempts: 2 });
        farm.add_dictionary(Dictionary::new(stored(), ended));
        for name in ["a", "b"] {
            farm.register(seconds(0), WorkerId(name.to_owned()), name.to_owned(), 2);
        }
        Self { farm, tokens: 0 }
    }

    fn acquire(&mut self, at: u64, worker: &str, max: usize) -> Vec<Lease> {
        let tokens = &mut self.tokens;
        let token = || {
            *tokens += 1;
            format!("token {tokens}")
        };
        self.farm.acquire(seconds(at), &WorkerId(worker.to_owned()), max, token).unwrap()
    }

    fn state(&self) -> DictionaryState {
        self.farm.status(&DictionaryName::new("d").unwrap()).unwrap().state()
    }
}

fn key(lease: &Lease) -> LeaseKey {
    lease.key.clone()
}

#[test]
fn the_longest_job_goes_first_and_none_twice() {
    let mut bench = Bench::new(vec![]);
    let first = bench.acquire(0, "a", 1);
    assert_eq!(first[0].job.point().sigma_t_per_mm(), 30.0);
    let rest: Vec<u32> = bench.acquire(0, "b", 10).iter().map(|l| l.key.job).collect();
    assert_eq!(rest, [1, 0]);
    assert!(bench.acquire(0, "a", 10).is_empty());
}

#[test]
fn after_a_restart_only_what_has_not_ended_is_left() {
    let mut bench = Bench::new(vec![
        EndedJob::Done { job: 2, records: DIGEST },
        EndedJob::Failed { job: 1, reason: "r".to_owned() },
    ]);
    let lease = bench.acquire(0, "a", 10);
    assert_eq!(lease.iter().map(|l| l.key.job).collect::<Vec<_>>(), [0]);
    bench.farm.completed(seconds(1), &key(&lease[0]), DIGEST);
    assert_eq!(bench.state(), DictionaryState::Failed);
}

#[test]
fn a_silent_worker_loses_its_lease_to_another_attempt() {
    let mut bench = Bench::new(vec![]);
    let old = bench.acquire(0, "a", 1);
    assert_eq!(bench.farm.expire(seconds(29)), 0);
    assert_eq!(bench.farm.expire(seconds(30)), 1);
    let new = bench.acquire(31, "b", 1);
    assert_eq!((new[0].key.job, new[0].key.attempt), (old[0].key.job, 2));
    let lost = bench.farm.renew(seconds(32), &WorkerId("a".to_owned()), vec![key(&old[0])]).unwrap();
    assert_eq!(lost, [key(&old[0])]);
    let refused = bench.farm.check_completion(&key(&old[0])).unwrap_err();
    assert_eq!(refused, DispatchError::LeaseLost { job: old[0].key.job, attempt: 1 });
    assert!(bench.farm.check_completion(&key(&new[0])).is_ok());
}

#[test]
fn renewed_leases_live_on() {
    let mut bench = Bench::new(vec![]);
    let lease = bench.acquire(0, "a", 1);
    let lost = bench.farm.renew(seconds(20), &WorkerId("a".to_owned()), vec![key(&lease[0])]).unwrap();
    assert!(lost.is_empty());
    assert_eq!(bench.farm.expire(seconds(49)), 0);
    assert_eq!(bench.farm.expire(seconds(50)), 1);
}

#[test]
fn a_guessed_token_is_worth_nothing() {
    let mut bench = Bench::new(vec![]);
    let lease = bench.acquire(0, "a", 1);
    let forged = LeaseKey { token: "token 2".to_owned(), ..key(&lease[0]) };
    assert!(bench.farm.check_completion(&forged).is_err());
    assert!(bench.farm.failed(&forged, "sabotage").is_err());
    bench.farm.hand_back(&[forged]);
    assert!(bench.farm.check_completion(&key(&lease[0])).is_ok());
}

#[test]
fn a_job_is_given_up_after_the_allowed_failures_with_all_reasons() {
    let mut bench = Bench::new(vec![]);
    let first = bench.acquire(0, "a", 1);
    assert_eq!(bench.farm.reasons_to_give_up(&key(&first[0]), "boom").unwrap(), None);
    bench.farm.failed(&key(&first[0]), "boom").unwrap();
    let second = bench.acquire(1, "b", 1);
    assert_eq!(second[0].key.job, first[0].key.job);
    let reasons = bench.farm.reasons_to_give_up(&key(&second[0]), "bang").unwrap().unwrap();
    assert_eq!(reasons, "attempt 1: boom; attempt 2: bang");
    bench.farm.failed(&key(&second[0]), "bang").unwrap();
    for lease in bench.acquire(2, "a", 10) {
        bench.farm.completed(seconds(3), &lease.key, DIGEST);
    }
    assert_eq!(bench.state(), DictionaryState::Failed);
}

#[test]
fn handing_back_blames_nobody() {
    let mut bench = Bench::new(vec![]);
    for _ in 0..5 {
        let lease = bench.acquire(0, "a", 1);
        bench.farm.hand_back(&[key(&lease[0])]);
    }
    assert_eq!(bench.acquire(0, "a", 10).len(), 3);
    assert_eq!(bench.state(), DictionaryState::Running);
}

#[test]
fn a_worker_that_leaves_frees_also_what_it_has_not_heard_of() {
    let mut bench = Bench::new(vec![]);
    let lost = bench.acquire(0, "a", 2);
    bench.farm.leave(&WorkerId("a".to_owned()));
    assert!(bench.farm.check_completion(&key(&lost[0])).is_err());
    assert_eq!(bench.acquire(1, "b", 10).len(), 3);
    let late = bench.farm.acquire(seconds(2), &WorkerId("a".to_owned()), 1, String::new);
    assert!(late.is_err(), "one that has left gets no more");
}

#[test]
fn a_late_result_of_a_done_job_may_be_compared() {
    let mut bench = Bench::new(vec![]);
    let old = bench.acquire(0, "a", 1);
    bench.farm.expire(seconds(30));
    let new = bench.acquire(31, "b", 1);
    bench.farm.completed(seconds(32), &key(&new[0]), DIGEST);
    assert!(bench.farm.check_completion(&key(&old[0])).is_ok());
}

#[test]
fn unknown_workers_and_jobs_are_refused() {
    let mut bench = Bench::new(vec![]);
    let nobody = WorkerId("nobody".to_owned());
    let refused = bench.farm.acquire(seconds(0), &nobody, 1, String::new).unwrap_err();
    assert_eq!(refused, DispatchError::UnknownWorker(nobody));
    let stray = LeaseKey { dictionary: DictionaryId(1), job: 99, attempt: 1, token: String::new() };
    assert!(bench.farm.check_completion(&stray).is_err());
    assert!(bench.farm.failed(&stray, "x").is_err());
}

#[test]
fn progress_counts_work_not_jobs() {
    let mut bench = Bench::new(vec![]);
    let lease = bench.acquire(0, "a", 1);
    bench.farm.completed(seconds(1), &key(&lease[0]), DIGEST);
    let status = bench.farm.status(&DictionaryName::new("d").unwrap()).unwrap();
    assert_eq!((status.jobs_done, status.records_done()), (1, 2));
    // The longest of three jobs is more than half of the work.
    assert!(status.work_done > 0.6, "{}", status.work_done);
    assert_eq!(status.records_digest, None);
}
