//! Implements `farmctl measure`: fits the media of all materials of one set-up, from a measurement file or from the
//! folder of a session.

mod chart;
pub(crate) mod question;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Args;
use farm_figures::error_budget;
use farm_lab::capture::budget_blocks;
use farm_lab::chart::is_chart;
use farm_lab::document::Block;
use farm_lab::measurement_file::MeasurementFile;
use farm_lab::mixture_file::read_mixtures;
use farm_lab::session_folder::SessionFolder;
use farm_lab::set_up::SetUp;
use farm_proto::DictionaryName;
use farm_proto::wire::{Keep, MeasureRequest};
use optics_model::Measurement;
use optics_model::fit::{FitOptions, FitSettings, Mixtures, MuRange, Objective};

use super::chosen_dictionary::{self, WantedDictionary};
use crate::answers::{FitsReport, UsedOptions, set_up_notes, verdict};
use crate::cli::set_up::SET_UP;
use crate::cli::{FigureArgs, Global, MuArgs, OptionArgs};
use crate::figure_files::{self, FigureSize, drawn};
use crate::measured;
use crate::output::Output;
use crate::slurm::shell_quoted;
use question::{Answer, Question, ask};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl measure materials.csv                        with `lab`, computed if lacking
  farmctl measure examples/white.csv --dictionary paper
  farmctl measure white                                what `farmctl capture` wrote there
  farmctl measure dilutions.csv --mixtures inks.toml   strong absorbers by dilution
  farmctl measure chart.csv -o media                   a chart of printed stacks
  farmctl measure materials.csv --objective paper      as the paper did")]
pub(crate) struct MeasureArgs {
    /// CSV with the profiles of all materials of one set-up, a chart of stacks, or a folder that `farmctl capture` wrote:
    /// its white reference is then taken for the scale factor (--mu 1), its report completed, and its dictionary computed.
    /// Without --dictionary, a farm on this machine that has none computes `lab` first.
    measurements: PathBuf,
    #[command(flatten)]
    pub(crate) options: OptionArgs,
    /// Take this scale factor instead of searching for it.
    #[arg(
        long,
        value_name = "MU",
        allow_negative_numbers = true,
        conflicts_with_all = ["mu_min", "mu_max", "mu_step"],
        help_heading = SET_UP
    )]
    pub(crate) mu: Option<f64>,
    /// Standard error of that factor.
    #[arg(
        long,
        value_name = "ERROR",
        default_value_t = 0.0,
        allow_negative_numbers = true,
        requires = "mu",
        help_heading = SET_UP
    )]
    mu_std_error: f64,
    #[command(flatten)]
    search: MuArgs,
    /// TOML file with the mixtures and their volume fractions: strong absorbers are then determined
    /// from how they darken other materials.
    #[arg(long, value_name = "FILE")]
    mixtures: Option<PathBuf>,
    /// Let every channel have its own anisotropy; without this, and without --g, those of a material are one.
    #[arg(long, conflicts_with = "g")]
    pub(crate) free_g: bool,
    /// Standard deviation of ln(1 − g) of a material about the mean of all; 0 for one g of all materials [default:
    /// estimated from the data].
    #[arg(long, value_name = "SPREAD", allow_negative_numbers = true, conflicts_with_all = ["g", "free_g"])]
    g_spread: Option<f64>,
    /// Where channels are wavelengths: standard deviation of the change of ln(1 − g) over 100 nm; 0 for one g of all
    /// wavelengths [default: 0.1].
    #[arg(long, value_name = "CHANGE", allow_negative_numbers = true, conflicts_with_all = ["g", "free_g"])]
    g_change: Option<f64>,
    /// Compare the intervals with the Cramér–Rao bound: the least errors that these pixels allow.
    #[arg(long)]
    bound: bool,
    /// Show the whole answer, not only its first screen.
    #[arg(long, short)]
    verbose: bool,
    /// Keep question and answer with the farm, for `farmctl measurements` and the page.
    #[arg(long, value_name = "TITLE", num_args = 0..=1, require_equals = true, default_missing_value = "")]
    keep: Option<String>,
    /// Write a folder with table.csv, media.json for `farmctl predict`, uncertainty.html, answer.json, and media for
    /// Mitsuba 3, pbrt-v4 and Blender. The folder of a session then stays as it is.
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Draw profiles and gradients with their fits, one figure per material, and media over wavelength where channels are
    /// wavelengths: FILE.svg, FILE.png or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    pub(crate) plot: Option<PathBuf>,
    #[command(flatten)]
    figure: FigureArgs,
}

impl MeasureArgs {
    /// Default arguments for these measurements.
    pub(crate) fn new(measurements: PathBuf) -> Self {
        Self {
            measurements,
            options: OptionArgs::default(),
            mu: None,
            mu_std_error: 0.0,
            search: MuArgs::default(),
            mixtures: None,
            free_g: false,
            g_spread: None,
            g_change: None,
            bound: false,
            verbose: false,
            keep: None,
            output: None,
            plot: None,
            figure: FigureArgs::default(),
        }
    }
}

