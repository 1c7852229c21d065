use proptest::prelude::*;

use super::*;

const LOOK: Duration = Duration::from_secs(30);

fn limits(most: u32) -> ScalingLimits {
    let most = NonZeroU32::new(most).unwrap();
    ScalingLimits { most, threads: 4, worth: Duration::from_mins(2) }
}

fn demand(waiting: u64, computing: u64) -> Demand {
    Demand { waiting, computing, left: None }
}

/// A cluster that starts waiting tasks at each poll as long as there is room, and a farm that every worker reaches.
struct Cluster {
    scaling: Scaling,
    tasks: Vec<(TaskId, TaskState)>,
    room: usize,
    /// Largest number of tasks that the queue accepts.
    takes: usize,
    jobs: u64,
    now: Duration,
    submissions: Vec<u32>,
}

impl Cluster {
    fn new(most: u32, room: usize) -> Self {
        Self {
            scaling: Scaling::new(limits(most)),
            tasks: Vec::new(),
            room,
            takes: usize::MAX,
            jobs: 0,
            now: Duration::ZERO,
            submissions: Vec::new(),
        }
    }

    /// Polls with `jobs` remaining jobs; each running worker computes four of them.
    fn look(&mut self, jobs: u64) -> Decision {
        self.look_with(jobs, None)
    }

    fn look_with(&mut self, jobs: u64, left: Option<Duration>) -> Decision {
        self.now += LOOK;
        let mut joined = Vec::new();
        for (id, state) in self.tasks.iter_mut().take(self.room) {
            if *state == TaskState::Waiting {
                *state = TaskState::Running;
                joined.push(*id);
            }
        }
        let computing = jobs.min(4 * self.states().0 as u64);
        let demand = Demand { waiting: jobs - computing, computing, left };
        let decision = self.scaling.look(self.now, &demand, &self.tasks, &joined);
        match &decision.action {
            Action::Submit(count) if self.tasks.len() + count.get() as usize > self.takes => {
                self.scaling.refused(self.now, *count);
            }
            Action::Submit(count) => {
                self.jobs += 1;
                self.submissions.push(count.get());
                self.scaling.submitted(self.jobs, *count);
                let job = self.jobs;
                self.tasks.extend((1..=count.get()).map(|task| (TaskId { job, task }, TaskState::Waiting)));
            }
            Action::Cancel(tasks) => {
                self.scaling.cancelled(tasks);
                self.tasks.retain(|(id, _)| !tasks.contains(id));
            }
            _ => {}
        }
        decision
    }

    fn looks(&mut self, count: usize, jobs: u64) {
        for _ in 0..count {
            self.look(jobs);
        }
    }

    /// Number of running and of waiting tasks.
    fn states(&self) -> (usize, usize) {
        let running = self.tasks.iter().filter(|(_, state)| *state == TaskState::Running).count();
        (running, self.tasks.len() - running)
    }
}

#[test]
fn workers_double_until_there_are_enough() {
    let mut cluster = Cluster::new(100, 100);
    // 45 jobs are 11.25 workers of four threads.
    cluster.looks(10, 45);
    assert_eq!(cluster.submissions, [1, 1, 2, 4, 4]);
    assert_eq!(cluster.states(), (12, 0));
}

/// Jobs that other workers compute already start no worker.
#[test]
fn foreign_work_starts_no_worker() {
    let mut scaling = Scaling::new(limits(64));
    assert_eq!(scaling.look(LOOK, &demand(0, 400), &[], &[]).action, Action::Nothing);
    let decision = scaling.look(2 * LOOK, &demand(1, 400), &[], &[]);
    assert_eq!((decision.wanted, decision.action), (1, Action::Submit(NonZeroU32::MIN)));
}

/// Work that is done soon starts no further worker.
#[test]
fn short_work_starts_no_further_worker() {
    let soon = Some(Duration::from_secs(100));
    let mut cluster = Cluster::new(64, 64);
    cluster.looks(3, 1000);
    let before = cluster.submissions.len();
    assert_eq!(cluster.look_with(1000, soon).action, Action::Hold(Hold::NotWorth));
    assert_eq!(cluster.submissions.len(), before);
    // Without any worker, one is needed even for little work.
    assert_eq!(Cluster::new(64, 64).look_with(1, soon).action, Action::Submit(NonZeroU32::MIN));
}

