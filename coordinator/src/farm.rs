//! Implements the operations of the coordinator, each once. They connect dispatch, store and fit.

mod asked_grid;
mod backup;
mod completion;
mod effects;
mod events;
mod export;
mod fit_cache;
mod inspection;
mod judge;
mod leasing;
mod manage;
mod measurements;
mod records;
mod result_room;
mod result_stream;
mod scheduler;
mod shared;
mod snapshot;
#[cfg(test)]
mod tests;
mod upkeep;
mod watch;
mod watch_jobs;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use farm_proto::DictionaryName;
use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::status::{DictionaryStatus, WorkerStatus};
use optics_model::{Grid, Invalid};
use tokio::time::Instant;

use crate::actor::Actor;
use crate::clock::random_secret;
use crate::config::Config;
use crate::dispatch::{Dictionary, DispatchError, Dispatcher, EventKind, Period, Settings};
use crate::metrics::Metrics;
use crate::quota::Exhausted;
use crate::store::{Store, StoreError};
use crate::stored::Machine;
pub(crate) use backup::{Backup, BackupPart};
use events::Recorder;
pub(crate) use export::Export;
use fit_cache::FitCache;
pub use fit_cache::load_dictionary;
pub(crate) use leasing::{Versions, WorkerEnd};
pub(crate) use measurements::NewMeasurement;
use result_room::ResultRoom;
pub(crate) use result_stream::{Header, MESSAGE_BYTES, Piece, Refusal};
use scheduler::Scheduler;
pub(crate) use watch::Watch;
pub(crate) use watch_jobs::{JobRun, JobWatch};

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
    #[error("dictionary {name} was deleted while it was watched")]
    Deleted { name: DictionaryName },
    #[error("dictionary {name} belongs to {}: only its owner and admins may change it", owner_of(owner))]
    NotYours { name: DictionaryName, owner: String },
    #[error("dictionary {name} exists with another grid or physics version: choose another name")]
    NameTaken { name: DictionaryName },
    #[error("dictionary {name} is not complete: {done} of {total} records are done")]
    NotComplete { name: DictionaryName, done: usize, total: usize },
    #[error(
        "dictionary {name} is too large to fit with: {channels} of its channels take {mib} MiB of memory, {limit_mib} are \
         allowed (request fewer channels, or raise --fit-memory (FARM_FIT_MEMORY) of farm-coordinator)"
    )]
    TooLarge { name: DictionaryName, channels: usize, mib: usize, limit_mib: usize },
    #[error("this worker {does} version {found}, the coordinator version {own}: install the same")]
    OtherVersion { does: &'static str, found: u32, own: u32 },
    #[error("dictionary {name} is {state}: {allowed}")]
    WrongState { name: DictionaryName, state: &'static str, allowed: &'static str },
    #[error("storing a result failed")]
    Broken,
    #[error("internal error: see the coordinator's log, and please report it with this request")]
    Defect,
    #[error(transparent)]
    Quota(#[from] Exhausted),
    #[error("measurement {id} does not exist: it may have been deleted")]
    NoMeasurement { id: String },
    #[error("measurement {id} belongs to {}: only its owner and admins may change it", owner_of(owner))]
    OthersMeasurement { id: String, owner: String },
    #[error("reading the backup: {0}")]
    Backup(std::io::Error),
    #[error("the coordinator is stopping")]
    Stopping,
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

fn owner_of(owner: &str) -> &str {
    if owner.is_empty() { "nobody" } else { owner }
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
    /// Numbers of results that the coordinator has computed too: equal, unequal, and waiting.
    pub checks: (u64, u64, usize),
    pub store_fault: Option<String>,
}

#[derive(Debug)]
pub(crate) struct Farm {
    store: Store,
    scheduler: Scheduler,
    /// Keeps changes of one dictionary from racing.
    managing: tokio::sync::Mutex<()>,
    fits: FitCache,
    results: ResultRoom,
    /// The time of the last backup.
    last_backup: Mutex<Option<Instant>>,
    /// The reason why the last result could not be stored.
    store_fault: Mutex<Option<String>>,
}

impl Farm {
    pub(crate) async fn load(
        store: Store,
        config: &Config,
        metrics: Metrics,
    ) -> Result<Arc<Self>, StoreError> {
        let dispatcher = dispatcher_of(&store, config).await?;
        let ids: Vec<_> = dispatcher.schedule().dictionaries().map(Dictionary::id).collect();
        // The coordinator's own machine, as the author of the records that it computes itself.
        let own = store.register_worker(&Machine::default(), "coordinator").await?;
        let (scheduler, orders) = Scheduler::new(dispatcher, Recorder::start(store.clone()), metrics);
        let farm = Arc::new(Self {
            store,
            scheduler,
            managing: tokio::sync::Mutex::new(()),
            fits: FitCache::new(config.fit_memory_bytes),
            results: ResultRoom::default(),
            last_backup: Mutex::default(),
            store_fault: Mutex::default(),
        });
        tokio::spawn(effects::perform(Arc::downgrade(&farm), orders));
        tokio::spawn(upkeep::keep(Arc::downgrade(&farm)));
        tokio::spawn(judge::judge(Arc::downgrade(&farm), config.recompute, own));
        let shared = farm.store.ledger().shared().await;
        for id in ids {
            farm.find_blocks(&shared, id).await?;
            farm.take_over_done(&shared, id).await?;
        }
        drop(shared);
        Ok(farm)
    }

    /// Records the event that the farm can be reached from now on.
    pub(crate) fn started(&self) {
        self.scheduler.note(
            &Actor::default(),
            EventKind::CoordinatorStarted,
            format!("version {}", env!("CARGO_PKG_VERSION")),
        );
    }

    pub(crate) fn metrics(&self) -> &Metrics {
        self.scheduler.metrics()
    }

    pub(crate) fn store(&self) -> &Store {
        &self.store
    }

    pub(crate) fn status(&self, name: &DictionaryName) -> Result<DictionaryStatus> {
        self.scheduler.query(|d, now| Ok(d.status_of(now, named(d, name)?)))
    }

    /// Dictionaries in the order of their numbers, from the one after `after` on.
    pub(crate) fn statuses(&self, after: DictionaryId, most: usize) -> Vec<(DictionaryId, DictionaryStatus)> {
        self.scheduler.query(|dispatcher, now| {
            let rest = dispatcher.schedule().dictionaries().filter(|d| d.id() > after);
            rest.take(most).map(|d| (d.id(), dispatcher.status_of(now, d))).collect()
        })
    }

    /// Workers in the order of their ids, from the one after `after` on.
    pub(crate) fn workers(&self, after: &WorkerId, most: usize) -> Vec<WorkerStatus> {
        self.scheduler.query(|dispatcher, now| dispatcher.workers(now, after, most))
    }

    pub(crate) fn overview(&self) -> Overview {
        let database_bytes = self.store.bytes();
        let store_fault = self.store_fault();
        self.scheduler.query(|dispatcher, now| {
            let (jobs_pending, jobs_leased) = dispatcher.schedule().load();
            let (workers, threads) = dispatcher.roster().strength();
            Overview {
                jobs_pending,
                jobs_leased,
                jobs_done: dispatcher.schedule().jobs_done(),
                dictionaries: dispatcher.schedule().dictionaries().count(),
                workers,
                threads,
                uptime_ms: now.as_millis() as u64,
                database_bytes,
                checks: dispatcher.verification().counts(),
                store_fault,
            }
        })
    }

    /// The work that was finished in each period of the last hour, and the time since the start.
    pub(crate) fn paces(&self) -> (Vec<Period>, Duration) {
        self.scheduler.query(|dispatcher, now| (dispatcher.schedule().paces(now), now))
    }

    /// The reason why the last result could not be stored, if it could not.
    pub(crate) fn store_fault(&self) -> Option<String> {
        self.store_fault.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Writes all pending data and closes the database.
    pub(crate) async fn close(&self) {
        self.scheduler.close().await;
        self.give_back_room_at_end().await;
        self.store.close().await;
    }

    /// Number and grid of a dictionary.
    fn found(&self, name: &DictionaryName) -> Result<(DictionaryId, Arc<Grid>)> {
        self.scheduler.query(|dispatcher, _| {
            let dictionary = named(dispatcher, name)?;
            Ok((dictionary.id(), dictionary.grid().clone()))
        })
    }
}

/// Builds the dispatcher from the store.
async fn dispatcher_of(store: &Store, config: &Config) -> Result<Dispatcher, StoreError> {
    let mut dispatcher = Dispatcher::new(Settings {
        lease: config.lease,
        max_attempts: config.max_attempts,
        check_share: config.check_share,
        secret: store.secret(random_secret()).await?,
    });
    for machine in store.machines().await? {
        dispatcher.roster_mut().remember_machine(machine);
    }
    for stored in store.dictionaries().await? {
        let ended = store.ended_jobs(stored.id, &stored.grid).await?;
        let mut dictionary = Dictionary::new(stored, &ended);
        if config.holds_unfinished {
            dictionary.hold();
        }
        if !dictionary.is_active() && dictionary.open_jobs() > 0 {
            let (name, state) = (dictionary.name(), dictionary.state().as_str());
            tracing::info!(%name, state, reason = dictionary.reason(), "not continued");
        }
        dispatcher.take_up_dictionary(dictionary);
    }
    for check in store.open_checks().await? {
        dispatcher.remember_check(check);
    }
    Ok(dispatcher)
}

/// The dictionary of a name.
fn named<'a>(dispatcher: &'a Dispatcher, name: &DictionaryName) -> Result<&'a Dictionary> {
    let schedule = dispatcher.schedule();
    schedule.by_name(name).ok_or_else(|| {
        let known = schedule.dictionaries().take(10).map(|d| d.name().to_string()).collect();
        FarmError::NotFound { name: name.to_string(), known }
    })
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
