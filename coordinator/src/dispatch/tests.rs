mod bad_machines;
mod blame;
mod blocks;
mod judge;
mod leases;
mod sets;
mod shared;
mod states;
mod trust;
mod wake_ups;

use std::ops::Range;
use std::time::Duration;

use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::{HeldLease, Lease};
use farm_proto::status::{DictionaryState, DictionaryStatus};
use optics_model::{Digest, Grid, Scene, Walks};

use super::{
    Admission, Arrived, Dictionary, DispatchError, Dispatcher, Effect, PartId, Registration, Settings,
    TokenSource, Verdict,
};
use crate::stored::{DesiredState, EndedJob, Machine, Origin, Secret};
use crate::testing;

pub(super) const DIGEST: Digest = Digest::from_bytes([7; 32]);
const WRONG: Digest = Digest::from_bytes([9; 32]);
const FIRST: DictionaryId = DictionaryId(1);
const SECOND: DictionaryId = DictionaryId(2);
/// The coordinator's own machine.
const OWN: Origin = Origin(100);

pub(super) fn seconds(s: u64) -> Duration {
    Duration::from_secs(s)
}

/// A finished job of the paper's walks.
fn done(job: u32, by: Option<Origin>, reused: bool) -> EndedJob {
    testing::done(job, Walks::PAPER, DIGEST, by, reused)
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
    testing::process(Machine::at(address), label)
}

impl Bench {
    fn new(ended: &[EndedJob]) -> Self {
        Self::with_checks(ended, 0.0)
    }

    /// Workers a, b, c; every result is checked if the share is 1.
    fn with_checks(ended: &[EndedJob], check_share: f64) -> Self {
        let settings = Settings { lease: seconds(30), max_attempts: 2, check_share, secret: Secret([3; 32]) };
        let mut bench = Self { farm: Dispatcher::new(settings), chance: Counted { tokens: 0 } };
        bench.add(FIRST, testing::grid(None, &[1.0, 2.0, 30.0], &[0.5, 0.9], Walks::PAPER.get()), ended);
        for name in ["a", "b", "c"] {
            bench.join(0, name);
        }
        bench
    }

    /// Workers a, b, c, and another grid.
    fn of_grid(grid: Grid, check_share: f64) -> Self {
        let mut bench = Self::with_checks(&[], check_share);
        bench.farm.remove_dictionary(FIRST);
        bench.add(FIRST, grid, &[]);
        bench
    }

    fn add(&mut self, id: DictionaryId, grid: Grid, ended: &[EndedJob]) {
        let name = if id == FIRST { "d" } else { "e" };
        self.farm.add_dictionary(Dictionary::new(testing::stored(id.0, name, grid), ended));
    }

    /// Registers a worker on the machine of its name.
    fn join(&mut self, at: u64, name: &str) {
        self.register(at, name, origin(name), about(name)).unwrap();
    }

    fn register(&mut self, at: u64, id: &str, on: Origin, about: Registration) -> Result<(), DispatchError> {
        self.farm.register(seconds(at), worker(id), on, about).map(drop)
    }

    fn leave(&mut self, names: &[&str]) {
        for name in names {
            self.farm.leave(&worker(name));
        }
    }

    /// Looks for silent workers every four seconds; returns the number of leases that have ended.
    fn look(&mut self, time: Range<u64>) -> usize {
        time.step_by(4).map(|second| self.farm.look_over(seconds(second))).sum()
    }

    /// Worker a has finished two of three jobs at 1 s, and holds the third.
    fn with_one_left() -> (Self, Lease) {
        let mut bench = Self::new(&[]);
        let leases = bench.acquire(0, "a", 3);
        bench.finish_all(1, "a", &leases[1..]);
        (bench, leases[0].clone())
    }

    fn look_at(&mut self, times: &[u64]) {
        for second in times {
            self.farm.look_over(seconds(*second));
        }
    }

    fn one(&mut self, at: u64, name: &str) -> Lease {
        self.acquire(at, name, 1).remove(0)
    }

    fn jobs(&mut self, at: u64, name: &str, max: usize) -> Vec<u32> {
        job_of(&self.acquire(at, name, max))
    }

    fn parts(&mut self, at: u64, name: &str, max: usize) -> Vec<u32> {
        self.acquire(at, name, max).iter().map(|lease| lease.key.part).collect()
    }

    fn desire(&mut self, id: DictionaryId, desire: DesiredState) {
        self.farm.set_desire(id, desire, String::new());
    }

