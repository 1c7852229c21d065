//! `farmctl slurm autoscale`: looks at the queue and the farm in turn, and does what [`Scaling`] decides.

use std::collections::BTreeSet;
use std::num::NonZeroU32;
use std::time::Duration;

use anyhow::{Result, bail, ensure};
use farm_link::walltime::span_text;
use farm_link::{ClientAccess, Target};
use farm_proto::status::{DictionaryState, DictionaryStatus, WorkerState};
use farm_proto::wire::{ListEventsRequest, StatusRequest};
use serde::Serialize;
use tokio::time::{Instant, sleep};

use super::{JOB_NAME, submission, warn_of_loopback};
use crate::cli::{Global, SlurmAutoscaleArgs};
use crate::commands::{list, workers};
use crate::connection::{Connection, Purpose, with_farm};
use crate::interrupt::interrupted;
use crate::output::{Output, counted, envelope, now_unix_s, sentence, utc};
use crate::slurm::scaling::{Action, Decision, Demand, Hold, Limits, Scaling, TaskId, TaskState};
use crate::slurm::{SbatchOption, Submission, queue, shell_quoted};

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
    /// The queue took no workers.
    Refused,
    /// Tasks wait until somebody releases them.
    Held,
    /// The farm or Slurm did not answer.
    Unknown,
    /// They answer again.
    Answering,
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
    stays_on_this_cluster(&args.workers_are.sbatch_option)?;
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
        is_right: false,
        jobs: BTreeSet::new(),
        told: None,
    };
    let mut stopped = std::pin::pin!(interrupted());
    let mut seen = None;
    let mut idle_looks = 0;
    loop {
        let look = tokio::select! {
            look = autoscaler.look() => look,
            () = &mut stopped => return autoscaler.end("stopped", seen.as_ref()),
        };
        match look {
            Ok(now) => {
                idle_looks = if now.demand.waiting + now.demand.computing == 0 { idle_looks + 1 } else { 0 };
                seen = Some(now);
            }
            // Whatever is wrong at once is wrong with the command.
            Err(error) if seen.is_none() || error.is::<Hopeless>() => return Err(error),
            Err(error) => {
                idle_looks = 0;
                autoscaler.tell(Step::Unknown, sentence(&error), None, seen.as_ref())?;
            }
        }
        if args.until_done && idle_looks >= IDLE_LOOKS {
            return autoscaler.end("the farm has no work left", seen.as_ref());
        }
        tokio::select! {
            () = sleep(args.every) => {}
            () = &mut stopped => return autoscaler.end("stopped", seen.as_ref()),
        }
    }
}

/// `squeue` and `scancel` look at the cluster of this machine alone.
fn stays_on_this_cluster(options: &[SbatchOption]) -> Result<()> {
    let elsewhere = options.iter().any(|option| option.begins("--clusters"));
    let told =
        ["SBATCH_CLUSTERS", "SLURM_CLUSTERS"].into_iter().find(|name| std::env::var_os(name).is_some());
    ensure!(
        !elsewhere && told.is_none(),
        "{} names a cluster: run autoscale on a login node of that cluster instead",
        told.unwrap_or("--sbatch-option=--clusters")
    );
    Ok(())
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
    /// Workers were in the queue, so the queue takes such.
    is_right: bool,
    /// Arrays that were submitted.
    jobs: BTreeSet<u64>,
    /// What was told last: it is not told again at each look.
    told: Option<(Step, String)>,
}

