//! Implements `farmctl measurements`: lists, shows, annotates and deletes the measurements that are kept with the farm.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use farm_lab::document::{Block, ValueTable};
use farm_lab::set_up::SetUp;
use farm_proto::wire::{
    AnnotateMeasurementRequest, DeleteMeasurementRequest, GetMeasurementRequest, KeptMeasurement,
    ListMeasurementsRequest, MeasureRequest, MeasurementSummary,
};
use optics_model::fit::FitOptions;
use optics_model::{Grid, Measurement};
use serde::Serialize;
use serde_json::json;

use crate::answers::{FitsReport, MeasureAnswer, UsedOptions};
use crate::cli::Global;
use crate::connection::{Connection, Purpose, with_farm};
use crate::measured;
use crate::output::{Output, utc};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl measure white.csv --keep='white, second print'
  farmctl measurements                                    the newest first
  farmctl measurements show 3f2a9c0d11e08b47")]
pub(crate) struct KeptArgs {
    #[command(subcommand)]
    command: Option<KeptCommand>,
}

#[derive(Debug, Subcommand)]
enum KeptCommand {
    /// List them, the newest first.
    #[command(after_help = "\
Examples:
  farmctl measurements list --most 100")]
    List(KeptListArgs),
    /// Print one as `farmctl measure` did.
    #[command(after_help = "\
Examples:
  farmctl measurements show 3f2a9c0d11e08b47
  farmctl measurements show 3f2a9c0d11e08b47 -o media     with the files that `measure -o` writes")]
    Show(KeptShowArgs),
    /// Change title or note.
    #[command(after_help = "\
Examples:
  farmctl measurements annotate 3f2a9c0d11e08b47 --title 'white, second print'
  farmctl measurements annotate 3f2a9c0d11e08b47 --note 'slab 2 had a scratch'")]
    Annotate(KeptNoteArgs),
    /// Delete one.
    #[command(after_help = "\
Example:
  farmctl measurements delete 3f2a9c0d11e08b47")]
    Delete(KeptIdArgs),
}

/// Number of listed measurements.
const USUAL_NUMBER: u32 = 20;

#[derive(Debug, Args)]
struct KeptIdArgs {
    /// As `farmctl measurements` lists it.
    id: String,
}

#[derive(Debug, Args)]
struct KeptListArgs {
    /// Number of measurements.
    #[arg(long, value_name = "N", default_value_t = USUAL_NUMBER, value_parser = clap::value_parser!(u32).range(1..))]
    most: u32,
}

