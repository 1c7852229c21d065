//! Implements `farmctl show`: prints the grid, progress, failed jobs and digest of a dictionary, with `--noise` the noise of
//! its records. `--plot` draws profiles, or the noise.

mod noise;
mod overview;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;
use farm_proto::DictionaryName;
use farm_proto::status::{DictionaryStatus, FailedJob};
use farm_proto::wire::{GetRequest, ListFailedRequest};
use optics_model::controls::is_computed;
use optics_model::grid::{Axes, Effort};
use optics_model::{Grid, SceneFile, Walks};
use serde::Serialize;

use crate::cli::{FigureArgs, Global};
use crate::connection::records::RecordStream;
use crate::connection::{Connection, Purpose, with_farm};
use crate::figure_files::{self, FigureSize};
use crate::output::{DictionaryJson, Output, grouped, lines, state};
use noise::Noise;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl show paper
  farmctl show paper --plot overview.png")]
pub(crate) struct ShowArgs {
    /// Name of the dictionary.
    name: String,
    /// Draw profiles from all over the dictionary, or with --noise how noisy each record is: FILE.svg, FILE.png or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    figure: FigureArgs,
    /// Read all records and print their noise: median, worst, and by albedo.
    #[arg(long)]
    noise: bool,
}

pub(crate) async fn run(global: &Global, args: ShowArgs, output: &Output) -> Result<()> {
    let name = DictionaryName::new(args.name)?;
    args.figure.check(args.plot.as_deref())?;
    let (status, noise) = with_farm(global, Purpose::Ask, async |connection| {
        let answer = connection.dictionaries().get(GetRequest { name: name.to_string() }).await?;
        let mut status = DictionaryStatus::try_from(answer.into_inner())?;
        if status.jobs_failed > status.failed.len() {
            status.failed = all_failed(connection, &name).await?;
        }
        if !args.noise {
            if let Some(path) = &args.plot {
                draw(connection, &status, path, args.figure.size()?).await?;
            }
            return Ok((status, None));
        }
        let found = noise::read(connection, &status).await?;
        if let Some(path) = &args.plot {
            figure_files::write(
                &noise::picture(status.name.as_str(), &status.grid, &found)?,
                path,
                args.figure.size()?,
            )?;
        }
        let noise = Noise::of(&status.grid, &found);
        Ok((status, Some(noise)))
    })
    .await?;
    let described = || {
        text(&status)
            + &noise.as_ref().map_or_else(String::new, Noise::text)
            + "\n"
            + &lines(&figure_files::drawn(&args.plot))
    };
    output.print("show", &Shown { dictionary: data(&status), noise: noise.as_ref() }, described)
}

#[derive(Serialize)]
struct Shown<'a, D> {
    #[serde(flatten)]
    dictionary: D,
    #[serde(skip_serializing_if = "Option::is_none")]
    noise: Option<&'a Noise>,
}

/// All jobs that were given up; a status contains only the first of them.
async fn all_failed(connection: &Connection, name: &DictionaryName) -> Result<Vec<FailedJob>> {
    let (mut failed, mut page_token) = (Vec::new(), String::new());
    loop {
        let request = ListFailedRequest { name: name.to_string(), page_size: 1000, page_token };
        let page = connection.dictionaries().list_failed(request).await?.into_inner();
        for job in page.failed {
            failed.push(FailedJob::try_from(job)?);
        }
        page_token = page.next_page_token;
        if page_token.is_empty() {
            return Ok(failed);
        }
    }
}

pub(crate) fn data(status: &DictionaryStatus) -> impl Serialize {
    #[derive(Serialize)]
    struct ShowData<'a> {
        #[serde(flatten)]
        dictionary: DictionaryJson,
        grid: GridData<'a>,
    }
    #[derive(Serialize)]
    struct GridData<'a> {
        #[serde(flatten)]
        axes: &'a Axes,
        /// Largest number of walks that a point begins with.
        walks: u64,
        /// The level of noise that determines the walks, if there is one.
        #[serde(skip_serializing_if = "Option::is_none")]
        quality: Option<&'static str>,
        seed: u64,
        derivatives: bool,
        scene: SceneFile,
    }
    let grid = &status.grid;
    let (seed, derivatives) = (grid.seed(), grid.derivatives());
    let [_, walks] = grid.least_and_most_walks().map(Walks::get);
    let quality = match grid.effort() {
        Effort::Noise(level) => Some(level.name()),
        Effort::Walks(_) => None,
    };
    let scene = SceneFile::from(grid.scene());
    ShowData {
        dictionary: status.into(),
        grid: GridData { axes: grid.axes(), walks, quality, seed, derivatives, scene },
    }
}

