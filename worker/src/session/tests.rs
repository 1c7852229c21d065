//! Registration, and calls under faults. The clock is paused: it advances when all tasks wait.

use tonic::Code;

use super::*;
use crate::leases::SetSwitch;
use crate::testing::{Answer, Call, Coordinator, Method, hold, job, lease, open, session};

const LEASE: Duration = Duration::from_secs(30);

/// Registration waits for a coordinator that is away, and the wait can be ended.
#[tokio::test(start_paused = true)]
async fn registration_waits_for_the_coordinator() {
    for comes_back in [true, false] {
        let (coordinator, shutdown) = (Coordinator::start(), CancellationToken::new());
        coordinator.set_down(true);
        let (session, ()) = tokio::join!(open(&coordinator, Arc::default(), &shutdown), async {
            tokio::time::sleep(Duration::from_hours(1)).await;
            if comes_back { coordinator.set_down(false) } else { shutdown.cancel() }
        });
        assert_eq!(session.unwrap().map(|session| session.lease()), comes_back.then_some(LEASE));
        let registrations = coordinator.calls(Call::register);
        let seen: Vec<_> = registrations.iter().map(|r| (r.label.as_str(), r.threads)).collect();
        assert_eq!(seen, if comes_back { vec![("test", 2)] } else { vec![] });
    }
}

/// A worker that is refused ends with the reason.
#[tokio::test(start_paused = true)]
async fn refused_worker_ends_with_the_reason() {
    let coordinator = Coordinator::start();
    let refusal = Status::failed_precondition("physics version 1 and 2 differ: install the same");
    coordinator.answer(Method::Register, Answer::Error(refusal));
    let error = open(&coordinator, Arc::default(), &CancellationToken::new()).await.unwrap_err();
    assert!(error.to_string().ends_with("install the same"), "{error}");
    assert_eq!(coordinator.calls(Call::register).len(), 1);
}

/// A worker that is unknown registers again. Its renewal names the leases that it holds, and which of them run.
#[tokio::test(start_paused = true)]
async fn unknown_worker_registers_and_renews() {
    let coordinator = Coordinator::start();
    let (session, held) = session(&coordinator).await;
    hold(&held, [false, true]);
    coordinator.restart(LEASE);
    let refused = session.acquire(1, Duration::ZERO).await.unwrap_err();
    assert_eq!(refused.code(), Code::Aborted);
    let registrations = coordinator.calls(Call::register);
    assert_eq!(registrations.len(), 2);
    assert_eq!(registrations[0].instance, registrations[1].instance, "it is the same process");
    let [renewal] = &coordinator.calls(Call::renew)[..] else { panic!("one renewal was expected") };
    assert_eq!(renewal.worker_token, "worker-2");
    let mut renewed: Vec<_> =
        renewal.leases.iter().map(|l| (l.key.clone().unwrap().job, l.running)).collect();
    renewed.sort_unstable();
    assert_eq!(renewed, [(0, false), (1, true)]);
    assert!(renewal.leases.iter().all(|l| l.identity == job(1).identity().as_bytes()));
    session.acquire(1, Duration::ZERO).await.unwrap();
    assert_eq!(coordinator.calls(Call::acquire).last().unwrap().worker_token, "worker-2");
}

/// Calls that find the worker unknown at the same time register it once.
#[tokio::test(start_paused = true)]
async fn concurrent_calls_reregister_once() {
    let coordinator = Coordinator::start();
    let (session, held) = session(&coordinator).await;
    hold(&held, [false]);
    coordinator.restart(LEASE);
    let key = lease(9).key;
    let (acquired, renewed, failed) = tokio::join!(
        session.acquire(1, Duration::ZERO),
        session.renew(held.all()),
        session.fail(&key, "the tracer panicked"),
    );
    assert_eq!(acquired.unwrap_err().code(), Code::Aborted);
    assert_eq!(renewed.unwrap_err().code(), Code::Aborted);
    failed.unwrap();
    // A second registration would free the leases that were announced after the first.
    assert_eq!(coordinator.calls(Call::register).len(), 2);
}

