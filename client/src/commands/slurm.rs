//! `farmctl slurm`: workers on a Slurm cluster, once or as many as there is work for.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf, absolute};

use anyhow::{Context, Result, ensure};
use serde::Serialize;

use crate::cli::{Global, SlurmCommand, SlurmSubmitArgs, SlurmWorkerArgs};
use crate::output::{Output, counted};
use crate::slurm::{CoordinatorAddress, OneLine, Submission, queue};
use farm_link::logs::to_stderr;
use farm_link::walltime::span_text;

mod autoscale;

/// Name of jobs that are given none.
const JOB_NAME: &str = "farm-worker";

#[derive(Debug, Serialize)]
struct SubmittedJson {
    /// None for a dry run.
    job_id: Option<u64>,
    workers: u32,
    script: String,
}

pub(crate) async fn run(global: &Global, command: SlurmCommand, output: &Output) -> Result<()> {
    match command {
        SlurmCommand::Submit(args) => submit(global, args, output).await,
        SlurmCommand::Autoscale(args) => autoscale::run(global, args, output).await,
    }
}

async fn submit(global: &Global, args: SlurmSubmitArgs, output: &Output) -> Result<()> {
    let workers = args.workers.get();
    let submission =
        Submission { at_once: args.at_once, ..submission(global, args.workers_are, JOB_NAME, args.workers)? };
    let script = submission.script();
    warn_of_loopback(global, &submission.coordinator);
    let job_id = if args.dry_run { None } else { Some(queue::submit(&submission, &script).await?) };
    let data = SubmittedJson { job_id, workers, script };
    output.print("slurm-submit", &data, || match job_id {
        None => data.script.clone(),
        Some(id) if global.quiet => id.to_string(),
        Some(id) => text(id, &submission),
    })
}

fn text(job_id: u64, submission: &Submission) -> String {
    format!(
        "job {job_id}: {} with {} and a walltime of {}, told to stop at least {} before it",
        counted(submission.workers.get().into(), "worker"),
        counted(submission.threads.into(), "thread"),
        submission.walltime,
        span_text(submission.warning())
    )
}

fn submission(
    global: &Global,
    args: SlurmWorkerArgs,
    job_name: &str,
    workers: NonZeroU32,
) -> Result<Submission> {
    let submission = Submission {
        coordinator: coordinator(global, args.worker_access)?,
        program: program(args.worker)?,
        workers,
        at_once: None,
        walltime: args.time,
        threads: args.threads,
        grace: args.grace,
        idle_exit: args.idle_exit,
        job_name: args.job_name.map_or_else(|| job_name.parse::<OneLine>(), Ok)?,
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

fn coordinator(global: &Global, worker_access: Option<PathBuf>) -> Result<CoordinatorAddress> {
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
    Ok(CoordinatorAddress { server: global.server.clone(), access })
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

fn warn_of_loopback(global: &Global, coordinator: &CoordinatorAddress) {
    let loopback = |url: &String| ["//127.", "//localhost", "//[::1]"].iter().any(|host| url.contains(host));
    if !global.quiet && coordinator.server.as_ref().is_some_and(loopback) {
        to_stderr(
            "farmctl: note: on another machine than the coordinator's, workers do not find it at a loopback address",
        );
    }
}
