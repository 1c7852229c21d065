//! Writes job scripts for Slurm: an array of workers that stop before the walltime.

pub(crate) mod queue;
mod quote;
pub(crate) mod scaling;

use std::fmt::Write as _;
use std::num::NonZeroU32;
use std::str::FromStr;
use std::time::Duration;

use farm_link::walltime::{Walltime, span_text};
use quote::sbatch_quoted;
pub(crate) use quote::shell_quoted;

/// Time that a worker needs after its grace to deliver finished records and return the other leases.
const HAND_BACK: Duration = Duration::from_secs(15);

/// Options that farmctl sets by itself, with their alternatives.
const OWN_OPTIONS: [(&str, &str); 11] = [
    ("--array", "--workers and --at-once"),
    ("--time", "--time of farmctl"),
    ("--cpus-per-task", "--threads"),
    ("--job-name", "--job-name of farmctl"),
    ("--output", "--log"),
    ("--signal", "--grace"),
    ("--nodes", "--workers"),
    ("--ntasks", "--workers"),
    ("--wrap", "no script of your own"),
    ("--parsable", "--quiet or --json"),
    ("--wait", "farmctl submit --wait"),
];

/// An array job whose tasks are one worker each.
#[derive(Debug)]
pub(crate) struct Submission {
    pub(crate) workers: NonZeroU32,
    /// Largest number of workers that run at the same time.
    pub(crate) at_once: Option<NonZeroU32>,
    pub(crate) walltime: Walltime,
    pub(crate) threads: u16,
    pub(crate) grace: Duration,
    pub(crate) idle_exit: Duration,
    pub(crate) job_name: OneLine,
    pub(crate) partition: Option<OneLine>,
    pub(crate) log: LogPattern,
    pub(crate) options: Vec<SbatchOption>,
    /// The worker's program: a name on the nodes' PATH, or an absolute path.
    pub(crate) program: String,
    pub(crate) coordinator: CoordinatorAddress,
}

/// URL of the coordinator and access file of the workers; at least one of them is given.
#[derive(Debug)]
pub(crate) struct CoordinatorAddress {
    pub(crate) server: Option<String>,
    pub(crate) access: Option<String>,
}

#[derive(Debug, thiserror::Error)]
pub enum InvalidOption {
    #[error("{0:?} does not begin with --, as in --account=lab")]
    NotLong(String),
    #[error("{0:?} has more than one line")]
    Lines(String),
    #[error("{0:?} is empty")]
    Empty(String),
    #[error("{option} is set by farmctl: use {instead}")]
    Own { option: String, instead: &'static str },
    #[error("{0:?} has a backslash, with which Slurm replaces no % in the name")]
    Backslash(String),
    #[error("{0:?} gives all tasks one file: put %A and %a in it, the numbers of the job and of the task")]
    OneFile(String),
}

fn one_line(text: &str) -> Result<String, InvalidOption> {
    if text.is_empty() {
        return Err(InvalidOption::Empty(text.to_owned()));
    }
    if text.contains(char::is_control) {
        Err(InvalidOption::Lines(text.to_owned()))
    } else {
        Ok(text.to_owned())
    }
}

/// Text for an `#SBATCH` line.
#[derive(Debug, Clone)]
pub struct OneLine(String);

impl OneLine {
    pub(crate) fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for OneLine {
    type Err = InvalidOption;

    fn from_str(text: &str) -> Result<Self, InvalidOption> {
        one_line(text).map(Self)
    }
}

/// The name of a log file, with a part that differs between tasks.
#[derive(Debug, Clone)]
pub struct LogPattern(String);

impl LogPattern {
    pub(crate) fn as_str(&self) -> &str {
        &self.0
    }

    /// The log file of one task.
    pub(crate) fn of_task(&self, job: u64, task: u32) -> String {
        self.0.replace("%A", &job.to_string()).replace("%a", &task.to_string())
    }
}

impl FromStr for LogPattern {
    type Err = InvalidOption;

    fn from_str(text: &str) -> Result<Self, InvalidOption> {
        let text = one_line(text)?;
        if text.contains('\\') {
            return Err(InvalidOption::Backslash(text));
        }
        let replaced = text.replace("%%", "");
        let apart = replaced.contains("%j") || (replaced.contains("%A") && replaced.contains("%a"));
        if apart || text == "/dev/null" { Ok(Self(text)) } else { Err(InvalidOption::OneFile(text)) }
    }
}

/// A further option for sbatch, as written in an `#SBATCH` line.
#[derive(Debug, Clone)]
pub struct SbatchOption(String);

impl SbatchOption {
    /// Whether it is the option of this name, or a prefix of it, which sbatch accepts as an abbreviation.
    pub(crate) fn begins(&self, name: &str) -> bool {
        let key = self.0.split(['=', ' ']).next().unwrap_or_default();
        name.starts_with(key)
    }
}

impl FromStr for SbatchOption {
    type Err = InvalidOption;