impl Autoscaler<'_> {
    /// Looks once, and acts. Where an answer is missing nothing is done.
    async fn look(&mut self) -> Result<Seen> {
        if self.events.is_none() {
            self.events = Some(with_farm(self.global, Purpose::Ask, newest_events).await?);
        }
        // The queue before the farm: who has left it has had the time to reach the coordinator.
        let mut tasks = queue::tasks(&self.submission.job_name).await?;
        let since = self.events.clone().unwrap_or_default();
        let Told { demand, registered, joined, events } =
            with_farm(self.global, Purpose::Ask, async |connection| ask(connection, since.clone()).await)
                .await?;
        self.events = Some(events);
        // Some clusters tell of a queue as it was a minute ago, or not of all: who is at work counts all the same.
        let unseen = |id: &&TaskId| self.jobs.contains(&id.job) && !tasks.iter().any(|(seen, _)| seen == *id);
        let unseen: Vec<TaskId> = registered.iter().filter(unseen).copied().collect();
        tasks.extend(unseen.into_iter().map(|id| (id, TaskState::Running)));
        self.is_right |= !tasks.is_empty();
        let now = self.start.elapsed();
        let decision = self.scaling.look(now, &demand, &tasks, &[registered, joined].concat());
        let count = |of: TaskState| tasks.iter().filter(|(_, state)| *state == of).count();
        let seen = Seen {
            demand,
            wanted: decision.wanted,
            running: count(TaskState::Running),
            queued: count(TaskState::Waiting),
        };
        if matches!(self.told, Some((Step::Unknown, _))) {
            self.tell(Step::Answering, "the farm and Slurm answer again".to_owned(), None, Some(&seen))?;
        }
        self.tell_failures(now, &decision, &seen)?;
        match count(TaskState::Held) {
            0 => {}
            held => {
                let message = format!(
                    "{} held in the queue, and counted no more: `squeue --me` tells why; release or cancel them",
                    if held == 1 { "1 worker is".to_owned() } else { format!("{held} workers are") }
                );
                self.tell(Step::Held, message, None, Some(&seen))?;
            }
        }
        self.act(now, decision.action, &seen).await?;
        Ok(seen)
    }

    fn tell_failures(&mut self, now: Duration, decision: &Decision, seen: &Seen) -> Result<()> {
        let Some(last) = decision.failed.last() else { return Ok(()) };
        let who = match decision.failed.len() {
            1 => format!("worker {last}"),
            more => format!("{more} workers, {last} the last of them,"),
        };
        let next = match decision.action {
            Action::GiveUp => String::new(),
            _ => format!("; the next comes in {} at the earliest", span_text(self.scaling.pause(now))),
        };
        let log = self.submission.log.as_str();
        let message =
            format!("{who} ended without having reached the coordinator, see the log ({log}){next}");
        self.tell(Step::Failed, message, None, Some(seen))
    }

    async fn act(&mut self, now: Duration, action: Action, seen: &Seen) -> Result<()> {
        match action {
            Action::Nothing => Ok(()),
            Action::Submit(count) => self.submit(now, count, seen).await,
            Action::Cancel(tasks) => {
                // Also if the answer is lost: who is still there at the next look is taken up again.
                self.scaling.cancelled(&tasks);
                queue::cancel(&tasks).await?;
                let message = format!("took {} out of the queue", counted(tasks.len() as u64, "worker"));
                self.tell(Step::Cancelled, message, None, Some(seen))
            }
            Action::Hold(why) => {
                let message = match why {
                    Hold::NotWorth => "what is left is done too soon for another worker",
                    Hold::Failing => "a pause, since workers ended without having reached the coordinator",
                    Hold::Refused => "a pause, since the queue takes no more workers",
                };
                self.tell(Step::Holding, message.to_owned(), None, Some(seen))
            }
            Action::GiveUp => Err(Hopeless { log: self.submission.log.as_str().to_owned() }.into()),
        }
    }

    async fn submit(&mut self, now: Duration, count: NonZeroU32, seen: &Seen) -> Result<()> {
        self.submission.workers = count;
        let submitted = queue::submit(&self.submission, &self.submission.script()).await;
        let job = match submitted {
            Ok((job, None)) => job,
            Ok((job, Some(cluster))) => {
                bail!("sbatch put job {job} on the cluster {cluster}, where squeue does not look")
            }
            // It never took any: the command is wrong. Later the cluster may have a reason that goes by.
            Err(error) if !self.is_right => return Err(error),
            Err(error) => {
                self.scaling.refused(now, count);
                return self.tell(Step::Refused, sentence(&error), None, Some(seen));
            }
        };
        self.is_right = true;
        self.jobs.insert(job);
        self.scaling.submitted(job, count);
        let message = format!("submitted {} as job {job}", counted(count.get().into(), "worker"));
        self.tell(Step::Submitted, message, Some(job), Some(seen))
    }

    fn end(&mut self, why: &str, seen: Option<&Seen>) -> Result<()> {
        let left = match seen.map_or(0, |seen| seen.running + seen.queued) {
            0 => String::new(),
            left => format!(
                "; {} still there end when they have had no work for {}, or by `scancel --me --name={}`",
                counted(left as u64, "worker"),
                span_text(self.submission.idle_exit),
                shell_quoted(self.submission.job_name.as_str())
            ),
        };
        self.tell(Step::Ended, format!("{why}{left}"), None, seen)
    }

    fn tell(&mut self, step: Step, message: String, job_id: Option<u64>, seen: Option<&Seen>) -> Result<()> {
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
            workers_wanted: seen.map_or(0, |seen| seen.wanted),
            workers_running: seen.map_or(0, |seen| seen.running),
            workers_queued: seen.map_or(0, |seen| seen.queued),
            jobs_waiting: seen.map_or(0, |seen| seen.demand.waiting),
            jobs_computing: seen.map_or(0, |seen| seen.demand.computing),
        };
        let is_wrong = matches!(step, Step::Failed | Step::Refused | Step::Held | Step::Unknown);
        if self.output.is_json() {
            writeln!(anstream::stdout(), "{}", envelope("slurm-autoscale", &line)?)?;
        } else if !self.global.quiet || is_wrong {
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

/// Where the events end now.
async fn newest_events(connection: &Connection) -> Result<String> {
    let request = ListEventsRequest { page_size: 1, newest: true, ..ListEventsRequest::default() };
    Ok(connection.farm().list_events(request).await?.into_inner().next_page_token)
}

/// What the farm tells.
struct Told {
    demand: Demand,
    /// Who is there.
    registered: Vec<TaskId>,
    /// Who has joined, and may have left again.
    joined: Vec<TaskId>,
    /// Where the events begin that are still to come.
    events: String,
}

async fn ask(connection: &Connection, since: String) -> Result<Told> {
    let status = connection.farm().status(StatusRequest {}).await?.into_inner();
    let demand = Demand {
        waiting: status.jobs_pending,
        computing: status.jobs_leased,
        left: time_left(&list::fetch(connection).await?),
    };
    let workers = workers::fetch(connection).await?;
    let there = workers.iter().filter(|worker| worker.state != WorkerState::Silent);
    let registered = there.filter_map(|worker| task(&worker.label)).collect();
    let (mut joined, mut events) = (Vec::new(), since);
    loop {
        let request =
            ListEventsRequest { page_size: 1000, page_token: events, ..ListEventsRequest::default() };
        let page = connection.farm().list_events(request).await?.into_inner();
        events = page.next_page_token;
        if page.events.is_empty() {
            return Ok(Told { demand, registered, joined, events });
        }
        let joins = page.events.iter().filter(|event| event.kind == "WORKER_JOINED");
        joined.extend(joins.filter_map(|event| task(&event.worker)));
    }
}

/// Time until the last of the running dictionaries is done; None while one does not know.
fn time_left(dictionaries: &[DictionaryStatus]) -> Option<Duration> {
    let running = dictionaries.iter().filter(|d| d.state == DictionaryState::Running);
    let left_s = running.map(|d| d.eta_s).try_fold(0.0, |most: f64, eta_s| Some(most.max(eta_s?)))?;
    Duration::try_from_secs_f64(left_s).ok()
}

/// The task by the label that the job script gives its worker: slurm:JOB.TASK@NODE.
fn task(label: &str) -> Option<TaskId> {
    let (job, task) = label.strip_prefix("slurm:")?.split('@').next()?.split_once('.')?;
    Some(TaskId { job: job.parse().ok()?, task: task.parse().ok()? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_is_known_by_the_label_of_the_job_script() {
        assert_eq!(task("slurm:17.2@node1"), Some(TaskId { job: 17, task: 2 }));
        for label in ["node1", "slurm:17@node1", "slurm:17.x@node1", "pbs:17.2@node1"] {
            assert_eq!(task(label), None, "{label}");
        }
    }

    #[test]
    fn options_that_lead_to_another_cluster_are_refused() {
        let check = |option: &str| stays_on_this_cluster(&[option.parse().unwrap()]);
        assert!(check("--account=lab").is_ok() && check("--cluster-constraint=gpu").is_ok());
        for option in ["--clusters=b", "--cluster=b", "--clusters all"] {
            assert!(
                check(option).unwrap_err().to_string().contains("login node of that cluster"),
                "{option}"
            );
        }
    }
}