/// The validated inputs of a measurement.
#[derive(Debug)]
pub(crate) struct Inputs {
    pub(crate) measurements: PathBuf,
    /// The session whose folder is given.
    pub(crate) folder: Option<SessionFolder>,
    pub(crate) set_up: SetUp,
    pub(crate) options: FitOptions,
    /// `None` if the scale factor is given.
    search_mu: Option<MuRange>,
    common_g: bool,
    g_spread: Option<f64>,
    g_change: Option<f64>,
    pub(crate) dictionary: Option<String>,
    /// The dictionary of the session's set-up, unless another was named.
    pub(crate) own: Option<WantedDictionary>,
    mixtures: Option<PathBuf>,
    bound: bool,
    /// The whole answer instead of its first screen.
    whole: bool,
    keep: Option<Keep>,
    output: Option<PathBuf>,
    plot: Option<PathBuf>,
    figure: FigureSize,
}

impl Inputs {
    /// Validates the arguments. A session's folder gives a scale factor of 1, with the standard error of its white
    /// reference, and a dictionary.
    pub(crate) fn of(args: MeasureArgs) -> Result<Self> {
        let folder =
            args.measurements.is_dir().then(|| SessionFolder::open(&args.measurements)).transpose()?;
        let session = folder.as_ref().and_then(SessionFolder::session);
        let set_up = args.options.set_up.read(session.as_deref())?;
        let of_session = folder.as_ref().and_then(|_| set_up.mu_std_error());
        let given =
            args.mu.map(|mu| [mu, args.mu_std_error]).or_else(|| of_session.map(|error| [1.0, error]));
        let range = args.search.range()?;
        let [mu, mu_std_error] = given.unwrap_or([1.0, 0.0]);
        let curves = args.plot.is_some() || folder.is_some();
        let settings = args.options.settings(&set_up)?;
        let options = FitOptions::new(FitSettings { mu, mu_std_error, curves, ..settings })?;
        check_objective(options.objective(), &args, folder.is_some())?;
        chosen_dictionary::check(args.options.dictionary.as_ref())?;
        args.figure.check(args.plot.as_deref())?;
        let keep = args.keep.map(|title| kept_as(title, &args.measurements));
        let own = match &folder {
            Some(folder) if args.options.dictionary.is_none() => {
                let (name, grid) = folder.dictionary()?;
                Some(WantedDictionary::new(DictionaryName::new(name)?, grid))
            }
            _ => None,
        };
        Ok(Self {
            measurements: folder.as_ref().map_or(args.measurements, SessionFolder::measurements),
            folder,
            set_up,
            options,
            search_mu: given.is_none().then_some(range),
            common_g: !args.free_g,
            g_spread: args.g_spread,
            g_change: args.g_change,
            dictionary: args.options.dictionary,
            own,
            mixtures: args.mixtures,
            bound: args.bound,
            whole: args.verbose || args.bound || options.objective() == Objective::Paper,
            keep,
            output: args.output,
            figure: args.figure.size()?,
            plot: args.plot,
        })
    }

    /// The request about these materials, without dictionary, board and texts to keep.
    pub(crate) fn request(&self, materials: &[Measurement], mixtures: Option<&Mixtures>) -> MeasureRequest {
        MeasureRequest {
            materials: materials.iter().map(Into::into).collect(),
            options: Some((&self.options).into()),
            search_mu: self.search_mu.map(Into::into),
            common_g: self.common_g,
            g_spread: self.g_spread,
            g_change: self.g_change,
            mixtures: mixtures.into_iter().flat_map(Mixtures::all).map(Into::into).collect(),
            ..MeasureRequest::default()
        }
    }
}

/// Texts of a measurement that is kept: its file, and this command line.
fn kept_as(title: String, measurements: &Path) -> Keep {
    let command = kept_command(std::env::args().skip(1));
    Keep { title, note: String::new(), source: measurements.display().to_string(), command }
}

/// A command line without general options: everybody reads it, and where the farm is or how its owner gets in is no part
/// of the question.
fn kept_command(arguments: impl IntoIterator<Item = String>) -> String {
    let mut command = "farmctl".to_owned();
    let mut arguments = arguments.into_iter();
    while let Some(argument) = arguments.next() {
        match argument.split_once('=').map_or(argument.as_str(), |(name, _)| name) {
            "--server" | "--access" | "--data" if !argument.contains('=') => drop(arguments.next()),
            "--server" | "--access" | "--data" | "--local" | "--json" | "--quiet" | "-q" => {}
            _ => command += &format!(" {}", shell_quoted(&argument)),
        }
    }
    command
}

