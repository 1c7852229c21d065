//! Follows a dictionary until it has ended, across restarts of the coordinator and lost connections.

use std::cell::RefCell;
use std::collections::HashMap;
use std::time::Duration;

use anyhow::{Result, bail};
use farm_proto::DictionaryName;
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::{Dictionary, GetRequest, JobStates, StatusRequest, WatchJobsRequest, WatchRequest};
use optics_model::Digest;
use tokio::time::{Instant, timeout};
use tonic::{Code, Status, Streaming};

use crate::connection::Connection;
use crate::connection::outage::Outage;
use crate::interrupt::interrupted;
use crate::output::grouped;
use crate::progress::{Cells, Progress};

/// A coordinator repeats its state every ten seconds: after this time without a message the connection is dead, or the
/// coordinator is an older one. In both cases the client subscribes again.
const SILENCE: Duration = Duration::from_mins(1);

/// After this time without a running job, the client checks whether any worker is connected.
const IDLE: Duration = Duration::from_secs(10);

/// Time between two looks at whether results can be stored.
const LOOK_AT_STORE: Duration = Duration::from_secs(5);

/// The end of following a dictionary.
pub(crate) enum FollowEnd {
    /// The dictionary is done, failed or cancelled.
    Ended(Duration),
    Interrupted,
}

/// The followed dictionary does not exist any more.
#[derive(Debug, thiserror::Error)]
#[error("dictionary {0} was deleted, or replaced by another one of its name, while it was waited for")]
pub(crate) struct DictionaryDeleted(DictionaryName);

impl DictionaryDeleted {
    /// The error of a call about a dictionary that existed before.
    fn or(error: anyhow::Error, name: &DictionaryName) -> anyhow::Error {
        let is_missing = |status: &Status| status.code() == Code::NotFound;
        if error.downcast_ref().is_some_and(is_missing) { Self(name.clone()).into() } else { error }
    }
}

/// Dictionaries that are followed: the first answer fixes them, even if their names are reused later.
#[derive(Debug, Default)]
pub(crate) struct Fixed(RefCell<HashMap<DictionaryName, Digest>>);

impl Fixed {
    /// The state of the dictionary that had the name at the first call.
    pub(crate) async fn get(
        &self,
        connection: &Connection,
        name: &DictionaryName,
    ) -> Result<DictionaryStatus> {
        let known = self.0.borrow().get(name).copied();
        let status = match get(connection, name).await {
            Err(error) if known.is_some() => return Err(DictionaryDeleted::or(error, name)),
            status => status?,
        };
        if known.is_some_and(|known| known != status.grid_digest) {
            return Err(DictionaryDeleted(name.clone()).into());
        }
        self.0.borrow_mut().insert(name.clone(), status.grid_digest);
        Ok(status)
    }
}

pub(crate) async fn get(connection: &Connection, name: &DictionaryName) -> Result<DictionaryStatus> {
    let answer = connection.dictionaries().get(GetRequest { name: name.to_string() }).await?;
    Ok(answer.into_inner().try_into()?)
}

/// Shows progress until the dictionary has ended or the user interrupts; `status` is its last state.
pub(crate) async fn follow(
    connection: &Connection,
    status: &mut DictionaryStatus,
    quiet: bool,
) -> Result<FollowEnd> {
    Following::new(connection, status, quiet, false).run().await
}

/// Shows progress as [`follow`] does, on a terminal with each job's state.
pub(crate) async fn follow_jobs(
    connection: &Connection,
    status: &mut DictionaryStatus,
    quiet: bool,
) -> Result<FollowEnd> {
    Following::new(connection, status, quiet, true).run().await
}

struct Following<'a> {
    connection: &'a Connection,
    status: &'a mut DictionaryStatus,
    progress: Progress,
    /// The jobs' states, if they are shown.
    cells: Option<Cells>,
    outage: Outage<'a>,
    /// When a job was last running; `None` once the lack of workers is reported.
    busy: Option<Instant>,
    /// Whether results could not be stored at the last look.
    is_stuck: bool,
}

impl<'a> Following<'a> {
    fn new(
        connection: &'a Connection,
        status: &'a mut DictionaryStatus,
        quiet: bool,
        with_jobs: bool,
    ) -> Self {
        let progress = Progress::new(status, quiet);
        let cells = (with_jobs && progress.has_room()).then(|| Cells::new(&status.grid));
        let busy = (!progress.is_quiet()).then(Instant::now);
        Self { connection, status, progress, cells, outage: Outage::new(connection), busy, is_stuck: false }
    }

    async fn run(mut self) -> Result<FollowEnd> {
        let start = Instant::now();
        // Signals are handled before the first progress is shown.
        let ended = tokio::select! {
            biased;
            () = interrupted() => Ok(FollowEnd::Interrupted),
            ended = self.across_outages() => ended.map(|()| FollowEnd::Ended(start.elapsed())),
        };
        self.progress.end();
        ended
    }

