//! What the coordinator can do, each operation once: dispatch, store and fit tied together.

mod fit_cache;

use std::sync::{Mutex, MutexGuard, PoisonError};

use farm_proto::ids::WorkerId;
use farm_proto::job::{Lease, LeaseKey};
use farm_proto::profile::RecordShape;
use farm_proto::status::{DictionaryStatus, WorkerStatus};
use farm_proto::{DictionaryName, Digest, Grid, Invalid, PHYSICS_VERSION, Record};
use tokio::sync::watch;

use crate::clock::{Clock, random_token};
use crate::config::Config;
use crate::dispatch::{self, Dictionary, DispatchError, Settings};
use crate::fit::FitDictionary;
use crate::store::{Completion, Store, StoreError};
use fit_cache::FitCache;
pub use fit_cache::load_dictionary;

#[derive(Debug, thiserror::Error)]
pub(crate) enum FarmError {
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
    #[error(
        "this worker computes physics version {found}, the coordinator version {PHYSICS_VERSION}: install the same"
    )]
    PhysicsVersion { found: u32 },
    #[error(
        "job {job} is done already, with other records than these: this worker or an earlier one computes wrongly"
    )]
    Conflict { job: u32 },
}

fn hint(known: &[String]) -> String {
    if known.is_empty() {
        "; there is none yet".to_owned()
    } else {
        format!("; there are: {}", known.join(", "))
    }
}

type Result<T, E = FarmError> = std::result::Result<T, E>;

#[derive(Debug)]
pub(crate) struct Farm {
    store: Store,
    dispatch: Mutex<dispatch::Farm>,
    /// Keeps two submissions of one name from racing.
    submitting: tokio::sync::Mutex<()>,
    clock: Clock,
    fits: FitCache,
    /// Told whenever there is new work or progress.
    changed: watch::Sender<()>,
}

impl Farm {
    pub(crate) async fn load(store: Store, config: &Config) -> Result<Self, StoreError> {
        let settings = Settings { lease: config.lease, max_attempts: config.max_attempts };
        let mut dispatch = dispatch::Farm::new(settings);
        for stored in store.dictionaries().await? {
            let ended = store.ended_jobs(stored.id).await?;
            let outdated = stored.grid_digest != Digest::of_grid(&stored.grid);
            let mut dictionary = Dictionary::new(stored, ended);
            if outdated && dictionary.pending() > 0 {
                tracing::warn!(name = %dictionary.name(), "begun with another physics version: it is not continued");
                dictionary.suspend();
            }
            dispatch.add_dictionary(dictionary);
        }
        Ok(Self {
            store,
            dispatch: Mutex::new(dispatch),
            submitting: tokio::sync::Mutex::new(()),
            clock: Clock::start(),
            fits: FitCache::default(),
            changed: watch::channel(()).0,
        })
    }

    pub(crate) fn store(&self) -> &Store {
        &self.store
    }

    /// Wakes up after every change that happens from now on.
    pub(crate) fn changes(&self) -> watch::Receiver<()> {
        self.changed.subscribe()
    }

    /// Creates a dictionary, or finds the one of the same name and grid.
    pub(crate) async fn submit(&self, name: DictionaryName, grid: Grid) -> Result<DictionaryStatus> {
        let _one_at_a_time = self.submitting.lock().await;
        if let Some(existing) = self.dispatch().by_name(&name) {
            if existing.grid_digest() == Digest::of_grid(&grid) {
                return Ok(existing.status());
            }
            return Err(FarmError::NameTaken { name });
        }
        let stored = self.store.create_dictionary(name.clone(), grid, Clock::unix_ms()).await?;
        tracing::info!(%name, jobs = stored.grid.job_count(), records = stored.grid.record_count(), "new dictionary");
        let dictionary = Dictionary::new(stored, Vec::new());
        self.dispatch().add_dictionary(dictionary);
        self.changed.send_replace(());
        self.status(&name)
    }

    pub(crate) fn status(&self, name: &DictionaryName) -> Result<DictionaryStatus> {
        let dispatch = self.dispatch();
        dispatch.status(name).ok_or_else(|| not_found(&dispatch, name))
    }

    pub(crate) fn statuses(&self) -> Vec<DictionaryStatus> {
        self.dispatch().dictionaries().map(Dictionary::status).collect()
    }

    pub(crate) fn workers(&self) -> Vec<WorkerStatus> {
        self.dispatch().workers(self.clock.now())
    }

    /// Jobs that wait and jobs that are leased, over all dictionaries.
    pub(crate) fn job_counts(&self) -> (usize, usize) {
        let dispatch = self.dispatch();
        let sum = |count: fn(&Dictionary) -> usize| dispatch.dictionaries().map(count).sum();
        (sum(Dictionary::pending), sum(Dictionary::leased))
    }

