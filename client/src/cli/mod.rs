//! The command line.

mod bounds;
mod farm;
mod fit;
mod slurm;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;

pub use bounds::BoundsArg;
pub use farm::{
    AccessCommand, AccessCreateArgs, BackupArgs, CancelArgs, DeleteArgs, DoctorArgs, DrainArgs, EventsArgs,
    NameArgs, PriorityArgs, RestoreArgs, WaitArgs, WorkersArgs, WorkersCommand,
};
pub use fit::{FitArgs, MapArgs, MeasureArgs, MuArgs, OptionArgs, ScaleArgs, SimilarArgs, WaveletArg};
pub use slurm::{SlurmCommand, SlurmSubmitArgs};

/// Measures the optical parameters of translucent resins: computes dictionaries of simulated edge profiles and fits
/// measured profiles to them.
///
/// Without --server or --access everything runs in this process, with its data in ./farm-data.
#[derive(Debug, Parser)]
#[command(name = "farmctl", version, after_help = EXAMPLES)]
pub struct Cli {
    #[command(flatten)]
    pub global: Global,
    #[command(subcommand)]
    pub command: Command,
}

const EXAMPLES: &str = "\
Examples:
  farmctl submit                               compute the paper's dictionary here
  farmctl measure examples/white.csv --mu 1    measure a material with it
  farmctl fit examples/white.csv --g 0.4       see the best fits one by one
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5 > profile.csv

Exit codes: 0 success, 1 error, 2 wrong usage; of a dictionary: 3 some jobs have failed, 4 some jobs are in
quarantine, 5 cancelled, 6 still running when the time to wait was over; 130 interrupted.";

const SIMULATE_EXAMPLES: &str = "\
Examples:
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5 > profile.csv
  farmctl simulate --sigma-t 4,6,8 --albedo 0.9,0.99 --g 0.4 --thickness 0.5,1 -o profiles.csv
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5,1 --measurement white -o white.csv";

#[derive(Debug, Args)]
pub struct Global {
    /// URL of a coordinator, as in http://farm:7700.
    #[arg(long, value_name = "URL", env = "FARM_SERVER", global = true, help_heading = "General options")]
    pub server: Option<String>,
    /// Access file of a coordinator: its URL, its certificate and a token.
    #[arg(long, value_name = "FILE", env = "FARM_ACCESS", global = true, help_heading = "General options")]
    pub access: Option<PathBuf>,
    /// Run in this process even if a server is configured.
    #[arg(long, global = true, help_heading = "General options")]
    pub local: bool,
    /// Folder of the local farm's data.
    #[arg(
        long,
        value_name = "DIR",
        env = "FARM_DATA",
        default_value = "farm-data",
        global = true,
        help_heading = "General options"
    )]
    pub data: PathBuf,
    /// Print one JSON object instead of text.
    #[arg(long, global = true, help_heading = "General options")]
    pub json: bool,
    /// No progress on standard error.
    #[arg(long, short, global = true, help_heading = "General options")]
    pub quiet: bool,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Compute a dictionary; one that exists with the same grid is continued.
    Submit(SubmitArgs),
    /// Find the media that explain measured edge profiles, with error bars.
    Fit(FitArgs),
    /// Find the scale factor and the anisotropy common to a set of materials.
    Scale(ScaleArgs),
    /// Measure a set of materials: scale factor, common anisotropy, media with error bars.
    Measure(MeasureArgs),
    /// Map the distance of measured profiles to every medium of a dictionary.
    Map(MapArgs),
    /// Tell which media similarity theory calls equal to one.
    Similar(SimilarArgs),
    /// Simulate edge profiles, without a farm.
    Simulate(SimulateArgs),
    /// Show what the farm is doing.
    Status,
    /// List the dictionaries.
    List,
    /// Follow a dictionary until it has ended; the exit code tells how.
    Watch(NameArgs),
    /// Wait without a word until dictionaries have ended; the exit code tells how.
    Wait(WaitArgs),
    /// Tell why a dictionary is not done.
    Explain(NameArgs),
    /// Give out no more jobs of a dictionary; those under way are finished.
    Pause(NameArgs),
    /// Go on with a dictionary that was paused or cancelled.
    Resume(NameArgs),
    /// End the work on a dictionary; finished records stay.
    Cancel(CancelArgs),
    /// Try the jobs of a dictionary again that were given up.
    Retry(NameArgs),
    /// Say which dictionaries go first.
    Priority(PriorityArgs),
    /// Delete a dictionary, and the records that no other one uses.
    Delete(DeleteArgs),
    /// List the workers, or let one leave.
    Workers(WorkersArgs),
    /// Show what has happened.
    Events(EventsArgs),
    /// Look for what is wrong: connection, versions, disk, every record.
    Doctor(DoctorArgs),
    /// Copy the whole database to a file, verified, while the farm goes on.
    Backup(BackupArgs),
    /// Make a backup the database of a folder that has none.
    Restore(RestoreArgs),
    /// Ask whether the coordinator serves; for health checks.
    Health,
    /// Make the files by which coordinator, workers and people know each other.
    #[command(subcommand)]
    Access(AccessCommand),
    /// Run workers on a Slurm cluster.
    #[command(subcommand)]
    Slurm(SlurmCommand),
    /// Show one dictionary.
    Show(ShowArgs),
    /// Write the finished records of a dictionary as CSV.
    Export(ExportArgs),
    /// Print completions for a shell.
    Completions(CompletionsArgs),
}