/// Waiting calls are repeated within 50 ms once another call has found the coordinator.
#[tokio::test(start_paused = true)]
async fn waiting_calls_go_when_coordinator_returns() {
    let coordinator = Coordinator::start();
    let (session, held) = session(&coordinator).await;
    hold(&held, [false]);
    coordinator.set_down(true);
    let start = Instant::now();
    let away = Duration::from_mins(10);
    let key = lease(9).key;
    let back = async {
        tokio::time::sleep(away).await;
        coordinator.restart(LEASE);
        coordinator.set_down(false);
        // Another call finds the coordinator, and registers again.
        session.renew(held.all()).await.unwrap_err();
    };
    let delivered = async {
        session.fail(&key, "the tracer panicked").await.unwrap();
        start.elapsed()
    };
    let (delivered, ()) = tokio::join!(delivered, back);
    assert!(delivered < away + Duration::from_millis(50), "{delivered:?}");
}

#[tokio::test(start_paused = true)]
async fn restarted_coordinator_of_another_version_refuses() {
    let coordinator = Coordinator::start();
    let (session, _) = session(&coordinator).await;
    coordinator.restart(LEASE);
    coordinator.answer(Method::Register, Answer::Error(Status::failed_precondition("install the same")));
    let refused = session.acquire(1, Duration::ZERO).await.unwrap_err();
    assert_eq!((refused.code(), refused.message()), (Code::FailedPrecondition, "install the same"));
}

/// Each lease is named once, when leases are renewed and after a new registration.
#[tokio::test(start_paused = true)]
async fn renewals_are_split_at_the_request_limit() {
    let most = RequestLimits::LEASES as usize;
    let coordinator = Coordinator::start();
    let (session, held) = session(&coordinator).await;
    let mut keys: Vec<_> =
        (0..2 * RequestLimits::LEASES + 7).map(|n| LeaseKey { job: n, ..lease(0).key }).collect();
    for key in &keys {
        drop(held.add(*key, job(1).identity(), SetSwitch::new(1)));
    }
    // In the first call and in the last.
    let all = held.all();
    let lost = [all[0].key, all[2 * most + 6].key];
    for key in lost {
        coordinator.lose(key);
    }
    let (reported, drain) = session.renew(all).await.unwrap();
    assert_eq!((reported, drain), (lost.to_vec(), false));
    coordinator.restart(LEASE);
    session.acquire(1, Duration::ZERO).await.unwrap_err();
    let calls = coordinator.calls(Call::renew);
    for calls in [&calls[..3], &calls[3..]] {
        assert_eq!(calls.iter().map(|call| call.leases.len()).collect::<Vec<_>>(), [most, most, 7]);
        let named = calls.iter().flat_map(|call| &call.leases).filter_map(|l| l.key.clone());
        let mut named: Vec<LeaseKey> = named.map(Into::into).collect();
        named.sort_unstable();
        keys.sort_unstable();
        assert_eq!(named, keys);
    }
}

/// Calls that are never answered end: a request for work after its time, leaving soon and after one attempt.
#[tokio::test(start_paused = true)]
async fn unanswered_calls_end() {
    let coordinator = Coordinator::start();
    let (session, _) = session(&coordinator).await;
    coordinator.answer(Method::Acquire, Answer::Never);
    let start = Instant::now();
    session.acquire(1, Duration::from_secs(20)).await.unwrap_err();
    assert!((CALL..2 * CALL).contains(&start.elapsed()), "{:?}", start.elapsed());
    coordinator.answer(Method::HandBack, Answer::Never);
    let start = Instant::now();
    session.leave(vec![lease(1).key]).await.unwrap_err();
    assert!(start.elapsed() < 2 * LEAVE, "{:?}", start.elapsed());
    assert_eq!(coordinator.calls(Call::hand_back).len(), 1);
}