    pub(crate) fn register(
        &self,
        label: String,
        threads: u32,
        physics_version: u32,
    ) -> Result<(WorkerId, Settings)> {
        if physics_version != PHYSICS_VERSION {
            return Err(FarmError::PhysicsVersion { found: physics_version });
        }
        let id = WorkerId(random_token());
        tracing::info!(worker = %id, label, threads, "worker registered");
        let mut dispatch = self.dispatch();
        dispatch.register(self.clock.now(), id.clone(), label, threads);
        Ok((id, dispatch.settings()))
    }

    pub(crate) fn acquire(&self, worker: &WorkerId, max: usize) -> Result<Vec<Lease>> {
        Ok(self.dispatch().acquire(self.clock.now(), worker, max, random_token)?)
    }

    pub(crate) fn renew(&self, worker: &WorkerId, leases: Vec<LeaseKey>) -> Result<Vec<LeaseKey>> {
        Ok(self.dispatch().renew(self.clock.now(), worker, leases)?)
    }

    /// The grid that the records of a completion must belong to, if the lease still counts.
    pub(crate) fn grid_of(&self, key: &LeaseKey) -> Result<Grid> {
        Ok(self.dispatch().check_completion(key)?.grid().clone())
    }

    /// Stores a job's records. True if the same were stored before.
    pub(crate) async fn complete(&self, key: &LeaseKey, records: &[Record]) -> Result<bool> {
        let digest = Digest::of_records(records);
        // The lease may have been lost while the records came in; what decides is the store's transaction.
        let dictionary = self.dispatch().check_completion(key)?.id();
        let completion = self.store.complete_job(dictionary, key.job, digest, records).await?;
        if completion == Completion::Conflict {
            tracing::error!(job = key.job, attempt = key.attempt, "two attempts gave different records");
            return Err(FarmError::Conflict { job: key.job });
        }
        self.dispatch().completed(self.clock.now(), key, digest);
        self.changed.send_replace(());
        Ok(completion == Completion::Duplicate)
    }

    /// Takes leases back; a worker that leaves gives all of its leases back, also those it has not heard of.
    pub(crate) fn hand_back(&self, worker: &WorkerId, leases: &[LeaseKey], leaving: bool) {
        let mut dispatch = self.dispatch();
        dispatch.hand_back(leases);
        if leaving {
            dispatch.leave(worker);
        }
        drop(dispatch);
        self.changed.send_replace(());
    }

    pub(crate) async fn failed(&self, key: &LeaseKey, reason: &str) -> Result<()> {
        let given_up = self.dispatch().reasons_to_give_up(key, reason)?;
        tracing::warn!(
            job = key.job,
            attempt = key.attempt,
            reason,
            given_up = given_up.is_some(),
            "attempt failed"
        );
        if let Some(reasons) = given_up {
            self.store.fail_job(key.dictionary, key.job, &reasons).await?;
        }
        let counted = self.dispatch().failed(key, reason);
        self.changed.send_replace(());
        Ok(counted?)
    }

    pub(crate) fn expire(&self) -> usize {
        let freed = self.dispatch().expire(self.clock.now());
        if freed > 0 {
            self.changed.send_replace(());
        }
        freed
    }

    /// Finished records of a dictionary among the numbers of a range, in order.
    pub(crate) async fn records(
        &self,
        name: &DictionaryName,
        range: std::ops::Range<usize>,
    ) -> Result<Vec<Record>> {
        let (id, shape) = {
            let dispatch = self.dispatch();
            let dictionary = dispatch.by_name(name).ok_or_else(|| not_found(&dispatch, name))?;
            (dictionary.id(), RecordShape::of(dictionary.grid()))
        };
        Ok(self.store.records(id, range, shape).await?)
    }

    /// Answers a question to a complete dictionary, off the async threads.
    pub(crate) async fn ask<T: Send + 'static>(
        &self,
        name: &DictionaryName,
        question: impl FnOnce(&FitDictionary) -> Result<T, Invalid> + Send + 'static,
    ) -> Result<T> {
        let (id, grid) = {
            let dispatch = self.dispatch();
            let dictionary = dispatch.by_name(name).ok_or_else(|| not_found(&dispatch, name))?;
            if !dictionary.is_complete() {
                let status = dictionary.status();
                let (done, total) = (status.records_done(), status.records_total());
                return Err(FarmError::NotComplete { name: name.clone(), done, total });
            }
            (dictionary.id(), dictionary.grid().clone())
        };
        let dictionary = self.fits.get(&self.store, name, id, grid).await?;
        Ok(blocking(move || question(&dictionary)).await?)
    }

    fn dispatch(&self) -> MutexGuard<'_, dispatch::Farm> {
        // Transitions do not panic half-way; a poisoned lock still guards consistent data.
        self.dispatch.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn not_found(dispatch: &dispatch::Farm, name: &DictionaryName) -> FarmError {
    let known = dispatch.dictionaries().take(10).map(|d| d.name().to_string()).collect();
    FarmError::NotFound { name: name.to_string(), known }
}

/// Records of a grid that are read at a time: some 8 MiB.
pub(crate) fn read_chunk(grid: &Grid) -> usize {
    ((8 << 20) / grid.record_bytes()).clamp(1, 1024)
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
