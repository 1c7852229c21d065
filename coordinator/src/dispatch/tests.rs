use std::sync::Arc;
use std::time::Duration;

use farm_proto::grid::Axes;
use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::job::{Lease, LeaseKey};
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::{DictionaryName, Digest, Grid, Scene, Walks};

use super::{
    Admission, Arrived, Chance, Dictionary, DispatchError, Dispatcher, Effect, Origin, Registration, Settings,
};
use crate::store::{Desire, EndedJob, StoredDictionary};

pub(super) const DIGEST: Digest = Digest::from_bytes([7; 32]);

pub(super) fn seconds(s: u64) -> Duration {
    Duration::from_secs(s)
}

pub(super) fn stored() -> StoredDictionary {
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
        grid: Arc::new(grid),
        created_unix_ms: 0,
        priority: 0,
        desire: Desire::Run,
        reason: String::new(),
    }
}

/// Tokens 1, 2, 3, …, and shares that are always the same.
#[derive(Debug)]
pub(super) struct Counted {
    pub tokens: u128,
    pub share: f64,
}

impl Chance for Counted {
    fn token(&mut self) -> Token {
        self.tokens += 1;
        Token(self.tokens)
    }

    fn share(&mut self) -> f64 {
        self.share
    }
}

struct Bench {
    farm: Dispatcher,
    chance: Counted,
}

fn worker(name: &str) -> WorkerId {
    WorkerId(name.to_owned())
}

/// That of a, b, c in the bench.
fn origin(name: &str) -> Origin {
    Origin(i64::from(name.as_bytes()[0] - b'a' + 1))
}

/// Lets a result of a worker reach the store.
fn arrive(name: &str, lease: &Lease, note: impl FnOnce(&Arrived)) {
    let (worker, walks) = (worker(name), lease.job.walks());
    note(&Arrived { worker: &worker, by: origin(name), key: &lease.key, walks });
}

fn about(label: &str) -> Registration {
    Registration { label: label.to_owned(), threads: 2, version: String::new() }
}

impl Bench {
    fn new(ended: &[EndedJob]) -> Self {
        Self::with_checks(ended, 0.0)
    }

    /// Workers a, b, c; every result is checked if the share is 1.
    fn with_checks(ended: &[EndedJob], check_share: f64) -> Self {
        let mut farm = Dispatcher::new(Settings { lease: seconds(30), max_attempts: 2, check_share });
        farm.add_dictionary(Dictionary::new(stored(), ended));
        for (name, origin) in [("a", 1), ("b", 2), ("c", 3)] {
            farm.register(seconds(0), worker(name), Origin(origin), about(name)).unwrap();
        }
        Self { farm, chance: Counted { tokens: 0, share: 0.5 } }
    }

    fn acquire(&mut self, at: u64, name: &str, max: usize) -> Vec<Lease> {
        self.farm.acquire(seconds(at), &worker(name), max, &mut self.chance).unwrap().leases
    }

    fn finish(&mut self, at: u64, name: &str, lease: &Lease) {
        self.finish_with(at, name, lease, DIGEST);
    }

    fn finish_with(&mut self, at: u64, name: &str, lease: &Lease, records: Digest) {
        arrive(name, lease, |arrived| {
            self.farm.finished(seconds(at), arrived, records, &mut self.chance);
        });
    }

    fn admit(&mut self, name: &str, lease: &Lease) -> Result<Admission, DispatchError> {
        self.farm.admit(seconds(1), &worker(name), &lease.key, lease.job.identity())
    }

    fn renew(&mut self, at: u64, name: &str, lease: &Lease, running: bool) -> bool {
        let held = vec![(lease.key, running, lease.job.identity())];
        self.farm.renew(seconds(at), &worker(name), held).unwrap().0.is_empty()
    }

    fn state(&self) -> DictionaryState {
        self.status().state()
    }

    fn status(&self) -> DictionaryStatus {
        self.farm.status(seconds(0), &DictionaryName::new("d").unwrap()).unwrap()
    }

    fn reasons(&self, at: u64) -> Vec<&'static str> {
        let name = DictionaryName::new("d").unwrap();
        self.farm.explain(seconds(at), &name).unwrap().into_iter().map(|r| r.code).collect()
    }
}

