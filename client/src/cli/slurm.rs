//! Arguments of `farmctl slurm`.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

use crate::slurm::{LogPattern, OneLine, SbatchOption};
use farm_link::walltime::{Walltime, parse_span, parse_time_limit};

#[derive(Debug, Subcommand)]
pub enum SlurmCommand {
    /// Submit workers as an array job; each stops by itself before its walltime, or when it runs out of work.
    Submit(SlurmSubmitArgs),
    /// Keep as many workers submitted as there is work for, until stopped.
    Autoscale(SlurmAutoscaleArgs),
}

/// What each worker is, and how it gets to its place.
#[derive(Debug, Args)]
pub struct SlurmWorkerArgs {
    /// Walltime of each worker: minutes, MM:SS, HH:MM:SS, D-HH, D-HH:MM or D-HH:MM:SS.
    #[arg(long, value_name = "TIME")]
    pub time: Walltime,
    /// Threads of each worker, and so the number of cores it gets.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: u16,
    /// Partition to run in [default: the cluster's].
    #[arg(long, value_name = "NAME")]
    pub partition: Option<OneLine>,
    /// How long jobs that are being computed may continue once a worker has to stop.
    #[arg(long, value_name = "DURATION", default_value = "10s", value_parser = parse_span)]
    pub grace: Duration,
    /// Stop a worker that has had no work for this long.
    #[arg(long, value_name = "DURATION", default_value = "5m", value_parser = parse_time_limit)]
    pub idle_exit: Duration,
    /// The workers' access file, on a filesystem that the nodes share [default: worker.toml beside --access].
    #[arg(long, value_name = "FILE")]
    pub worker_access: Option<PathBuf>,
    /// The worker's program, on a filesystem that the nodes share [default: farm-worker beside this program, or
    /// on the nodes' PATH].
    #[arg(long, value_name = "PATH")]
    pub worker: Option<PathBuf>,
    /// Name of the job in Slurm [default: farm-worker]. `autoscale` adds the farm's address by default, to recognise
    /// its own jobs.
    #[arg(long, value_name = "NAME")]
    pub job_name: Option<OneLine>,
    /// Log file of each worker; %A is the job number, %a the task number.
    #[arg(long, value_name = "PATTERN", default_value = "farm-worker-%A_%a.log")]
    pub log: LogPattern,
    /// Additional option for sbatch, such as --sbatch-option=--account=lab; may be given several times.
    #[arg(long, value_name = "OPTION", allow_hyphen_values = true)]
    pub sbatch_option: Vec<SbatchOption>,
}

#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct SlurmSubmitArgs {
    /// Number of workers; each is one task of the array.
    #[arg(long, value_name = "N", value_parser = at_most_a_million)]
    pub workers: NonZeroU32,
    /// How many of them may run at the same time [default: all]. The others follow as these end, so that work
    /// which takes longer than the walltime needs only one submission.
    #[arg(long, value_name = "N", value_parser = at_most_a_million)]
    pub at_once: Option<NonZeroU32>,
    #[command(flatten)]
    pub workers_are: SlurmWorkerArgs,
    /// Print the job script without submitting it.
    #[arg(long)]
    pub dry_run: bool,
}

#[derive(Debug, Args)]
#[command(after_help = AUTOSCALE_EXAMPLES)]
pub struct SlurmAutoscaleArgs {
    /// Most workers at the same time, including those that wait in the queue.
    #[arg(long, value_name = "N", value_parser = at_most_a_million)]
    pub max_workers: NonZeroU32,
    /// Add no worker to those there if they will have finished all work within this time.
    #[arg(long, value_name = "DURATION", default_value = "2m", value_parser = parse_span)]
    pub worth: Duration,
    /// Pause between two looks at the farm and the queue. The first look that finds work submits one worker; each
    /// further one at most doubles their number.
    #[arg(long, value_name = "DURATION", default_value = "30s", value_parser = parse_time_limit)]
    pub every: Duration,
    /// End when the farm has no work left, instead of waiting for more.
    #[arg(long)]
    pub until_done: bool,
    #[command(flatten)]
    pub workers_are: SlurmWorkerArgs,
}

const AUTOSCALE_EXAMPLES: &str = "\
Examples:
  farmctl slurm autoscale --max-workers 32 --time 1:00:00 --threads 16 --access ~/farm/client.toml
  farmctl slurm autoscale --max-workers 8 --time 0:30:00 --until-done --job-name night";

const EXAMPLES: &str = "\
Examples:
  farmctl slurm submit --workers 8 --time 2:00:00 --threads 16 --worker-access ~/farm/worker.toml
  farmctl slurm submit --workers 100 --at-once 8 --time 1:00:00 --server https://farm:7700 --dry-run";

fn at_most_a_million(text: &str) -> Result<NonZeroU32, String> {
    let number = text.parse::<NonZeroU32>().ok().filter(|n| n.get() <= 1_000_000);
    number.ok_or_else(|| "a whole number from 1 to 1000000 is allowed".to_owned())
}
