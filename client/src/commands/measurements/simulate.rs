//! Implements `farmctl simulate`: traces edge profiles without a farm, as rows or as a measurement.

mod camera;
mod changes;
mod figures;

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use clap::Args;
use farm_lab::grid_file::read_scene;
use farm_lab::measurement_file::{MeasurementWriter, check_name};
use farm_lab::phase_file::read_phase_table;
use farm_lab::whole_file::open_node;
use farm_link::logs::to_stderr;
use optics_model::job::JobSpec;
use optics_model::phase::{PhaseShape, SecondLobe};
use optics_model::scene::{Channel, Scene, Sensor};
use optics_model::{Invalid, Medium, Profile, Record, TransportPoint, Walks};
use serde::Serialize;

use crate::cli::{FigureArgs, whole_number};
use crate::figure_files;
use crate::output::{Output, envelope, write_whole};
use crate::traced::traced;
use camera::{NOISE, SimulatedCamera};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5 > profile.csv
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5 --walks 1e6 --plot-changes changes.svg
  farmctl simulate --sigma-t 6 --albedo 0.98 --g 0.4 --second-lobe 0.1,-0.5 --thickness 0.5 > lobes.csv
  farmctl simulate --sigma-t 4,6,8 --albedo 0.9,0.99 --g 0.4 --thickness 0.5,1 -o profiles.csv
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5,1 --measurement white -o white.csv")]
pub(crate) struct SimulateArgs {
    /// Extinction coefficients of the sample, per mm, as in 6 or 4,6,8.
    #[arg(long, value_name = "LIST", required = true, value_delimiter = ',', allow_negative_numbers = true)]
    sigma_t: Vec<f64>,
    /// Single-scattering albedos.
    #[arg(long, value_name = "LIST", required = true, value_delimiter = ',', allow_negative_numbers = true)]
    albedo: Vec<f64>,
    /// Anisotropies: mean cosines of the phase function.
    #[arg(
        long,
        value_name = "LIST",
        conflicts_with = "phase_function",
        value_delimiter = ',',
        allow_negative_numbers = true
    )]
    g: Vec<f64>,
    /// Second lobe of the phase function (1 − b) HG(g₁) + b HG(g₂): its weight b and anisotropy g₂, as in 0.1,-0.5; with
    /// 0,0 it is Henyey–Greenstein [default: the scene's].
    #[arg(long, value_name = "WEIGHT,G", value_parser = two_numbers, conflicts_with = "phase_function")]
    second_lobe: Option<[f64; 2]>,
    /// Tabulated phase function: CSV with the columns angle_deg and value, for angles from 0 to 180, in place of --g.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["plot", "plot_changes"])]
    phase_function: Option<PathBuf>,
    /// Thicknesses of the sample in mm.
    #[arg(long, value_name = "LIST", required = true, value_delimiter = ',', allow_negative_numbers = true)]
    thickness: Vec<f64>,
    /// File to write [default: standard output]. It appears under this name once it is complete.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Write a measurement of the material NAME, which `farmctl measure` reads.
    #[arg(long, value_name = "NAME")]
    measurement: Option<String>,
    /// Noise of a camera in a measurement: standard deviation as a share of each pixel's value, up to 0.5 [default: 0.005].
    /// With 0 the profiles are written as simulated; their errors are then alike in neighbouring pixels.
    #[arg(long, value_name = "SHARE", requires = "measurement", allow_negative_numbers = true)]
    noise: Option<f64>,
    /// "lab", "paper", "smooth" or a scene file in TOML.
    #[arg(long, value_name = "SCENE", default_value = "lab")]
    scene: String,
    /// Refractive index of the sample.
    #[arg(long, value_name = "N", default_value_t = 1.53, allow_negative_numbers = true)]
    sample_ior: f64,
    /// Reflectance of the light side of the base; replaces the scene's channels by one, "mono".
    #[arg(long, value_name = "RHO", requires = "rho_dark", allow_negative_numbers = true)]
    rho_light: Option<f64>,
    /// Reflectance of the dark side of the base.
    #[arg(long, value_name = "RHO", requires = "rho_light", allow_negative_numbers = true)]
    rho_dark: Option<f64>,
    /// Width of the profile in mm [default: the scene's].
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    width: Option<f64>,
    /// Number of pixels [default: the scene's].
    #[arg(long, value_name = "N")]
    pixels: Option<u32>,
    /// Random walks: a multiple of 500, at least 1000 [default: 50000, of a measurement 500000].
    #[arg(long, value_name = "N", value_parser = whole_number)]
    walks: Option<u64>,
    /// Seed of the random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Threads to use; the result is the same for any number [default: all cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    threads: Option<u16>,
    /// Also draw the profiles with their noise, one figure per medium and thickness: FILE.svg, FILE.png or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Also draw the effect of a small change of σ_t, 1 − albedo and 1 − g.
    #[arg(long, value_name = "FILE")]
    plot_changes: Option<PathBuf>,
    #[command(flatten)]
    figure: FigureArgs,
    /// Relative size of these changes, above 0 and below 1.
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = 0.2,
        requires = "plot_changes",
        allow_negative_numbers = true
    )]
    change: f64,
}

