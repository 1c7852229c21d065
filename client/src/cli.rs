//! The command line.

mod bounds;
mod capture;
mod design;
mod examples;
mod farm;
mod fit;
mod profile;
mod set_up;
mod slurm;
mod web;
mod whole;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;
use optics_model::grid::NoiseLevel;

pub use bounds::BoundsArg;
pub use capture::CaptureArgs;
pub use design::{DesignArgs, PixelsArg, SlabList};
pub use farm::{
    AccessAddArgs, AccessCommand, AccessCreateArgs, AccessRevokeArgs, BackupArgs, CancelArgs, DeleteArgs,
    DoctorArgs, DrainArgs, EventsArgs, NameArgs, PriorityArgs, ReadmitArgs, RestoreArgs, WaitArgs,
    WorkersArgs, WorkersCommand,
};
pub use fit::{
    FitArgs, MapArgs, MeasureArgs, MuArgs, ObjectiveArg, OptionArgs, ScaleArgs, SimilarArgs, WaveletArg,
};
pub use profile::ProfileArgs;
pub use set_up::SetUpArgs;
pub use slurm::{SlurmAutoscaleArgs, SlurmCommand, SlurmSubmitArgs, SlurmWorkerArgs};
pub use web::WebArgs;
use whole::whole_number;

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
  farmctl capture session.toml --measure       from photographs to media
  farmctl submit                               compute the paper's dictionary here
  farmctl measure examples/white.csv --mu 1    measure a material with it
  farmctl fit examples/white.csv --g 0.4       see the best fits one by one
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5 > profile.csv

Exit codes: 0 success, 1 error, 2 wrong usage, 130 interrupted; for a dictionary: 3 some jobs
failed, 4 some jobs are in quarantine, 5 cancelled, 6 still running when --timeout ran out, 7 machines
disagree about some jobs, 8 deleted while it was waited for.";

#[derive(Debug, Clone, Args)]
pub struct Global {
    /// URL of the coordinator, such as http://farm:7700.
    #[arg(long, value_name = "URL", env = "FARM_SERVER", global = true, help_heading = "General options")]
    pub server: Option<String>,
    /// Access file for the coordinator: its URL, its certificate and a token.
    #[arg(long, value_name = "FILE", env = "FARM_ACCESS", global = true, help_heading = "General options")]
    pub access: Option<PathBuf>,
    /// Run in this process even if a server is configured.
    #[arg(long, global = true, help_heading = "General options")]
    pub local: bool,
    /// Folder for the local farm's data.
    #[arg(
        long,
        value_name = "DIR",
        env = "FARM_DATA",
        default_value = "farm-data",
        global = true,
        help_heading = "General options"
    )]
    pub data: PathBuf,
    /// Print a single JSON object instead of text.
    #[arg(long, global = true, help_heading = "General options")]
    pub json: bool,
    /// Show no progress on standard error.
    #[arg(long, short, global = true, help_heading = "General options")]
    pub quiet: bool,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Compute a dictionary; if it exists with the same grid, carry on with it.
    #[command(after_help = examples::SUBMIT)]
    Submit(SubmitArgs),
    /// Turn the photographs of a session into edge profiles, with the quantities of the set-up.
    #[command(after_help = examples::CAPTURE)]
    Capture(CaptureArgs),
    /// Check a measurement file: print what is read, and refuse or note what may be wrong.
    #[command(after_help = examples::CHECK)]
    Check(CheckArgs),
    /// Find the media that best explain measured edge profiles, with error bars.
    #[command(after_help = examples::FIT)]
    Fit(FitArgs),
    /// Find the scale factor and the anisotropy common to a set of materials.
    #[command(after_help = examples::SCALE)]
    Scale(ScaleArgs),
    /// Measure a set of materials: scale factor, common anisotropy, and media with error bars.
    #[command(after_help = examples::MEASURE)]
    Measure(MeasureArgs),
    /// Map how far measured profiles are from every medium of a dictionary.
    #[command(after_help = examples::MAP)]
    Map(MapArgs),
    /// Compare sets of slabs by how well photographs of them would determine a medium.
    #[command(after_help = examples::DESIGN)]
    Design(DesignArgs),
    /// Predict the profile of a slab of a medium from a dictionary, at its records and between them.
    #[command(after_help = examples::PROFILE)]
    Profile(ProfileArgs),
    /// List the media that similarity theory considers equivalent to a given one.
    #[command(after_help = examples::SIMILAR)]
    Similar(SimilarArgs),
    /// Simulate edge profiles, without a farm.
    #[command(after_help = examples::SIMULATE)]
    Simulate(SimulateArgs),
    /// Open a page in the browser: measure, look at dictionaries, run the farm, judge captures.
    #[command(after_help = examples::WEB)]
    Web(WebArgs),
    /// Keep the farm of a folder running, for notebooks and other programs on this machine.
    #[command(after_help = examples::SERVE)]
    Serve(ServeArgs),
    /// Show what the farm is doing.
    #[command(after_help = examples::STATUS)]
    Status,
    /// List the dictionaries.
    #[command(after_help = examples::LIST)]
    List,
    /// Follow the progress of a dictionary until it ends; the exit code is that of its end.
    #[command(after_help = examples::WATCH)]
    Watch(NameArgs),
    /// Wait silently until dictionaries have ended; the exit code is that of their end.
    #[command(after_help = examples::WAIT)]
    Wait(WaitArgs),
    /// Explain why a dictionary is not finished yet.
    #[command(after_help = examples::EXPLAIN)]
    Explain(NameArgs),
    /// Stop handing out jobs of a dictionary; jobs already running are finished.
    #[command(after_help = examples::PAUSE)]
    Pause(NameArgs),
    /// Resume a dictionary that was paused or cancelled.
    #[command(after_help = examples::RESUME)]
    Resume(NameArgs),
    /// Cancel a dictionary; finished records are kept.
    #[command(after_help = examples::CANCEL)]
    Cancel(CancelArgs),
    /// Retry the jobs of a dictionary that were given up.
    #[command(after_help = examples::RETRY)]
    Retry(NameArgs),
    /// Set the priority of a dictionary.
    #[command(after_help = examples::PRIORITY)]
    Priority(PriorityArgs),
    /// Delete a dictionary and the records that no other dictionary uses.
    #[command(after_help = examples::DELETE)]
    Delete(DeleteArgs),
    /// List the workers, or ask one to leave.
    #[command(after_help = examples::WORKERS)]
    Workers(WorkersArgs),
    /// Show what has happened on the farm.
    #[command(after_help = examples::EVENTS)]
    Events(EventsArgs),
    /// Check everything: connection, versions, disk and every record.
    #[command(after_help = examples::DOCTOR)]
    Doctor(DoctorArgs),
    /// Copy the whole database to a file and verify the copy, while the farm keeps running.
    #[command(after_help = examples::BACKUP)]
    Backup(BackupArgs),
    /// Restore a backup into a folder that has no database yet.
    #[command(after_help = examples::RESTORE)]
    Restore(RestoreArgs),
    /// Check whether the coordinator is serving; meant for health checks.
    #[command(after_help = examples::HEALTH)]
    Health,
    /// Create the access files for the coordinator, the workers and people.
    #[command(subcommand)]
    Access(AccessCommand),
    /// Run workers on a Slurm cluster.
    #[command(subcommand)]
    Slurm(SlurmCommand),
    /// Show the details of a dictionary.
    #[command(after_help = examples::SHOW)]
    Show(ShowArgs),
    /// Export the finished records of a dictionary as CSV.
    #[command(after_help = examples::EXPORT)]
    Export(ExportArgs),
    /// Print completions for a shell.
    #[command(after_help = examples::COMPLETIONS)]
    Completions(CompletionsArgs),
    /// Write the manual pages of farmctl, farm-coordinator and farm-worker.
    #[command(after_help = examples::MANUAL)]
    Manual(ManualArgs),
}

