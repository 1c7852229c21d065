//! Implements `farmctl export`: writes the finished records of a dictionary as CSV, as arrays for NumPy, or as a measurement
//! of one medium.

mod arrays;
mod chosen;
mod npz;
mod rows;
mod variant;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Args;
use farm_lab::measurement_file::MeasurementWriter;
use farm_lab::whole_file::{DraftFile, open_node};
use farm_link::logs::to_stderr;
use farm_proto::DictionaryName;
use farm_proto::status::DictionaryStatus;
use farm_proto::wire::GetRequest;
use optics_model::Grid;

use crate::cli::Global;
use crate::connection::records::RecordStream;
use crate::connection::{Connection, Purpose};
use crate::interrupt::{Interrupted, interrupted};
use crate::output::Output;
use chosen::ChosenAxes;
use rows::RecordText;

/// Records that are formatted together, on all cores.
const BATCH: usize = 256;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl export paper -o paper.csv
  farmctl export paper --sigma-t 6,9 --g 0.4 > part.csv
  farmctl export paper --npz paper.npz            arrays for NumPy
  farmctl export paper --json > paper.jsonl       one record per line")]
pub(crate) struct ExportArgs {
    /// Name of the dictionary.
    name: String,
    /// File to write [default: standard output]. It appears under this name once it is complete.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Write arrays for NumPy instead of rows: values and standard errors over all axes, the axes, and about.json with
    /// the answer of `show --json`.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["output", "measurement", "json"])]
    npz: Option<PathBuf>,
    /// Write the profiles of the responses, not those of the axes: traced in scenes in which one uncertain quantity has
    /// another value, each row with the quantity, the step from the scene's value and its unit.
    #[arg(long, conflicts_with = "measurement")]
    responses: bool,
    /// Write the profiles of one medium as a measurement of the material NAME, which `farmctl measure` reads.
    #[arg(long, value_name = "NAME")]
    measurement: Option<String>,
    /// Only these extinction coefficients, such as 6,9.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    sigma_t: Vec<f64>,
    /// Only these albedos.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    albedo: Vec<f64>,
    /// Only these anisotropies.
    #[arg(long, value_name = "LIST", value_delimiter = ',', allow_negative_numbers = true)]
    g: Vec<f64>,
    /// Only these thicknesses.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    thickness: Vec<f64>,
    /// Only these refractive indices of the sample.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    sample_ior: Vec<f64>,
}

pub(crate) async fn run(global: &Global, args: ExportArgs, output: &Output) -> Result<()> {
    let name = DictionaryName::new(args.name.as_str())?;
    let connection = Connection::open(global, Purpose::Ask).await?;
    let exported = if let Some(file) = &args.npz {
        to_arrays(&connection, &name, &args, file).await
    } else if let Some(file) = &args.output {
        to_file(&connection, &name, &args, output.is_json(), file).await
    } else {
        let stdout = std::io::BufWriter::new(std::io::stdout().lock());
        export(&connection, &name, &args, output.is_json(), stdout).await
    };
    let exported = exported.map_err(|error| connection.in_plain_words(error));
    connection.close().await?;
    exported
}

/// Writes a file atomically. A device or pipe is written to directly.
async fn to_file(
    connection: &Connection,
    name: &DictionaryName,
    args: &ExportArgs,
    json: bool,
    file: &Path,
) -> Result<()> {
    let place = || format!("output {}", file.display());
    if let Some(node) = open_node(file).with_context(place)? {
        return export(connection, name, args, json, std::io::BufWriter::new(node)).await;
    }
    let mut draft = DraftFile::create(file).with_context(place)?;
    tokio::select! {
        exported = export(connection, name, args, json, &mut draft) => exported?,
        () = interrupted() => return Err(Interrupted.into()),
    }
    draft.finish().with_context(place)
}

