//! `farmctl slurm autoscale`: looks at the queue and the farm in turn, and does what [`Scaling`] decides.

use std::num::NonZeroU32;
use std::time::Duration;

use anyhow::{Result, ensure};
use farm_link::walltime::span_text;
use farm_link::{ClientAccess, Target};
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::{Event, ListEventsRequest, StatusRequest};
use serde::Serialize;
use tokio::time::{Instant, sleep};

use super::{JOB_NAME, submission, warn_of_loopback};
use crate::cli::{Global, SlurmAutoscaleArgs};
use crate::commands::list;
use crate::connection::{Connection, Purpose, with_farm};
use crate::interrupt::interrupted;
use crate::output::{Output, counted, envelope, now_unix_s, sentence, utc};
use crate::slurm::scaling::{Action, Demand, Hold, Limits, Scaling, TaskId, TaskState};
use crate::slurm::{Submission, queue};

/// Looks in a row without work after which there is none: gaps between dictionaries are short.
const IDLE_LOOKS: u32 = 2;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Step {
    Submitted,
    Cancelled,
    /// There is work for more workers, and none is submitted.
    Holding,
    /// Workers ended without having reached the coordinator.
    Failed,
    /// The farm or the queue did not answer.
    Unknown,
    Ended,
}

/// A line of the answer.
#[derive(Debug, Serialize)]
struct StepJson {
    unix_ms: u64,
    step: Step,
    message: String,
    /// Of the array that was submitted.
    job_id: Option<u64>,
    workers_wanted: u32,
    workers_running: usize,
    workers_queued: usize,
    jobs_waiting: u64,
    jobs_computing: u64,
}

/// What a look saw.
#[derive(Debug, Clone)]
struct Seen {
    demand: Demand,
    wanted: u32,
    running: usize,
    queued: usize,
}

/// Nothing but a person can help.
#[derive(Debug, thiserror::Error)]
#[error(
    "workers end without having reached the coordinator, again and again: see their logs ({log}); usual causes are a \
     firewall between nodes and coordinator, and a path that the nodes do not have"
)]
struct Hopeless {
    log: String,
}

pub(super) async fn run(global: &Global, args: SlurmAutoscaleArgs, output: &Output) -> Result<()> {
    let limits = Limits { most: args.max_workers, threads: args.workers_are.threads, worth: args.worth };
    let submission = submission(global, args.workers_are, &job_name(global)?, NonZeroU32::MIN)?;
    warn_of_loopback(global, &submission.coordinator);
    let mut autoscaler = Autoscaler {
        global,
        output,
        submission,
        scaling: Scaling::new(limits),
        start: Instant::now(),
        events: None,
        has_submitted: false,
        told: None,
    };
    // Whatever is wrong at once is wrong with the command.
    let mut seen = autoscaler.look().await?;
    let mut idle_looks = 0;
    let mut stopped = std::pin::pin!(interrupted());
    loop {
        idle_looks = if seen.demand.waiting + seen.demand.computing == 0 { idle_looks + 1 } else { 0 };
        if args.until_done && idle_looks >= IDLE_LOOKS {
            return autoscaler.end("the farm has no work left", &seen);
        }
        tokio::select! {
            () = sleep(args.every) => {}
            () = &mut stopped => return autoscaler.end("stopped", &seen),
        }
        match autoscaler.look().await {
            Ok(now) => seen = now,
            Err(error) if error.is::<Hopeless>() => return Err(error),
            Err(error) => {
                idle_looks = 0;
                autoscaler.tell(Step::Unknown, sentence(&error), None, &seen)?;
            }
        }
    }
}

