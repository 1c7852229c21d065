//! Tests which votes about results count, and which of them survive a restart.

use farm_proto::lease::Lease;
use optics_model::Digest;

use super::blocks::divided;
use super::{Bench, DIGEST, FIRST, WRONG, arrive, done, on, origin, seconds};
use crate::dispatch::{Admission, Effect};
use crate::stored::{OpenCheck, Origin, Vote};

/// Machine a has computed a job correctly, and machine b has checked it with this result. Machine a has repeated its own
/// result, which proves nothing: the check is still needed.
fn checked(by_b: Digest) -> (Bench, Lease, Lease) {
    let mut bench = Bench::with_checks(&[], 1.0);
    let lease = bench.one(0, "a");
    bench.finish(1, "a", &lease);
    bench.compare("a", &lease, DIGEST, DIGEST);
    let check = bench.one(2, "b");
    assert_eq!(check.key.job, lease.key.job);
    bench.compare("b", &check, DIGEST, by_b);
    (bench, lease, check)
}

fn notes(bench: &mut Bench) -> Vec<OpenCheck> {
    let noted = |effect| if let Effect::NoteCheck(check) = effect { Some(check) } else { None };
    bench.farm.take_outbox().effects.into_iter().filter_map(noted).collect()
}

/// A machine has one vote, regardless of its number of processes.
#[test]
fn one_machine_has_one_vote() {
    let (mut bench, lease, check) = checked(WRONG);
    for name in ["d", "e", "f"] {
        bench.register(1, name, origin("b"), on("b", name)).unwrap();
        assert!(!bench.jobs(3, name, 9).contains(&lease.key.job), "{name} would vote");
    }
    // Nor does it vote with its earlier lease.
    bench.compare("b", &check, DIGEST, WRONG);
    assert!(bench.effects().is_empty(), "no machine is fenced off");
    let third = bench.one(4, "c");
    bench.compare("c", &third, DIGEST, DIGEST);
    assert!(matches!(
        &bench.effects()[..],
        [Effect::Agreed { machine: Origin(3), .. }, Effect::Fence { machine: Origin(2), .. }]
    ));
}

/// Different results from machines without a lease of their own fence no machine. The check that follows decides.
#[test]
fn unrequested_results_do_not_vote() {
    let mut bench = Bench::with_checks(&[], 0.0);
    let lease = bench.one(0, "a");
    bench.finish(1, "a", &lease);
    for name in ["b", "c", "b"] {
        bench.compare(name, &lease, DIGEST, WRONG);
    }
    assert!(bench.effects().is_empty());
    assert_eq!((bench.farm.verification.counts(), bench.status().jobs_disputed), ((0, 0, 1), 0));
    let check = bench.one(2, "c");
    bench.compare("c", &check, DIGEST, DIGEST);
    assert_eq!(bench.farm.verification.counts(), (1, 0, 0));
}

/// A result on which several machines agree is not undone by fewer.
#[test]
fn majority_is_not_undone_by_fewer() {
    let (mut bench, lease, _) = checked(DIGEST);
    assert!(matches!(&bench.effects()[..], [Effect::Agreed { machine: Origin(2), .. }]));
    bench.compare("c", &lease, DIGEST, WRONG);
    let again = bench.one(3, "c");
    assert_eq!(again.key.job, lease.key.job);
    bench.compare("c", &again, DIGEST, WRONG);
    assert!(matches!(&bench.effects()[..], [Effect::Fence { machine: Origin(3), .. }]), "two against one");
    arrive("c", &lease, |arrived| bench.farm.contradict(seconds(4), arrived, None));
    assert!(bench.farm.verification.is_confirmed(&[(FIRST, lease.key.job)]));
}

/// Records that a second machine confirmed stay when the first is fenced, and a third machine checks them.
#[test]
fn confirmed_records_survive_a_fence() {
    let (mut bench, lease, _) = checked(DIGEST);
    bench.farm.take_outbox();
    bench.compare("a", &lease, DIGEST, WRONG);
    let outbox = bench.farm.take_outbox();
    assert!(outbox.work, "another machine checks it");
    let fences = outbox.effects.iter().any(|e| matches!(e, Effect::Fence { machine: Origin(1), .. }));
    assert!(fences, "it contradicts itself");
    assert_eq!(bench.status().jobs_done, 1);
    assert!(!bench.jobs(3, "b", 9).contains(&lease.key.job), "b stands for it now");
    assert_eq!(bench.acquire(3, "c", 1)[0].key.job, lease.key.job);
}

