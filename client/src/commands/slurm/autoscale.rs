//! Implements `farmctl slurm autoscale`: polls the queue and the farm, and executes the decisions of [`Scaling`].

use std::collections::BTreeSet;
use std::num::NonZeroU32;
use std::time::Duration;

use anyhow::{Result, ensure};
use farm_link::walltime::span_text;
use farm_link::{ClientAccess, Target};
use tokio::time::{Instant, sleep};

use self::ask::{FarmState, ask, newest_events};
use self::report::{FarmSnapshot, Reporter, Step};
use super::{JOB_NAME, SlurmAutoscaleArgs, submission, warn_of_loopback};
use crate::cli::Global;
use crate::connection::{Purpose, with_farm};
use crate::interrupt::interrupted;
use crate::output::{Output, counted, sentence};
use crate::slurm::scaling::{Action, Decision, Hold, Scaling, ScalingLimits, TaskId, TaskState};
use crate::slurm::{SbatchOption, Submission, queue, shell_quoted};

mod ask;
mod report;

/// Number of polls in a row without work after which the farm counts as idle: gaps between dictionaries are short.
const IDLE_LOOKS: u32 = 2;

/// A failure that only the user can fix.
#[derive(Debug, thiserror::Error)]
#[error(
    "workers end without having reached the coordinator, again and again: see their logs ({log}); usual causes are a \
     firewall between nodes and coordinator, and a path that the nodes do not have"
)]
struct Hopeless {
    log: String,
}