/// The name by which the workers of this farm are known in the queue.
fn job_name(global: &Global) -> Result<String> {
    ensure!(
        !global.local && (global.access.is_some() || global.server.is_some()),
        "workers need a coordinator that runs: name it by --access FILE or --server URL"
    );
    let access = global.access.as_deref().map(ClientAccess::read).transpose()?;
    let target = Target::new(access.as_ref(), global.server.as_deref())?;
    let address = target.url().rsplit("//").next().unwrap_or_default().trim_end_matches('/');
    Ok(format!("{JOB_NAME}@{address}"))
}

struct Autoscaler<'a> {
    global: &'a Global,
    output: &'a Output,
    submission: Submission,
    scaling: Scaling,
    start: Instant,
    /// Where the events begin that were not looked at yet.
    events: Option<String>,
    has_submitted: bool,
    /// What was told last: it is not told again at each look.
    told: Option<(Step, String)>,
}

impl Autoscaler<'_> {
    /// Looks once, and acts. Where an answer is missing nothing is done.
    async fn look(&mut self) -> Result<Seen> {
        // The queue first: who has left it has had the time to reach the coordinator.
        let tasks = queue::tasks(&self.submission.job_name)?;
        let since = self.events.clone();
        let (demand, joined, next) =
            with_farm(self.global, Purpose::Ask, async |connection| ask(connection, since.clone()).await)
                .await?;
        self.events = Some(next);
        let now = self.start.elapsed();
        let decision = self.scaling.look(now, &demand, &tasks, &joined);
        let running = tasks.iter().filter(|(_, state)| *state == TaskState::Running).count();
        let seen = Seen { demand, wanted: decision.wanted, running, queued: tasks.len() - running };
        if let Some(last) = decision.failed.last() {
            let message = format!(
                "{} ended without having reached the coordinator, {last} the last of them: see the log; the next \
                 comes in {} at the earliest",
                counted(decision.failed.len() as u64, "worker"),
                span_text(self.scaling.pause(now))
            );
            self.tell(Step::Failed, message, None, &seen)?;
        }
        self.act(decision.action, &seen)?;
        Ok(seen)
    }

    fn act(&mut self, action: Action, seen: &Seen) -> Result<()> {
        match action {
            Action::Nothing => Ok(()),
            Action::Submit(count) => self.submit(count, seen),
            Action::Cancel(tasks) => {
                queue::cancel(&tasks)?;
                self.scaling.cancelled(&tasks);
                let message = format!("took {} out of the queue", counted(tasks.len() as u64, "worker"));
                self.tell(Step::Cancelled, message, None, seen)
            }
            Action::Hold(why) => {
                let message = match why {
                    Hold::NotWorth => "what is left is done too soon for another worker",
                    Hold::Failing => "a pause, since workers failed",
                };
                self.tell(Step::Holding, message.to_owned(), None, seen)
            }
            Action::GiveUp => Err(Hopeless { log: self.submission.log.as_str().to_owned() }.into()),
        }
    }

    fn submit(&mut self, count: NonZeroU32, seen: &Seen) -> Result<()> {
        self.submission.workers = count;
        let job = match queue::submit(&self.submission, &self.submission.script()) {
            Ok(job) => job,
            Err(error) => {
                // The first time the command is wrong, later the cluster may have a reason that goes by.
                if self.has_submitted {
                    self.scaling.refused(self.start.elapsed());
                }
                return Err(error);
            }
        };
        self.has_submitted = true;
        self.scaling.submitted(job, count);
        let message = format!("submitted {} as job {job}", counted(count.get().into(), "worker"));
        self.tell(Step::Submitted, message, Some(job), seen)
    }

    fn end(&mut self, why: &str, seen: &Seen) -> Result<()> {
        let left = match seen.running + seen.queued {
            0 => String::new(),
            left => format!(
                "; {} still there end when they have had no work for {}, or by `scancel --name='{}'`",
                counted(left as u64, "worker"),
                span_text(self.submission.idle_exit),
                self.submission.job_name.as_str()
            ),
        };
        self.tell(Step::Ended, format!("{why}{left}"), None, seen)
    }

    fn tell(&mut self, step: Step, message: String, job_id: Option<u64>, seen: &Seen) -> Result<()> {
        use std::io::Write;
        let told = Some((step, message.clone()));
        if self.told == told {
            return Ok(());
        }
        self.told = told;
        let line = StepJson {
            unix_ms: now_unix_s() as u64 * 1000,
            step,
            message,
            job_id,
            workers_wanted: seen.wanted,
            workers_running: seen.running,
            workers_queued: seen.queued,
            jobs_waiting: seen.demand.waiting,
            jobs_computing: seen.demand.computing,
        };
        if self.output.is_json() {
            writeln!(anstream::stdout(), "{}", envelope("slurm-autoscale", &line)?)?;
        } else if !self.global.quiet || matches!(step, Step::Failed | Step::Unknown) {
            writeln!(anstream::stdout(), "{}", text(&line))?;
        }
        Ok(())
    }
}

