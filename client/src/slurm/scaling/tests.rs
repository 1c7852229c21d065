use proptest::prelude::*;

use super::*;

const LOOK: Duration = Duration::from_secs(30);

fn limits(most: u32) -> Limits {
    let most = NonZeroU32::new(most).unwrap();
    Limits { most, threads: 4, worth: Duration::from_mins(2) }
}

fn demand(waiting: u64, computing: u64) -> Demand {
    Demand { waiting, computing, left: None }
}

/// A cluster that starts what waits at each look, as long as there is room, and a farm that everybody reaches.
struct Cluster {
    scaling: Scaling,
    tasks: Vec<(TaskId, TaskState)>,
    room: usize,
    jobs: u64,
    now: Duration,
    submissions: Vec<u32>,
}

impl Cluster {
    fn new(limits: Limits, room: usize) -> Self {
        let scaling = Scaling::new(limits);
        Self { scaling, tasks: Vec::new(), room, jobs: 0, now: Duration::ZERO, submissions: Vec::new() }
    }

    fn look(&mut self, demand: &Demand) -> Decision {
        self.now += LOOK;
        let mut joined = Vec::new();
        for (id, state) in self.tasks.iter_mut().take(self.room) {
            if *state == TaskState::Waiting {
                *state = TaskState::Running;
                joined.push(*id);
            }
        }
        let decision = self.scaling.look(self.now, demand, &self.tasks, &joined);
        match &decision.action {
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

    fn looks(&mut self, count: usize, demand: &Demand) {
        for _ in 0..count {
            self.look(demand);
        }
    }

    fn states(&self) -> (usize, usize) {
        let running = self.tasks.iter().filter(|(_, state)| *state == TaskState::Running).count();
        (running, self.tasks.len() - running)
    }
}

#[test]
fn workers_double_until_there_are_enough() {
    let mut cluster = Cluster::new(limits(100), 100);
    // 45 jobs are 11.25 workers of four threads.
    cluster.looks(10, &demand(40, 5));
    assert_eq!(cluster.submissions, [1, 1, 2, 4, 4]);
    assert_eq!(cluster.states(), (12, 0));
}

#[test]
fn there_are_never_more_than_told_and_a_full_cluster_is_not_asked_again() {
    let mut cluster = Cluster::new(limits(6), 2);
    cluster.looks(100, &demand(10_000, 8));
    assert_eq!(cluster.states(), (2, 4));
    assert_eq!(cluster.submissions.iter().sum::<u32>(), 6);
}

#[test]
fn work_that_is_done_soon_is_worth_no_further_worker() {
    let mut cluster = Cluster::new(limits(64), 64);
    cluster.looks(3, &demand(1000, 4));
    let soon = Demand { left: Some(Duration::from_secs(100)), ..demand(1000, 16) };
    let before = cluster.submissions.len();
    assert_eq!(cluster.look(&soon).action, Action::Hold(Hold::NotWorth));
    assert_eq!(cluster.submissions.len(), before);
    // Where there is none, one is needed however little there is to do.
    let mut cluster = Cluster::new(limits(64), 64);
    assert_eq!(
        cluster.look(&Demand { left: Some(LOOK), ..demand(1, 0) }).action,
        Action::Submit(NonZeroU32::MIN)
    );
}

#[test]
fn without_work_nobody_comes() {
    let mut cluster = Cluster::new(limits(64), 64);
    cluster.looks(10, &demand(0, 0));
    cluster.looks(10, &demand(0, 7));
    assert_eq!(cluster.states(), (0, 0), "what others compute is theirs");
}

#[test]
fn what_waits_in_vain_is_taken_back_once_it_is_clear_and_what_runs_is_left() {
    let mut cluster = Cluster::new(limits(8), 3);
    cluster.looks(6, &demand(1000, 12));
    assert_eq!(cluster.states(), (3, 5));
    assert_eq!(cluster.look(&demand(0, 12)).action, Action::Nothing, "one look is a gap");
    let Action::Cancel(tasks) = cluster.look(&demand(0, 12)).action else {
        panic!("they are not taken back")
    };
    assert_eq!(tasks.len(), 5);
    assert_eq!(tasks[0], TaskId { job: cluster.jobs, task: tasks[0].task }, "the newest first");
    assert_eq!(cluster.states(), (3, 0));
    // Their leave is nobody's failure.
    assert_eq!(cluster.look(&demand(0, 12)).failed, []);
}

#[test]
fn gaps_between_dictionaries_make_nobody_come_and_go() {
    let mut cluster = Cluster::new(limits(8), 4);
    cluster.looks(8, &demand(1000, 16));
    let submitted = cluster.submissions.len();
    for _ in 0..50 {
        cluster.look(&demand(0, 0));
        cluster.look(&demand(1000, 16));
    }
    assert_eq!(cluster.submissions.len(), submitted);
    assert_eq!(cluster.states(), (4, 4));
}

#[test]
fn workers_that_never_arrive_are_tried_less_and_less_and_then_given_up() {
    let mut scaling = Scaling::new(limits(8));
    let (mut tries, mut now, mut pauses) = (Vec::new(), Duration::ZERO, Vec::new());
    for job in 1.. {
        let decision = scaling.look(now, &demand(100, 0), &[], &[]);
        match decision.action {
            Action::Submit(count) => {
                tries.push(now);
                // Gone by the next look.
                scaling.submitted(job, count);
            }
            Action::Hold(Hold::Failing) => pauses.push(scaling.pause(now)),
            Action::GiveUp => break,
            other => panic!("{other:?}"),
        }
        now += LOOK;
        assert!(now < Duration::from_hours(3), "it goes on");
    }
    let between: Vec<u64> = tries.windows(2).map(|pair| pair[1].saturating_sub(pair[0]).as_secs()).collect();
    assert_eq!(between, [90, 150, 270, 510], "a look, and a pause that doubles");
    assert_eq!(tries.len() as u32, HOPELESS);
}

#[test]
fn a_node_that_swallows_workers_slows_the_others_down_but_stops_nobody() {
    let mut cluster = Cluster::new(limits(4), 4);
    cluster.looks(6, &demand(1000, 16));
    assert_eq!(cluster.states(), (4, 0));
    let mut submitted = 0;
    // One of four ends, and each that follows dies on a bad node before it has joined.
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
fn a_worker_that_arrives_ends_the_pause() {
    let mut scaling = Scaling::new(limits(8));
    let one = TaskId { job: 1, task: 1 };
    assert_eq!(scaling.look(LOOK, &demand(100, 0), &[], &[]).action, Action::Submit(NonZeroU32::MIN));
    scaling.submitted(1, NonZeroU32::MIN);
    scaling.refused(LOOK);
    let waits = [(one, TaskState::Waiting)];
    assert_eq!(scaling.look(2 * LOOK, &demand(100, 0), &waits, &[]).action, Action::Hold(Hold::Failing));
    let runs = [(one, TaskState::Running)];
    let decision = scaling.look(3 * LOOK, &demand(100, 0), &runs, &[one]);
    assert_eq!(decision.action, Action::Submit(NonZeroU32::MIN));
    // It ends after it had joined: an idle one, or one at its walltime.
    assert_eq!(scaling.look(4 * LOOK, &demand(100, 0), &[], &[]).failed, []);
}

#[test]
fn after_a_start_anew_nothing_is_submitted_twice_and_who_runs_is_not_blamed() {
    let tasks = [1, 2, 3].map(|task| (TaskId { job: 7, task }, TaskState::Running));
    let mut scaling = Scaling::new(limits(3));
    assert_eq!(scaling.look(LOOK, &demand(1000, 12), &tasks, &[]).action, Action::Nothing);
    let decision = scaling.look(2 * LOOK, &demand(1000, 12), &tasks[..2], &[]);
    assert_eq!((decision.action, decision.failed), (Action::Submit(NonZeroU32::MIN), vec![]));
}

proptest! {
    #[test]
    fn whatever_is_told_the_bounds_hold(
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
                    prop_assert!(have + count <= decision.wanted);
                    prop_assert!(waiting > 0);
                    prop_assert!(have + count <= (2 * have).max(1));
                    let job = look as u64;
                    scaling.submitted(job, NonZeroU32::new(count).unwrap());
                    tasks.extend((1..=count).map(|task| (TaskId { job, task }, TaskState::Waiting)));
                }
                Action::Cancel(cancelled) => {
                    let of = |id: &TaskId| tasks.iter().find(|(task, _)| task == id).map(|(_, state)| *state);
                    prop_assert!(cancelled.iter().all(|id| of(id) == Some(TaskState::Waiting)));
                    prop_assert!(tasks.len() - cancelled.len() >= decision.wanted as usize);
                    scaling.cancelled(&cancelled);
                    tasks.retain(|(id, _)| !cancelled.contains(id));
                }
                Action::Nothing | Action::Hold(_) => {}
                Action::GiveUp => break,
            }
        }
    }
}