#[derive(Debug, Args)]
pub struct CheckArgs {
    /// CSV with measured profiles.
    pub measurements: PathBuf,
}

#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Stop when standard input ends, and so with the program that started this one.
    #[arg(long)]
    pub until_input_ends: bool,
}

#[derive(Debug, Args)]
pub struct SubmitArgs {
    /// Grid file in TOML, or "lab" for the paper's axes in the scene of a laboratory [default: the paper's grid].
    pub grid: Option<PathBuf>,
    /// Name of the dictionary [default: the file's name, "lab" or "paper"].
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// How quiet the records are to be: draft, paper or fine, for about a tenth of the paper's work, the paper's noise,
    /// and ten times the work; instead of the grid file's setting.
    #[arg(long, value_name = "LEVEL", value_parser = level)]
    pub quality: Option<NoiseLevel>,
    /// Wait until the dictionary is finished; without a server, submit always waits.
    #[arg(long)]
    pub wait: bool,
    /// Priority from -1000 to 1000; higher goes first.
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true)]
    pub priority: i32,
}

fn level(name: &str) -> Result<NoiseLevel, String> {
    NoiseLevel::from_name(name).map_err(|invalid| invalid.allowed().to_owned())
}

#[derive(Debug, Args)]
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
    /// File to write [default: standard output]. It appears under this name once it is complete.
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Write a measurement of the material NAME, which `farmctl measure` reads.
    #[arg(long, value_name = "NAME")]
    pub measurement: Option<String>,
    /// Noise of a camera in a measurement: standard deviation as a share of each pixel's value, up to 0.5 [default: 0.005].
    /// With 0 the profiles are written as simulated; their errors are then alike in neighbouring pixels.
    #[arg(long, value_name = "SHARE", requires = "measurement", allow_negative_numbers = true)]
    pub noise: Option<f64>,
    /// "lab", "paper", "smooth" or a scene file in TOML.
    #[arg(long, value_name = "SCENE", default_value = "lab")]
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
    /// Random walks: a multiple of 500, at least 1000 [default: 50000, of a measurement 500000].
    #[arg(long, value_name = "N", value_parser = whole_number)]
    pub walks: Option<u64>,
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
    /// Draw profiles from all over the dictionary, or with --noise how noisy each record is: FILE.svg or FILE.png.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Read all records and print their noise: median, worst, and by albedo.
    #[arg(long)]
    pub noise: bool,
}

#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Name of the dictionary.
    pub name: String,
    /// File to write [default: standard output]. It appears under this name once it is complete.
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Write arrays for NumPy instead of rows: values and standard errors over all axes, the axes, and about.json with
    /// the answer of `show --json`.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["output", "measurement", "json"])]
    pub npz: Option<PathBuf>,
    /// Write the profiles of the responses, not those of the axes: traced in scenes in which one uncertain quantity has
    /// another value, each row with the quantity, the step from the scene's value and its unit.
    #[arg(long, conflicts_with = "measurement")]
    pub responses: bool,
    /// Write the profiles of one medium as a measurement of the material NAME, which `farmctl measure` reads.
    #[arg(long, value_name = "NAME")]
    pub measurement: Option<String>,
    /// Only these extinction coefficients, such as 6,9.
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
pub struct ManualArgs {
    /// Folder for the pages, which is made if it is not there.
    pub folder: PathBuf,
}

#[derive(Debug, Args)]
pub struct CompletionsArgs {
    pub shell: Shell,
}