/// Surplus workers are cancelled only after two polls in a row, the newest first, and never running ones.
#[test]
fn unneeded_waiting_workers_are_cancelled() {
    let mut cluster = Cluster::new(8, 3);
    cluster.looks(6, 1000);
    assert_eq!(cluster.states(), (3, 5));
    assert_eq!(cluster.look(12).action, Action::Nothing, "one look is a gap");
    let Action::Cancel(tasks) = cluster.look(12).action else { panic!("they are not taken back") };
    assert_eq!((tasks.len(), tasks[0].job), (5, cluster.jobs), "the newest first");
    assert_eq!(cluster.states(), (3, 0));
    // Cancelled tasks do not count as failed.
    assert_eq!(cluster.look(12).failed, []);
}

/// Gaps between dictionaries start and end no workers.
#[test]
fn gaps_between_dictionaries_change_nothing() {
    let mut cluster = Cluster::new(8, 4);
    cluster.looks(8, 1000);
    let submitted = cluster.submissions.len();
    for _ in 0..50 {
        cluster.look(0);
        cluster.look(1000);
    }
    assert_eq!(cluster.submissions.len(), submitted);
    assert_eq!(cluster.states(), (4, 4));
}

/// A queue with a limit is filled up and refilled.
#[test]
fn limited_queue_is_filled_and_refilled() {
    let mut cluster = Cluster::new(32, 32);
    cluster.takes = 10;
    cluster.looks(12, 10_000);
    assert_eq!(cluster.states(), (10, 0), "{:?}", cluster.submissions);
    // Then a full queue is tried less and less often.
    let before = cluster.now;
    let mut asked = 0;
    while cluster.now < before + Duration::from_hours(5) {
        asked += u32::from(matches!(cluster.look(10_000).action, Action::Submit(_)));
    }
    assert!((10..=16).contains(&asked), "{asked} in five hours, with pauses of half an hour");
    // When workers leave at their walltime, new ones are submitted at once.
    cluster.tasks.drain(..3);
    cluster.looks(5, 10_000);
    assert_eq!(cluster.states(), (10, 0), "{:?}", cluster.submissions);
}

/// Tasks that Slurm holds do not count as workers, and are not cancelled.
#[test]
fn held_tasks_do_not_count() {
    let mut scaling = Scaling::new(limits(1));
    let held = [(TaskId { job: 1, task: 1 }, TaskState::Held)];
    let decision = scaling.look(LOOK, &demand(8, 0), &held, &[]);
    assert_eq!((decision.wanted, decision.action), (1, Action::Submit(NonZeroU32::MIN)));
    assert_eq!(
        scaling.look(2 * LOOK, &demand(0, 0), &held, &[]).action,
        Action::Nothing,
        "nor are they cancelled"
    );
}

/// The pauses double, and after a number of failures the autoscaler gives up.
#[test]
fn missing_workers_are_retried_with_growing_pauses() {
    let mut scaling = Scaling::new(limits(8));
    let (mut tries, mut now) = (Vec::new(), Duration::ZERO);
    for job in 1.. {
        let decision = scaling.look(now, &demand(100, 0), &[], &[]);
        match decision.action {
            Action::Submit(count) => {
                tries.push(now);
                // The task is gone by the next poll.
                scaling.submitted(job, count);
            }
            Action::Hold(Hold::Failing) => {}
            Action::GiveUp => break,
            other => panic!("{other:?}"),
        }
        now += LOOK;
        assert!(now < Duration::from_hours(3), "no end after three hours");
    }
    let between: Vec<u64> = tries.windows(2).map(|pair| pair[1].saturating_sub(pair[0]).as_secs()).collect();
    assert_eq!(between, [90, 150, 270, 510], "a look, and a pause that doubles");
    assert_eq!(tries.len() as u32, HOPELESS);
}

/// As long as other workers run, workers that die before they join cause pauses, but the autoscaler does not give up.
#[test]
fn bad_node_slows_scaling() {
    let mut cluster = Cluster::new(4, 4);
    cluster.looks(6, 1000);
    assert_eq!(cluster.states(), (4, 0));
    let mut submitted = 0;
    // One of four ends, and each replacement dies on a bad node before it has joined.
    let healthy = cluster.tasks[..3].to_vec();
    for look in 0..1000 {
        cluster.now += LOOK;
        let decision = cluster.scaling.look(cluster.now, &demand(1000, 12), &healthy, &[]);
        assert_ne!(decision.action, Action::GiveUp, "look {look}");
        if let Action::Submit(count) = decision.action {
            submitted += count.get();
            cluster.scaling.submitted(1000 + look, count);
        }
    }
    // Eight hours with pauses of half an hour.
    assert!((10..=25).contains(&submitted), "{submitted}");
}

