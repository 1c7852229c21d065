//! Answers the page's calls to `farmctl web` itself: reads and writes files like the other verbs.

mod colours;
mod comparison;
mod prints;
mod session;
mod simulation;
mod tables;

use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, anyhow, bail};
use farm_figures::estimates::{self, estimate_rows};
use farm_figures::{ErrorBudget, Picture, error_budget, fit_figure, map_figure, profile_figure};
use farm_proto::{to_status, wire};
use optics_model::fit::{DistanceMap, FitOptions, PredictedProfiles};
use optics_model::grid::NoiseLevel;
use optics_model::quantities::Quantity;
use optics_model::{Grid, Invalid, Measurement, Scene};
use tonic::{Request, Response, Status};

use super::api;
use super::api::desk_server::Desk;
use super::api::figures_request::Of;
use super::api::{
    AboutRequest, AboutResponse, CaptureProgressRequest, CaptureProgressResponse, ChannelSummary,
    ColorsRequest, ColorsResponse, CompareRequest, CompareResponse, CompleteCaptureRequest,
    CompleteCaptureResponse, FigureFormat, FiguresRequest, File, Files, ListCapturesRequest,
    ListCapturesResponse, ListSessionsRequest, ListSessionsResponse, ListSetUpQuantitiesRequest,
    ListSetUpQuantitiesResponse, MediaRequest, Note, NumberWithInterval, OpenCaptureRequest,
    OpenCaptureResponse, PlanResponsesRequest, PlanResponsesResponse, PredictPrintRequest,
    PredictPrintResponse, ReadGridRequest, ReadGridResponse, ReadMeasurementsRequest,
    ReadMeasurementsResponse, ReadMixturesRequest, ReadMixturesResponse, Remark, SetUpQuantity,
    SimulateRequest, SimulateResponse, StartCaptureRequest, StartCaptureResponse, SummarizeRequest,
    SummarizeResponse,
};
use super::capture_run::CaptureRun;
use super::captures::{Captures, session_files};
use crate::answers::{self, MeasureAnswer, all_remarks, common_text, low_scale, media_files, objective};
use farm_lab::grid_file::{grid_of, named_grid, with_responses};
use farm_lab::measurement_file::{self, MeasurementFile};
use farm_lab::media_file::MEDIA_FILE;
use farm_lab::mixture_file::mixtures_in;
use farm_lab::session_folder::SessionFolder;
use farm_lab::set_up::SetUp;
use farm_lab::uncertainty::UNCERTAINTY_FILE;

use crate::figure_files::{FigureSize, file_name};
use crate::output::{INTERNAL_ERROR, sentence};

/// The measurement of the documentation, as an example in the page.
const EXAMPLE: &[u8] = include_bytes!("../../../examples/white.csv");

/// The service behind the page's forms.
#[derive(Debug)]
pub(super) struct DeskService {
    pub about: AboutResponse,
    pub captures: Arc<Captures>,
    pub run: CaptureRun,
}

#[tonic::async_trait]
impl Desk for DeskService {
    async fn about(&self, _: Request<AboutRequest>) -> Result<Response<AboutResponse>, Status> {
        Ok(Response::new(self.about.clone()))
    }

    async fn read_measurements(
        &self,
        request: Request<ReadMeasurementsRequest>,
    ) -> Result<Response<ReadMeasurementsResponse>, Status> {
        let file = request.into_inner().file;
        answer(move || {
            let bytes = file.as_ref().map_or(EXAMPLE, |file| &file.content);
            let MeasurementFile { materials, notes } = measurement_file::read(bytes)?;
            Ok(ReadMeasurementsResponse {
                materials: materials.iter().map(Into::into).collect(),
                notes: notes.into_iter().map(note).collect(),
            })
        })
        .await
    }

    async fn read_grid(
        &self,
        request: Request<ReadGridRequest>,
    ) -> Result<Response<ReadGridResponse>, Status> {
        let request = request.into_inner();
        let quality = request.quality();
        answer(move || {
            let grid = request.file.as_ref().map_or_else(|| built_in(&request.built_in), grid)?;
            let grid = match quality {
                wire::NoiseLevel::Unspecified => grid,
                wire::NoiseLevel::Draft => grid.with_effort(NoiseLevel::Draft)?,
                wire::NoiseLevel::Paper => grid.with_effort(NoiseLevel::Paper)?,
                wire::NoiseLevel::Fine => grid.with_effort(NoiseLevel::Fine)?,
            };
            Ok(ReadGridResponse {
                records: grid.stored_records() as u64,
                jobs: grid.job_count() as u64,
                bytes: (grid.stored_records() * grid.record_bytes()) as u64,
                grid: Some((&grid).into()),
            })
        })
        .await
    }

