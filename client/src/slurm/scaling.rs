//! How many workers a farm's work is worth: decided from what the farm and the queue tell, without a clock or a cluster.
//!
//! Nothing that was submitted is remembered: each look begins from the tasks that Slurm tells. So an answer that was
//! lost, another copy of this program, or a start of it anew submits nothing twice.

use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZeroU32;
use std::time::Duration;

/// Pause after workers ended without having reached the coordinator, first and longest.
const PAUSE: (Duration, Duration) = (Duration::from_mins(1), Duration::from_mins(30));
/// So many times in a row, without one that ever reached it, and nothing but a person can help.
const HOPELESS: u32 = 5;
/// Workers in a row that are too many in so many looks are taken back: gaps between dictionaries are short.
const SURPLUS_LOOKS: u32 = 2;
/// Most tasks of an array, as clusters have it unless told otherwise.
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
    /// On a node, or about to be.
    Running,
}

/// What the farm has to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Demand {
    /// Jobs that nobody has.
    pub(crate) waiting: u64,
    pub(crate) computing: u64,
    /// Time that all of it takes at the present pace, if that is known.
    pub(crate) left: Option<Duration>,
}

#[derive(Debug, Clone)]
pub(crate) struct Limits {
    pub(crate) most: NonZeroU32,
    /// Jobs that a worker computes at the same time.
    pub(crate) threads: u16,
    /// Work that is done sooner anyway is not worth another worker.
    pub(crate) worth: Duration,
}

/// Why there are fewer workers than work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hold {
    /// What is left is done soon.
    NotWorth,
    /// Workers ended without having reached the coordinator, or the queue took none: there is a pause.
    Failing,
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

#[derive(Debug)]
pub(crate) struct Scaling {
    limits: Limits,
    /// Tasks of the last look, and whether they have reached the coordinator.
    tasks: BTreeMap<TaskId, bool>,
    /// Looks in a row with more workers than wanted.
    surplus: u32,
    /// Times in a row that workers ended without having reached the coordinator.
    deaths: u32,
    /// The same, with the times that the queue took none: the pause grows with them.
    failures: u32,
    /// Nothing is submitted before.
    not_before: Duration,
    has_joined: bool,
    is_first: bool,
}

impl Scaling {
    pub(crate) fn new(limits: Limits) -> Self {
        Self {
            limits,
            tasks: BTreeMap::new(),
            surplus: 0,
            deaths: 0,
            failures: 0,
            not_before: Duration::ZERO,
            has_joined: false,
            is_first: true,
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
        let failed = self.compare(tasks, joined);
        if !failed.is_empty() {
            self.deaths += 1;
            self.pause_from(now);
        }
        let (wanted, have) = (self.wanted(demand), tasks.len() as u32);
        self.surplus = if have > wanted { self.surplus + 1 } else { 0 };
        let action = if self.deaths >= HOPELESS && !self.has_joined {
            Action::GiveUp
        } else if have < wanted && demand.waiting > 0 {
            self.grow(now, demand, wanted, have)
        } else if self.surplus >= SURPLUS_LOOKS {
            shrink(tasks, have - wanted)
        } else {
            Action::Nothing
        };
        Decision { wanted, action, failed }
    }

    /// That `count` tasks of `job` were submitted. Those that are gone at the next look are told as failed.
    pub(crate) fn submitted(&mut self, job: u64, count: NonZeroU32) {
        self.failures = self.deaths;
        self.tasks.extend((1..=count.get()).map(|task| (TaskId { job, task }, false)));
    }

    /// That tasks were cancelled: nothing is wrong if they are gone.
    pub(crate) fn cancelled(&mut self, tasks: &[TaskId]) {
        self.tasks.retain(|id, _| !tasks.contains(id));
    }

    /// That the queue did not take a job: it is asked again after a pause.
    pub(crate) fn refused(&mut self, now: Duration) {
        self.pause_from(now);
    }

    /// How long nothing is submitted.
    pub(crate) fn pause(&self, now: Duration) -> Duration {
        self.not_before.saturating_sub(now)
    }

    fn pause_from(&mut self, now: Duration) {
        let pause = PAUSE.0.saturating_mul(1 << self.failures.min(10)).min(PAUSE.1);
        self.failures += 1;
        self.not_before = now + pause;
    }

    /// Takes up what the queue tells; those that have left it without having reached the coordinator.
    fn compare(&mut self, tasks: &[(TaskId, TaskState)], joined: &[TaskId]) -> Vec<TaskId> {
        for id in joined {
            self.tasks.entry(*id).and_modify(|has_joined| {
                *has_joined = true;
                self.has_joined = true;
                (self.deaths, self.failures) = (0, 0);
                self.not_before = Duration::ZERO;
            });
        }
        // Who ran before the first look may have joined before it.
        let known = |id: &TaskId, state: TaskState| {
            self.tasks.get(id).copied().unwrap_or(self.is_first && state == TaskState::Running)
        };
        let now: BTreeMap<_, _> = tasks.iter().map(|(id, state)| (*id, known(id, *state))).collect();
        let gone = |(id, has_joined): (&TaskId, &bool)| (!has_joined && !now.contains_key(id)).then_some(*id);
        let failed = self.tasks.iter().filter_map(gone).collect();
        self.tasks = now;
        self.is_first = false;
        failed
    }

    fn wanted(&self, demand: &Demand) -> u32 {
        let jobs = demand.waiting.saturating_add(demand.computing);
        let workers = jobs.div_ceil(self.limits.threads.max(1).into());
        let most = self.limits.most.get();
        u32::try_from(workers).unwrap_or(most).min(most)
    }

    /// Twice as many at most at each look: by the next one it may be known how soon the work is done.
    fn grow(&self, now: Duration, demand: &Demand, wanted: u32, have: u32) -> Action {
        let is_soon = demand.left.is_some_and(|left| left < self.limits.worth);
        let count = (wanted - have).min(have.max(1)).min(MOST_TASKS);
        match NonZeroU32::new(count) {
            Some(_) if have > 0 && is_soon => Action::Hold(Hold::NotWorth),
            Some(_) if !self.pause(now).is_zero() => Action::Hold(Hold::Failing),
            Some(count) => Action::Submit(count),
            None => Action::Nothing,
        }
    }
}

/// Those that wait, the newest first. Those that run end by themselves when they have had no work for a while.
fn shrink(tasks: &[(TaskId, TaskState)], count: u32) -> Action {
    let mut waiting: Vec<TaskId> =
        tasks.iter().filter(|(_, state)| *state == TaskState::Waiting).map(|(id, _)| *id).collect();
    waiting.sort_unstable_by(|a, b| b.cmp(a));
    waiting.truncate(count as usize);
    if waiting.is_empty() { Action::Nothing } else { Action::Cancel(waiting) }
}

#[cfg(test)]
mod tests;