/// Largest number of profiles of one command; more are the work of a farm.
const MOST_PROFILES: usize = 1000;
/// Default number of walks. A measurement needs more: the error of the simulation, which all pixels share, must be small
/// against the uncertainty of a profile's gain.
const WALKS: u64 = 50_000;
const MEASUREMENT_WALKS: u64 = 500_000;

pub(crate) async fn run(args: SimulateArgs, output: &Output) -> Result<()> {
    let jobs = jobs(&args)?;
    let style = style(&args, &jobs, output)?;
    check_plot(&args, &jobs)?;
    let mut pool = rayon::ThreadPoolBuilder::new();
    if let Some(threads) = args.threads {
        pool = pool.num_threads(usize::from(threads));
    }
    let pool = pool.build().context("starting the tracing threads")?;
    let work = move || pool.install(|| simulate(&args, &style, &jobs));
    tokio::task::spawn_blocking(work).await.context("the tracer")?
}

fn simulate(args: &SimulateArgs, style: &OutputStyle, jobs: &[JobSpec]) -> Result<()> {
    let mut pictures = Vec::new();
    // Figures need all records before the first is written; otherwise each is traced when it is written.
    let mut kept = Vec::new();
    if let Some(path) = &args.plot {
        kept = jobs.iter().map(traced).collect::<Result<_>>()?;
        pictures = figures::draw(jobs, &kept, path, args.figure.size()?)?;
    }
    if let Some(path) = &args.plot_changes {
        let (job, medium) = (&jobs[0], Medium::new(args.sigma_t[0], args.albedo[0], jobs[0].point().g())?);
        figure_files::write(&changes::picture(job, &medium, args.change)?, path, args.figure.size()?)?;
        pictures.push(path.clone());
    }
    for path in pictures {
        to_stderr(format_args!("drawn: {}", path.display()));
    }
    let jobs: Vec<(&JobSpec, Option<Vec<Record>>)> =
        jobs.iter().zip(kept.into_iter().map(Some).chain(std::iter::repeat_with(|| None))).collect();
    let Some(path) = &args.output else {
        return write(style, jobs, std::io::BufWriter::new(std::io::stdout().lock()));
    };
    let place = || format!("output {}", path.display());
    if let Some(node) = open_node(path).with_context(place)? {
        return write(style, jobs, node);
    }
    let mut bytes = Vec::new();
    write(style, jobs, &mut bytes)?;
    write_whole(path, &bytes).with_context(place)
}

/// One job for each σ_t, g and thickness, which traces all albedos.
fn jobs(args: &SimulateArgs) -> Result<Vec<JobSpec>> {
    for (field, list) in
        [("sigma_t", &args.sigma_t), ("albedo", &args.albedo), ("g", &args.g), ("thickness", &args.thickness)]
    {
        if let Some(twice) = (1..list.len()).find(|i| list[..*i].contains(&list[*i])) {
            return Err(Invalid::new(field, list[twice], "each value may be given once").into());
        }
    }
    let scene = scene(args)?;
    let anisotropies =
        scene.phase().table().map_or_else(|| args.g.clone(), |table| vec![table.mean_cosine()]);
    match (args.g.is_empty(), scene.phase().table().is_some()) {
        (false, true) => bail!("--g: leave it out, a tabulated phase function has its own mean cosine"),
        (true, false) => bail!("--g is needed: the mean cosine of the phase function, as in 0.4"),
        _ => {}
    }
    let count = args.sigma_t.len() * args.albedo.len() * anisotropies.len() * args.thickness.len();
    if count > MOST_PROFILES {
        let allowed = format!("at most {MOST_PROFILES} are allowed; for more, submit a grid");
        return Err(Invalid::new("profiles", count, allowed).into());
    }
    let walks = Walks::new(walks(args))?;
    let mut jobs = Vec::new();
    for &sigma_t in &args.sigma_t {
        for &g in &anisotropies {
            for albedo in &args.albedo {
                Medium::new(sigma_t, *albedo, g)?;
            }
            for &thickness in &args.thickness {
                let point = TransportPoint::new(sigma_t, g, thickness, args.sample_ior)?;
                let albedo = args.albedo.clone();
                jobs.push(JobSpec::new(scene.clone(), point, albedo, walks, args.seed, false)?);
            }
        }
    }
    Ok(jobs)
}