    async fn summarize(
        &self,
        request: Request<SummarizeRequest>,
    ) -> Result<Response<SummarizeResponse>, Status> {
        let request = request.into_inner();
        let folder = request.capture.as_deref().map(|folder| self.captures.folder(folder)).transpose()?;
        answer(move || {
            let found = found(request.found)?;
            let options = FitOptions::try_from(request.options.unwrap_or_default())?;
            let materials: Vec<Measurement> =
                request.materials.into_iter().map(Measurement::try_from).collect::<Result<_, _>>()?;
            let of_session = folder.as_deref().map(SessionFolder::open).transpose()?;
            let of_set_up = answers::set_up_notes(&found.materials, of_session.as_ref())?;
            let set_up = folder.map_or_else(|| Ok(SetUp::default()), |f| session::set_up(&f))?;
            let given = set_up.with_given(options.settings());
            let assumed = given.assumed(&materials).text(options.settings());
            let verdict = answers::verdict(&found.materials);
            Ok(SummarizeResponse {
                common: common_text(&found.common),
                channels: channels(&found),
                objective: objective(&found.materials, assumed).into_iter().map(for_page).collect(),
                remarks: remarks(&found, &of_set_up),
                estimates: estimate_rows(&found.materials).into_iter().map(Into::into).collect(),
                estimates_note: estimates::NOTE.to_owned(),
                budget: error_budget(&found.materials)
                    .map(|budget| ErrorBudget { first: for_page(budget.first), ..budget }.into()),
                verdict: verdict.sentences,
                precision: verdict.precision.into_iter().map(Into::into).collect(),
            })
        })
        .await
    }

    async fn media(&self, request: Request<MediaRequest>) -> Result<Response<Files>, Status> {
        let request = request.into_inner();
        let folder = request.capture.as_deref().map(|folder| self.captures.folder(folder)).transpose()?;
        answer(move || {
            let record = folder.map(|f| SessionFolder::open(&f)?.record()).transpose()?;
            let (found, dictionary) = prints::measured(request)?;
            let mut files: Vec<_> = media_files(&found.materials)?.into();
            if let Some((name, grid)) = dictionary {
                files.push((MEDIA_FILE, found.media_file(&name, &grid).text()?));
                files.push((UNCERTAINTY_FILE, found.uncertainty(&name, &grid, record.as_ref())));
            }
            let file = |(name, text): (&str, String)| File {
                name: name.to_owned(),
                media_type: "text/plain".to_owned(),
                content: text.into_bytes(),
            };
            Ok(Files { files: files.into_iter().map(file).collect() })
        })
        .await
    }

    async fn complete_capture(
        &self,
        request: Request<CompleteCaptureRequest>,
    ) -> Result<Response<CompleteCaptureResponse>, Status> {
        let request = request.into_inner();
        let capture = request.media.as_ref().and_then(|media| media.capture.clone()).unwrap_or_default();
        let folder = self.captures.folder(&capture)?;
        answer(move || session::complete(&folder, request)).await
    }

    async fn figures(&self, request: Request<FiguresRequest>) -> Result<Response<Files>, Status> {
        let request = request.into_inner();
        let format = request.format();
        answer(move || {
            let Some(of) = request.of else { bail!(Invalid::new("of", "nothing", "what to draw is needed")) };
            let files = pictures(of)?.into_iter().map(|(name, picture)| figure(&name, &picture, format));
            Ok(Files { files: files.collect::<Result<_>>()? })
        })
        .await
    }

    async fn colors(&self, request: Request<ColorsRequest>) -> Result<Response<ColorsResponse>, Status> {
        let media = request.into_inner().media;
        answer(move || Ok(ColorsResponse { radiance_factors: colours::radiance_factors(media)? })).await
    }

    async fn predict_print(
        &self,
        request: Request<PredictPrintRequest>,
    ) -> Result<Response<PredictPrintResponse>, Status> {
        let request = request.into_inner();
        answer(move || prints::print(request)).await
    }

    async fn compare(&self, request: Request<CompareRequest>) -> Result<Response<CompareResponse>, Status> {
        let request = request.into_inner();
        answer(move || comparison::compare(request)).await
    }

