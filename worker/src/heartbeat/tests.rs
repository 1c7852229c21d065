//! Leases that are renewed, lost and handed over. The clock is paused: it advances when all tasks wait.

use std::collections::BTreeSet;

use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};

use super::*;
use crate::testing::{Answer, Call, Coordinator, Method, hold, lease, session};

const LEASE: Duration = Duration::from_secs(30);

struct Beating {
    coordinator: Coordinator,
    held: Arc<HeldLeases>,
    drain: CancellationToken,
    end: CancellationToken,
    heartbeat: JoinHandle<()>,
}

impl Beating {
    async fn start() -> Self {
        let coordinator = Coordinator::start();
        let (session, held) = session(&coordinator).await;
        let (drain, end) = (CancellationToken::new(), CancellationToken::new());
        let heartbeat = tokio::spawn(beat(session, held.clone(), drain.clone(), end.clone()));
        Self { coordinator, held, drain, end, heartbeat }
    }

    fn beats(&self) -> usize {
        self.coordinator.calls(Call::renew).len()
    }

    /// Renewals within a time from now.
    async fn beats_within(&self, time: Duration) -> usize {
        let before = self.beats();
        sleep(time).await;
        self.beats() - before
    }
}

/// Leases are renewed four times within their duration. A lost lease stops its job and is not renewed any more.
#[tokio::test(start_paused = true)]
async fn leases_are_renewed_four_times() {
    let beating = Beating::start().await;
    let [kept, lost] = hold(&beating.held, [false, true]);
    assert!((39..=41).contains(&beating.beats_within(10 * LEASE).await));
    for left in [2, 1] {
        let renewal = beating.coordinator.calls(Call::renew).pop().unwrap();
        let jobs = renewal.leases.iter().map(|l| (l.key.clone().unwrap().job, l.running));
        assert_eq!(jobs.collect::<BTreeSet<_>>(), [(0, false), (1, true)][..left].iter().copied().collect());
        beating.coordinator.lose(lease(1).key);
        sleep(LEASE).await;
        assert_eq!([kept.is_stopped(), lost.is_stopped()], [false, true]);
    }
}

/// The heartbeat reports the drain to the agent, and running jobs keep their leases.
#[tokio::test(start_paused = true)]
async fn leases_are_renewed_while_draining() {
    let beating = Beating::start().await;
    assert!(!beating.drain.is_cancelled());
    beating.coordinator.drain();
    timeout(LEASE, beating.drain.cancelled()).await.unwrap();
    assert!(beating.beats_within(2 * LEASE).await >= 7, "running jobs keep their leases");
}

/// A renewal without an answer is abandoned in time for another one.
#[tokio::test(start_paused = true)]
async fn unanswered_renewals_leave_time_for_another() {
    let beating = Beating::start().await;
    for _ in 0..20 {
        beating.coordinator.answer(Method::Renew, Answer::Never);
    }
    assert!(beating.beats_within(10 * LEASE).await >= 15, "at least three in two leases");
}

/// Renewals follow the lease duration of a restarted coordinator.
#[tokio::test(start_paused = true)]
async fn renewals_follow_a_new_lease_duration() {
    let beating = Beating::start().await;
    sleep(LEASE).await;
    beating.coordinator.restart(LEASE / 10);
    sleep(LEASE).await;
    assert!((39..=41).contains(&beating.beats_within(LEASE).await));
}

/// The heartbeat ends at once, even during a call.
#[tokio::test(start_paused = true)]
async fn heartbeat_ends_at_once() {
    let beating = Beating::start().await;
    beating.coordinator.answer(Method::Renew, Answer::Never);
    let beats = beating.beats();
    beating.coordinator.wait_for(beats + 1, Call::renew).await;
    beating.end.cancel();
    timeout(Duration::from_millis(1), beating.heartbeat).await.unwrap().unwrap();
}