    /// A block reaches the store with these sums.
    fn store_part(&mut self, name: &str, lease: &Lease, digest: Digest) {
        arrive(name, lease, |arrived| self.farm.part_finished(seconds(1), &Arrived { digest, ..*arrived }));
    }

    fn prolong(&mut self, at: u64, name: &str, lease: &Lease, walks: u64) {
        let walks = Walks::new(walks).unwrap();
        arrive(name, lease, |arrived| self.farm.prolong(seconds(at), arrived, walks));
    }

    fn finish_all(&mut self, at: u64, name: &str, leases: &[Lease]) {
        for lease in leases {
            self.finish(at, name, lease);
        }
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
        arrive(name, lease, |arrived| {
            self.farm.compare_with_stored(&Arrived { digest: new, ..*arrived }, stored);
        });
    }

    /// The coordinator finds this result of what is to be checked next; returns the part and the verdict.
    fn judge(&mut self, right: Digest) -> (PartId, Verdict) {
        let (part, job) = self.farm.next_check(&[].into()).unwrap();
        let verdict = self.farm.verdict(part, &job, right).unwrap();
        if verdict.stored_is_wrong {
            self.farm.reopen(part.dictionary, &[part.job]);
        }
        if job.block().is_none() {
            self.farm.verified(part.job_ref(), job.walks(), right, OWN);
        }
        self.farm.settle(part, right, &verdict);
        (part, verdict)
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
        self.farm.status_of(seconds(0), self.farm.schedule.by_id(FIRST).unwrap())
    }

    fn fail(&mut self, at: u64, name: &str, lease: &Lease) {
        self.farm.failed(seconds(at), &worker(name), &lease.key, "boom").unwrap();
    }

    fn reasons(&self, at: u64) -> Vec<&'static str> {
        let dictionary = self.farm.schedule.by_id(FIRST).unwrap();
        self.farm.explain(seconds(at), dictionary).into_iter().map(|r| r.code).collect()
    }
}

fn job_of(leases: &[Lease]) -> Vec<u32> {
    leases.iter().map(|l| l.key.job).collect()
}

/// The longest job is leased first, and no job twice. Progress counts work: the longest of three is more than half of it.
#[test]
fn longest_job_goes_first_and_counts_most() {
    let mut bench = Bench::new(&[]);
    let first = bench.one(0, "a");
    assert_eq!(first.job.point().sigma_t_per_mm(), 30.0);
    assert_eq!(bench.jobs(0, "b", 10), [1, 0]);
    assert!(bench.acquire(0, "a", 10).is_empty());
    bench.finish(1, "a", &first);
    let status = bench.status();
    assert_eq!((status.jobs_done, status.records_done(), status.records_digest), (1, 2, None));
    assert!(status.work_done > 0.6, "{}", status.work_done);
}

/// Priorities and desired states decide which jobs are leased. A cancellation is explained with its reason.
#[test]
fn priorities_and_desires_order_the_leases() {
    let mut bench = Bench::new(&[]);
    // A dictionary with other walks.
    let axes = testing::axes(&[1.0, 2.0, 30.0], &[0.5, 0.9]);
    bench.add(SECOND, Grid::new(Scene::paper(), axes, Walks::PAPER, 2, false).unwrap(), &[]);
    assert_eq!(bench.one(0, "a").key.dictionary, FIRST);
    bench.farm.set_priority(SECOND, 5);
    assert_eq!(bench.one(0, "a").key.dictionary, SECOND);
    assert!(bench.reasons(0).contains(&"HIGHER_PRIORITY"));
    bench.desire(SECOND, DesiredState::Pause);
    assert_eq!(bench.one(0, "a").key.dictionary, FIRST);
    bench.farm.set_desire(FIRST, DesiredState::Cancel, "enough".to_owned());
    assert!(bench.acquire(0, "a", 9).is_empty());
    assert_eq!((bench.state(), bench.status().reason.as_str()), (DictionaryState::Cancelled, "enough"));
    let why = bench.farm.explain(seconds(0), bench.farm.schedule.by_id(FIRST).unwrap());
    assert!(why[0].code == "CANCELLED" && why[0].text.contains("enough"), "{why:?}");
    bench.desire(FIRST, DesiredState::Run);
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
    bench.leave(&["a", "b", "c"]);
    assert_eq!(bench.reasons(0), ["NO_WORKERS", "WAITING"]);
}