fn job_of(leases: &[Lease]) -> Vec<u32> {
    leases.iter().map(|l| l.key.job).collect()
}

#[test]
fn the_longest_job_goes_first_and_none_twice() {
    let mut bench = Bench::new(&[]);
    let first = bench.acquire(0, "a", 1);
    assert_eq!(first[0].job.point().sigma_t_per_mm(), 30.0);
    assert_eq!(job_of(&bench.acquire(0, "b", 10)), [1, 0]);
    assert!(bench.acquire(0, "a", 10).is_empty());
}

#[test]
fn after_a_restart_only_what_has_not_ended_is_left() {
    let mut bench = Bench::new(&[
        EndedJob::Done { job: 2, walks: Walks::PAPER, records: DIGEST, by: None, reused: false },
        EndedJob::GivenUp { job: 1, reason: "r".to_owned(), quarantined: true },
    ]);
    let lease = bench.acquire(0, "a", 10);
    assert_eq!(job_of(&lease), [0]);
    bench.finish(1, "a", &lease[0]);
    assert_eq!(bench.state(), DictionaryState::Failed);
    assert!(bench.status().has_quarantined());
}

#[test]
fn a_silent_workers_job_goes_to_another_and_its_late_result_still_counts() {
    let mut bench = Bench::new(&[]);
    let old = bench.acquire(0, "a", 1);
    assert_eq!(bench.farm.expire(seconds(29)), 0);
    assert_eq!(bench.farm.expire(seconds(30)), 1);
    let new = bench.acquire(31, "b", 1);
    assert_eq!((new[0].key.job, new[0].key.attempt), (old[0].key.job, 2));
    assert!(!bench.renew(32, "a", &old[0], true), "the lease is lost");
    assert!(matches!(bench.admit("a", &old[0]), Ok(Admission::Store { .. })), "but its result is as good");
    bench.finish(33, "a", &old[0]);
    assert!(!bench.renew(34, "b", &new[0], true), "now nobody holds it");
    assert!(matches!(bench.admit("b", &new[0]), Ok(Admission::Compare { stored: DIGEST, .. })));
}

#[test]
fn renewed_leases_live_on() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    assert!(bench.renew(20, "a", &lease[0], true));
    assert_eq!(bench.farm.expire(seconds(24)), 0);
    assert_eq!(bench.farm.expire(seconds(29)), 0);
    for second in (30..50).step_by(4) {
        assert_eq!(bench.farm.expire(seconds(second)), 0);
    }
    assert_eq!(bench.farm.expire(seconds(50)), 1);
}

#[test]
fn a_guessed_token_is_worth_nothing() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    let forged = LeaseKey { token: Token(99), ..lease[0].key };
    assert!(bench.farm.failed(seconds(1), &worker("b"), &forged, "sabotage").is_err());
    assert!(bench.farm.failed(seconds(1), &worker("b"), &lease[0].key, "another's").is_err());
    bench.farm.hand_back(&[forged]);
    assert_eq!(bench.status().jobs_leased, 1);
}

#[test]
fn a_job_is_given_up_after_the_allowed_failures_with_all_reasons() {
    let mut bench = Bench::new(&[]);
    let first = bench.acquire(0, "a", 1);
    bench.farm.failed(seconds(1), &worker("a"), &first[0].key, "boom").unwrap();
    assert!(bench.farm.take_effects().is_empty());
    let second = bench.acquire(1, "b", 1);
    assert_eq!(second[0].key.job, first[0].key.job);
    assert!(bench.reasons(1).contains(&"RETRYING"));
    bench.farm.failed(seconds(2), &worker("b"), &second[0].key, "bang").unwrap();
    let reason = "attempt 1: boom; attempt 2: bang".to_owned();
    let (dictionary, job) = (DictionaryId(1), first[0].key.job);
    assert_eq!(bench.farm.take_effects(), [Effect::GiveUp { dictionary, job, reason, quarantined: false }]);
    for lease in bench.acquire(2, "a", 10) {
        bench.finish(3, "a", &lease);
    }
    assert_eq!(bench.state(), DictionaryState::Failed);
    assert!(bench.reasons(3).contains(&"JOBS_GIVEN_UP"));
    assert_eq!(bench.farm.retry(DictionaryId(1)), 1);
    assert_eq!(job_of(&bench.acquire(4, "c", 10)), [job]);
}

