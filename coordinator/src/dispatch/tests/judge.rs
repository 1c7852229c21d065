//! Tests what the coordinator computes itself, and what follows from its results.

use farm_proto::lease::Lease;
use farm_proto::status::JobState;
use optics_model::Digest;

use super::blocks::divided;
use super::{Bench, DIGEST, FIRST, WRONG, arrive, done, origin};
use crate::dispatch::{Effect, EventKind};
use crate::stored::{Claim, OpenCheck};

/// Machine a has computed a job with the first result, and the second came from machine b.
fn disputed(first: Digest, second: Digest) -> (Bench, Lease) {
    let mut bench = Bench::new(&[]);
    let lease = bench.one(0, "a");
    bench.finish_with(1, "a", &lease, first);
    bench.compare("b", &lease, first, second);
    (bench, lease)
}

fn claim(by: &str, digest: Digest) -> Claim {
    Claim { by: Some(origin(by)), digest }
}

fn notes(bench: &mut Bench) -> Vec<OpenCheck> {
    let noted = |effect| if let Effect::NoteCheck(check) = effect { Some(check) } else { None };
    bench.farm.take_outbox().effects.into_iter().filter_map(noted).collect()
}

/// The wrong one of two machines that disagree is fenced off, whichever came first, and the job has the right records.
#[test]
fn wrong_machine_is_fenced_whichever_came_first() {
    for (first, second, wrong) in [(DIGEST, WRONG, "b"), (WRONG, DIGEST, "a")] {
        let (mut bench, lease) = disputed(first, second);
        assert_eq!((bench.status().jobs_disputed, bench.reasons(1)[1]), (1, "DISPUTED"));
        let verdict = bench.judge(DIGEST).1;
        assert_eq!((verdict.wrong, verdict.stored_is_wrong), (vec![origin(wrong)], first == WRONG));
        assert_eq!((bench.status().jobs_disputed, bench.farm.verification.counts()), (0, (0, 1, 0)));
        assert_eq!(bench.farm.schedule.records_of((FIRST, lease.key.job)), Some(DIGEST));
        assert_eq!(bench.farm.job_states(FIRST)[lease.key.job as usize], JobState::Checked);
        let events = bench.farm.take_outbox().events;
        let fenced: Vec<&str> =
            events.iter().filter(|e| e.kind == EventKind::WorkerFenced).map(|e| &e.worker[..]).collect();
        assert_eq!(fenced, [wrong]);
        assert!(bench.register(2, "again", origin(wrong), super::about(wrong)).is_err(), "it stays outside");
    }
}

/// Several machines with the same wrong result do not outvote an honest one.
#[test]
fn colluding_machines_do_not_outvote_honest_ones() {
    let (mut bench, lease) = disputed(DIGEST, WRONG);
    bench.compare("c", &lease, DIGEST, WRONG);
    assert_eq!(bench.judge(DIGEST).1.wrong, [origin("b"), origin("c")]);
    assert_eq!(bench.farm.schedule.records_of((FIRST, lease.key.job)), Some(DIGEST));
}

/// A right result that is sampled is confirmed, and a machine that contradicts itself later is found.
#[test]
fn confirmed_result_is_not_undone() {
    let mut bench = Bench::with_checks(&[], 1.0);
    let lease = bench.one(0, "a");
    bench.finish(1, "a", &lease);
    assert_eq!(bench.judge(DIGEST).1.wrong, []);
    assert_eq!(bench.farm.verification.counts(), (1, 0, 0));
    bench.compare("a", &lease, DIGEST, WRONG);
    let verdict = bench.judge(DIGEST).1;
    assert!(verdict.wrong == [origin("a")] && !verdict.stored_is_wrong, "{verdict:?}");
    assert_eq!(bench.status().jobs_done, 1);
}

/// After a restart the claims are restored, and the dispute is shown for a dictionary that is otherwise done.
#[test]
fn dispute_survives_a_restart() {
    let (mut bench, _) = disputed(DIGEST, WRONG);
    let noted = notes(&mut bench);
    assert_eq!(noted[0].claims, [claim("a", DIGEST), claim("b", WRONG)]);
    let mut after = Bench::new(&[0, 1, 2].map(|job| done(job, Some(origin("a")), false)));
    after.farm.remember_check(noted[0].clone());
    assert_eq!(after.status().jobs_disputed, 1);
    assert_eq!(after.reasons(0), ["DISPUTED", "DONE"]);
    assert_eq!(after.judge(DIGEST).1.wrong, [origin("b")]);
    let over = OpenCheck { claims: vec![], ..noted[0].clone() };
    assert_eq!(notes(&mut after), [over]);
}

