//! Answers questions about a measurement: that of a file, of a capture's folder, or one that is kept with the farm.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use farm_figures::estimates::{self, EstimateRow, estimate_rows};
use farm_figures::{ErrorBudget, error_budget};
use farm_lab::capture::MeasureVerdict;
use farm_lab::measurement_file::{self, MeasurementFile, Note, beyond_limits, read_measurements};
use farm_lab::mixture_file::mixtures_in;
use farm_lab::session_folder::SessionFolder;
use farm_lab::set_up::{Assumed, Session, SetUp};
use farm_proto::wire::{self, GetMeasurementRequest, Keep, MapRequest, MeasureRequest};
use optics_model::fit::{
    Bounds, ChannelFit, DistanceMap, FitOptions, FitSettings, Mixtures, Objective, PhaseModel,
};
use optics_model::{Grid, Invalid, Measurement, Scene};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::task::block_in_place;

use super::super::colours::colours;
use super::{GivenFile, PageState};
use crate::answers::{
    ChannelSummary, FitsReport, MeasureAnswer, Remark, SetUpJson, UsedOptions, all_remarks, common_text,
    low_scale, objective, set_up_notes, verdict,
};
use crate::cli::OptionArgs;
use crate::commands::fits::map::MaterialMap;
use crate::commands::fits::measure::question::{Answer, Question, addressed, answered};
use crate::commands::fits::measure::{Inputs, MeasureArgs};
use crate::commands::measurements::check;
use crate::commands::measurements::kept::{KeptAnswer, KeptJson};
use crate::connection::patient;
use crate::measured;
use crate::output::{envelope, sentence};

/// The measurement of the documentation, as an example in the page.
const EXAMPLE: &[u8] = include_bytes!("../../../../../examples/white.csv");

/// The measurement of a question; the example if none is given.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct GivenMeasurement {
    file: Option<GivenFile>,
    /// Folder of a capture, by its name in the list.
    capture: Option<String>,
    /// Id of a measurement that is kept with the farm, with its answer.
    kept: Option<String>,
    /// Id of a kept measurement of which only the profiles are taken.
    data_of: Option<String>,
}

/// Inputs of `farmctl measure` by the names of its options.
#[derive(Debug, Deserialize)]
pub(super) struct MeasureInputs {
    #[serde(flatten)]
    source: GivenMeasurement,
    #[serde(flatten)]
    options: OptionArgs,
    mu: Option<f64>,
    #[serde(default)]
    free_g: bool,
    mixtures: Option<GivenFile>,
    keep: Option<KeepInputs>,
}

/// Texts of a measurement that is to be kept.
#[derive(Debug, Deserialize)]
struct KeepInputs {
    title: String,
    /// Name of the file or folder.
    source: String,
    command: String,
}

/// Inputs of `farmctl map` for one channel of a measurement.
#[derive(Debug, Deserialize)]
pub(super) struct MapInputs {
    #[serde(flatten)]
    question: MeasureInputs,
    material: String,
    channel: String,
    mu: f64,
    lambda: f64,
    /// The paper's distance in the place of the likelihood.
    paper: bool,
}

impl GivenMeasurement {
    fn read(&self) -> Result<MeasurementFile> {
        match &self.file {
            Some(file) => measurement_file::read(&file.bytes()?),
            None => measurement_file::read(EXAMPLE),
        }
    }
}

/// The contents of a file, as `farmctl check` prints them.
pub(super) fn check(source: &GivenMeasurement) -> Result<String> {
    let mut file = source.read()?;
    file.notes.extend(beyond_limits(&file.materials));
    envelope("check", &check::data(&file))
}

pub(super) fn mixtures(file: &GivenFile) -> Result<Mixtures> {
    mixtures_in(&file.bytes()?, Path::new(&file.name))
}

fn board(channels: impl IntoIterator<Item = wire::Channel>) -> Vec<Value> {
    let channel =
        |c: wire::Channel| json!({ "name": c.name, "rho_light": c.rho_light, "rho_dark": c.rho_dark });
    channels.into_iter().map(channel).collect()
}