    fn from_str(text: &str) -> Result<Self, InvalidOption> {
        let text = one_line(text)?;
        let name = text.split(['=', ' ']).next().unwrap_or_default();
        if name.len() < 3 || !name.starts_with("--") {
            return Err(InvalidOption::NotLong(text));
        }
        // sbatch accepts a prefix of an option's name as an abbreviation.
        match OWN_OPTIONS.iter().find(|(own, _)| own.starts_with(name)) {
            Some((_, instead)) => Err(InvalidOption::Own { option: name.to_owned(), instead }),
            None => Ok(Self(text)),
        }
    }
}

impl Submission {
    /// Time before the walltime at which Slurm sends SIGTERM: this works even if the worker's clock is wrong.
    pub(crate) fn warning(&self) -> Duration {
        self.grace + HAND_BACK
    }

    pub(crate) fn script(&self) -> String {
        format!("#!/bin/bash\n{}\n{}", self.head(), self.body())
    }

    fn head(&self) -> String {
        let throttle = self.at_once.map_or(String::new(), |n| format!("%{n}"));
        let mut lines = vec![
            format!("--job-name={}", sbatch_quoted(&self.job_name.0)),
            format!("--array=1-{}{throttle}", self.workers),
            format!("--time={}", self.walltime),
            "--nodes=1".to_owned(),
            "--ntasks=1".to_owned(),
            format!("--cpus-per-task={}", self.threads),
            format!("--signal=B:TERM@{}", self.warning().as_secs()),
            format!("--output={}", sbatch_quoted(&self.log.0)),
            // A requeued task continues in the same file.
            "--open-mode=append".to_owned(),
            "--requeue".to_owned(),
        ];
        lines.extend(self.partition.iter().map(|p| format!("--partition={}", sbatch_quoted(&p.0))));
        lines.extend(self.options.iter().map(|o| o.0.clone()));
        lines.iter().map(|line| format!("#SBATCH {line}\n")).collect()
    }

    fn body(&self) -> String {
        let mut body = TIME_LEFT.replace("@WALLTIME@", &self.walltime.to_string());
        let _ = write!(body, "exec {}", shell_quoted(&self.program));
        let mut add = |option: &str, value: &str| {
            let _ = write!(body, " \\\n  {option} {value}");
        };
        if let Some(access) = &self.coordinator.access {
            add("--access", &shell_quoted(access));
        }
        if let Some(server) = &self.coordinator.server {
            add("--server", &shell_quoted(server));
        }
        add("--threads", "\"$SLURM_CPUS_PER_TASK\"");
        add("--label", "\"$label\"");
        add("--time-limit", "\"$left\"");
        add("--grace", &span_text(self.grace));
        add("--idle-exit", &span_text(self.idle_exit));
        body.push('\n');
        body
    }
}

/// Sets `left` to the remaining walltime, in a form that `--time-limit` accepts.
const TIME_LEFT: &str = r#"# The options below count; the submitter's environment, which sbatch hands on, does not.
unset FARM_SERVER FARM_ACCESS FARM_TIME_LIMIT FARM_GRACE

label="slurm:$SLURM_ARRAY_JOB_ID.$SLURM_ARRAY_TASK_ID@${SLURMD_NODENAME:-$(hostname)}"

# What is left of the walltime: a requeued task, or one whose limit was changed, has another than the one asked for.
if [[ ${SLURM_JOB_END_TIME:-} =~ ^[0-9]+$ ]]; then
  left_s=$((SLURM_JOB_END_TIME - $(date +%s)))
  left=$((left_s > 0 ? left_s : 1))s
else
  # By task: the job number of an array's last task is that of the whole array.
  left=$(timeout 20 squeue --noheader --jobs="${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID" --format=%L || true)
  [[ $left =~ ^([0-9]+-)?[0-9:]*[1-9][0-9:]*$ && $left == *:* ]] || left=@WALLTIME@
fi
echo "$label: $left left of the walltime"

# exec: Slurm warns the batch shell only, and this makes the worker take its place.
"#;

#[cfg(test)]
mod tests;