async fn draw(
    connection: &Connection,
    status: &DictionaryStatus,
    path: &Path,
    size: FigureSize,
) -> Result<()> {
    let axes = overview::chosen_axes(&status.grid);
    let mut wanted = axes.records(&status.grid);
    wanted.sort_unstable();
    let mut answers = RecordStream::ask(connection, status, wanted).await?;
    let mut records = Vec::new();
    while let Some(record) = answers.next().await? {
        records.push(record);
    }
    if records.is_empty() {
        bail!("none of the records to be drawn is done yet");
    }
    figure_files::write(&overview::picture(status.name.as_str(), &status.grid, &axes, &records)?, path, size)
}

fn text(status: &DictionaryStatus) -> String {
    let grid = &status.grid;
    let sensor = grid.scene().sensor();
    let channels: Vec<_> = grid.scene().channels().iter().map(optics_model::scene::Channel::name).collect();
    let digest = status.records_digest.map_or("– (not complete)".to_owned(), |d| d.to_string());
    let mut lines = vec![
        ("dictionary", status.name.to_string()),
        ("state", state(status)),
        ("records", {
            let (done, total) = (status.records_done() as u64, status.records_total() as u64);
            format!("{} of {} done", grouped(done), grouped(total))
        }),
        ("jobs", {
            let (done, total) = (status.jobs_done as u64, status.jobs_total() as u64);
            format!("{} of {} done, {} being computed", grouped(done), grouped(total), status.jobs_leased)
        }),
        ("sigma_t /mm", axis(grid.sigma_t_per_mm())),
        ("albedo", axis(grid.albedo())),
        ("g", axis(grid.g())),
        ("thickness mm", axis(grid.thickness_mm())),
        ("sample index", axis(grid.sample_ior())),
        ("channels", channels.join(", ")),
        ("profile", format!("{} pixels over {} mm", sensor.pixels(), sensor.width_mm())),
        ("walks", walks(grid)),
        ("derivatives", if grid.derivatives() { "by albedo and sigma_t" } else { "none" }.to_owned()),
        ("grid digest", status.grid_digest.to_string()),
        ("records digest", digest),
    ];
    lines.extend(narrow(grid).map(|text| ("levels", text)));
    if status.records_reused > 0 {
        lines
            .push(("reused", format!("{} records were there before", grouped(status.records_reused as u64))));
    }
    if let Some(quality) = grid.quality() {
        let (fewest, most) = status.walks;
        lines.push((
            "quality",
            format!(
                "noise of {} or up to {} walks; so far {} to {}",
                quality.relative_std_error(),
                grouped(quality.max_walks().get()),
                grouped(fewest),
                grouped(most)
            ),
        ));
    }
    if !status.owner.is_empty() {
        lines.push(("owner", status.owner.clone()));
    }
    if !status.reason.is_empty() {
        lines.push(("reason", status.reason.clone()));
    }
    let failed = |f: &FailedJob| {
        let name = if f.quarantined { "quarantined" } else { "failed job" };
        (name, format!("job {}: {}", f.job, f.reason))
    };
    lines.extend(status.failed.iter().map(failed));
    lines.iter().map(|(name, value)| format!("{name:<15} {value}\n")).collect()
}

/// The anisotropies at which records have the levels of their walks; None if exact ones are computed for all.
fn narrow(grid: &Grid) -> Option<String> {
    let narrow = grid.g().iter().filter(|g| !is_computed(grid.scene().phase(), **g));
    let narrow: Vec<f64> = narrow.copied().collect();
    let text = || format!("of the walks alone at g {}: the phase function is too narrow", axis(&narrow));
    (!narrow.is_empty()).then(text)
}

fn walks(grid: &Grid) -> String {
    let [least, most] = grid.least_and_most_walks().map(|walks| grouped(walks.get()));
    match grid.effort() {
        Effort::Walks(_) => format!("{most} per transport point, seed {}", grid.seed()),
        Effort::Noise(level) => {
            let quality = level.name();
            format!("{least} to {most} per transport point (quality {quality}), seed {}", grid.seed())
        }
    }
}

fn axis(values: &[f64]) -> String {
    let list = values.iter().map(f64::to_string).collect::<Vec<_>>();
    if list.len() <= 12 {
        return list.join(", ");
    }
    format!("{} … {} ({} values)", list[..4].join(", "), list[list.len() - 4..].join(", "), list.len())
}