#[test]
fn worker_that_arrives_ends_the_pause() {
    let mut scaling = Scaling::new(limits(8));
    let one = TaskId { job: 1, task: 1 };
    assert_eq!(scaling.look(LOOK, &demand(100, 0), &[], &[]).action, Action::Submit(NonZeroU32::MIN));
    scaling.submitted(1, NonZeroU32::MIN);
    scaling.deaths.begin(LOOK);
    let waits = [(one, TaskState::Waiting)];
    assert_eq!(scaling.look(2 * LOOK, &demand(100, 0), &waits, &[]).action, Action::Hold(Hold::Failing));
    let runs = [(one, TaskState::Running)];
    let decision = scaling.look(3 * LOOK, &demand(100, 0), &runs, &[one]);
    assert_eq!(decision.action, Action::Submit(NonZeroU32::MIN));
    // A task that ends after it has joined (idle, or at its walltime) does not count as failed.
    assert_eq!(scaling.look(4 * LOOK, &demand(100, 0), &[], &[]).failed, []);
}

/// A restarted autoscaler does not submit running workers again, and does not count them as failed when they end.
#[test]
fn restarted_autoscaler_adopts_running_workers() {
    let tasks = [1, 2, 3].map(|task| (TaskId { job: 7, task }, TaskState::Running));
    let mut scaling = Scaling::new(limits(3));
    assert_eq!(scaling.look(LOOK, &demand(1000, 12), &tasks, &[]).action, Action::Nothing);
    let decision = scaling.look(2 * LOOK, &demand(1000, 12), &tasks[..2], &[]);
    assert_eq!((decision.action, decision.failed), (Action::Submit(NonZeroU32::MIN), vec![]));
    // As long as these work, the autoscaler does not give up, although all further ones die.
    for look in 3..2000 {
        match scaling.look(look * LOOK, &demand(1000, 8), &tasks[..2], &[]).action {
            Action::Submit(count) => scaling.submitted(look.into(), count),
            action => assert_ne!(action, Action::GiveUp, "look {look}"),
        }
    }
}

proptest! {
    /// The bounds hold, whatever the scaling observes.
    #[test]
    fn scaling_bounds_always_hold(
        most in 1_u32..40,
        looks in prop::collection::vec((0_u64..400, 0_u64..100, prop::option::of(0_u64..600), 0_usize..12, 0_u8..4), 1..60),
    ) {
        let mut scaling = Scaling::new(limits(most));
        let mut tasks: Vec<(TaskId, TaskState)> = Vec::new();
        for (look, (waiting, computing, left_s, leave, starts)) in looks.into_iter().enumerate() {
            let leave = leave.min(tasks.len());
            tasks.drain(..leave);
            let mut joined = Vec::new();
            for (id, state) in tasks.iter_mut().take(starts.into()) {
                *state = TaskState::Running;
                joined.push(*id);
            }
            let demand = Demand { waiting, computing, left: left_s.map(Duration::from_secs) };
            let now = LOOK * (look as u32 + 1);
            let decision = scaling.look(now, &demand, &tasks, &joined);
            prop_assert!(decision.wanted <= most);
            match decision.action {
                Action::Submit(count) => {
                    let (have, count) = (tasks.len() as u32, count.get());
                    prop_assert!(have + count <= most);
                    prop_assert!(waiting > 0);
                    prop_assert!(have + count <= (2 * have).max(1));
                    let job = look as u64;
                    scaling.submitted(job, NonZeroU32::new(count).unwrap());
                    tasks.extend((1..=count).map(|task| (TaskId { job, task }, TaskState::Waiting)));
                }
                Action::Cancel(cancelled) => {
                    let task_state =
                        |id: &TaskId| tasks.iter().find(|(task, _)| task == id).map(|(_, state)| *state);
                    prop_assert!(cancelled.iter().all(|id| task_state(id) == Some(TaskState::Waiting)));
                    prop_assert_eq!(tasks.len() - cancelled.len(), decision.wanted as usize);
                    scaling.cancelled(&cancelled);
                    tasks.retain(|(id, _)| !cancelled.contains(id));
                }
                Action::Nothing | Action::Hold(_) => {}
                Action::GiveUp => break,
            }
        }
    }
}