/// After a restart the votes are restored, and the dispute is shown for a dictionary that is otherwise done.
#[test]
fn dispute_survives_a_restart() {
    let (mut bench, _, _) = checked(WRONG);
    let noted = notes(&mut bench);
    let votes = [("a", DIGEST), ("b", WRONG)].map(|(name, digest)| Vote { by: Some(origin(name)), digest });
    assert_eq!(noted[0].votes, votes);
    let mut after = Bench::new(&[0, 1, 2].map(|job| done(job, Some(origin("a")), false)));
    after.farm.remember_check(noted[0].clone());
    assert_eq!(after.status().jobs_disputed, 1);
    assert_eq!(after.reasons(0), ["DISPUTED", "DONE"]);
    assert!(after.acquire(0, "b", 9).is_empty() && after.acquire(0, "a", 9).is_empty());
    let third = after.one(1, "c");
    after.compare("c", &third, DIGEST, WRONG);
    let fenced = after.farm.take_outbox().effects;
    assert!(fenced.iter().any(|e| matches!(e, Effect::Fence { machine: Origin(1), .. })), "{fenced:?}");
    let over = OpenCheck { votes: vec![], ..noted[0].clone() };
    assert!(fenced.contains(&Effect::NoteCheck(over)), "{fenced:?}");
    // The check is about records that no longer exist.
    let mut later = Bench::new(&[]);
    later.farm.remember_check(noted[0].clone());
    assert_eq!((later.status().jobs_disputed, notes(&mut later).len()), (0, 1));
}

/// Blocks are checked one by one, also once the job is done. A dispute about one block leaves the others alone.
#[test]
fn blocks_are_checked_one_by_one() {
    let mut bench = divided(1.0);
    let leases = bench.acquire(0, "a", 3);
    bench.store_part("a", &leases[0], WRONG);
    bench.store_part("a", &leases[1], DIGEST);
    let noted = notes(&mut bench);
    let blocks: Vec<_> = noted.iter().map(|check| check.block).collect();
    assert_eq!(blocks, [0, 1], "they could not be drawn again");
    bench.finish(2, "a", &leases[2]);
    let checks = bench.acquire(3, "b", 9);
    assert_eq!(checks.iter().map(|l| l.job.block()).collect::<Vec<_>>(), [Some(0), Some(1), Some(2)]);
    for (check, agrees) in checks[..2].iter().zip([false, true]) {
        let Ok(Admission::Compare { stored, .. }) = bench.admit("b", check) else { panic!("not compared") };
        assert_eq!(stored == DIGEST, agrees);
        bench.compare("b", check, stored, DIGEST);
        assert_eq!(bench.status().jobs_disputed, 1);
    }
    let third = bench.one(4, "c");
    assert_eq!(third.job.block(), Some(0));
    bench.compare("c", &third, WRONG, DIGEST);
    assert!(matches!(&bench.effects()[..], [Effect::Fence { machine: Origin(1), .. }]));
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
    for (at, name) in (1..).zip(["b", "c", "d", "e", "f"]) {
        if bench.status().failed.is_empty() {
            let lease = bench.acquire(at, name, 1).remove(0);
            bench.fail(at, name, &lease);
        }
    }
    assert_eq!(bench.status().failed.len(), 1);
    bench.store_part("a", &late, WRONG);
    assert_eq!(bench.farm.verification.counts(), (0, 0, 1));
}

/// When a machine is fenced off, the store notes the disputes in which it has voted without its votes.
#[test]
fn withdrawn_votes_are_noted() {
    let (mut bench, lease, _) = checked(WRONG);
    let own = bench.one(3, "b");
    bench.finish(4, "b", &own);
    notes(&mut bench);
    bench.compare("b", &own, DIGEST, WRONG);
    let noted = notes(&mut bench);
    let left = noted.iter().find(|check| check.job == lease.key.job).unwrap();
    assert_eq!(left.votes, [Vote { by: Some(origin("a")), digest: DIGEST }]);
}