fn text(line: &StepJson) -> String {
    format!(
        "{}  {} ({} running and {} queued of {} wanted; {} waiting, {} being computed)",
        utc(line.unix_ms),
        line.message,
        line.workers_running,
        line.workers_queued,
        counted(line.workers_wanted.into(), "worker"),
        counted(line.jobs_waiting, "job"),
        line.jobs_computing
    )
}

/// What the farm has to do, who has joined it since those events, and where the next ones begin.
async fn ask(connection: &Connection, since: Option<String>) -> Result<(Demand, Vec<TaskId>, String)> {
    let status = connection.farm().status(StatusRequest {}).await?.into_inner();
    let demand = Demand {
        waiting: status.jobs_pending,
        computing: status.jobs_leased,
        left: time_left(&list::fetch(connection).await?),
    };
    let mut joined = Vec::new();
    // At first only where they end.
    let newest = since.is_none();
    let mut page_token = since.unwrap_or_default();
    loop {
        let page_size = if newest { 1 } else { 1000 };
        let request = ListEventsRequest { page_size, page_token, dictionary: String::new(), newest };
        let page = connection.farm().list_events(request).await?.into_inner();
        page_token = page.next_page_token;
        if newest || page.events.is_empty() {
            return Ok((demand, joined, page_token));
        }
        joined.extend(page.events.iter().filter_map(joined_task));
    }
}

/// Time until the last of the running dictionaries is done; None while one does not know.
fn time_left(dictionaries: &[DictionaryStatus]) -> Option<Duration> {
    let running = dictionaries.iter().filter(|d| d.state == DictionaryState::Running);
    let left_s = running.map(|d| d.eta_s).try_fold(0.0, |most: f64, eta_s| Some(most.max(eta_s?)))?;
    Duration::try_from_secs_f64(left_s).ok()
}

/// The task that joined, by the label that the job script gives its worker: slurm:JOB.TASK@NODE.
fn joined_task(event: &Event) -> Option<TaskId> {
    let label = (event.kind == "WORKER_JOINED").then(|| event.worker.strip_prefix("slurm:"))??;
    let (job, task) = label.split('@').next()?.split_once('.')?;
    Some(TaskId { job: job.parse().ok()?, task: task.parse().ok()? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_joins_is_known_by_the_label_of_the_job_script() {
        let event = |kind: &str, worker: &str| Event {
            kind: kind.to_owned(),
            worker: worker.to_owned(),
            ..Event::default()
        };
        let task = TaskId { job: 17, task: 2 };
        assert_eq!(joined_task(&event("WORKER_JOINED", "slurm:17.2@node1")), Some(task));
        for (kind, worker) in [
            ("WORKER_LEFT", "slurm:17.2@node1"),
            ("WORKER_JOINED", "node1"),
            ("WORKER_JOINED", "slurm:17@node1"),
            ("WORKER_JOINED", "slurm:17.x@node1"),
        ] {
            assert_eq!(joined_task(&event(kind, worker)), None, "{kind} {worker}");
        }
    }
}