fn walks(args: &SimulateArgs) -> u64 {
    args.walks.unwrap_or(if args.measurement.is_some() { MEASUREMENT_WALKS } else { WALKS })
}

fn scene(args: &SimulateArgs) -> Result<Scene> {
    let mut scene = read_scene(&args.scene)?;
    if let (Some(light), Some(dark)) = (args.rho_light, args.rho_dark) {
        scene = scene.with_channels(vec![Channel::new("mono", light, dark)?])?;
    }
    if let Some([weight, g]) = args.second_lobe {
        scene = with_phase(scene, PhaseShape::Lobes(SecondLobe::new(weight, g)?))?;
    }
    if let Some(path) = &args.phase_function {
        scene = with_phase(scene, PhaseShape::Table(Arc::new(read_phase_table(path)?)))?;
    }
    let sensor = scene.sensor();
    let width = args.width.unwrap_or(sensor.width_mm());
    let sensor = Sensor::new(width, args.pixels.unwrap_or(sensor.pixels() as u32), sensor.polar_deg())?;
    Ok(scene.with_sensor(sensor))
}

fn two_numbers(text: &str) -> Result<[f64; 2], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let numbers = numbers.ok().and_then(|numbers| <[f64; 2]>::try_from(numbers).ok());
    numbers.ok_or_else(|| "two numbers with a comma between them are needed, such as 0.1,-0.5".to_owned())
}

/// The scene with a phase function that is exact.
fn with_phase(scene: Scene, phase: PhaseShape) -> Result<Scene> {
    let others = scene.priors().iter().filter(|prior| !prior.kind().is_of_phase()).cloned().collect();
    Ok(scene.with_phase(phase).with_priors(others)?)
}

fn check_plot(args: &SimulateArgs, jobs: &[JobSpec]) -> Result<()> {
    for path in args.plot.iter().chain(&args.plot_changes) {
        args.figure.check(Some(path))?;
    }
    if args.plot_changes.is_none() {
        return Ok(());
    }
    if !(args.change > 0.0 && args.change < 1.0) {
        return Err(Invalid::new("change", args.change, "allowed are numbers above 0, below 1").into());
    }
    if jobs.len() * args.albedo.len() > 1 {
        bail!("--plot-changes shows the changes about one medium at one thickness: give one of each");
    }
    Ok(())
}

/// The format of the output.
enum OutputStyle {
    /// The plain table of one profile.
    One,
    /// A table that names every medium and thickness.
    Several,
    Json(JsonStyle),
    /// A measurement of the material with this name, with the noise of a camera with this seed.
    Measurement {
        material: String,
        noise: f64,
        seed: u64,
    },
}

pub(crate) struct JsonStyle {
    pub(crate) several: bool,
    pub(crate) walks: u64,
    pub(crate) seed: u64,
}

fn style(args: &SimulateArgs, jobs: &[JobSpec], output: &Output) -> Result<OutputStyle> {
    let several = jobs.len() * args.albedo.len() > 1;
    let Some(material) = &args.measurement else {
        let json = JsonStyle { several, walks: walks(args), seed: args.seed };
        return Ok(match (output.is_json(), several) {
            (true, _) => OutputStyle::Json(json),
            (false, true) => OutputStyle::Several,
            (false, false) => OutputStyle::One,
        });
    };
    if output.is_json() {
        bail!("--measurement writes CSV: leave out --json");
    }
    if args.sigma_t.len() * args.albedo.len() * args.g.len().max(1) > 1 {
        bail!(
            "--measurement writes one material: give one --sigma-t, --albedo and --g; --thickness may be a list"
        );
    }
    let (noise, seed) = (args.noise.unwrap_or(NOISE), args.seed);
    SimulatedCamera::new(noise, seed)?;
    Ok(OutputStyle::Measurement { material: check_name(material)?.to_owned(), noise, seed })
}

