//! What the coordinator can do, each operation once: dispatch, store and fit tied together.

mod backup;
mod events;
mod fit_cache;
mod inspection;
mod manage;
mod records;
mod results;
mod shared;
mod snapshot;
#[cfg(test)]
mod tests;
mod work;

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use farm_proto::DictionaryName;
use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::status::{DictionaryStatus, WorkerStatus};
use optics_model::{Grid, Invalid};
use tokio::sync::watch;

use crate::clock::{Clock, Random};
use crate::config::Config;
use crate::dispatch;
use crate::dispatch::{Dictionary, DispatchError, Event, EventKind, Settings};
use crate::metrics::Metrics;
use crate::store::{Store, StoreError};
pub(crate) use backup::Backup;
use events::Recorder;
use fit_cache::FitCache;
pub use fit_cache::load_dictionary;
pub(crate) use records::read_chunk;
pub(crate) use results::Fate;
pub(crate) use work::Versions;

#[derive(Debug, thiserror::Error)]
pub enum FarmError {
    #[error(transparent)]
    Invalid(#[from] Invalid),
    #[error(transparent)]
    Dispatch(#[from] DispatchError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("dictionary {name} does not exist{}", hint(known))]
    NotFound { name: String, known: Vec<String> },
    #[error("dictionary {name} exists with another grid or physics version: choose another name")]
    NameTaken { name: DictionaryName },
    #[error("dictionary {name} is not complete: {done} of {total} records are done")]
    NotComplete { name: DictionaryName, done: usize, total: usize },
    #[error("dictionary {name} is too large to fit with: {bytes} bytes, {limit} are allowed")]
    TooLarge { name: DictionaryName, bytes: usize, limit: usize },
    #[error("this worker {does} version {found}, the coordinator version {own}: install the same")]
    OtherVersion { does: &'static str, found: u32, own: u32 },
    #[error("dictionary {name} is {state}: {allowed}")]
    WrongState { name: DictionaryName, state: &'static str, allowed: &'static str },
    #[error("worker {which:?}: {why}")]
    Worker { which: String, why: String },
    #[error(
        "job {job} of dictionary {name} was damaged on the disk ({what}): it is computed again, try later"
    )]
    Damaged { name: DictionaryName, job: u32, what: String },
    #[error(
        "job {job} of dictionary {name} could not be read ({what}): nothing was deleted; look at the disk, then try again"
    )]
    Unreadable { name: DictionaryName, job: u32, what: String },
}

fn hint(known: &[String]) -> String {
    if known.is_empty() {
        "; there is none yet".to_owned()
    } else {
        format!("; there are: {}", known.join(", "))
    }
}

type Result<T, E = FarmError> = std::result::Result<T, E>;

/// Counts over all dictionaries and workers.
#[derive(Debug, Clone, Default)]
pub(crate) struct Overview {
    pub jobs_pending: usize,
    pub jobs_leased: usize,
    pub jobs_done: u64,
    pub dictionaries: usize,
    pub workers: usize,
    pub threads: u64,
    pub uptime_ms: u64,
    pub database_bytes: u64,
    /// Comparisons between workers: equal, unequal, and waiting.
    pub checks: (u64, u64, usize),
    pub store_fault: Option<String>,
}

#[derive(Debug)]
pub(crate) struct Farm {
    store: Store,
    dispatch: Mutex<dispatch::Dispatcher>,
    /// Held by all while results reach the store and then the dispatcher; alone by whoever forgets records there. So
    /// nothing is noted as stored that was forgotten in between.
    records: tokio::sync::RwLock<()>,
    /// Keeps changes of one dictionary from racing.
    managing: tokio::sync::Mutex<()>,
    clock: Clock,
    fits: FitCache,
    recorder: Recorder,
    metrics: Metrics,
    /// Told whenever there is progress.
    changed: watch::Sender<()>,
    /// Told whenever there is work for workers that wait.
    work: watch::Sender<()>,
    /// Why the last result could not be stored.
    store_fault: Mutex<Option<String>>,
}

impl Farm {
    pub(crate) async fn load(store: Store, config: &Config, metrics: Metrics) -> Result<Self, StoreError> {
        let settings = Settings {
            lease: config.lease,
            max_attempts: config.max_attempts,
            check_share: config.check_share,
        };
        let mut dispatch = dispatch::Dispatcher::new(settings);
        for (worker, reason) in store.fenced_workers().await? {
            dispatch.remember_fence(worker, reason);
        }
        let mut ids = Vec::new();
        for stored in store.dictionaries().await? {
            let ended = store.ended_jobs(stored.id, stored.grid.walks()).await?;
            let dictionary = Dictionary::new(stored, &ended);
            if !dictionary.is_active() && dictionary.open_jobs() > 0 {
                let (name, state) = (dictionary.name(), dictionary.state().as_str());
                tracing::info!(%name, state, reason = dictionary.reason(), "not continued");
            }
            ids.push(dictionary.id());
            dispatch.take_up_dictionary(dictionary);
        }
        let recorder = Recorder::start(store.clone());
        let farm = Self {
            store,
            dispatch: Mutex::new(dispatch),
            records: tokio::sync::RwLock::new(()),
            managing: tokio::sync::Mutex::new(()),
            clock: Clock::start(),
            fits: FitCache::default(),
            recorder,
            metrics,
            changed: watch::channel(()).0,
            work: watch::channel(()).0,
            store_fault: Mutex::default(),
        };
        for id in ids {
            farm.find_blocks(id).await?;
            farm.take_over_done(id).await?;
        }
        Ok(farm)
    }