    async fn list_set_up_quantities(
        &self,
        _: Request<ListSetUpQuantitiesRequest>,
    ) -> Result<Response<ListSetUpQuantitiesResponse>, Status> {
        let quantities = Quantity::OF_OPTIONS.iter().map(SetUpQuantity::from).collect();
        Ok(Response::new(ListSetUpQuantitiesResponse { quantities }))
    }

    async fn simulate(
        &self,
        request: Request<SimulateRequest>,
    ) -> Result<Response<SimulateResponse>, Status> {
        let request = request.into_inner();
        answer(move || simulation::simulate(request)).await
    }

    async fn read_mixtures(
        &self,
        request: Request<ReadMixturesRequest>,
    ) -> Result<Response<ReadMixturesResponse>, Status> {
        let file = request.into_inner().file.unwrap_or_default();
        answer(move || {
            let mixtures = mixtures_in(&file.content, Path::new(&file.name))?;
            Ok(ReadMixturesResponse { mixtures: mixtures.all().iter().map(Into::into).collect() })
        })
        .await
    }

    async fn list_sessions(
        &self,
        _: Request<ListSessionsRequest>,
    ) -> Result<Response<ListSessionsResponse>, Status> {
        answer(|| {
            let sessions = session_files().iter().map(|path| path.display().to_string()).collect();
            Ok(ListSessionsResponse { sessions })
        })
        .await
    }

    async fn start_capture(
        &self,
        request: Request<StartCaptureRequest>,
    ) -> Result<Response<StartCaptureResponse>, Status> {
        self.run.start(request.into_inner(), Arc::clone(&self.captures))?;
        Ok(Response::new(StartCaptureResponse {}))
    }

    async fn capture_progress(
        &self,
        _: Request<CaptureProgressRequest>,
    ) -> Result<Response<CaptureProgressResponse>, Status> {
        Ok(Response::new(self.run.progress()))
    }

    async fn list_captures(
        &self,
        _: Request<ListCapturesRequest>,
    ) -> Result<Response<ListCapturesResponse>, Status> {
        Ok(Response::new(ListCapturesResponse { captures: self.captures.list() }))
    }

    async fn open_capture(
        &self,
        request: Request<OpenCaptureRequest>,
    ) -> Result<Response<OpenCaptureResponse>, Status> {
        let folder = self.captures.folder(&request.into_inner().folder)?;
        answer(move || session::open(&folder)).await
    }

    async fn plan_responses(
        &self,
        request: Request<PlanResponsesRequest>,
    ) -> Result<Response<PlanResponsesResponse>, Status> {
        let grid = request.into_inner().grid;
        answer(move || {
            let grid = grid.ok_or_else(|| Invalid::new("grid", "nothing", "a grid is needed"))?;
            let grid = Grid::try_from(grid).map_err(|e| e.within("grid"))?;
            Ok(PlanResponsesResponse { grid: Some((&with_responses(grid)?).into()) })
        })
        .await
    }
}

fn note(note: measurement_file::Note) -> Note {
    Note { code: note.code.to_owned(), text: note.text }
}

/// Runs blocking work outside the async runtime, so that it does not delay other calls.
async fn answer<T: Send + 'static>(
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> Result<Response<T>, Status> {
    let done = tokio::task::spawn_blocking(work).await;
    let done = done.map_err(|_| Status::internal(INTERNAL_ERROR))?;
    done.map(Response::new).map_err(|error| match error.downcast_ref::<Invalid>() {
        // Reported with its field, as by the coordinator.
        Some(invalid) if error.chain().count() == 1 => to_status(invalid),
        _ => Status::invalid_argument(sentence(&error)),
    })
}

/// The built-in grid of this name; `lab` without a name.
fn built_in(name: &str) -> Result<Grid> {
    let name = if name.is_empty() { "lab" } else { name };
    let grid = named_grid(name);
    grid.ok_or_else(|| Invalid::new("built_in", name, "allowed are \"lab\" and \"paper\"").into())
}

/// The grid of a file from a browser: it must not name other files, which would be read on this machine.
fn grid(file: &File) -> Result<Grid> {
    let text = measurement_file::plain(&file.content)
        .map_err(|_| Invalid::new("file", &file.name, "a grid file is text in UTF-8"))?;
    grid_of(&text, Path::new(&file.name), |name| {
        Scene::named(name).ok_or_else(|| {
            anyhow!(
                "scene {name:?} is in a file of its own, which a page cannot read: put it into the grid file as [scene], \
                 or use `farmctl submit`"
            )
        })
    })
}