#[test]
fn only_a_job_that_was_running_is_blamed_for_its_workers_death() {
    let mut bench = Bench::new(&[]);
    for round in 0..2 {
        let at = 100 * round;
        bench.farm.expire(seconds(at));
        let leases = bench.acquire(at, "a", 2);
        assert_eq!(job_of(&leases), [2, 1], "the longest first");
        assert!(bench.renew(at, "a", &leases[0], true));
        assert!(bench.renew(at, "a", &leases[1], false));
        // The process dies; another one comes in its place.
        for second in (at + 4..at + 40).step_by(4) {
            bench.farm.expire(seconds(second));
        }
        bench.farm.register(seconds(at + 40), worker("a"), Origin(10 + round as i64), about("a")).unwrap();
    }
    let status = bench.status();
    assert_eq!(status.failed.len(), 1);
    assert_eq!((status.failed[0].job, status.failed[0].quarantined), (2, true));
    assert!(status.failed[0].reason.contains("worker a fell silent"), "{}", status.failed[0].reason);
    assert_eq!(job_of(&bench.acquire(300, "b", 9)), [1, 0], "the others go on");
}

#[test]
fn a_worker_that_comes_back_takes_the_blame_from_its_jobs() {
    let mut bench = Bench::new(&[]);
    for round in 0..5 {
        let at = 100 * round;
        let lease = bench.acquire(at, "a", 1);
        assert_eq!(job_of(&lease), [2], "it was not given up");
        bench.farm.expire(seconds(at));
        assert!(bench.renew(at, "a", &lease[0], true));
        for second in (at + 4..at + 40).step_by(4) {
            bench.farm.expire(seconds(second));
        }
        assert!(bench.renew(at + 50, "a", &lease[0], true), "nobody else has it: it goes on");
        bench.farm.hand_back(&[lease[0].key]);
        bench.farm.expire(seconds(at + 54));
    }
}

#[test]
fn a_coordinator_that_was_stopped_itself_blames_nobody() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    bench.farm.expire(seconds(1));
    assert_eq!(bench.farm.expire(seconds(1000)), 0, "it was away for 999 s, not the worker");
    assert!(bench.renew(1001, "a", &lease[0], true));
}

#[test]
fn leases_survive_a_restart_of_the_coordinator() {
    let mut before = Bench::new(&[]);
    let lease = before.acquire(0, "a", 1);
    let mut after = Bench::new(&[]);
    assert!(after.renew(0, "a", &lease[0], true), "the part waits: it is the worker's again");
    assert!(!job_of(&after.acquire(1, "b", 9)).contains(&lease[0].key.job));
    let other_grid = vec![(lease[0].key, true, DIGEST)];
    let lost = after.farm.renew(seconds(1), &worker("b"), other_grid).unwrap().0;
    assert_eq!(lost.len(), 1, "what is computed must be what is wanted");
}

#[test]
fn handing_back_blames_nobody() {
    let mut bench = Bench::new(&[]);
    for _ in 0..5 {
        let lease = bench.acquire(0, "a", 1);
        bench.farm.hand_back(&[key(&lease[0])]);
    }
    assert_eq!(bench.acquire(0, "a", 10).len(), 3);
    assert_eq!(bench.state(), DictionaryState::Running);
}

#[test]
fn a_worker_that_leaves_frees_also_what_it_has_not_heard_of() {
    let mut bench = Bench::new(&[]);
    bench.acquire(0, "a", 2);
    bench.farm.leave(&worker("a"));
    assert_eq!(bench.acquire(1, "b", 10).len(), 3);
    let late = bench.farm.acquire(seconds(2), &worker("a"), 1, &mut bench.chance);
    assert!(late.is_err(), "one that has left gets no more");
}

#[test]
fn a_draining_worker_gets_nothing_and_is_told() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    assert_eq!(bench.farm.drain("nobody").unwrap_err(), "no worker has this id or label");
    assert_eq!(bench.farm.drain("a").unwrap(), worker("a"));
    let grant = bench.farm.acquire(seconds(1), &worker("a"), 5, &mut bench.chance).unwrap();
    assert!(grant.drain && grant.leases.is_empty());
    assert!(bench.renew(2, "a", &lease[0], true), "what it has it may finish");
}

