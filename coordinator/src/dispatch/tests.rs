mod bad_machines;
mod blame;
mod blocks;
mod leases;
mod sets;
mod shared;
mod states;
mod trust;
mod votes;
mod wake_ups;

use std::sync::Arc;
use std::time::Duration;

use farm_proto::DictionaryName;
use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::{HeldLease, Lease, LeaseKey};
use farm_proto::status::{DictionaryState, DictionaryStatus, MachineFacts};
use optics_model::grid::Axes;
use optics_model::{Digest, Grid, Scene, Walks};

use super::{
    Admission, Arrived, Dictionary, DispatchError, Dispatcher, Effect, Registration, Settings, TokenSource,
};
use crate::stored::{DesiredState, EndedJob, Machine, Origin, Secret, StoredDictionary};

pub(super) const DIGEST: Digest = Digest::from_bytes([7; 32]);

pub(super) fn seconds(s: u64) -> Duration {
    Duration::from_secs(s)
}

fn axes() -> Axes {
    Axes {
        sigma_t_per_mm: vec![1.0, 2.0, 30.0],
        albedo: vec![0.5, 0.9],
        g: vec![0.0],
        thickness_mm: vec![1.0],
        sample_ior: vec![1.5],
    }
}

pub(super) fn stored() -> StoredDictionary {
    let grid = Grid::new(Scene::paper(), axes(), Walks::PAPER, 1, false).unwrap();
    StoredDictionary {
        id: DictionaryId(1),
        name: DictionaryName::new("d").unwrap(),
        grid_digest: Digest::of_grid(&grid),
        grid: Arc::new(grid),
        created_unix_ms: 0,
        priority: 0,
        desire: DesiredState::Run,
        reason: String::new(),
        owner: String::new(),
    }
}

/// Tokens 1, 2, 3, ….
#[derive(Debug)]
pub(super) struct Counted {
    pub tokens: u128,
}

impl TokenSource for Counted {
    fn token(&mut self) -> Token {
        self.tokens += 1;
        Token(self.tokens)
    }
}

struct Bench {
    farm: Dispatcher,
    chance: Counted,
}

fn worker(name: &str) -> WorkerId {
    WorkerId(name.to_owned())
}

/// The origin of worker a, b or c of the bench.
fn origin(name: &str) -> Origin {
    Origin(i64::from(name.as_bytes()[0] - b'a' + 1))
}

/// Lets a result of a worker reach the store.
fn arrive<T>(name: &str, lease: &Lease, note: impl FnOnce(&Arrived) -> T) -> T {
    let (worker, walks) = (worker(name), lease.job.walks());
    note(&Arrived { worker: &worker, by: origin(name), key: &lease.key, walks, digest: DIGEST })
}

/// A process of this name, on a machine of its own.
fn about(label: &str) -> Registration {
    on(label, label)
}

/// A process of this name on a machine.
fn on(address: &str, label: &str) -> Registration {
    let machine = Machine { address: address.to_owned(), ..Machine::default() };
    let (label, instance) = (label.to_owned(), label.to_owned());
    Registration {
        instance,
        machine,
        label,
        threads: 2,
        version: String::new(),
        facts: MachineFacts::default(),
    }
}

impl Bench {
    fn new(ended: &[EndedJob]) -> Self {
        Self::with_checks(ended, 0.0)
    }

    /// Workers a, b, c; every result is checked if the share is 1.
    fn with_checks(ended: &[EndedJob], check_share: f64) -> Self {
        let mut farm = Dispatcher::new(Settings {
            lease: seconds(30),
            max_attempts: 2,
            check_share,
            secret: Secret([3; 32]),
        });
        farm.add_dictionary(Dictionary::new(stored(), ended));
        for (name, origin) in [("a", 1), ("b", 2), ("c", 3)] {
            farm.register(seconds(0), worker(name), Origin(origin), about(name)).unwrap();
        }
        Self { farm, chance: Counted { tokens: 0 } }
    }

