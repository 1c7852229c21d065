//! Serialises access to the dispatcher and publishes the output of each transition.
//!
//! The dispatcher is reached through this type alone. A [`Scheduler::transition`] locks once and then empties the outbox:
//! effects go to the one task that performs them, events to the recorder, counts to the metrics, and the tasks that wait
//! for work or for changes are woken.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};

use super::events::Recorder;
use crate::actor::Actor;
use crate::clock::Clock;
use crate::dispatch::{Count, Dispatcher, Effect, Event, EventKind, Outbox, Purpose};
use crate::metrics::{JobFailure, LeaseKind, Metrics, VerificationOutcome};

/// An order to the task that performs effects.
#[derive(Debug)]
pub(super) enum Order {
    Perform(Effect),
    /// Report that all earlier orders are done.
    Report(oneshot::Sender<()>),
}

#[derive(Debug)]
pub(super) struct Scheduler {
    dispatcher: Mutex<Dispatcher>,
    clock: Clock,
    orders: mpsc::UnboundedSender<Order>,
    /// Effects that were ordered and not performed yet.
    outstanding: AtomicUsize,
    recorder: Recorder,
    metrics: Metrics,
    changed: watch::Sender<()>,
    work: watch::Sender<()>,
}

impl Scheduler {
    /// The scheduler of a dispatcher, and the receiver of the orders that its decisions produce.
    pub fn new(
        dispatcher: Dispatcher,
        recorder: Recorder,
        metrics: Metrics,
    ) -> (Self, mpsc::UnboundedReceiver<Order>) {
        let (orders, receiver) = mpsc::unbounded_channel();
        let scheduler = Self {
            dispatcher: Mutex::new(dispatcher),
            clock: Clock::start(),
            orders,
            outstanding: AtomicUsize::new(0),
            recorder,
            metrics,
            changed: watch::channel(()).0,
            work: watch::channel(()).0,
        };
        (scheduler, receiver)
    }

    /// Changes the state and publishes the output of the change.
    pub fn transition<T>(&self, change: impl FnOnce(&mut Dispatcher, Duration) -> T) -> T {
        self.transition_by(&Actor::default(), change)
    }

    /// Changes the state on behalf of an actor, whose name goes into the events.
    pub fn transition_by<T>(&self, actor: &Actor, change: impl FnOnce(&mut Dispatcher, Duration) -> T) -> T {
        let (value, outbox) = {
            let mut dispatcher = self.lock();
            let value = change(&mut dispatcher, self.clock.now());
            #[cfg(debug_assertions)]
            dispatcher.check(self.clock.now()).expect("the dispatcher's state is consistent");
            let mut outbox = dispatcher.take_outbox();
            // Under the lock, so that effects are performed in the order in which they were decided.
            for effect in outbox.effects.drain(..) {
                self.outstanding.fetch_add(1, Ordering::SeqCst);
                let _ = self.orders.send(Order::Perform(effect));
            }
            (value, outbox)
        };
        self.publish(actor, outbox);
        value
    }

    /// Looks at the state.
    pub fn query<T>(&self, look: impl FnOnce(&Dispatcher, Duration) -> T) -> T {
        look(&self.lock(), self.clock.now())
    }

    /// Waits until all earlier decisions are durable.
    pub async fn settled(&self) {
        // The usual case: results seldom cause decisions.
        if self.outstanding.load(Ordering::SeqCst) == 0 {
            return;
        }
        let (report, done) = oneshot::channel();
        if self.orders.send(Order::Report(report)).is_ok() {
            let _ = done.await;
        }
    }

    /// Notes that an effect was performed, or deferred.
    pub fn performed(&self) {
        self.outstanding.fetch_sub(1, Ordering::SeqCst);
    }

    /// Records an event that no change of the state has caused.
    pub fn note(&self, actor: &Actor, kind: EventKind, message: impl Into<String>) {
        self.recorder.record(&Event { actor: actor.to_string(), ..Event::of_farm(kind, message) });
    }

    /// Waits until the events so far are stored, but not for long.
    pub async fn settle_events(&self) {
        self.recorder.settle().await;
    }

    pub fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// A receiver that is woken after every change from now on.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.changed.subscribe()
    }

    /// A receiver that is woken whenever there may be work for a waiting worker.
    pub fn work(&self) -> watch::Receiver<()> {
        self.work.subscribe()
    }

    /// Writes all pending effects and events.
    pub async fn close(&self) {
        self.settled().await;
        self.recorder.finish().await;
    }

    fn lock(&self) -> MutexGuard<'_, Dispatcher> {
        // Transitions do not panic half-way; a poisoned lock still guards consistent data.
        self.dispatcher.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn publish(&self, actor: &Actor, outbox: Outbox) {
        for event in outbox.events {
            self.recorder.record(&Event { actor: actor.to_string(), ..event });
        }
        for count in &outbox.counts {
            self.count(*count);
        }
        if outbox.work {
            self.work.send_replace(());
        }
        if outbox.changed {
            self.changed.send_replace(());
        }
    }

    fn count(&self, count: Count) {
        let metrics = &self.metrics;
        match count {
            Count::Granted(Purpose::First) => metrics.leases_granted(LeaseKind::First, 1),
            Count::Granted(Purpose::Retry) => metrics.leases_granted(LeaseKind::Retry, 1),
            Count::Granted(Purpose::Copy) => metrics.leases_granted(LeaseKind::Speculative, 1),
            Count::Expired(leases) => metrics.leases_expired(leases as u64),
            Count::GivenUp { quarantined: false } => metrics.job_failed(JobFailure::Failed),
            Count::GivenUp { quarantined: true } => metrics.job_failed(JobFailure::Quarantined),
            Count::Agreed => metrics.verified(VerificationOutcome::Agreed),
            Count::Disputed => metrics.verified(VerificationOutcome::Disputed),
        }
    }
}