#[test]
fn priorities_and_desires_decide_what_is_given_out() {
    let mut bench = Bench::new(&[]);
    let second =
        StoredDictionary { id: DictionaryId(2), name: DictionaryName::new("e").unwrap(), ..stored() };
    bench.farm.add_dictionary(Dictionary::new(second, &[]));
    assert_eq!(bench.acquire(0, "a", 1)[0].key.dictionary, DictionaryId(1));
    bench.farm.set_priority(DictionaryId(2), 5);
    assert_eq!(bench.acquire(0, "a", 1)[0].key.dictionary, DictionaryId(2));
    assert!(bench.reasons(0).contains(&"HIGHER_PRIORITY"));
    bench.farm.set_desire(DictionaryId(2), Desire::Pause, String::new());
    assert_eq!(bench.acquire(0, "a", 1)[0].key.dictionary, DictionaryId(1));
    bench.farm.set_desire(DictionaryId(1), Desire::Cancel, "enough".to_owned());
    assert!(bench.acquire(0, "a", 9).is_empty());
    assert_eq!((bench.state(), bench.status().reason.as_str()), (DictionaryState::Cancelled, "enough"));
    bench.farm.set_desire(DictionaryId(1), Desire::Run, String::new());
    assert_eq!(bench.acquire(1, "a", 9).len(), 3, "what was out when it was cancelled is out no more");
}

#[test]
fn a_straggler_gets_a_second_copy_and_the_first_result_counts() {
    let mut bench = Bench::new(&[]);
    let leases = bench.acquire(0, "a", 3);
    bench.finish(1, "a", &leases[1]);
    bench.finish(1, "a", &leases[2]);
    bench.farm.expire(seconds(4));
    assert!(bench.acquire(4, "b", 1).is_empty(), "not yet");
    bench.farm.expire(seconds(9));
    bench.farm.expire(seconds(14));
    bench.farm.expire(seconds(18));
    assert!(bench.acquire(18, "a", 1).is_empty(), "not a second copy for the same worker");
    let copy = bench.acquire(18, "b", 1);
    assert_eq!(copy[0].key.job, leases[0].key.job);
    bench.farm.expire(seconds(19));
    assert!(bench.acquire(19, "c", 1).is_empty(), "two are enough");
    bench.finish(20, "b", &copy[0]);
    assert_eq!(bench.state(), DictionaryState::Done);
    assert!(!bench.renew(20, "a", &leases[0], true), "the slow one is told to stop");
}

#[test]
fn a_wrong_result_is_found_by_a_check_and_settled_by_a_third_worker() {
    let mut bench = Bench::with_checks(&[], 1.0);
    let wrong = Digest::from_bytes([9; 32]);
    let lease = bench.acquire(0, "a", 1);
    bench.finish_with(1, "a", &lease[0], wrong);
    assert!(!job_of(&bench.acquire(2, "a", 1)).contains(&lease[0].key.job), "not its own result");
    let check = bench.acquire(2, "b", 1);
    assert_eq!(check[0].key.job, lease[0].key.job);
    assert!(!bench.farm.compared(origin("b"), &check[0].key, wrong, DIGEST));
    assert!(bench.reasons(2).contains(&"DISPUTED"));
    assert!(bench.farm.take_effects().is_empty(), "one against one decides nothing");
    let third = bench.acquire(3, "c", 1);
    assert_eq!(third[0].key.job, lease[0].key.job);
    bench.farm.compared(origin("c"), &third[0].key, wrong, DIGEST);
    let effects = bench.farm.take_effects();
    assert!(matches!(&effects[..], [Effect::Fence { worker: Origin(1), .. }]), "{effects:?}");
    let fenced = bench.farm.acquire(seconds(4), &worker("a"), 1, &mut bench.chance).unwrap_err();
    assert!(matches!(fenced, DispatchError::Fenced(_)));
    let again = bench.farm.register(seconds(5), worker("z"), Origin(1), about("z"));
    assert!(again.is_err(), "the same process does not come in by another door");
    bench.farm.reopen(DictionaryId(1), &[lease[0].key.job]);
    assert!(job_of(&bench.acquire(6, "b", 9)).contains(&lease[0].key.job), "its records are computed again");
}