#[derive(Debug, Args)]
pub struct SubmitArgs {
    /// Grid file in TOML; the paper's grid without one.
    pub grid: Option<PathBuf>,
    /// Name of the dictionary [default: the file's name, or "paper"].
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Wait until the dictionary is done. Always so without a server.
    #[arg(long)]
    pub wait: bool,
    /// Dictionaries of higher priority go first: -1000 to 1000.
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true)]
    pub priority: i32,
}

#[derive(Debug, Args)]
#[command(after_help = SIMULATE_EXAMPLES)]
pub struct SimulateArgs {
    /// Extinction coefficients of the sample, per mm, as in 6 or 4,6,8.
    #[arg(long, value_name = "LIST", required = true, value_delimiter = ',', allow_negative_numbers = true)]
    pub sigma_t: Vec<f64>,
    /// Single-scattering albedos.
    #[arg(long, value_name = "LIST", required = true, value_delimiter = ',', allow_negative_numbers = true)]
    pub albedo: Vec<f64>,
    /// Anisotropies of the Henyey–Greenstein phase function.
    #[arg(long, value_name = "LIST", required = true, value_delimiter = ',', allow_negative_numbers = true)]
    pub g: Vec<f64>,
    /// Thicknesses of the sample in mm.
    #[arg(long, value_name = "LIST", required = true, value_delimiter = ',', allow_negative_numbers = true)]
    pub thickness: Vec<f64>,
    /// File to write, whole or not at all [default: standard output].
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Write a measurement of the material NAME, which `farmctl measure` reads.
    #[arg(long, value_name = "NAME")]
    pub measurement: Option<String>,
    /// "paper", "smooth" or a scene file in TOML.
    #[arg(long, value_name = "SCENE", default_value = "paper")]
    pub scene: String,
    /// Refractive index of the sample.
    #[arg(long, value_name = "N", default_value_t = 1.53, allow_negative_numbers = true)]
    pub sample_ior: f64,
    /// Reflectance of the light side of the base; replaces the scene's channels by one, "mono".
    #[arg(long, value_name = "RHO", requires = "rho_dark", allow_negative_numbers = true)]
    pub rho_light: Option<f64>,
    /// Reflectance of the dark side of the base.
    #[arg(long, value_name = "RHO", requires = "rho_light", allow_negative_numbers = true)]
    pub rho_dark: Option<f64>,
    /// Width of the profile in mm [default: the scene's].
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub width: Option<f64>,
    /// Number of pixels [default: the scene's].
    #[arg(long, value_name = "N")]
    pub pixels: Option<u32>,
    /// Random walks: a multiple of 2500, at least 5000.
    #[arg(long, value_name = "N", default_value_t = 250_000)]
    pub walks: u64,
    /// Seed of the random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Threads to use; the result is the same for any number [default: all cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: Option<u16>,
    /// Also draw what a small change of σ_t, 1 − albedo and 1 − g does: FILE.svg or FILE.png.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Relative size of these changes, above 0 and below 1.
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = 0.2,
        requires = "plot",
        allow_negative_numbers = true
    )]
    pub change: f64,
}

#[derive(Debug, Args)]
pub struct ShowArgs {
    /// Name of the dictionary.
    pub name: String,
    /// Draw profiles from all over the dictionary: FILE.svg or FILE.png.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Name of the dictionary.
    pub name: String,
    /// File to write [default: standard output].
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Write the profiles of one medium as a measurement of the material NAME, which `farmctl measure` reads.
    #[arg(long, value_name = "NAME")]
    pub measurement: Option<String>,
    /// Only these extinction coefficients, as in 6,9.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub sigma_t: Vec<f64>,
    /// Only these albedos.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub albedo: Vec<f64>,
    /// Only these anisotropies.
    #[arg(long, value_name = "LIST", value_delimiter = ',', allow_negative_numbers = true)]
    pub g: Vec<f64>,
    /// Only these thicknesses.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub thickness: Vec<f64>,
    /// Only these refractive indices of the sample.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub sample_ior: Vec<f64>,
}

#[derive(Debug, Args)]
pub struct CompletionsArgs {
    pub shell: Shell,
}