pub(super) async fn run(global: &Global, args: SlurmAutoscaleArgs, output: &Output) -> Result<()> {
    is_one_cluster(&args.workers_are.sbatch_option, |name| std::env::var(name).ok())?;
    let limits =
        ScalingLimits { most: args.max_workers, threads: args.workers_are.threads, worth: args.worth };
    let submission = submission(global, args.workers_are, &job_name(global)?, NonZeroU32::MIN)?;
    warn_of_loopback(global, &submission.coordinator);
    let mut autoscaler = Autoscaler {
        global,
        reporter: Reporter::new(output, global.quiet),
        submission,
        scaling: Scaling::new(limits),
        start: Instant::now(),
        events: None,
        proven: false,
        jobs: BTreeSet::new(),
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
            // An error of the first poll means that the command is wrong.
            Err(error) if seen.is_none() || error.is::<Hopeless>() => return Err(error),
            Err(error) => {
                idle_looks = 0;
                autoscaler.reporter.report(Step::Unknown, sentence(&error), seen.as_ref())?;
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

/// Refuses options and variables that select a cluster for `sbatch` but not for `squeue` and `scancel`.
fn is_one_cluster(options: &[SbatchOption], variable: impl Fn(&str) -> Option<String>) -> Result<()> {
    let given =
        variable("SBATCH_CLUSTERS").is_some() || options.iter().any(|option| option.begins("--clusters"));
    ensure!(!given, "name the cluster by SLURM_CLUSTERS, which squeue and scancel follow as well as sbatch");
    let several = variable("SLURM_CLUSTERS").filter(|names| names.contains(',') || names == "all");
    ensure!(several.is_none(), "SLURM_CLUSTERS is {:?}: one cluster is needed", several.unwrap_or_default());
    Ok(())
}

/// The job name that identifies this farm's workers in the queue.
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
    reporter: Reporter<'a>,
    submission: Submission,
    scaling: Scaling,
    start: Instant,
    /// Page token of the first event that was not read yet.
    events: Option<String>,
    /// Whether a refusal by sbatch is more likely caused by the cluster than by a wrong command: after the first poll,
    /// or if such workers are in the queue.
    proven: bool,
    /// Submitted arrays.
    jobs: BTreeSet<u64>,
}

impl Autoscaler<'_> {
    /// Polls once, and acts. Without all answers, nothing is done.
    async fn look(&mut self) -> Result<FarmSnapshot> {
        if self.events.is_none() {
            self.events = Some(with_farm(self.global, Purpose::Ask, newest_events).await?);
        }
        // The queue is polled before the farm: workers that have left the queue have had the time to reach the
        // coordinator.
        let mut tasks = queue::tasks(&self.submission.job_name).await?;
        let since = self.events.clone().unwrap_or_default();
        let FarmState { demand, registered, joined, events } =
            with_farm(self.global, Purpose::Ask, async |connection| ask(connection, since.clone()).await)
                .await?;
        self.events = Some(events);
        // Some clusters list a stale or partial queue: registered workers count in any case.
        let unseen = |id: &&TaskId| self.jobs.contains(&id.job) && !tasks.iter().any(|(seen, _)| seen == *id);
        let unseen: Vec<TaskId> = registered.iter().filter(unseen).copied().collect();
        tasks.extend(unseen.into_iter().map(|id| (id, TaskState::Running)));
        self.proven |= !tasks.is_empty();
        let now = self.start.elapsed();
        let decision = self.scaling.look(now, &demand, &tasks, &[registered, joined].concat());
        let count = |of: TaskState| tasks.iter().filter(|(_, state)| *state == of).count();
        let seen = FarmSnapshot {
            demand,
            wanted: decision.wanted,
            running: count(TaskState::Running),
            queued: count(TaskState::Waiting),
        };
        if self.reporter.stands(Step::Unknown) {
            self.reporter.is_over(Step::Unknown);
            self.reporter.report(
                Step::Answering,
                "the farm and Slurm answer again".to_owned(),
                Some(&seen),
            )?;
        }
        self.report_failures(now, &decision, &seen)?;
        self.report_held(count(TaskState::Held), &seen)?;
        if !matches!(decision.action, Action::Hold(_)) {
            self.reporter.is_over(Step::Holding);
        }
        self.act(now, decision.action, &seen).await?;
        self.proven = true;
        Ok(seen)
    }

    fn report_failures(&mut self, now: Duration, decision: &Decision, seen: &FarmSnapshot) -> Result<()> {
        let Some(last) = decision.failed.last() else { return Ok(()) };
        let who = match decision.failed.len() {
            1 => format!("worker {last}"),
            more => format!("{more} workers, {last} the last of them,"),
        };
        let next = match decision.action {
            Action::GiveUp => String::new(),
            _ => format!("; the next comes in {} at the earliest", span_text(self.scaling.pause(now))),
        };
        let log = self.submission.log.of_task(last.job, last.task);
        let message =
            format!("{who} ended without having reached the coordinator, see the log ({log}){next}");
        self.reporter.report(Step::Failed, message, Some(seen))
    }

    fn report_held(&mut self, held: usize, seen: &FarmSnapshot) -> Result<()> {
        if held == 0 {
            self.reporter.is_over(Step::Held);
            return Ok(());
        }
        let who = if held == 1 { "1 worker is".to_owned() } else { format!("{held} workers are") };
        let message = format!(
            "{who} held in the queue, and counted no more: see `squeue --me` for the reason; release or cancel them"
        );
        self.reporter.report(Step::Held, message, Some(seen))
    }

    async fn act(&mut self, now: Duration, action: Action, seen: &FarmSnapshot) -> Result<()> {
        match action {
            Action::Nothing => Ok(()),
            Action::Submit(count) => self.submit(now, count, seen).await,
            Action::Cancel(tasks) => {
                // Recorded even if the answer is lost: tasks that still exist at the next poll are counted again.
                self.scaling.cancelled(&tasks);
                queue::cancel(&tasks).await?;
                let message = format!("took {} out of the queue", counted(tasks.len() as u64, "worker"));
                self.reporter.report(Step::Cancelled, message, Some(seen))
            }
            Action::Hold(why) => {
                let message = match why {
                    Hold::NotWorth => "what is left is done too soon for another worker",
                    Hold::Failing => "a pause, since workers ended without having reached the coordinator",
                    Hold::Refused => "a pause, since the queue takes no more workers",
                };
                self.reporter.report(Step::Holding, message.to_owned(), Some(seen))
            }
            Action::GiveUp => Err(Hopeless { log: self.submission.log.as_str().to_owned() }.into()),
        }
    }

    async fn submit(&mut self, now: Duration, count: NonZeroU32, seen: &FarmSnapshot) -> Result<()> {
        self.submission.workers = count;
        let job = match queue::submit(&self.submission, &self.submission.script()).await {
            Ok(job) => job,
            Err(error) if !self.proven => return Err(error),
            Err(error) => {
                self.scaling.refused(now, count);
                return self.reporter.report(Step::Refused, sentence(&error), Some(seen));
            }
        };
        self.reporter.is_over(Step::Refused);
        self.jobs.insert(job);
        self.scaling.submitted(job, count);
        let message = format!("submitted {} as job {job}", counted(count.get().into(), "worker"));
        self.reporter.report_job(Step::Submitted, message, Some(job), Some(seen))
    }

    fn end(&mut self, why: &str, seen: Option<&FarmSnapshot>) -> Result<()> {
        let left = match seen.map_or(0, |seen| seen.running + seen.queued) {
            0 => String::new(),
            left => format!(
                "; {} still there end when they have had no work for {}, or by `scancel --me --name={}`",
                counted(left as u64, "worker"),
                span_text(self.submission.idle_exit),
                shell_quoted(self.submission.job_name.as_str())
            ),
        };
        self.reporter.report(Step::Ended, format!("{why}{left}"), seen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    /// Options and variables of sbatch alone are refused: squeue and scancel would use another cluster.
    #[test]
    fn clusters_are_selected_by_slurm_clusters_only() {
        for (option, variable, value, is_one) in [
            ("--account=lab", "", "", true),
            ("--cluster-constraint=gpu", "", "", true),
            ("--account=lab", "SLURM_CLUSTERS", "b", true),
            ("--clusters=b", "", "", false),
            ("--cluster b", "", "", false),
            ("--account=lab", "SBATCH_CLUSTERS", "b", false),
            ("--account=lab", "SLURM_CLUSTERS", "a,b", false),
            ("--account=lab", "SLURM_CLUSTERS", "all", false),
        ] {
            let assigned = |name: &str| (name == variable).then(|| value.to_owned());
            let refused = is_one_cluster(&[option.parse().unwrap()], assigned).err().map(|e| e.to_string());
            assert_eq!(refused.is_none(), is_one, "{option} {variable}={value}");
            assert!(refused.is_none_or(|refused| refused.contains("SLURM_CLUSTERS")));
        }
    }
}