#[derive(Debug, Args)]
struct KeptShowArgs {
    #[command(flatten)]
    kept: KeptIdArgs,
    /// Write a folder with table, media and statement of uncertainty, as `farmctl measure -o` does.
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct KeptNoteArgs {
    #[command(flatten)]
    kept: KeptIdArgs,
    /// New title, one line.
    #[arg(long, value_name = "TEXT", required_unless_present = "note")]
    title: Option<String>,
    /// New note, which may have several lines; empty for none.
    #[arg(long, value_name = "TEXT")]
    note: Option<String>,
}

#[derive(Debug, Serialize)]
pub(crate) struct KeptJson {
    id: String,
    kept: String,
    owner: String,
    pub(crate) title: String,
    note: String,
    pub(crate) source: String,
    command: String,
    dictionary: String,
    materials: Vec<String>,
    channels: u32,
}

impl From<MeasurementSummary> for KeptJson {
    fn from(kept: MeasurementSummary) -> Self {
        Self {
            id: kept.id,
            kept: utc(kept.kept_unix_ms),
            owner: kept.owner,
            title: kept.title,
            note: kept.note,
            source: kept.source,
            command: kept.command,
            dictionary: kept.dictionary,
            materials: kept.materials,
            channels: kept.channels,
        }
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct KeptListJson {
    pub(crate) measurements: Vec<KeptJson>,
}

pub(crate) async fn run(global: &Global, args: KeptArgs, output: &Output) -> Result<()> {
    let command = args.command.unwrap_or(KeptCommand::List(KeptListArgs { most: USUAL_NUMBER }));
    with_farm(global, Purpose::Ask, async |connection| match &command {
        KeptCommand::List(args) => {
            let data = KeptListJson { measurements: newest(connection, args.most as usize).await? };
            output.answer("measurements", &data, || vec![list(&data.measurements)])
        }
        KeptCommand::Show(args) => show(get(connection, &args.kept).await?, args.output.as_deref(), output),
        KeptCommand::Annotate(args) => {
            let data = annotate(connection, args).await?;
            output.answer("measurement", &data, || vec![Block::Preformatted(head(&data))])
        }
        KeptCommand::Delete(KeptIdArgs { id }) => {
            connection.measurements().delete(DeleteMeasurementRequest { id: id.clone() }).await?;
            output.print("measurement_deleted", &json!({ "id": id }), || format!("deleted: measurement {id}"))
        }
    })
    .await
}

async fn get(connection: &Connection, kept: &KeptIdArgs) -> Result<KeptMeasurement> {
    let request = GetMeasurementRequest { id: kept.id.clone() };
    Ok(connection.measurements().get(request).await?.into_inner())
}

async fn annotate(connection: &Connection, args: &KeptNoteArgs) -> Result<KeptJson> {
    let (id, title, note) = (args.kept.id.clone(), args.title.clone(), args.note.clone());
    let changed = AnnotateMeasurementRequest { id, title, note };
    Ok(connection.measurements().annotate(changed).await?.into_inner().into())
}

/// The newest measurements.
async fn newest(connection: &Connection, most: usize) -> Result<Vec<KeptJson>> {
    let (mut all, mut page_token) = (Vec::new(), String::new());
    while all.len() < most {
        let page_size = (most - all.len()) as u32;
        let request = ListMeasurementsRequest { page_size, page_token };
        let page = connection.measurements().list(request).await?.into_inner();
        all.extend(page.measurements.into_iter().map(KeptJson::from));
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    Ok(all)
}

fn list(all: &[KeptJson]) -> Block {
    if all.is_empty() {
        return Block::paragraph(
            "no measurement is kept yet: `farmctl measure FILE --keep` and the page of `farmctl web` keep them",
        );
    }
    let rows = all.iter().map(|kept| {
        let KeptJson { id, kept, owner, title, dictionary, channels, .. } = kept;
        [id, kept, owner, title, dictionary, &channels.to_string()].map(Clone::clone).to_vec()
    });
    ValueTable::new("id | kept | owner | title | dictionary | >channels", rows).block()
}

fn head(kept: &KeptJson) -> String {
    let KeptJson { id, title, note, command, .. } = kept;
    let by = if kept.owner.is_empty() { String::new() } else { format!(" by {}", kept.owner) };
    let mut text = format!("{title}\nmeasurement {id}, kept {}{by}", kept.kept);
    for line in note.lines().chain((!command.is_empty()).then_some(command.as_str())) {
        text += &format!("\n  {line}");
    }
    text
}

/// A kept measurement, checked.
pub(crate) struct KeptAnswer {
    pub(crate) summary: KeptJson,
    pub(crate) request: MeasureRequest,
    pub(crate) materials: Vec<Measurement>,
    pub(crate) found: MeasureAnswer,
    /// With the scale factor that was found.
    pub(crate) options: FitOptions,
    pub(crate) grid: Grid,
}

impl TryFrom<KeptMeasurement> for KeptAnswer {
    type Error = anyhow::Error;

    fn try_from(kept: KeptMeasurement) -> Result<Self> {
        let summary = KeptJson::from(kept.summary.context("the coordinator sent no summary")?);
        let request = kept.request.context("the coordinator sent no question")?;
        let found = MeasureAnswer::try_from(kept.answer.context("the coordinator sent no answer")?)?;
        let grid = Grid::try_from(kept.grid.context("the coordinator sent no grid")?)?;
        let options = FitOptions::try_from(request.options.clone().unwrap_or_default())?;
        let options = options.with_mu(found.common.mu, found.common.mu_std_error.min(1.0))?;
        let materials = request.materials.iter().cloned().map(Measurement::try_from);
        let materials = materials.collect::<Result<_, _>>()?;
        Ok(Self { summary, request, materials, found, options, grid })
    }
}

fn show(kept: KeptMeasurement, folder: Option<&Path>, output: &Output) -> Result<()> {
    let KeptAnswer { summary, materials, found, options, grid, .. } = KeptAnswer::try_from(kept)?;
    let assumed = SetUp::default().with_given(options.settings()).assumed(&materials);
    if let Some(folder) = folder {
        measured::write_renderers(folder, &found)
            .and_then(|()| measured::write_media(folder, &found, (&summary.dictionary, &grid), None))
            .with_context(|| format!("writing {}", folder.display()))?;
    }
    let used = UsedOptions::new(&summary.dictionary, &options, &assumed);
    let data = measured::data(used, &found, &[]);
    if let Some(folder) = folder {
        measured::write_answer(folder, &data)?;
    }
    output.answer("measure", &data, || {
        let report = FitsReport {
            fits: &found.materials,
            assumed: assumed.text(options.settings()),
            bound: false,
            scene: true,
        };
        let mut blocks = vec![Block::Preformatted(head(&summary) + "\n")];
        blocks.extend(measured::blocks(&found, &report));
        blocks.extend(folder.map(|folder| measured::written_to(folder, "")));
        blocks
    })
}