    fn acquire(&mut self, at: u64, name: &str, max: usize) -> Vec<Lease> {
        self.farm.acquire(seconds(at), &worker(name), max, &mut self.chance).unwrap().leases
    }

    fn finish(&mut self, at: u64, name: &str, lease: &Lease) {
        self.finish_with(at, name, lease, DIGEST);
    }

    fn finish_with(&mut self, at: u64, name: &str, lease: &Lease, records: Digest) {
        arrive(name, lease, |arrived| {
            self.farm.finished(seconds(at), arrived, records);
        });
    }

    /// Compares a result with what is stored.
    fn compare(&mut self, name: &str, lease: &Lease, stored: Digest, new: Digest) {
        arrive(name, lease, |arrived| self.farm.compare_with_stored(arrived, stored, new));
    }

    /// The effects, except notes about checks.
    fn effects(&mut self) -> Vec<Effect> {
        let effects = self.farm.take_outbox().effects.into_iter();
        effects.filter(|effect| !matches!(effect, Effect::NoteCheck(_))).collect()
    }

    fn admit(&mut self, name: &str, lease: &Lease) -> Result<Admission, DispatchError> {
        self.farm.admit(seconds(1), &worker(name), &lease.key, lease.job.identity())
    }

    fn renew(&mut self, at: u64, name: &str, lease: &Lease, running: bool) -> bool {
        let held = HeldLease { key: lease.key, running, identity: lease.job.identity() };
        self.farm.renew(seconds(at), &worker(name), vec![held]).unwrap().0.is_empty()
    }

    fn state(&self) -> DictionaryState {
        self.status().state()
    }

    fn status(&self) -> DictionaryStatus {
        self.farm.status_of(seconds(0), self.farm.schedule.by_id(DictionaryId(1)).unwrap())
    }

    fn fail(&mut self, at: u64, name: &str, lease: &Lease) {
        self.farm.failed(seconds(at), &worker(name), &lease.key, "boom").unwrap();
    }

    fn reasons(&self, at: u64) -> Vec<&'static str> {
        self.reasons_of("d", at)
    }

    fn reasons_of(&self, name: &str, at: u64) -> Vec<&'static str> {
        let name = DictionaryName::new(name).unwrap();
        let dictionary = self.farm.schedule.by_name(&name).unwrap();
        self.farm.explain(seconds(at), dictionary).into_iter().map(|r| r.code).collect()
    }
}

fn job_of(leases: &[Lease]) -> Vec<u32> {
    leases.iter().map(|l| l.key.job).collect()
}

/// The longest job is leased first, and no job twice.
#[test]
fn longest_job_goes_first() {
    let mut bench = Bench::new(&[]);
    let first = bench.acquire(0, "a", 1);
    assert_eq!(first[0].job.point().sigma_t_per_mm(), 30.0);
    assert_eq!(job_of(&bench.acquire(0, "b", 10)), [1, 0]);
    assert!(bench.acquire(0, "a", 10).is_empty());
}

/// After a restart, only jobs that have not ended are leased.
#[test]
fn only_unfinished_jobs_remain_after_restart() {
    let mut bench = Bench::new(&[
        EndedJob::Done {
            job: 2,
            walks: Walks::PAPER,
            records: DIGEST,
            by: None,
            confirmed: vec![],
            reused: false,
        },
        EndedJob::GivenUp { job: 1, reason: "r".to_owned(), quarantined: true },
    ]);
    let lease = bench.acquire(0, "a", 10);
    assert_eq!(job_of(&lease), [0]);
    bench.finish(1, "a", &lease[0]);
    assert_eq!(bench.state(), DictionaryState::Failed);
    assert!(bench.status().has_quarantined());
}

