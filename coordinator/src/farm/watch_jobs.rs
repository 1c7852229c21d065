//! Reports the states of a dictionary's jobs as they change.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use farm_proto::status::JobState;
use tokio::sync::watch;
use tokio::time::{Instant, timeout_at};

use super::watch::REPEAT;
use super::{Farm, FarmError, Result};

/// Least time between two looks, for every hundred thousand jobs begun: a look takes the scheduler's lock.
const PAUSE: Duration = Duration::from_millis(250);
const JOBS_A_PAUSE: usize = 100_000;
/// Most jobs that are sent at once.
const MOST: usize = 1 << 16;
/// Unchanged jobs between changed ones that are sent again, rather than begin another run.
const BRIDGED: usize = 8;

/// States of jobs that follow each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct JobRun {
    pub first: u32,
    pub states: Vec<JobState>,
}

/// The states of all jobs of a dictionary, and then those that have changed, until it has ended.
#[derive(Debug)]
pub(crate) struct JobWatch {
    farm: Arc<Farm>,
    name: DictionaryName,
    id: DictionaryId,
    changes: watch::Receiver<()>,
    /// The states at the last look.
    last: Vec<JobState>,
    /// The runs of these states that are still to be sent.
    runs: VecDeque<JobRun>,
    /// The time at which something was sent last.
    sent: Instant,
    /// The dictionary has ended: there will be no other look.
    ended: bool,
}

impl Farm {
    pub(crate) fn watch_jobs(self: &Arc<Self>, name: &DictionaryName) -> Result<JobWatch> {
        // Subscribed before the first look, so that no change is missed in between.
        let mut changes = self.scheduler.changes();
        changes.mark_changed();
        let (id, _) = self.found(name)?;
        Ok(JobWatch {
            farm: self.clone(),
            name: name.clone(),
            id,
            changes,
            last: Vec::new(),
            runs: VecDeque::new(),
            sent: Instant::now(),
            ended: false,
        })
    }
}

impl JobWatch {
    /// The next states that differ from those sent last, or the first job's again after [`REPEAT`]; None after those
    /// with which the dictionary has ended.
    pub(crate) async fn next(&mut self) -> Result<Option<JobRun>> {
        loop {
            let repeat = self.sent + REPEAT;
            let due = || self.last.first().filter(|_| !self.ended && Instant::now() >= repeat);
            let again = || due().map(|state| JobRun { first: 0, states: vec![*state] });
            if let Some(run) = self.runs.pop_front().or_else(again) {
                self.sent = Instant::now();
                return Ok(Some(run));
            }
            if self.ended {
                return Ok(None);
            }
            match timeout_at(repeat, self.changes.changed()).await {
                Ok(Ok(())) => {
                    if !self.last.is_empty() {
                        tokio::time::sleep(PAUSE * (1 + self.last.len() / JOBS_A_PAUSE) as u32).await;
                        self.changes.mark_unchanged();
                    }
                    self.look()?;
                }
                Ok(Err(_)) => return Ok(None),
                Err(_) => {}
            }
        }
    }

    fn look(&mut self) -> Result<()> {
        let found = self.farm.scheduler.query(|dispatcher, _| {
            let open = dispatcher.schedule().by_id(self.id)?.state().is_open();
            Some((dispatcher.job_states(self.id), open))
        });
        let (states, open) = found.ok_or_else(|| FarmError::Deleted { name: self.name.clone() })?;
        self.runs = changed(&self.last, &states);
        self.last = states;
        self.ended = !open;
        Ok(())
    }
}

/// The runs of states that have changed.
fn changed(before: &[JobState], now: &[JobState]) -> VecDeque<JobRun> {
    let is_new = |i: &usize| before.get(*i) != now.get(*i);
    let mut runs: Vec<std::ops::Range<usize>> = Vec::new();
    for i in (0..now.len()).filter(is_new) {
        match runs.last_mut() {
            Some(run) if i - run.end <= BRIDGED && i - run.start < MOST => run.end = i + 1,
            _ => runs.push(i..i + 1),
        }
    }
    runs.into_iter().map(|run| JobRun { first: run.start as u32, states: now[run].to_vec() }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use JobState::{Computing, Done, Waiting};

    /// The states of a client that has received these runs.
    fn received(mut known: Vec<JobState>, runs: &VecDeque<JobRun>, jobs: usize) -> Vec<JobState> {
        known.resize(jobs, JobState::Failed);
        for run in runs {
            let first = run.first as usize;
            known[first..first + run.states.len()].copy_from_slice(&run.states);
        }
        known
    }

    /// A client that applies all changes has the states of all jobs.
    #[test]
    fn changes_rebuild_all_job_states() {
        let first = vec![Waiting; 200_000];
        let runs = changed(&[], &first);
        assert_eq!(runs.len(), 4);
        assert!(runs.iter().all(|run| run.states.len() <= MOST));
        assert_eq!(received(Vec::new(), &runs, first.len()), first);
        let mut second = first.clone();
        for job in [3, 5, 6, 100, 70_000, 199_999] {
            second[job] = if job % 2 == 0 { Done } else { Computing };
        }
        let runs = changed(&first, &second);
        assert_eq!(runs.len(), 4, "{runs:?}");
        assert_eq!(received(first.clone(), &runs, first.len()), second);
        assert!(changed(&second, &second).is_empty());
    }
}
