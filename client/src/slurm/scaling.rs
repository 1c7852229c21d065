//! Decides how many workers a farm's work needs, from the states of farm and queue, without a clock or a cluster.
//!
//! Each step starts from the tasks that Slurm lists, so that a lost answer or a restart submits nothing twice.

use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZeroU32;
use std::time::Duration;

/// First and longest pause after a failure.
const PAUSE: (Duration, Duration) = (Duration::from_mins(1), Duration::from_mins(30));
/// Number of failures in a row, without a worker that has ever reached the coordinator, after which the autoscaler gives
/// up.
const HOPELESS: u32 = 5;
/// Tasks that are surplus for this many polls in a row are cancelled: gaps between dictionaries are short.
const SURPLUS_LOOKS: u32 = 2;
/// Largest number of tasks in an array: Slurm's default.
const MOST_TASKS: u32 = 1000;

/// A task of an array job, as in 17_2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct TaskId {
    pub(crate) job: u64,
    pub(crate) task: u32,
}

impl fmt::Display for TaskId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}_{}", self.job, self.task)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TaskState {
    /// In the queue.
    Waiting,
    /// On a node, or about to be, or about to leave it.
    Running,
    /// In the queue until it is released.
    Held,
}

/// The work of the farm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Demand {
    /// Unclaimed jobs.
    pub(crate) waiting: u64,
    pub(crate) computing: u64,
    /// Time that all work takes at the current pace, if known.
    pub(crate) left: Option<Duration>,
}

#[derive(Debug, Clone)]
pub(crate) struct ScalingLimits {
    pub(crate) most: NonZeroU32,
    /// Jobs that a worker computes at the same time.
    pub(crate) threads: u16,
    /// Remaining time below which no further worker is submitted.
    pub(crate) worth: Duration,
}

/// The reason why no worker is submitted although jobs wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hold {
    /// The remaining work is done soon.
    NotWorth,
    /// Workers ended without having reached the coordinator.
    Failing,
    /// The queue accepted none.
    Refused,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Action {
    Nothing,
    Submit(NonZeroU32),
    /// Cancels queued tasks that are not needed any more.
    Cancel(Vec<TaskId>),
    Hold(Hold),
    /// All workers ended repeatedly without having reached the coordinator.
    GiveUp,
}

/// The result of a poll.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Decision {
    pub(crate) wanted: u32,
    pub(crate) action: Action,
    /// Tasks that left the queue since the last poll without having reached the coordinator.
    pub(crate) failed: Vec<TaskId>,
}

/// A pause that doubles with each failure in a row.
#[derive(Debug, Default)]
struct Pause {
    failures: u32,
    until: Duration,
}

impl Pause {
    fn begin(&mut self, now: Duration) {
        self.until = now + PAUSE.0.saturating_mul(1 << self.failures.min(10)).min(PAUSE.1);
        self.failures += 1;
    }

    fn left(&self, now: Duration) -> Duration {
        self.until.saturating_sub(now)
    }
}

#[derive(Debug)]
pub(crate) struct Scaling {
    limits: ScalingLimits,
    /// Tasks of the last poll, and whether they have reached the coordinator.
    tasks: BTreeMap<TaskId, bool>,
    has_joined: bool,
    is_first: bool,
    /// Number of polls in a row with surplus tasks.
    surplus: u32,
    /// Pause after workers ended without having reached the coordinator.
    deaths: Pause,
    /// Pause after the queue accepted none.
    refusals: Pause,
    /// Largest number of tasks that the queue is likely to accept at once.
    at_once: u32,
}

impl Scaling {
    pub(crate) fn new(limits: ScalingLimits) -> Self {
        Self {
            limits,
            tasks: BTreeMap::new(),
            has_joined: false,
            is_first: true,
            surplus: 0,
            deaths: Pause::default(),
            refusals: Pause::default(),
            at_once: MOST_TASKS,
        }
    }

    /// Decides at the time `now`, whose zero is arbitrary: `tasks` are in the queue, `joined` have reached the
    /// coordinator since the last poll. `joined` must have been read after `tasks`, so that it contains tasks that left
    /// the queue.
    pub(crate) fn look(
        &mut self,
        now: Duration,
        demand: &Demand,
        tasks: &[(TaskId, TaskState)],
        joined: &[TaskId],
    ) -> Decision {
        if tasks.len() < self.tasks.len() {
            // The queue may accept tasks again.
            self.refusals = Pause::default();
        }
        let failed = self.compare(tasks, joined);
        if !failed.is_empty() {
            self.deaths.begin(now);
        }
        let count = |of: TaskState| tasks.iter().filter(|(_, state)| *state == of).count() as u32;
        let (running, waiting) = (count(TaskState::Running), count(TaskState::Waiting));
        let needed = self.needed(demand, running);
        self.surplus = if waiting > needed { self.surplus + 1 } else { 0 };
        let action = if self.is_hopeless() {
            Action::GiveUp
        } else if waiting < needed {
            self.grow(now, demand, needed - waiting, running + waiting)
        } else if self.surplus >= SURPLUS_LOOKS {
            shrink(tasks, waiting - needed)
        } else {
            Action::Nothing
        };
        Decision { wanted: running + needed, action, failed }
    }

