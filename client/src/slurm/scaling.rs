//! How many workers a farm's work is worth: decided from the states of farm and queue, without a clock or a cluster.
//!
//! Each step begins from the tasks that Slurm lists. So a lost answer or a restart submits nothing twice.

use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZeroU32;
use std::time::Duration;

/// Pause after a failure, first and longest.
const PAUSE: (Duration, Duration) = (Duration::from_mins(1), Duration::from_mins(30));
/// So many times in a row, without a worker that has ever reached the coordinator, and nothing but a person can help.
const HOPELESS: u32 = 5;
/// Jobs that waited in vain for this many polls in a row are cancelled: gaps between dictionaries are short.
const SURPLUS_LOOKS: u32 = 2;
/// Most tasks of an array: Slurm's default.
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
    /// In the queue until somebody releases it.
    Held,
}

/// What the farm has to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Demand {
    /// Unclaimed jobs.
    pub(crate) waiting: u64,
    pub(crate) computing: u64,
    /// Time that all of it takes at the present pace, if that is known.
    pub(crate) left: Option<Duration>,
}

#[derive(Debug, Clone)]
pub(crate) struct ScalingLimits {
    pub(crate) most: NonZeroU32,
    /// Jobs that a worker computes at the same time.
    pub(crate) threads: u16,
    /// Work that is done sooner anyway is not worth another worker.
    pub(crate) worth: Duration,
}

/// Why no worker is submitted although jobs wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hold {
    /// What is left is done soon.
    NotWorth,
    /// Workers ended without having reached the coordinator.
    Failing,
    /// The queue took none.
    Refused,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Action {
    Nothing,
    Submit(NonZeroU32),
    /// Tasks that wait in the queue and are not needed any more.
    Cancel(Vec<TaskId>),
    Hold(Hold),
    /// Every worker ended without having reached the coordinator, again and again.
    GiveUp,
}

/// What a look came to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Decision {
    pub(crate) wanted: u32,
    pub(crate) action: Action,
    /// Tasks that left the queue without having reached the coordinator since the last look.
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
    /// Tasks of the last look, and whether they have reached the coordinator.
    tasks: BTreeMap<TaskId, bool>,
    has_joined: bool,
    is_first: bool,
    /// Looks in a row in which tasks waited in vain.
    surplus: u32,
    /// Since workers ended without having reached the coordinator.
    deaths: Pause,
    /// Since the queue took none.
    refusals: Pause,
    /// Most tasks that the queue is likely to take at once.
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

    /// Decides at `now`, counted from any moment: `tasks` are in the queue, `joined` have reached the coordinator since
    /// the last look. Who has left the queue must have had the time to be in `joined`.
    pub(crate) fn look(
        &mut self,
        now: Duration,
        demand: &Demand,
        tasks: &[(TaskId, TaskState)],
        joined: &[TaskId],
    ) -> Decision {
        if tasks.len() < self.tasks.len() {
            // There may be a place again.
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

    /// Records that `count` tasks of `job` were submitted. Those that are gone at the next step count as failed.
    pub(crate) fn submitted(&mut self, job: u64, count: NonZeroU32) {
        self.tasks.extend((1..=count.get()).map(|task| (TaskId { job, task }, false)));
        self.refusals = Pause::default();
        self.at_once = (2 * self.at_once).min(MOST_TASKS);
    }

    /// That the queue did not take so many. There may be room for fewer; if not for one, there is a pause.
    pub(crate) fn refused(&mut self, now: Duration, count: NonZeroU32) {
        match count.get() / 2 {
            0 => self.refusals.begin(now),
            fewer => self.at_once = fewer,
        }
    }

    /// That tasks are being cancelled: nothing is wrong if they are gone.
    pub(crate) fn cancelled(&mut self, tasks: &[TaskId]) {
        self.tasks.retain(|id, _| !tasks.contains(id));
    }

    /// How long nothing is submitted since workers failed.
    pub(crate) fn pause(&self, now: Duration) -> Duration {
        self.deaths.left(now)
    }

    /// Takes up the state of the queue; returns the tasks that have left it without having reached the coordinator.
    fn compare(&mut self, tasks: &[(TaskId, TaskState)], joined: &[TaskId]) -> Vec<TaskId> {
        for id in joined {
            if let Some(has_joined) = self.tasks.get_mut(id).filter(|has_joined| !**has_joined) {
                *has_joined = true;
                self.has_joined = true;
                self.deaths = Pause::default();
            }
        }
        // Who ran before the first look may have joined before it.
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

    /// Workers in addition to those that run, for the unclaimed jobs.
    fn needed(&self, demand: &Demand, running: u32) -> u32 {
        let room = self.limits.most.get().saturating_sub(running);
        let workers = demand.waiting.div_ceil(self.limits.threads.max(1).into());
        u32::try_from(workers).unwrap_or(room).min(room)
    }

    /// At first one, then twice as many at most at each look: by the next it may be known how soon the work is done.
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

/// Those that wait, the newest first. Those that run end by themselves when they have had no work for a while.
fn shrink(tasks: &[(TaskId, TaskState)], count: u32) -> Action {
    let mut waiting: Vec<TaskId> =
        tasks.iter().filter(|(_, state)| *state == TaskState::Waiting).map(|(id, _)| *id).collect();
    waiting.sort_unstable_by(|a, b| b.cmp(a));
    waiting.truncate(count as usize);
    Action::Cancel(waiting)
}

#[cfg(test)]
mod tests;
