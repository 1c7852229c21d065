use std::io::Write;
use std::path::{Path, PathBuf, absolute};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use serde::Serialize;

use crate::cli::{Global, SlurmCommand, SlurmSubmitArgs};
use crate::output::{Output, grouped};
use crate::slurm::{Coordinator, Submission};
use farm_link::walltime::span_text;

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

#[derive(Debug, Serialize)]
struct SubmittedJson {
    /// None for a dry run.
    job_id: Option<u64>,
    workers: u32,
    script: String,
}

pub(crate) fn run(global: &Global, command: SlurmCommand, output: &Output) -> Result<()> {
    match command {
        SlurmCommand::Submit(args) => submit(global, args, output),
    }
}

fn submit(global: &Global, args: SlurmSubmitArgs, output: &Output) -> Result<()> {
    let (dry_run, workers) = (args.dry_run, args.workers.get());
    let submission = submission(global, args)?;
    let script = submission.script();
    warn_of_loopback(global, &submission.coordinator);
    let job_id = if dry_run { None } else { Some(sbatch(Path::new("sbatch"), &submission, &script)?) };
    let data = SubmittedJson { job_id, workers, script };
    output.print("slurm-submit", &data, || match job_id {
        None => data.script.clone(),
        Some(id) if global.quiet => id.to_string(),
        Some(id) => text(id, &submission),
    })
}

fn text(job_id: u64, submission: &Submission) -> String {
    let counted = |n: u64, what: &str| format!("{} {what}{}", grouped(n), if n == 1 { "" } else { "s" });
    format!(
        "job {job_id}: {} with {} and a walltime of {}, told to stop at least {} before it",
        counted(submission.workers.get().into(), "worker"),
        counted(submission.threads.into(), "thread"),
        submission.walltime,
        span_text(submission.warning())
    )
}

fn submission(global: &Global, args: SlurmSubmitArgs) -> Result<Submission> {
    let submission = Submission {
        coordinator: coordinator(global, args.worker_access)?,
        program: program(args.worker)?,
        workers: args.workers,
        at_once: args.at_once,
        walltime: args.time,
        threads: args.threads,
        grace: args.grace,
        idle_exit: args.idle_exit,
        job_name: args.job_name,
        partition: args.partition,
        log: args.log,
        options: args.sbatch_option,
    };
    // Slurm takes no more than 65535 seconds here, and would send the signal at once if it were not before the end.
    let (warning, walltime) = (submission.warning(), submission.walltime.rounded_to_minutes());
    ensure!(
        warning < walltime && warning.as_secs() <= 65_535,
        "walltime {} with grace {}: workers must stop {} before the end, which leaves no time to work",
        submission.walltime,
        span_text(submission.grace),
        span_text(warning)
    );
    Ok(submission)
}

fn coordinator(global: &Global, worker_access: Option<PathBuf>) -> Result<Coordinator> {
    // Clients' tokens open nothing for workers; `farmctl access create` writes the files side by side.
    let beside = global.access.as_ref().map(|client| client.with_file_name("worker.toml"));
    let access = match worker_access.or(beside) {
        Some(file) => Some(access_file(&file).context("the workers' access file (--worker-access)")?),
        None => None,
    };
    ensure!(
        access.is_some() || global.server.is_some(),
        "workers must know the coordinator: name it by --server URL or --worker-access FILE"
    );
    Ok(Coordinator { server: global.server.clone(), access })
}

/// The absolute path of a file that is there and that others cannot read.
fn access_file(file: &Path) -> Result<String> {
    use std::os::unix::fs::PermissionsExt;
    let path = shared_path(file)?;
    let metadata = std::fs::metadata(&path).with_context(|| path.clone())?;
    ensure!(metadata.is_file(), "{path} is no file");
    let mode = metadata.permissions().mode() & 0o777;
    let of_others = mode & 0o077;
    ensure!(of_others == 0, "{path} has mode {mode:04o}, so that others can read the token: chmod 600 it");
    Ok(path)
}

/// A name without a slash is looked up on the nodes; a path must be there.
fn program(worker: Option<PathBuf>) -> Result<String> {
    let Some(worker) = worker else { return Ok(beside_this_program().unwrap_or("farm-worker".to_owned())) };
    if worker.components().count() == 1 && worker.is_relative() && !worker.starts_with(".") {
        return shown(&worker);
    }
    let path = shared_path(&worker)?;
    let metadata =
        std::fs::metadata(&path).with_context(|| format!("the worker's program (--worker): {path}"))?;
    ensure!(metadata.is_file(), "the worker's program (--worker): {path} is no file");
    Ok(path)
}

fn beside_this_program() -> Option<String> {
    let path = std::env::current_exe().ok()?.with_file_name("farm-worker");
    path.is_file().then(|| path.to_str().map(str::to_owned))?
}

fn shared_path(path: &Path) -> Result<String> {
    shown(&absolute(path).with_context(|| path.display().to_string())?)
}

fn shown(path: &Path) -> Result<String> {
    Ok(path.to_str().with_context(|| format!("{} is not UTF-8", path.display()))?.to_owned())
}

fn warn_of_loopback(global: &Global, coordinator: &Coordinator) {
    let loopback = |url: &String| ["//127.", "//localhost", "//[::1]"].iter().any(|host| url.contains(host));
    if !global.quiet && coordinator.server.as_ref().is_some_and(loopback) {
        eprintln!(
            "farmctl: note: on another machine than the coordinator's, workers do not find it at a loopback address"
        );
    }
}

/// Hands the script to sbatch and reads the job's number.
fn sbatch(program: &Path, submission: &Submission, script: &str) -> Result<u64> {
    let mut command = Command::new(program);
    command.arg("--parsable").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    for variable in OVERRIDES {
        command.env_remove(variable);
    }
    if submission.partition.is_some() {
        command.env_remove("SBATCH_PARTITION");
    }
    let mut child = command.spawn().map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => anyhow::anyhow!(
            "sbatch is not on PATH: run this on a login node of the cluster, or take the script from --dry-run there"
        ),
        _ => anyhow::Error::new(error).context("starting sbatch"),
    })?;
    // A program that ends without reading the script tells why by its status.
    let written = child.stdin.take().map_or(Ok(()), |mut stdin| stdin.write_all(script.as_bytes()));
    let answer = child.wait_with_output().context("waiting for sbatch")?;
    let told = String::from_utf8_lossy(&answer.stderr);
    if !answer.status.success() {
        bail!("sbatch refused the job ({}): {}", answer.status, told.trim());
    }
    written.context("handing the script to sbatch")?;
    if !told.trim().is_empty() {
        eprintln!("{}", told.trim_end());
    }
    job_id(&String::from_utf8_lossy(&answer.stdout))
}

/// `--parsable` answers "NUMBER" or "NUMBER;CLUSTER".
fn job_id(answer: &str) -> Result<u64> {
    let number = answer.trim().split(';').next().unwrap_or_default();
    number.parse().with_context(|| format!("sbatch answered {:?}, which is no job number", answer.trim()))
}