/// A draining worker gets no leases and is informed that it drains, but may finish its work.
#[test]
fn draining_worker_gets_no_leases() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    assert_eq!(bench.farm.drain("nobody").unwrap_err(), "no worker has this id or label");
    assert_eq!(bench.farm.drain("a").unwrap(), worker("a"));
    let grant = bench.farm.acquire(seconds(1), &worker("a"), 5, &mut bench.chance).unwrap();
    assert!(grant.drain && grant.leases.is_empty());
    assert!(bench.renew(2, "a", &lease[0], true), "what it has it may finish");
}

/// Priorities and desired states decide which jobs are leased.
#[test]
fn priorities_and_desires_order_the_leases() {
    let mut bench = Bench::new(&[]);
    // A dictionary with other walks.
    let grid = Grid::new(Scene::paper(), axes(), Walks::PAPER, 2, false).unwrap();
    let second = StoredDictionary {
        id: DictionaryId(2),
        name: DictionaryName::new("e").unwrap(),
        grid_digest: Digest::of_grid(&grid),
        grid: Arc::new(grid),
        ..stored()
    };
    bench.farm.add_dictionary(Dictionary::new(second, &[]));
    assert_eq!(bench.acquire(0, "a", 1)[0].key.dictionary, DictionaryId(1));
    bench.farm.set_priority(DictionaryId(2), 5);
    assert_eq!(bench.acquire(0, "a", 1)[0].key.dictionary, DictionaryId(2));
    assert!(bench.reasons(0).contains(&"HIGHER_PRIORITY"));
    bench.farm.set_desire(DictionaryId(2), DesiredState::Pause, String::new());
    assert_eq!(bench.acquire(0, "a", 1)[0].key.dictionary, DictionaryId(1));
    bench.farm.set_desire(DictionaryId(1), DesiredState::Cancel, "enough".to_owned());
    assert!(bench.acquire(0, "a", 9).is_empty());
    assert_eq!((bench.state(), bench.status().reason.as_str()), (DictionaryState::Cancelled, "enough"));
    bench.farm.set_desire(DictionaryId(1), DesiredState::Run, String::new());
    assert_eq!(bench.acquire(1, "a", 9).len(), 3, "leases from before the cancellation are not kept");
}

/// The explanation of a dictionary lists why its jobs wait.
#[test]
fn reasons_for_waiting_are_explained() {
    let mut bench = Bench::new(&[]);
    assert_eq!(bench.reasons(0), ["WAITING"]);
    assert_eq!(bench.reasons(100), ["WORKERS_SILENT", "WAITING"]);
    for name in ["a", "b", "c"] {
        bench.farm.drain(name).unwrap();
    }
    assert_eq!(bench.reasons(0), ["NO_WORKERS", "WAITING"]);
    for name in ["a", "b", "c"] {
        bench.farm.leave(&worker(name));
    }
    assert_eq!(bench.reasons(0), ["NO_WORKERS", "WAITING"]);
}

#[test]
fn unknown_workers_and_jobs_are_refused() {
    let mut bench = Bench::new(&[]);
    let nobody = worker("nobody");
    let refused = bench.farm.acquire(seconds(0), &nobody, 1, &mut bench.chance).unwrap_err();
    assert_eq!(refused, DispatchError::UnknownWorker(nobody));
    let stray = LeaseKey { dictionary: DictionaryId(1), job: 99, attempt: 1, token: Token(0), part: 0 };
    assert!(bench.farm.admit(seconds(0), &worker("a"), &stray, DIGEST).is_err());
    assert!(bench.farm.failed(seconds(0), &worker("a"), &stray, "x").is_err());
}

#[test]
fn progress_counts_work_not_jobs() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    bench.finish(1, "a", &lease[0]);
    let status = bench.status();
    assert_eq!((status.jobs_done, status.records_done()), (1, 2));
    // The longest of three jobs is more than half of the work.
    assert!(status.work_done > 0.6, "{}", status.work_done);
    assert_eq!(status.records_digest, None);
}