    async fn across_outages(&mut self) -> Result<()> {
        while let Err(error) = self.listen().await {
            let error = DictionaryDeleted::or(error, &self.status.name);
            let progress = &self.progress;
            self.outage.outlast(error, |word| progress.print(&word)).await?;
        }
        Ok(())
    }

    /// Applies the coordinator's updates until the dictionary has ended.
    async fn listen(&mut self) -> Result<()> {
        let (mut updates, mut jobs) = self.subscribe().await?;
        let mut look = tokio::time::interval(LOOK_AT_STORE);
        loop {
            tokio::select! {
                _ = look.tick() => self.look_at_store().await?,
                update = timeout(SILENCE, updates.message()) => {
                    let Ok(update) = update else {
                        (updates, jobs) = self.subscribe().await?;
                        continue;
                    };
                    match update? {
                        Some(update) => self.take(update)?,
                        None if self.status.state().is_open() => return Err(self.stopped().into()),
                        None => return Ok(()),
                    }
                }
                run = next_run(&mut jobs) => self.take_jobs(&run)?,
                () = until(self.busy.map(|busy| busy + IDLE)) => self.look_for_workers().await?,
            }
        }
    }

    async fn subscribe(&self) -> Result<(Streaming<Dictionary>, Option<Streaming<JobStates>>)> {
        let silent = |_| Status::deadline_exceeded(format!("no answer within {} s", SILENCE.as_secs()));
        let (name, mut client) = (self.status.name.to_string(), self.connection.dictionaries());
        let updates = client.watch(WatchRequest { name: name.clone() });
        let updates = timeout(SILENCE, updates).await.map_err(silent)??.into_inner();
        tracing::info!(dictionary = %self.status.name, "following");
        if self.cells.is_none() {
            return Ok((updates, None));
        }
        let jobs = client.watch_jobs(WatchJobsRequest { name });
        match timeout(SILENCE, jobs).await.map_err(silent)? {
            Ok(jobs) => Ok((updates, Some(jobs.into_inner()))),
            // An older coordinator does not report the states of jobs.
            Err(error) if error.code() == Code::Unimplemented => Ok((updates, None)),
            Err(error) => Err(error.into()),
        }
    }

    fn take(&mut self, update: Dictionary) -> Result<()> {
        let update = DictionaryStatus::try_from(update)?;
        if update.grid_digest != self.status.grid_digest {
            return Err(DictionaryDeleted(self.status.name.clone()).into());
        }
        *self.status = update;
        let progress = &self.progress;
        self.outage.is_over(|word| progress.print(&word));
        self.progress.show(self.status);
        let rests = self.status.state() != DictionaryState::Running || self.status.jobs_leased > 0;
        self.busy = self.busy.map(|busy| if rests { Instant::now() } else { busy });
        Ok(())
    }

    /// Reports once that no worker is connected.
    async fn look_for_workers(&mut self) -> Result<()> {
        let farm = self.connection.farm().status(StatusRequest {}).await?.into_inner();
        self.busy = (farm.workers > 0).then(Instant::now);
        if farm.workers == 0 {
            let server = self.connection.address();
            self.progress.print(&format!(
                "no worker is connected: start one with `farm-worker --server {server}`, or with its access file"
            ));
        }
        Ok(())
    }

    /// Reports once that results cannot be stored. A farm in this process would compute in vain: at the second look in a
    /// row the command ends.
    async fn look_at_store(&mut self) -> Result<()> {
        let fault = self.connection.farm().status(StatusRequest {}).await?.into_inner().store_fault;
        if fault.is_empty() {
            self.is_stuck = false;
            return Ok(());
        }
        let was_stuck = std::mem::replace(&mut self.is_stuck, true);
        if was_stuck && self.connection.is_embedded() {
            let (done, total) = (self.status.records_done() as u64, self.status.records_total() as u64);
            bail!(
                "results cannot be stored: {fault}; {} of {} records are there: make room on the disk, and run the same \
                 command again to continue",
                grouped(done),
                grouped(total)
            );
        }
        if !was_stuck && !self.connection.is_embedded() {
            self.progress.print(&format!("results cannot be stored: {fault}; workers keep them meanwhile"));
        }
        Ok(())
    }

    fn take_jobs(&mut self, run: &JobStates) -> Result<()> {
        let (first, states) = run.read()?;
        if let Some(cells) = &mut self.cells {
            cells.set(first, &states);
            self.progress.show_cells(cells);
        }
        Ok(())
    }

    fn stopped(&self) -> Status {
        let name = &self.status.name;
        Status::unavailable(format!(
            "the coordinator stopped before {name} was done: run the same command again to continue"
        ))
    }
}

async fn until(when: Option<Instant>) {
    match when {
        Some(when) => tokio::time::sleep_until(when).await,
        None => std::future::pending().await,
    }
}

/// The next states of jobs. At the end of the stream it never returns: the end of the dictionary is reported elsewhere.
async fn next_run(jobs: &mut Option<Streaming<JobStates>>) -> JobStates {
    if let Some(states) = jobs
        && let Ok(Some(run)) = states.message().await
    {
        return run;
    }
    *jobs = None;
    std::future::pending().await
}