/// The contents of a capture's folder: the measurement, its set-up and its dictionary, with the board if that is for all
/// boards, and the standard error of the scale factor by a white reference.
pub(super) fn open(state: &PageState, source: &GivenMeasurement) -> Result<String> {
    let folder = state.captures.folder(source.capture.as_deref().unwrap_or_default())?;
    let inputs = Inputs::of(MeasureArgs::new(folder))?;
    let file = read_measurements(&inputs.measurements)?;
    let own = inputs.own.as_ref().context("a session has a dictionary")?;
    let session = inputs.folder.as_ref().map(SessionFolder::scene).transpose()?.flatten();
    let session = session.filter(|_| own.grid.scene().is_for_all_boards());
    let opened = json!({
        "measurement": check::data(&file),
        "set_up": SetUpJson(inputs.options.settings()),
        "mu_std_error": inputs.set_up.mu_std_error(),
        "dictionary": own.name.to_string(),
        "records": own.grid.stored_records(),
        "board": board(session.iter().flat_map(Scene::channels).map(Into::into)),
    });
    envelope("open", &opened)
}

/// A question that was read and checked.
struct Prepared {
    inputs: Inputs,
    dictionary: String,
    file: MeasurementFile,
    assumed: Assumed,
    session: Option<Scene>,
    request: MeasureRequest,
}

impl Prepared {
    async fn read(state: &PageState, asked: MeasureInputs) -> Result<Self> {
        let kept = match &asked.source.data_of {
            Some(id) => Some(kept(state, id).await?.materials),
            None => None,
        };
        block_in_place(|| Self::new(state, asked, kept))
    }

    fn new(state: &PageState, asked: MeasureInputs, kept: Option<Vec<Measurement>>) -> Result<Self> {
        let MeasureInputs { source, mut options, mu, free_g, mixtures: mixture_file, .. } = asked;
        let mut path = PathBuf::new();
        if let Some(capture) = &source.capture {
            path = state.captures.folder(capture)?;
            options.dictionary = None;
        }
        // The command refuses the paper's objective for a session, whose report needs media.
        let objective = options.objective.take().map(Objective::from);
        let mut args = MeasureArgs::new(path);
        (args.options, args.mu, args.free_g) = (options, mu, free_g);
        // The page draws curves.
        args.plot = Some(PathBuf::from("figures.svg"));
        let mut inputs = Inputs::of(args)?;
        inputs.options = FitOptions::new(FitSettings { objective, ..*inputs.options.settings() })?;
        let own = inputs.own.as_ref().map(|own| own.name.to_string());
        let dictionary = own.or_else(|| inputs.dictionary.clone());
        let lacks_name = || Invalid::new("dictionary", "nothing", "the name of a dictionary is needed");
        let dictionary = dictionary.ok_or_else(lacks_name)?;
        let mut file = match kept {
            Some(materials) => MeasurementFile { materials, notes: Vec::new() },
            None if inputs.folder.is_some() => read_measurements(&inputs.measurements)?,
            None => source.read()?,
        };
        let mixtures = mixture_file.as_ref().map(mixtures).transpose()?;
        let assumed = inputs.set_up.assumed(&file.materials);
        file.materials = inputs.set_up.apply_to(file.materials)?;
        let request = inputs.request(&file.materials, mixtures.as_ref());
        let session = inputs.folder.as_ref().map(SessionFolder::scene).transpose()?.flatten();
        Ok(Self { inputs, dictionary, file, assumed, session, request })
    }

    fn question(&self) -> Question<'_> {
        let given = self.inputs.own.is_none().then_some(&self.dictionary);
        Question { given, session: self.session.as_ref(), request: self.request.clone() }
    }
}

/// A measurement with its answer.
pub(super) struct MeasuredAnswer {
    pub found: MeasureAnswer,
    pub grid: Grid,
    /// With dictionary and board.
    request: MeasureRequest,
    /// With the scale factor that was found.
    options: FitOptions,
    file: MeasurementFile,
    assumed: Assumed,
    pub folder: Option<SessionFolder>,
    /// On dictionary and set-up.
    notes: Vec<Note>,
    kept: Option<KeptJson>,
}