/// Refuses the paper's objective where media or intervals are required: it gives the best records only.
fn check_objective(objective: Objective, args: &MeasureArgs, is_session: bool) -> Result<()> {
    let needs = match () {
        () if objective == Objective::Likelihood => return Ok(()),
        () if args.output.is_some() => "--output",
        () if args.bound => "--bound",
        () if args.g_spread.is_some() => "--g-spread",
        () if args.g_change.is_some() => "--g-change",
        () if is_session => "the folder of a session, whose report has media",
        () => return Ok(()),
    };
    bail!("--objective paper gives records of the dictionary without intervals: leave it out with {needs}")
}

/// Measures a chart of stacks, or profiles over an edge.
pub(crate) async fn measured(global: &Global, args: MeasureArgs, output: &Output) -> Result<()> {
    if is_chart(&args.measurements) {
        return chart::run(&args, global.quiet, output);
    }
    run(global, Inputs::of(args)?, output).await
}

pub(crate) async fn run(global: &Global, inputs: Inputs, output: &Output) -> Result<()> {
    let mixtures = inputs.mixtures.as_deref().map(read_mixtures).transpose()?;
    let MeasurementFile { materials, mut notes } = output.read_measurements(&inputs.measurements)?;
    let assumed = inputs.set_up.assumed(&materials);
    let materials = inputs.set_up.apply_to(materials)?;
    let is_kept = inputs.keep.is_some();
    let mut request = inputs.request(&materials, mixtures.as_ref());
    request.keep = inputs.keep;
    let session = inputs.folder.as_ref().map(SessionFolder::scene).transpose()?.flatten();
    let record = inputs.folder.as_ref().map(SessionFolder::record).transpose()?;
    let asked = Question { given: inputs.dictionary.as_ref(), session: session.as_ref(), request };
    let Answer { dictionary, grid, mut found, notes: of_dictionary, .. } =
        ask(global, inputs.own, &asked).await?;
    output.notes(&of_dictionary, &inputs.measurements);
    notes.extend(of_dictionary);
    if mixtures.is_some() && found.unmixed.is_none() {
        bail!("the coordinator is too old to fit mixtures: upgrade it");
    }
    if is_kept && found.kept.is_none() && found.not_kept.is_none() {
        found.not_kept = Some("the coordinator is too old to keep measurements: upgrade it".to_owned());
    }
    let pictures = match &inputs.plot {
        Some(path) => figure_files::write_fits(&found.materials, path, inputs.figure)?,
        None => Vec::new(),
    };
    if let Some(folder) = &inputs.output {
        measured::write_renderers(folder, &found)
            .and_then(|()| measured::write_media(folder, &found, (&dictionary, &grid), record.as_ref()))
            .with_context(|| format!("writing {}", folder.display()))?;
    }
    let of_set_up = set_up_notes(&found.materials, inputs.folder.as_ref())?;
    output.notes(&of_set_up, &inputs.measurements);
    notes.extend(of_set_up);
    let options = inputs.options.with_mu(found.common.mu, found.common.mu_std_error.min(1.0))?;
    let report = FitsReport {
        fits: &found.materials,
        assumed: assumed.text(options.settings()),
        bound: inputs.bound,
        scene: true,
    };
    // With --output, a session's folder keeps its report and media.
    let completed = inputs.folder.as_ref().filter(|_| inputs.output.is_none());
    let data = measured::data(UsedOptions::new(&dictionary, &options, &assumed), &found, &notes);
    let folder = inputs.output.as_deref().or(completed.map(SessionFolder::path));
    // The description of a session's folder lists it.
    if let Some(folder) = folder {
        measured::write_answer(folder, &data)?;
    }
    let completed = match completed {
        Some(folder) => measured::complete(folder, &found, (&dictionary, &grid), &report)?,
        None => None,
    };
    output.answer("measure", &data, || {
        if !inputs.whole {
            return [measured::screen(&found, folder), drawn(&pictures)].concat();
        }
        let mut blocks = [measured::blocks(&found, &report), drawn(&pictures)].concat();
        if inputs.folder.is_some() {
            blocks.extend(error_budget(&found.materials).iter().flat_map(budget_blocks));
            blocks.push(Block::heading(2, "Verdict"));
            blocks.extend(verdict(&found.materials).blocks());
        }
        let report =
            completed.as_ref().map(|_| "report.html with the media, ro-crate-metadata.json (for archives), ");
        blocks.extend(folder.map(|folder| measured::written_to(folder, report.unwrap_or_default())));
        blocks
    })?;
    found.not_kept.clone().map_or(Ok(()), |why| Err(NotKept(why).into()))
}

/// The answer is there, but it could not be kept with the farm.
#[derive(Debug, thiserror::Error)]
#[error("this answer is not kept: {0}")]
pub(crate) struct NotKept(String);