    /// Notes that the farm can be reached from now on.
    pub(crate) fn started(&self) {
        let version = format!("version {}", env!("CARGO_PKG_VERSION"));
        self.recorder.record("", &Event::of_farm(EventKind::CoordinatorStarted, version));
    }

    pub(crate) fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    pub(crate) fn store(&self) -> &Store {
        &self.store
    }

    /// Wakes up after every change that happens from now on.
    pub(crate) fn changes(&self) -> watch::Receiver<()> {
        self.changed.subscribe()
    }

    /// Wakes up whenever there may be work for a worker that waits.
    pub(crate) fn work(&self) -> watch::Receiver<()> {
        self.work.subscribe()
    }

    pub(crate) fn status(&self, name: &DictionaryName) -> Result<DictionaryStatus> {
        let dispatch = self.dispatch();
        dispatch.status(self.clock.now(), name).ok_or_else(|| not_found(&dispatch, name))
    }

    /// How many of the records of these ranges are done.
    pub(crate) fn finished_records(&self, name: &DictionaryName, ranges: &[Range<usize>]) -> Result<usize> {
        let dispatch = self.dispatch();
        let dictionary = dispatch.by_name(name).ok_or_else(|| not_found(&dispatch, name))?;
        Ok(ranges.iter().map(|range| dictionary.finished_records(range.clone())).sum())
    }

    /// Dictionaries in the order of their numbers, from the one after `after` on, and the number of the last.
    pub(crate) fn statuses(
        &self,
        after: DictionaryId,
        most: usize,
    ) -> (Vec<DictionaryStatus>, Option<DictionaryId>) {
        let (dispatch, now) = (self.dispatch(), self.clock.now());
        let mut rest = dispatch.dictionaries().filter(|d| d.id() > after);
        let page: Vec<&Dictionary> = rest.by_ref().take(most).collect();
        let last = rest.next().and(page.last()).map(|d| d.id());
        (page.into_iter().map(|d| dispatch.status_of(now, d)).collect(), last)
    }

    /// Workers in the order of their ids, from the one after `after` on.
    pub(crate) fn workers(&self, after: &WorkerId, most: usize) -> Vec<WorkerStatus> {
        self.dispatch().workers(self.clock.now(), after, most)
    }

    pub(crate) fn overview(&self) -> Overview {
        let database_bytes = self.store.bytes();
        let store_fault = self.store_fault.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let dispatch = self.dispatch();
        let (jobs_pending, jobs_leased) = dispatch.load();
        let (workers, threads) = dispatch.strength();
        Overview {
            jobs_pending,
            jobs_leased,
            jobs_done: dispatch.jobs_done(),
            dictionaries: dispatch.dictionaries().count(),
            workers,
            threads,
            uptime_ms: self.clock.now().as_millis() as u64,
            database_bytes,
            checks: dispatch.checks(),
            store_fault,
        }
    }

    /// Writes what is still to be written and closes the database.
    pub(crate) async fn close(&self) {
        self.recorder.finish().await;
        self.store.close().await;
    }

    fn dispatch(&self) -> MutexGuard<'_, dispatch::Dispatcher> {
        // Transitions do not panic half-way; a poisoned lock still guards consistent data.
        self.dispatch.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number and grid of a dictionary.
    fn found(&self, name: &DictionaryName) -> Result<(DictionaryId, Arc<Grid>)> {
        let dispatch = self.dispatch();
        let dictionary = dispatch.by_name(name).ok_or_else(|| not_found(&dispatch, name))?;
        Ok((dictionary.id(), dictionary.grid().clone()))
    }
}

fn not_found(dispatch: &dispatch::Dispatcher, name: &DictionaryName) -> FarmError {
    let known = dispatch.dictionaries().take(10).map(|d| d.name().to_string()).collect();
    FarmError::NotFound { name: name.to_string(), known }
}

/// A source of randomness for one call.
fn chance() -> Random {
    Random
}

/// Runs numerics off the async threads; a panic there is passed on.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    finished(tokio::task::spawn_blocking(work)).await
}

/// Runs to the end even if the client goes away in the middle, so that store and dispatch agree.
pub(crate) async fn detached<T: Send + 'static>(work: impl Future<Output = T> + Send + 'static) -> T {
    finished(tokio::spawn(work)).await
}

async fn finished<T>(task: tokio::task::JoinHandle<T>) -> T {
    match task.await {
        Ok(value) => value,
        Err(error) => std::panic::resume_unwind(error.into_panic()),
    }
}