impl MeasuredAnswer {
    pub async fn ask(state: &PageState, mut asked: MeasureInputs) -> Result<Self> {
        if let Some(id) = &asked.source.kept {
            let kept = kept(state, id).await?;
            return block_in_place(|| Self::from_kept(state, kept));
        }
        let keep = asked.keep.take();
        let mut prepared = Prepared::read(state, asked).await?;
        let texts =
            |KeepInputs { title, source, command }| Keep { title, note: String::new(), source, command };
        prepared.request.keep = keep.map(texts);
        let connection = state.farm.connection().await?;
        let question = prepared.question();
        let asking = Box::pin(answered(&connection, prepared.dictionary.clone(), &question));
        let Answer { dictionary, board, grid, found, mut notes } =
            state.farm.answer(&connection, asking).await?;
        drop(connection);
        let kept = match &found.kept {
            Some(id) => Some(kept(state, id).await?.summary),
            None => None,
        };
        let Prepared { inputs, file, assumed, request, .. } = prepared;
        let request = MeasureRequest { dictionary, board, ..request };
        notes.extend(set_up_notes(&found.materials, inputs.folder.as_ref())?);
        let options = inputs.options.with_mu(found.common.mu, found.common.mu_std_error.min(1.0))?;
        Ok(Self { found: *found, grid, request, options, file, assumed, folder: inputs.folder, notes, kept })
    }

    /// Its folder is that of a capture of this page.
    fn from_kept(state: &PageState, kept: KeptAnswer) -> Result<Self> {
        let KeptAnswer { summary, request, materials, found, options, grid } = kept;
        let folder = state.captures.folder(&summary.source).ok();
        let folder = folder.map(|folder| SessionFolder::open(&folder)).transpose()?;
        let session = folder.as_ref().and_then(SessionFolder::session);
        let set_up = SetUp::new(session.as_deref(), Session::default())?.with_given(options.settings());
        let (assumed, notes) = (set_up.assumed(&materials), set_up_notes(&found.materials, folder.as_ref())?);
        let file = MeasurementFile { materials, notes: Vec::new() };
        Ok(Self { found, grid, request, options, file, assumed, folder, notes, kept: Some(summary) })
    }

    pub fn dictionary(&self) -> &str {
        &self.request.dictionary
    }

    /// The paper's objective gives records without intervals.
    pub fn has_intervals(&self) -> bool {
        self.options.objective() != Objective::Paper
    }

    /// The answer as `--json` prints it.
    fn data<'a>(&'a self, notes: &'a [Note]) -> impl Serialize + use<'a> {
        measured::data(UsedOptions::new(self.dictionary(), &self.options, &self.assumed), &self.found, notes)
    }

    /// Writes media and report into the folder of a capture, as `farmctl measure FOLDER` does.
    fn complete(&self) -> Result<()> {
        let Some(folder) = self.folder.as_ref().filter(|_| self.has_intervals()) else { return Ok(()) };
        let fits = &self.found.materials;
        let assumed = self.assumed.text(self.options.settings());
        let report = FitsReport { fits, assumed, bound: false, scene: false };
        measured::write_answer(folder.path(), &self.data(&self.all_notes()))?;
        measured::complete(folder, &self.found, (self.dictionary(), &self.grid), &report)?;
        Ok(())
    }

    fn all_notes(&self) -> Vec<Note> {
        self.file.notes.iter().chain(&self.notes).cloned().collect()
    }

    /// `not_written` is the reason why the folder of the capture has no media of this answer.
    fn json(&self, not_written: Option<&str>) -> Result<String> {
        let notes = self.all_notes();
        let media = || self.found.media_file(self.dictionary(), &self.grid);
        let page = json!({
            "shown": ShownJson::new(self),
            "media": self.has_intervals().then(media),
            "colours": colours(&self.found.materials)?,
            "measurement": check::data(&self.file),
            "board": board(self.request.board.iter().cloned()),
            "kept": self.kept.as_ref(),
            "searches_mu": self.request.search_mu.is_some(),
            "free_g": !self.request.common_g,
            "not_written": not_written,
        });
        envelope("measure", &MeasuredJson { answer: self.data(&notes), page })
    }
}

