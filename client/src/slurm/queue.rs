//! The commands of Slurm: `sbatch`, `squeue`, `scancel`.

use std::io::Write;
use std::process::{Command, Output, Stdio};

use anyhow::{Context, Result, bail};

use super::scaling::{TaskId, TaskState};
use super::{OneLine, Submission};

/// Variables that sbatch puts above the script's lines; what the script says of these must hold.
const OVERRIDES: [&str; 9] = [
    "SBATCH_ARRAY_INX",
    "SBATCH_JOB_NAME",
    "SBATCH_NO_REQUEUE",
    "SBATCH_OPEN_MODE",
    "SBATCH_OUTPUT",
    "SBATCH_REQUEUE",
    "SBATCH_SIGNAL",
    "SBATCH_TIMELIMIT",
    "SBATCH_WAIT",
];
/// Variables that change what squeue tells.
const VIEWS: [&str; 6] =
    ["SQUEUE_ALL", "SQUEUE_FORMAT", "SQUEUE_FORMAT2", "SQUEUE_PARTITION", "SQUEUE_SORT", "SQUEUE_STATES"];
/// Most tasks that one call of scancel names.
const CANCELLED_AT_ONCE: usize = 500;

/// Hands the script to sbatch and reads the job's number.
pub(crate) fn submit(submission: &Submission, script: &str) -> Result<u64> {
    let mut command = Command::new("sbatch");
    command.arg("--parsable");
    for variable in OVERRIDES {
        command.env_remove(variable);
    }
    if submission.partition.is_some() {
        command.env_remove("SBATCH_PARTITION");
    }
    let output = run(command, Some(script), ", or take the script from --dry-run there")?;
    let told = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        bail!("sbatch refused the job ({}): {}", output.status, told.trim());
    }
    if !told.trim().is_empty() {
        eprintln!("{}", told.trim_end());
    }
    job_id(&String::from_utf8_lossy(&output.stdout))
}

/// This user's tasks of that name that wait or run.
pub(crate) fn tasks(job_name: &OneLine) -> Result<Vec<(TaskId, TaskState)>> {
    let mut command = Command::new("squeue");
    command.args(["--me", "--noheader", "--array", "--format=%F %K %T %j"]);
    for variable in VIEWS {
        command.env_remove(variable);
    }
    let output = run(command, None, "")?;
    if !output.status.success() {
        bail!("squeue failed ({}): {}", output.status, String::from_utf8_lossy(&output.stderr).trim());
    }
    let told = String::from_utf8_lossy(&output.stdout);
    Ok(told.lines().filter_map(|line| task(line, job_name.as_str())).collect())
}

pub(crate) fn cancel(tasks: &[TaskId]) -> Result<()> {
    for tasks in tasks.chunks(CANCELLED_AT_ONCE) {
        let mut command = Command::new("scancel");
        command.args(tasks.iter().map(ToString::to_string));
        let output = run(command, None, "")?;
        if !output.status.success() {
            bail!("scancel failed ({}): {}", output.status, String::from_utf8_lossy(&output.stderr).trim());
        }
    }
    Ok(())
}

fn run(mut command: Command, input: Option<&str>, otherwise: &str) -> Result<Output> {
    let program = command.get_program().to_string_lossy().into_owned();
    command.stdin(if input.is_some() { Stdio::piped() } else { Stdio::null() });
    let mut child =
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(|error| {
            match error.kind() {
                std::io::ErrorKind::NotFound => anyhow::anyhow!(
                    "{program} is not on PATH: run this on a login node of the cluster{otherwise}"
                ),
                _ => anyhow::Error::new(error).context(format!("starting {program}")),
            }
        })?;
    let written = match (child.stdin.take(), input) {
        (Some(mut stdin), Some(text)) => stdin.write_all(text.as_bytes()),
        _ => Ok(()),
    };
    let output = child.wait_with_output().with_context(|| format!("waiting for {program}"))?;
    // A program that ends without reading its input tells why by its status.
    if output.status.success() {
        written.with_context(|| format!("handing the script to {program}"))?;
    }
    Ok(output)
}

/// `--parsable` answers "NUMBER" or "NUMBER;CLUSTER".
fn job_id(answer: &str) -> Result<u64> {
    let number = answer.trim().split(';').next().unwrap_or_default();
    number.parse().with_context(|| format!("sbatch answered {:?}, which is no job number", answer.trim()))
}

/// A line of squeue's: the array's job, the task, its state and the job's name, which may have blanks.
fn task(line: &str, job_name: &str) -> Option<(TaskId, TaskState)> {
    let mut words = line.splitn(4, ' ');
    let mut next = || words.next();
    let (job, task, state, name) = (next()?, next()?, next()?, next()?);
    let state = match state {
        "PENDING" | "REQUEUED" | "REQUEUE_HOLD" | "REQUEUE_FED" | "SPECIAL_EXIT" => TaskState::Waiting,
        "RUNNING" | "CONFIGURING" | "RESIZING" | "SUSPENDED" | "STOPPED" | "SIGNALING" | "STAGE_OUT" => {
            TaskState::Running
        }
        // It ends, or has ended.
        _ => return None,
    };
    if name.trim_end() != job_name {
        return None;
    }
    // A job that is no array has no number of a task: it is none of these workers.
    Some((TaskId { job: job.parse().ok()?, task: task.parse().ok()? }, state))
}

#[cfg(test)]
mod tests;