/// Writes a file of arrays atomically.
async fn to_arrays(
    connection: &Connection,
    name: &DictionaryName,
    args: &ExportArgs,
    file: &Path,
) -> Result<()> {
    let place = || format!("output {}", file.display());
    let status = connection.dictionaries().get(GetRequest { name: name.to_string() }).await?.into_inner();
    let status = DictionaryStatus::try_from(status)?;
    let chosen = ChosenAxes::new(&status.grid, args)?;
    let write = async {
        let mut draft = DraftFile::create(file).with_context(place)?;
        npz::write(connection, &status, &chosen, &mut draft).await?;
        draft.finish().with_context(place)
    };
    tokio::select! {
        written = write => written,
        () = interrupted() => Err(Interrupted.into()),
    }
}

async fn export(
    connection: &Connection,
    name: &DictionaryName,
    args: &ExportArgs,
    json: bool,
    mut out: impl Write,
) -> Result<()> {
    let status = connection.dictionaries().get(GetRequest { name: name.to_string() }).await?.into_inner();
    let status = DictionaryStatus::try_from(status)?;
    let grid = &status.grid;
    let indices = chosen::selection(grid, args)?;
    let material = args.measurement.as_deref();
    let mut measurement = material.map(|name| one_material(grid, &indices, name, json)).transpose()?;
    let wanted = if indices.is_empty() { grid.record_count() } else { indices.len() };
    let mut records = RecordStream::ask(connection, &status, indices).await?;
    if !json && measurement.is_none() {
        rows::write_head(&mut out, grid, args.responses)?;
    }
    let form = RecordText::new(grid, json);
    let (mut count, mut bytes) = (0, 0);
    loop {
        let batch = records.next_batch(BATCH).await?;
        if batch.is_empty() {
            break;
        }
        count += batch.len();
        if let Some(measurement) = &mut measurement {
            for record in batch {
                let thickness_mm = grid.parameters(record.index).0.thickness_mm();
                measurement.add(grid.scene(), thickness_mm, &record.profiles)?;
            }
            continue;
        }
        for text in form.of_all(&batch)? {
            bytes += text.len();
            out.write_all(&text)?;
        }
        if count == batch.len() && args.output.is_some() {
            report_size(bytes as f64 / count as f64 * records.promised() as f64);
        }
    }
    if let Some(measurement) = measurement {
        out.write_all(&measurement.into_bytes()?)?;
    }
    out.flush()?;
    if count == 0 {
        bail!("none of the records asked for is done yet");
    }
    if count < wanted {
        to_stderr(format_args!(
            "farmctl: {count} of the {wanted} records asked for are done, the others are left out"
        ));
    }
    Ok(())
}

/// A writer for the selected medium; several media are refused.
fn one_material(grid: &Grid, indices: &[u32], name: &str, json: bool) -> Result<MeasurementWriter<Vec<u8>>> {
    if json {
        bail!("--measurement writes CSV: leave out --json");
    }
    let all = 0..grid.record_count() as u32;
    let picked = if indices.is_empty() { all.collect() } else { indices.to_vec() };
    let medium = |index: &u32| {
        let (point, medium) = grid.parameters(*index as usize);
        (medium.sigma_t_per_mm(), medium.albedo(), medium.g(), point.sample_ior())
    };
    let mut media: Vec<_> = picked.iter().map(medium).collect();
    media.dedup();
    if let [first, second, ..] = media[..] {
        bail!(
            "--measurement writes one medium, and several match, as (σ_t, α, g, index) {first:?} and {second:?}: \
             pick one with --sigma-t, --albedo, --g and, if there are several indices, --sample-ior"
        );
    }
    MeasurementWriter::new(Vec::new(), name)
}

/// Reports the size of a large file before it is complete.
fn report_size(bytes: f64) {
    const LARGE: f64 = 1e8;
    if bytes > LARGE {
        to_stderr(format_args!("farmctl: about {:.1} GB will be written", bytes / 1e9));
    }
}