/// A measurement that is kept with the farm.
pub(super) async fn kept(state: &PageState, id: &str) -> Result<KeptAnswer> {
    let connection = state.farm.connection().await?;
    let mut measurements = connection.measurements();
    let asking = async { Ok(measurements.get(GetMeasurementRequest { id: id.to_owned() }).await?) };
    let kept = state.farm.answer(&connection, asking).await?;
    block_in_place(|| KeptAnswer::try_from(kept.into_inner()))
}

/// Measures; an answer that is kept also goes into the folder of its capture.
pub(super) async fn measure(state: &PageState, asked: MeasureInputs) -> Result<String> {
    let is_to_write = asked.keep.is_some();
    let measured = MeasuredAnswer::ask(state, asked).await?;
    block_in_place(|| {
        let written = if is_to_write { measured.complete() } else { Ok(()) };
        measured.json(written.err().as_ref().map(sentence).as_deref())
    })
}

/// The map of a channel, as `farmctl map` gives it.
pub(super) async fn maps(state: &PageState, asked: MapInputs) -> Result<Vec<MaterialMap>> {
    let MapInputs { question, material, channel, mu, lambda, paper } = asked;
    let connection = state.farm.connection().await?;
    let request = if let Some(id) = &question.source.kept {
        kept(state, id).await?.request
    } else {
        let prepared = Prepared::read(state, question).await?;
        let question = prepared.question();
        let asking = Box::pin(addressed(&connection, prepared.dictionary.clone(), &question));
        state.farm.answer(&connection, asking).await?.0
    };
    let options = FitOptions::try_from(request.options.unwrap_or_default())?;
    let options = FitOptions::new(FitSettings {
        mu,
        lambda,
        sigma_t_per_mm: Bounds::FREE,
        albedo: Bounds::FREE,
        g: Bounds::FREE,
        objective: Some(if paper { Objective::Paper } else { Objective::Likelihood }),
        // The paper's distance accepts no choice of the phase function.
        phase: if paper { PhaseModel::default() } else { options.settings().phase },
        ..*options.settings()
    })?;
    let mut measurement = request.materials.into_iter().find(|m| m.material == material);
    if let Some(measurement) = &mut measurement {
        measurement.profiles.retain(|profile| profile.channel == channel);
    }
    let dictionary = request.dictionary;
    let map = MapRequest { dictionary, measurement, options: Some((&options).into()), board: request.board };
    let mut fits = connection.fits();
    let asking = async { Ok(fits.map(patient(map)).await?) };
    let found = state.farm.answer(&connection, asking).await?.into_inner();
    let map = |map| Ok(MaterialMap { material: material.clone(), map: DistanceMap::try_from(map)? });
    found.maps.into_iter().map(map).collect()
}

/// The answer of `measure`, with what the page shows of it.
#[derive(Serialize)]
struct MeasuredJson<A> {
    #[serde(flatten)]
    answer: A,
    page: Value,
}

/// The answer in words, which are those of the terminal.
#[derive(Serialize)]
struct ShownJson {
    common: String,
    /// By material and channel; null where the fit was not refined.
    numbers: Vec<Vec<Option<ChannelSummary>>>,
    objective: Vec<String>,
    remarks: Vec<Remark>,
    estimates: Vec<EstimateRow>,
    estimates_note: &'static str,
    budget: Option<ErrorBudget>,
    verdict: MeasureVerdict,
}

impl ShownJson {
    fn new(measured: &MeasuredAnswer) -> Self {
        let (common, fits) = (&measured.found.common, &measured.found.materials);
        let number = |channel: &ChannelFit| channel.refined.as_ref().map(ChannelSummary::of);
        let warning =
            |about: &str, text: String| Remark { about: vec![about.to_owned()], text, warning: true };
        let of_scale = low_scale(common, fits).map(|text| warning("μ", text));
        let of_set_up = measured.notes.iter().map(|note| warning("set-up", note.text.clone()));
        Self {
            common: common_text(common),
            numbers: fits.iter().map(|fit| fit.channels.iter().map(number).collect()).collect(),
            objective: objective(fits, measured.assumed.text(measured.options.settings())),
            remarks: of_scale.into_iter().chain(of_set_up).chain(all_remarks(fits)).collect(),
            estimates: estimate_rows(fits),
            estimates_note: estimates::NOTE,
            budget: error_budget(fits),
            verdict: verdict(fits),
        }
    }
}
