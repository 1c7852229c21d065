//! Implements `farmctl slurm`: submits workers to a Slurm cluster, once or according to the farm's demand.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf, absolute};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand};
use farm_link::logs::to_stderr;
use farm_link::walltime::{Walltime, parse_span, parse_time_limit, span_text};
use serde::Serialize;

use crate::cli::Global;
use crate::output::{Output, counted};
use crate::slurm::{CoordinatorAddress, LogPattern, OneLine, SbatchOption, Submission, queue};

mod autoscale;

#[derive(Debug, Subcommand)]
pub(crate) enum SlurmCommand {
    /// Submit workers as an array job; each stops by itself before its walltime, or when it runs out of work.
    Submit(SlurmSubmitArgs),
    /// Keep as many workers submitted as there is work for, until stopped.
    Autoscale(SlurmAutoscaleArgs),
}

/// Size of each worker, and the way in which it is started.
#[derive(Debug, Args)]
pub(crate) struct SlurmWorkerArgs {
    /// Walltime of each worker: minutes, MM:SS, HH:MM:SS, D-HH, D-HH:MM or D-HH:MM:SS.
    #[arg(long, value_name = "TIME")]
    time: Walltime,
    /// Threads of each worker, and so the number of cores it gets.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=4096))]
    threads: u16,
    /// Partition to run in [default: the cluster's].
    #[arg(long, value_name = "NAME")]
    partition: Option<OneLine>,
    /// How long jobs that are being computed may continue once a worker has to stop.
    #[arg(long, value_name = "DURATION", default_value = "10s", value_parser = parse_span)]
    grace: Duration,
    /// Stop a worker that has had no work for this long.
    #[arg(long, value_name = "DURATION", default_value = "5m", value_parser = parse_time_limit)]
    idle_exit: Duration,
    /// The workers' access file, on a filesystem that the nodes share [default: worker.toml next to --access].
    #[arg(long, value_name = "FILE")]
    worker_access: Option<PathBuf>,
    /// The worker's program, on a filesystem that the nodes share [default: farm-worker next to this program, or
    /// on the nodes' PATH].
    #[arg(long, value_name = "PATH")]
    worker: Option<PathBuf>,
    /// Name of the job in Slurm [default: farm-worker]. `autoscale` adds the farm's address by default, to recognise
    /// its own jobs.
    #[arg(long, value_name = "NAME")]
    job_name: Option<OneLine>,
    /// Log file of each worker; %A is the job number, %a the task number.
    #[arg(long, value_name = "PATTERN", default_value = "farm-worker-%A_%a.log")]
    log: LogPattern,
    /// Additional option for sbatch, such as --sbatch-option=--account=lab; may be given several times.
    #[arg(long, value_name = "OPTION", allow_hyphen_values = true)]
    sbatch_option: Vec<SbatchOption>,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl slurm submit --workers 8 --time 2:00:00 --threads 16 --worker-access ~/farm/worker.toml
  farmctl slurm submit --workers 100 --at-once 8 --time 1:00:00 --server https://farm:7700 --dry-run")]
pub(crate) struct SlurmSubmitArgs {
    /// Number of workers; each is one task of the array.
    #[arg(long, value_name = "N", value_parser = at_most_a_million)]
    workers: NonZeroU32,
    /// How many of them may run at the same time [default: all]. The others follow as these end, so that work
    /// which takes longer than the walltime needs only one submission.
    #[arg(long, value_name = "N", value_parser = at_most_a_million)]
    at_once: Option<NonZeroU32>,
    #[command(flatten)]
    workers_are: SlurmWorkerArgs,
    /// Print the job script without submitting it.
    #[arg(long)]
    dry_run: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl slurm autoscale --max-workers 32 --time 1:00:00 --threads 16 --access ~/farm/client.toml
  farmctl slurm autoscale --max-workers 8 --time 0:30:00 --until-done --job-name night")]
pub(crate) struct SlurmAutoscaleArgs {
    /// Most workers at the same time, including those that wait in the queue.
    #[arg(long, value_name = "N", value_parser = at_most_a_million)]
    max_workers: NonZeroU32,
    /// Add no worker to those there if they will have finished all work within this time.
    #[arg(long, value_name = "DURATION", default_value = "2m", value_parser = parse_span)]
    worth: Duration,
    /// Pause between two looks at the farm and the queue. The first look that finds work submits one worker; each
    /// further one at most doubles their number.
    #[arg(long, value_name = "DURATION", default_value = "30s", value_parser = parse_time_limit)]
    every: Duration,
    /// End when the farm has no work left, instead of waiting for more.
    #[arg(long)]
    until_done: bool,
    #[command(flatten)]
    workers_are: SlurmWorkerArgs,
}

fn at_most_a_million(text: &str) -> Result<NonZeroU32, String> {
    let number = text.parse::<NonZeroU32>().ok().filter(|n| n.get() <= 1_000_000);
    number.ok_or_else(|| "a whole number from 1 to 1000000 is allowed".to_owned())
}

/// Default name of jobs.
const JOB_NAME: &str = "farm-worker";

#[derive(Debug, Serialize)]
struct SubmittedJson {
    /// `None` for a dry run.
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
        "job {job_id}: {} with {} and a walltime of {}, which stop at least {} before it",
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
    // Slurm accepts at most 65535 seconds here, and would send the signal immediately if it were not before the end.
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
    // Clients' tokens do not authorise workers; `farmctl access create` writes the files side by side.
    let shared = global.access.as_ref().map(|client| client.with_file_name("worker.toml"));
    let access = match worker_access.or(shared) {
        Some(file) => Some(access_file(&file).context("the workers' access file (--worker-access)")?),
        None => None,
    };
    ensure!(
        access.is_some() || global.server.is_some(),
        "workers must know the coordinator: name it by --server URL or --worker-access FILE"
    );
    Ok(CoordinatorAddress { server: global.server.clone(), access })
}

/// The absolute path of an existing file that other users cannot read.
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

/// The worker's program: a name without a slash is looked up on the nodes; a path must exist.
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