/// Blocks are checked one by one, also once the job is done: with a wrong one all are computed again.
#[test]
fn blocks_are_checked_one_by_one() {
    let mut bench = divided(1.0);
    let leases = bench.acquire(0, "a", 3);
    bench.store_part("a", &leases[0], DIGEST);
    bench.store_part("a", &leases[1], WRONG);
    bench.finish(2, "a", &leases[2]);
    assert_eq!(notes(&mut bench).iter().map(|check| check.block).collect::<Vec<_>>(), [0, 1, 2]);
    let mut judged = Vec::new();
    while bench.farm.verification.counts().2 > 0 {
        let (part, verdict) = bench.judge(DIGEST);
        judged.push((part.part, verdict.stored_is_wrong));
    }
    assert!(judged.contains(&(1, true)) && judged.iter().all(|(block, wrong)| *wrong == (*block == 1)));
    assert_eq!(bench.status().jobs_done, 0);
}

/// When a job gets more walks, the checks of its earlier blocks end.
#[test]
fn more_walks_end_the_old_block_checks() {
    let mut bench = divided(1.0);
    let leases = bench.acquire(0, "a", 2);
    bench.store_part("a", &leases[0], DIGEST);
    assert_eq!(bench.farm.verification.counts(), (0, 0, 1));
    bench.prolong(2, "a", &leases[1], 3_500_000);
    assert_eq!(bench.farm.verification.counts(), (0, 0, 0));
}

/// A block that arrives after its job was given up is checked, since it is used when the job is tried again.
#[test]
fn late_block_of_abandoned_job_is_checked() {
    let mut bench = divided(1.0);
    let late = bench.acquire(0, "a", 2).pop().unwrap();
    for (at, name) in (1..).zip(["b", "c"]) {
        let lease = bench.acquire(at, name, 1).remove(0);
        bench.fail(at, name, &lease);
    }
    assert_eq!(bench.status().failed.len(), 1);
    bench.store_part("a", &late, WRONG);
    assert_eq!(bench.farm.verification.counts(), (0, 0, 1));
}

/// The claims about a part are bounded by the number of machines, and those of a machine that is fenced off are dropped.
#[test]
fn claims_are_bounded_and_withdrawn() {
    let (mut bench, lease) = disputed(DIGEST, WRONG);
    for byte in 0..50 {
        bench.compare("b", &lease, DIGEST, Digest::from_bytes([byte; 32]));
    }
    let other = bench.one(2, "a");
    bench.finish(3, "a", &other);
    bench.compare("b", &other, DIGEST, WRONG);
    let noted = notes(&mut bench);
    assert!(noted.iter().all(|check| check.claims.len() <= 3), "{noted:?}");
    bench.judge(DIGEST);
    let left = notes(&mut bench).into_iter().find(|check| !check.claims.is_empty()).unwrap();
    assert_eq!(left.claims, [claim("a", DIGEST)]);
}

/// A result that comes between a verdict and its end is judged by itself.
#[test]
fn result_during_a_verdict_is_judged_too() {
    let (mut bench, lease) = disputed(DIGEST, WRONG);
    let (part, job) = bench.farm.next_check(&[].into()).unwrap();
    let verdict = bench.farm.verdict(part, &job, DIGEST).unwrap();
    bench.compare("c", &lease, DIGEST, WRONG);
    bench.farm.settle(part, DIGEST, &verdict);
    assert_eq!((verdict.wrong, bench.judge(DIGEST).1.wrong), (vec![origin("b")], vec![origin("c")]));
    assert_eq!(bench.farm.verification.counts(), (0, 2, 0));
}

/// A job whose result differs from another dictionary's records is computed by the coordinator alone, also after a
/// restart.
#[test]
fn conflicting_shared_records_go_to_the_coordinator() {
    let mut bench = Bench::new(&[]);
    let lease = bench.one(0, "a");
    arrive("a", &lease, |arrived| bench.farm.contradict(super::seconds(0), arrived));
    let check = notes(&mut bench).remove(0);
    let mut restarted = Bench::new(&[]);
    restarted.farm.remember_check(check);
    for mut bench in [bench, restarted] {
        assert!(!bench.jobs(1, "b", 9).contains(&lease.key.job), "no machine gets it");
        assert_eq!(bench.status().jobs_disputed, 1);
        assert_eq!(bench.judge(DIGEST).1.wrong, []);
        assert_eq!(bench.farm.job_states(FIRST)[lease.key.job as usize], JobState::Checked);
    }
}

/// If the coordinator does not keep up, a random selection of the sampled results waits.
#[test]
fn waiting_checks_are_bounded() {
    let sigma_t: Vec<f64> = (1..=1100).map(f64::from).collect();
    let mut bench = Bench::of_grid(crate::testing::grid(None, &sigma_t, &[0.5], 5000), 1.0);
    let leases = bench.acquire(0, "a", 1100);
    bench.finish_all(1, "a", &leases);
    assert_eq!(bench.farm.verification.counts(), (0, 0, 1000));
    let waiting = bench.farm.verification.parts();
    let late = waiting.filter(|part| leases[1000..].iter().any(|lease| lease.key.job == part.job)).count();
    assert!((70..110).contains(&late), "{late} of the last hundred, not about 91");
}
