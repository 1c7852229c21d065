//! Runs the commands of Slurm: `sbatch`, `squeue`, `scancel`.

use std::io::ErrorKind;
use std::process::{Output, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use farm_link::logs::to_stderr;
use tokio::io::AsyncWriteExt;
use tokio::process::Command;
use tokio::time::timeout;

use super::scaling::{TaskId, TaskState};
use super::{OneLine, Submission};

/// Environment variables that take precedence over the script's `#SBATCH` lines for sbatch; they are removed.
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
/// Deadline of a command. After it the result is unknown, and nothing is done.
const PATIENCE: Duration = Duration::from_mins(3);
/// Largest number of tasks in one call of scancel.
const CANCELLED_AT_ONCE: usize = 500;

/// Passes the script to sbatch and returns the job's number.
pub(crate) async fn submit(submission: &Submission, script: &str) -> Result<u64> {
    let mut command = Command::new("sbatch");
    command.arg("--parsable");
    for variable in OVERRIDES {
        command.env_remove(variable);
    }
    if submission.partition.is_some() {
        command.env_remove("SBATCH_PARTITION");
    }
    let output =
        run(command, Some(script), ", or take the script from `slurm submit --dry-run` there").await?;
    let text = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "sbatch refused the job ({}): {}", output.status, text.trim());
    if !text.trim().is_empty() {
        to_stderr(text.trim_end());
    }
    job_id(&String::from_utf8_lossy(&output.stdout))
}

/// This user's tasks with this job name that are queued or running.
pub(crate) async fn tasks(job_name: &OneLine) -> Result<Vec<(TaskId, TaskState)>> {
    let mut command = Command::new("squeue");
    // --all includes jobs of hidden partitions.
    command.args(["--me", "--all", "--noheader", "--array", "--format=%F|%K|%T|%r|%j"]);
    // Some of these variables filter jobs out.
    for (variable, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("SQUEUE_"))
    {
        command.env_remove(variable);
    }
    let text = answer("squeue", command).await?;
    Ok(text.lines().filter_map(|line| task(line, job_name.as_str())).collect())
}

/// Cancels tasks in the queue; those that have begun in the meantime continue.
pub(crate) async fn cancel(tasks: &[TaskId]) -> Result<()> {
    for tasks in tasks.chunks(CANCELLED_AT_ONCE) {
        let mut command = Command::new("scancel");
        command.arg("--state=PENDING").args(tasks.iter().map(ToString::to_string));
        answer("scancel", command).await?;
    }
    Ok(())
}

async fn answer(program: &str, command: Command) -> Result<String> {
    let output = run(command, None, "").await?;
    if !output.status.success() {
        bail!("{program} failed ({}): {}", output.status, String::from_utf8_lossy(&output.stderr).trim());
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

async fn run(mut command: Command, input: Option<&str>, otherwise: &str) -> Result<Output> {
    let program = command.as_std().get_program().to_string_lossy().into_owned();
    command.stdin(if input.is_some() { Stdio::piped() } else { Stdio::null() });
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).kill_on_drop(true);
    let mut child = command.spawn().map_err(|error| match error.kind() {
        ErrorKind::NotFound => {
            anyhow::anyhow!("{program} is not on PATH: run this on a login node of the cluster{otherwise}")
        }
        _ => anyhow::Error::new(error).context(format!("starting {program}")),
    })?;
    let stdin = child.stdin.take();
    let talk = async {
        let written = match (stdin, input) {
            (Some(mut stdin), Some(text)) => stdin.write_all(text.as_bytes()).await,
            _ => Ok(()),
        };
        (written, child.wait_with_output().await)
    };
    let Ok((written, output)) = timeout(PATIENCE, talk).await else {
        bail!("{program} gave no answer in {} minutes", PATIENCE.as_secs() / 60);
    };
    let output = output.with_context(|| format!("waiting for {program}"))?;
    // If a program ends without reading its input, its exit status reports the cause.
    if output.status.success() {
        written.with_context(|| format!("handing the script to {program}"))?;
    }
    Ok(output)
}

/// Parses the answer of `--parsable`: "NUMBER" or "NUMBER;CLUSTER".
fn job_id(answer: &str) -> Result<u64> {
    let number = answer.trim().split(';').next().unwrap_or_default();
    number.parse().with_context(|| format!("sbatch answered {:?}, which is no job number", answer.trim()))
}

/// Parses a line of squeue: the array's job, the task, its state, the reason of the state, and the job's name.
fn task(line: &str, job_name: &str) -> Option<(TaskId, TaskState)> {
    let mut parts = line.splitn(5, '|');
    let mut next = || parts.next();
    let (job, task, state, reason, name) = (next()?, next()?, next()?, next()?, next()?);
    if name.trim_end() != job_name.trim_end() {
        return None;
    }
    let state = match state {
        "REQUEUE_HOLD" | "SPECIAL_EXIT" | "RESV_DEL_HOLD" => TaskState::Held,
        // The reasons are JobHeldUser, JobHeldAdmin and "launch failed requeued held".
        "PENDING" if reason.to_lowercase().contains("held") => TaskState::Held,
        "PENDING" | "REQUEUED" | "REQUEUE_FED" => TaskState::Waiting,
        "BOOT_FAIL" | "CANCELLED" | "COMPLETED" | "DEADLINE" | "FAILED" | "LAUNCH_FAILED" | "NODE_FAIL"
        | "OUT_OF_MEMORY" | "PREEMPTED" | "RECONFIG_FAIL" | "REVOKED" | "TIMEOUT" => return None,
        // A completing task may be queued again, and counts until it is gone. So do states of later versions of Slurm.
        _ => TaskState::Running,
    };
    // A job that is no array has no task number: it is none of these workers.
    Some((TaskId { job: job.parse().ok()?, task: task.parse().ok()? }, state))
}

#[cfg(test)]
mod tests;