#[test]
fn equal_results_agree_and_a_worker_that_contradicts_itself_is_fenced_off() {
    let mut bench = Bench::with_checks(&[], 1.0);
    let lease = bench.acquire(0, "a", 1);
    bench.finish(1, "a", &lease[0]);
    assert!(bench.farm.compared(origin("a"), &lease[0].key, DIGEST, DIGEST), "its own repetition");
    let check = bench.acquire(2, "b", 1);
    assert_eq!(check[0].key.job, lease[0].key.job, "which proves nothing: the check is still wanted");
    assert!(bench.farm.compared(origin("b"), &check[0].key, DIGEST, DIGEST));
    assert_eq!(bench.farm.checks(), (1, 0, 0));
    bench.farm.compared(origin("a"), &lease[0].key, DIGEST, Digest::from_bytes([1; 32]));
    assert!(matches!(&bench.farm.take_effects()[..], [Effect::Fence { worker: Origin(1), .. }]));
}

#[test]
fn a_divided_job_is_given_out_block_by_block() {
    let mut divided = stored();
    let axes = Axes {
        sigma_t_per_mm: vec![1.0],
        albedo: vec![0.5],
        g: vec![0.0],
        thickness_mm: vec![1.0],
        sample_ior: vec![1.5],
    };
    let grid = Grid::new(Scene::paper(), axes, Walks::new(2_500_000).unwrap(), 1, false).unwrap();
    divided.grid_digest = Digest::of_grid(&grid);
    divided.grid = Arc::new(grid);
    let mut bench = Bench::new(&[]);
    bench.farm.remove_dictionary(DictionaryId(1));
    bench.farm.add_dictionary(Dictionary::new(divided, &[]));
    let leases = bench.acquire(0, "a", 2);
    assert_eq!(leases.iter().map(|l| l.job.block()).collect::<Vec<_>>(), [Some(0), Some(1)]);
    let last = bench.acquire(0, "b", 5);
    assert_eq!(last.iter().map(|l| l.job.block()).collect::<Vec<_>>(), [Some(2)]);
    arrive("b", &last[0], |arrived| bench.farm.part_finished(seconds(1), arrived));
    assert!(matches!(bench.admit("b", &last[0]), Ok(Admission::Repeated { .. })));
    bench.farm.expire(seconds(4));
    bench.farm.hand_back(&[leases[0].key]);
    assert_eq!(bench.acquire(5, "c", 5)[0].job.block(), Some(0));
    bench.finish(6, "c", &leases[0]);
    assert_eq!(bench.state(), DictionaryState::Done);
}

#[test]
fn more_walks_begin_the_job_again() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    let more = Walks::new(500_000).unwrap();
    arrive("a", &lease[0], |arrived| bench.farm.prolong(seconds(1), arrived, more));
    assert!(bench.admit("a", &lease[0]).is_err(), "what was computed with fewer walks is not wanted");
    let again = bench.acquire(2, "b", 1);
    assert_eq!((again[0].key.job, again[0].job.walks().get()), (lease[0].key.job, 500_000));
}