fn found(found: Option<wire::MeasureResponse>) -> Result<MeasureAnswer> {
    let Some(found) = found else { bail!(Invalid::new("found", "nothing", "an answer is needed")) };
    MeasureAnswer::try_from(found)
}

fn channels(found: &MeasureAnswer) -> Vec<ChannelSummary> {
    let number =
        |n: answers::NumberWithInterval| Some(NumberWithInterval { value: n.value, interval: n.interval });
    let channels = found.materials.iter().flat_map(|fit| fit.channels.iter().map(move |c| (fit, c)));
    let channel = |(fit, channel): (&optics_model::fit::MaterialFit, &optics_model::fit::ChannelFit)| {
        let mut empty = ChannelSummary {
            material: fit.material.clone(),
            channel: channel.channel.clone(),
            ..ChannelSummary::default()
        };
        if let Some(refined) = &channel.refined {
            let numbers = answers::ChannelSummary::of(refined);
            empty.resolved = refined.resolved;
            empty.resolved_at_g = refined.resolved_at_g;
            empty.reduced_scattering_per_mm = number(numbers.reduced_scattering_per_mm);
            empty.absorption_per_mm = number(numbers.absorption_per_mm);
            empty.sigma_t_per_mm = number(numbers.sigma_t_per_mm);
            empty.albedo = number(numbers.albedo);
            empty.g = number(numbers.g);
            empty.misfit = numbers.misfit;
        }
        empty
    };
    channels.map(channel).collect()
}

/// A text with the page's words in the place of options and commands.
fn for_page(text: impl AsRef<str>) -> String {
    const WORDS: [(&str, &str); 5] = [
        ("the dictionary or --sigma-t ends", "the dictionary or the bound on σ_t ends"),
        (" (--g)", ""),
        ("(farmctl design)", "(Dictionary, “Which slabs to photograph”)"),
        ("`--dictionary lab`", "the dictionary lab"),
        ("`", ""),
    ];
    WORDS.iter().fold(text.as_ref().to_owned(), |text, (option, word)| text.replace(option, word))
}

/// Remarks on channels, on the scale factor of all, and on the set-up.
fn remarks(found: &MeasureAnswer, of_set_up: &[measurement_file::Note]) -> Vec<Remark> {
    let warning = |about: &str, text: &str| Remark {
        about: vec![about.to_owned()],
        text: for_page(text),
        warning: true,
    };
    let of_all = low_scale(&found.common, &found.materials).map(|text| warning("μ", &text));
    let of_all = of_all.into_iter().chain(of_set_up.iter().map(|note| warning("set-up", &note.text)));
    let of_channels = all_remarks(&found.materials).into_iter();
    let remark = |r: answers::Remark| Remark { about: r.about, text: for_page(r.text), warning: r.warning };
    of_all.chain(of_channels.map(remark)).collect()
}

/// Figures with the names of their files.
fn pictures(of: Of) -> Result<Vec<(String, Picture)>> {
    match of {
        Of::Fits(answer) => {
            let found = MeasureAnswer::try_from(answer)?;
            found.materials.iter().map(|fit| Ok((fit.material.clone(), fit_figure(fit)?))).collect()
        }
        Of::Maps(maps) => {
            let draw = |map: wire::DistanceMap| {
                let map = DistanceMap::try_from(map)?;
                Ok((format!("{}-{}-map", maps.material, map.channel), map_figure(&maps.material, &map)?))
            };
            maps.maps.into_iter().map(draw).collect()
        }
        Of::Profile(profile) => {
            let profiles = PredictedProfiles::try_from(profile)?;
            Ok(vec![("profile".to_owned(), profile_figure(&profiles)?)])
        }
    }
}

fn figure(name: &str, picture: &Picture, format: FigureFormat) -> Result<File> {
    let size = FigureSize::default();
    let (extension, media_type, content) = match format {
        FigureFormat::Png => ("png", "image/png", picture.png(size.width_mm, size.dpi)?),
        FigureFormat::Svg | FigureFormat::Unspecified => ("svg", "image/svg+xml", picture.svg().into_bytes()),
    };
    Ok(File { name: format!("{}.{extension}", file_name(name)), media_type: media_type.to_owned(), content })
}