/// Writes each profile as soon as it is traced.
/// Writes the records of all jobs; those that are not given are traced.
fn write(style: &OutputStyle, jobs: Vec<(&JobSpec, Option<Vec<Record>>)>, mut out: impl Write) -> Result<()> {
    let records = |job: &JobSpec, kept: Option<Vec<Record>>| kept.map_or_else(|| traced(job), Ok);
    match style {
        OutputStyle::Measurement { material, noise, seed } => {
            let mut camera = SimulatedCamera::new(*noise, *seed)?;
            let mut measurement = MeasurementWriter::new(&mut out, material)?;
            for (job, kept) in jobs {
                for Record { profiles, .. } in records(job, kept)? {
                    let profiles = match &mut camera {
                        Some(camera) => camera.photograph(&profiles)?,
                        None => profiles,
                    };
                    measurement.add(job.scene(), job.point().thickness_mm(), &profiles)?;
                }
            }
            measurement.finish()?;
        }
        OutputStyle::Json(json) => {
            for (job, kept) in jobs {
                for (record, albedo) in records(job, kept)?.iter().zip(job.albedo()) {
                    let data = SimulateJson::new(json, job, *albedo, record);
                    writeln!(out, "{}", envelope("simulate", &data)?)?;
                }
            }
        }
        OutputStyle::One | OutputStyle::Several => {
            let several = matches!(style, OutputStyle::Several);
            let media = if several { "sigma_t_per_mm,albedo,g,thickness_mm," } else { "" };
            writeln!(out, "{media}channel,x_mm,value,std_error")?;
            for (job, kept) in jobs {
                for (record, albedo) in records(job, kept)?.iter().zip(job.albedo()) {
                    let medium = if several { medium_cells(job, *albedo) } else { String::new() };
                    write_rows(&mut out, &medium, job.scene(), &record.profiles)?;
                }
            }
        }
    }
    out.flush()?;
    Ok(())
}

fn medium_cells(job: &JobSpec, albedo: f64) -> String {
    let point = job.point();
    format!("{},{albedo},{},{},", point.sigma_t_per_mm(), point.g(), point.thickness_mm())
}

fn write_rows(out: &mut impl Write, medium: &str, scene: &Scene, profiles: &[Profile]) -> Result<()> {
    for (channel, profile) in scene.channels().iter().zip(profiles) {
        let (values, errors) = (profile.radiance_factor.values(), profile.radiance_factor.std_errors());
        for (i, (value, error)) in values.iter().zip(errors).enumerate() {
            writeln!(out, "{medium}{},{},{value},{error}", channel.name(), scene.sensor().centre_mm(i))?;
        }
    }
    Ok(())
}

#[derive(Debug, Serialize)]
pub(crate) struct SimulateJson {
    /// The medium, if there are several.
    #[serde(flatten)]
    medium: Option<MediumJson>,
    x_mm: Vec<f64>,
    walks: u64,
    seed: u64,
    channels: Vec<ChannelJson>,
}

#[derive(Debug, Serialize)]
struct MediumJson {
    sigma_t_per_mm: f64,
    albedo: f64,
    g: f64,
    thickness_mm: f64,
}

impl SimulateJson {
    pub(crate) fn new(style: &JsonStyle, job: &JobSpec, albedo: f64, record: &Record) -> Self {
        let (scene, point) = (job.scene(), job.point());
        let medium = MediumJson {
            sigma_t_per_mm: point.sigma_t_per_mm(),
            albedo,
            g: point.g(),
            thickness_mm: point.thickness_mm(),
        };
        let channels = scene.channels().iter().zip(&record.profiles);
        Self {
            medium: style.several.then_some(medium),
            x_mm: (0..scene.sensor().pixels()).map(|i| scene.sensor().centre_mm(i)).collect(),
            walks: style.walks,
            seed: style.seed,
            channels: channels.map(|(c, p)| ChannelJson::new(c, p)).collect(),
        }
    }
}

#[derive(Debug, Serialize)]
struct ChannelJson {
    channel: String,
    values: Vec<f32>,
    std_errors: Vec<f32>,
}

impl ChannelJson {
    fn new(channel: &Channel, profile: &Profile) -> Self {
        Self {
            channel: channel.name().to_owned(),
            values: profile.radiance_factor.values().to_vec(),
            std_errors: profile.radiance_factor.std_errors().to_vec(),
        }
    }
}