    /// Records that `count` tasks of `job` were submitted. Those that are gone at the next poll count as failed.
    pub(crate) fn submitted(&mut self, job: u64, count: NonZeroU32) {
        self.tasks.extend((1..=count.get()).map(|task| (TaskId { job, task }, false)));
        self.refusals = Pause::default();
        self.at_once = (2 * self.at_once).min(MOST_TASKS);
    }

    /// Records that the queue did not accept `count` tasks. It may accept fewer; if it does not accept one, there is a
    /// pause.
    pub(crate) fn refused(&mut self, now: Duration, count: NonZeroU32) {
        match count.get() / 2 {
            0 => self.refusals.begin(now),
            fewer => self.at_once = fewer,
        }
    }

    /// Records that tasks are being cancelled, so that they do not count as failed.
    pub(crate) fn cancelled(&mut self, tasks: &[TaskId]) {
        self.tasks.retain(|id, _| !tasks.contains(id));
    }

    /// Remaining pause after failures of workers.
    pub(crate) fn pause(&self, now: Duration) -> Duration {
        self.deaths.left(now)
    }

    /// Updates the state of the queue; returns the tasks that have left it without having reached the coordinator.
    fn compare(&mut self, tasks: &[(TaskId, TaskState)], joined: &[TaskId]) -> Vec<TaskId> {
        for id in joined {
            if let Some(has_joined) = self.tasks.get_mut(id).filter(|has_joined| !**has_joined) {
                *has_joined = true;
                self.has_joined = true;
                self.deaths = Pause::default();
            }
        }
        // Tasks that ran before the first poll may have joined before it.
        let known = |id: &TaskId, state: TaskState| {
            let before = self.is_first && state == TaskState::Running;
            self.tasks.get(id).copied().unwrap_or(before) || joined.contains(id)
        };
        let now: BTreeMap<_, _> = tasks.iter().map(|(id, state)| (*id, known(id, *state))).collect();
        let gone = |(id, has_joined): (&TaskId, &bool)| (!has_joined && !now.contains_key(id)).then_some(*id);
        let failed = self.tasks.iter().filter_map(gone).collect();
        self.tasks = now;
        self.is_first = false;
        failed
    }

    fn is_hopeless(&self) -> bool {
        self.deaths.failures >= HOPELESS && !self.has_joined && !self.tasks.values().any(|joined| *joined)
    }

    /// Number of workers needed for the unclaimed jobs, in addition to the running ones.
    fn needed(&self, demand: &Demand, running: u32) -> u32 {
        let room = self.limits.most.get().saturating_sub(running);
        let workers = demand.waiting.div_ceil(self.limits.threads.max(1).into());
        u32::try_from(workers).unwrap_or(room).min(room)
    }

    /// Submits one worker first, then at most doubles their number at each poll: by the next one the remaining time may
    /// be known.
    fn grow(&self, now: Duration, demand: &Demand, missing: u32, have: u32) -> Action {
        let count = missing.min(have.max(1)).min(self.at_once);
        if have > 0 && demand.left.is_some_and(|left| left < self.limits.worth) {
            Action::Hold(Hold::NotWorth)
        } else if !self.deaths.left(now).is_zero() {
            Action::Hold(Hold::Failing)
        } else if !self.refusals.left(now).is_zero() {
            Action::Hold(Hold::Refused)
        } else {
            NonZeroU32::new(count).map_or(Action::Nothing, Action::Submit)
        }
    }
}

/// Cancels waiting tasks, the newest first. Running workers end by themselves after a while without work.
fn shrink(tasks: &[(TaskId, TaskState)], count: u32) -> Action {
    let mut waiting: Vec<TaskId> =
        tasks.iter().filter(|(_, state)| *state == TaskState::Waiting).map(|(id, _)| *id).collect();
    waiting.sort_unstable_by(|a, b| b.cmp(a));
    waiting.truncate(count as usize);
    Action::Cancel(waiting)
}

#[cfg(test)]
mod tests;
