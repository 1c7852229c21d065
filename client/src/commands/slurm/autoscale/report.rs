//! Prints the output of an autoscaler: a line for each action and each change.

use std::collections::BTreeMap;

use anyhow::Result;
use serde::Serialize;

use crate::output::{Output, counted, envelope, now_unix_s, print_line, utc};
use crate::slurm::scaling::Demand;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Step {
    Submitted,
    Cancelled,
    /// There is work for more workers, but none is submitted.
    Holding,
    /// Workers ended without having reached the coordinator.
    Failed,
    /// The queue accepted no workers.
    Refused,
    /// Held tasks wait to be released.
    Held,
    /// The farm or Slurm did not answer.
    Unknown,
    /// The farm and Slurm answer again.
    Answering,
    Ended,
}

/// A line of the output.
#[derive(Debug, Serialize)]
struct StepJson {
    unix_ms: u64,
    step: Step,
    message: String,
    /// Number of the submitted array.
    job_id: Option<u64>,
    workers_wanted: u32,
    workers_running: usize,
    workers_queued: usize,
    jobs_waiting: u64,
    jobs_computing: u64,
}

/// Results of a poll.
#[derive(Debug, Clone)]
pub(super) struct FarmSnapshot {
    pub(super) demand: Demand,
    pub(super) wanted: u32,
    pub(super) running: usize,
    pub(super) queued: usize,
}

pub(super) struct Reporter<'a> {
    output: &'a Output,
    quiet: bool,
    /// Lasting states, which are not reported again at each step.
    standing: BTreeMap<Step, String>,
}

impl<'a> Reporter<'a> {
    pub(super) fn new(output: &'a Output, quiet: bool) -> Self {
        Self { output, quiet, standing: BTreeMap::new() }
    }

    /// Whether this lasting state was reported and has not ended.
    pub(super) fn stands(&self, step: Step) -> bool {
        self.standing.contains_key(&step)
    }

    /// Ends a lasting state; if it returns, it is reported again.
    pub(super) fn is_over(&mut self, step: Step) {
        self.standing.remove(&step);
    }

    pub(super) fn report(&mut self, step: Step, message: String, seen: Option<&FarmSnapshot>) -> Result<()> {
        self.report_job(step, message, None, seen)
    }

    pub(super) fn report_job(
        &mut self,
        step: Step,
        message: String,
        job_id: Option<u64>,
        seen: Option<&FarmSnapshot>,
    ) -> Result<()> {
        let lasts = matches!(step, Step::Holding | Step::Refused | Step::Held | Step::Unknown);
        if lasts && self.standing.insert(step, message.clone()).as_ref() == Some(&message) {
            return Ok(());
        }
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
            print_line(&envelope("slurm-autoscale", &line)?)?;
        } else if !self.quiet || is_wrong {
            print_line(&text(&line))?;
        }
        Ok(())
    }
}

fn text(line: &StepJson) -> String {
    format!(
        "{}  {} ({} running and {} queued of {} needed; {} waiting, {} being computed)",
        utc(line.unix_ms),
        line.message,
        line.workers_running,
        line.workers_queued,
        counted(line.workers_wanted.into(), "worker"),
        counted(line.jobs_waiting, "job"),
        line.jobs_computing
    )
}