#[test]
fn what_is_missing_is_explained() {
    let mut bench = Bench::new(&[]);
    assert_eq!(bench.reasons(0), ["WAITING"]);
    assert_eq!(bench.reasons(100), ["WORKERS_SILENT", "WAITING"]);
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

fn key(lease: &Lease) -> LeaseKey {
    lease.key
}

#[test]
fn what_is_held_stays_held_when_other_jobs_begin_again() {
    let mut bench = Bench::new(&[]);
    let leases = bench.acquire(0, "a", 2);
    bench.finish(1, "a", &leases[0]);
    bench.farm.reopen(DictionaryId(1), &[leases[0].key.job]);
    let all = bench.acquire(2, "b", 9);
    assert!(!job_of(&all).contains(&leases[1].key.job), "no part is computed by two: {all:?}");
    assert_eq!(bench.status().jobs_leased, 3);
}

#[test]
fn what_was_leased_before_a_pause_is_finished_and_nothing_else_is_given_out() {
    let mut bench = Bench::new(&[]);
    let leases = bench.acquire(0, "a", 3);
    bench.finish(1, "a", &leases[1]);
    bench.finish(1, "a", &leases[2]);
    for second in (4..=20).step_by(4) {
        bench.farm.expire(seconds(second));
    }
    bench.farm.set_desire(DictionaryId(1), Desire::Pause, String::new());
    assert!(bench.acquire(20, "b", 9).is_empty(), "no second copy either");
    assert!(matches!(bench.admit("a", &leases[0]), Ok(Admission::Store { .. })));
}

#[test]
fn a_result_that_nobody_wants_ends_its_lease_without_blame() {
    let mut bench = Bench::new(&[]);
    for second in (0..20).step_by(4) {
        let lease = bench.acquire(second, "a", 1);
        assert!(bench.renew(second, "a", &lease[0], true));
        assert!(bench.farm.admit(seconds(second), &worker("a"), &lease[0].key, DIGEST).is_err());
        assert_eq!(bench.status().jobs_leased, 0);
    }
}

#[test]
fn a_part_whose_result_is_being_checked_is_not_late() {
    let mut bench = Bench::with_checks(&[], 1.0);
    let leases = bench.acquire(0, "a", 3);
    bench.finish(1, "a", &leases[1]);
    bench.finish(1, "a", &leases[2]);
    for second in (4..=20).step_by(4) {
        bench.farm.expire(seconds(second));
    }
    bench.finish(20, "a", &leases[0]);
    assert_eq!(bench.acquire(20, "b", 3).len(), 3, "the checks");
    assert!(bench.acquire(20, "c", 3).is_empty());
}

#[test]
fn of_two_copies_that_ask_for_more_walks_the_second_changes_nothing() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    let more = Walks::new(500_000).unwrap();
    arrive("a", &lease[0], |arrived| bench.farm.prolong(seconds(1), arrived, more));
    let again = bench.acquire(2, "b", 1);
    arrive("a", &lease[0], |arrived| bench.farm.prolong(seconds(3), arrived, more));
    assert!(bench.renew(4, "b", &again[0], true));
    assert!(!job_of(&bench.acquire(5, "c", 9)).contains(&again[0].key.job));
}

#[test]
fn a_worker_cannot_take_up_a_part_with_the_token_of_another_lease() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    let other = bench.acquire(0, "b", 2);
    bench.farm.hand_back(&[other[0].key]);
    let forged = LeaseKey { token: lease[0].key.token, attempt: u32::MAX, ..other[0].key };
    let held = vec![(forged, true, other[0].job.identity())];
    assert_eq!(bench.farm.renew(seconds(1), &worker("a"), held).unwrap().0, [forged]);
    assert_eq!(bench.acquire(2, "c", 1)[0].key.attempt, 2);
}

#[test]
fn a_worker_that_was_forgotten_and_comes_back_takes_the_blame_from_its_jobs() {
    let mut bench = Bench::new(&[]);
    for round in 0..3 {
        let at = 1000 * round;
        let id = format!("a{round}");
        bench.farm.register(seconds(at), worker(&id), Origin(7), about("a")).unwrap();
        bench.farm.expire(seconds(at));
        let lease = bench.acquire(at, &id, 1);
        assert_eq!(job_of(&lease), [2], "it was not given up");
        assert!(bench.renew(at, &id, &lease[0], true));
        for second in (at + 4..at + 800).step_by(4) {
            bench.farm.expire(seconds(second));
        }
    }
}

#[test]
fn blocks_that_the_store_has_forgotten_are_computed_again() {
    let mut divided = stored();
    let axes = Axes {
        sigma_t_per_mm: vec![1.0],
        albedo: vec![0.5],
        g: vec![0.0],
        thickness_mm: vec![1.0],
        sample_ior: vec![1.5],
    };
    let walks = Walks::new(2_500_000).unwrap();
    divided.grid = Arc::new(Grid::new(Scene::paper(), axes, walks, 1, false).unwrap());
    divided.grid_digest = Digest::of_grid(&divided.grid);
    let mut bench = Bench::new(&[]);
    bench.farm.remove_dictionary(DictionaryId(1));
    bench.farm.add_dictionary(Dictionary::new(divided, &[]));
    let leases = bench.acquire(0, "a", 2);
    arrive("a", &leases[0], |arrived| bench.farm.part_finished(seconds(1), arrived));
    bench.farm.parts_stored(DictionaryId(1), 0, walks, &[2].into());
    let left: Vec<_> = bench.acquire(2, "b", 9).iter().map(|l| l.key.part).collect();
    assert_eq!(left, [0], "block 1 is held, block 2 is there");
}
