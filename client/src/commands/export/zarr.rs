//! A dictionary as a Zarr store: a folder that xarray and others open as it is, and read in parts.
//!
//! Version 3 of the specification (zarr-specs.readthedocs.io): each array is a folder with a `zarr.json` and its chunks,
//! numbers one after the other without compression, since noise hardly shrinks. A chunk holds all records of one index,
//! σ_t and g. The group's `zarr.json` repeats those of its arrays, so that a reader opens one file.

use std::fs::{File, create_dir_all};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use farm_proto::status::DictionaryStatus;
use serde_json::{Map, Value, json};

use super::Chosen;
use super::arrays::{AXES, Array, Complete, about, channels, numeric_axes, unit_of_axis};
use crate::connection::Connection;

/// Axes along which a chunk has the length 1: the first of [`AXES`].
const OUTER: usize = 3;

/// Writes the chosen records, which must all be done, into a folder that is not there yet. It appears once it is complete.
pub(super) async fn write(
    connection: &Connection,
    status: &DictionaryStatus,
    chosen: &Chosen,
    folder: &Path,
) -> Result<()> {
    if folder.exists() {
        bail!("it is there already, and a store is not written over: delete it, or name another");
    }
    let parent = folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let draft = tempfile::Builder::new().prefix(".zarr.").suffix(".partial").tempdir_in(parent)?;
    let grid = &status.grid;
    let arrays = Array::all(grid);
    let names = channels(grid);
    let shape = [&chosen.shape()[..], &[names.len(), grid.scene().sensor().pixels()]].concat();
    let mut chunk = shape.clone();
    chunk[..OUTER].fill(1);

    let mut metadata = Map::new();
    for array in arrays {
        let attributes = json!({ "units": array.unit });
        metadata.insert(array.name.to_owned(), array_json("float32", &shape, &chunk, &AXES, &attributes));
    }
    for (name, values) in numeric_axes(grid, chosen) {
        let length = [values.len()];
        let attributes = unit_of_axis(name).map_or(json!({}), |unit| json!({ "units": unit }));
        metadata.insert(name.to_owned(), array_json("float64", &length, &length, &[name], &attributes));
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        write_chunk(&draft.path().join(name), &[0], &bytes)?;
    }
    metadata.insert("channel".to_owned(), texts_json(names.len()));
    write_chunk(&draft.path().join("channel"), &[0], &texts(&names))?;

    write_records(connection, status, chosen, draft.path()).await?;
    for (name, array) in &metadata {
        write_json(&draft.path().join(name).join("zarr.json"), array)?;
    }
    let group = json!({
        "zarr_format": 3,
        "node_type": "group",
        "attributes": about(status, arrays)?,
        "consolidated_metadata": { "kind": "inline", "must_understand": false, "metadata": metadata },
    });
    write_json(&draft.path().join("zarr.json"), &group)?;
    let finished = draft.keep();
    if let Err(error) = publish(&finished, folder) {
        // What has no name is of no use to anybody.
        let _ = std::fs::remove_dir_all(&finished);
        return Err(error);
    }
    Ok(())
}

/// Gives the folder its name, and the rights of one that the user made.
fn publish(finished: &Path, folder: &Path) -> Result<()> {
    let made_here = tempfile::Builder::new().permissions(all()).tempdir_in(finished)?;
    std::fs::set_permissions(finished, std::fs::metadata(made_here.path())?.permissions())?;
    made_here.close()?;
    std::fs::rename(finished, folder)?;
    Ok(())
}

/// All rights, before the process's mask.
fn all() -> std::fs::Permissions {
    std::os::unix::fs::PermissionsExt::from_mode(0o777)
}

async fn write_records(
    connection: &Connection,
    status: &DictionaryStatus,
    chosen: &Chosen,
    folder: &Path,
) -> Result<()> {
    let [iors, sigma_ts, gs, thicknesses, albedos] = chosen.shape();
    let arrays = Array::all(&status.grid);
    let mut records = Complete::ask(connection, status, chosen).await?;
    let mut chunks = vec![Vec::new(); arrays.len()];
    for place in 0..iors * sigma_ts * gs {
        for _ in 0..thicknesses * albedos {
            let record = records.next().await?.context("the records end early")?;
            for profile in &record.profiles {
                for (array, chunk) in arrays.iter().zip(&mut chunks) {
                    chunk.extend(array.numbers(profile).iter().flat_map(|number| number.to_le_bytes()));
                }
            }
        }
        let key = [place / (sigma_ts * gs), place / gs % sigma_ts, place % gs, 0, 0, 0, 0];
        for (array, chunk) in arrays.iter().zip(&mut chunks) {
            write_chunk(&folder.join(array.name), &key, chunk)?;
            chunk.clear();
        }
    }
    Ok(())
}

fn write_chunk(array: &Path, key: &[usize], bytes: &[u8]) -> Result<()> {
    let mut path = array.join("c");
    path.extend(key.iter().map(|part| PathBuf::from(part.to_string())));
    create_dir_all(path.parent().expect("a chunk lies in its array's folder"))?;
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    Ok(file.sync_all()?)
}

fn write_json(path: &Path, value: &Value) -> Result<()> {
    let mut file = File::create(path)?;
    file.write_all(&serde_json::to_vec_pretty(value)?)?;
    Ok(file.sync_all()?)
}

fn array_json(kind: &str, shape: &[usize], chunk: &[usize], axes: &[&str], attributes: &Value) -> Value {
    json!({
        "zarr_format": 3,
        "node_type": "array",
        "shape": shape,
        "data_type": kind,
        "chunk_grid": { "name": "regular", "configuration": { "chunk_shape": chunk } },
        "chunk_key_encoding": { "name": "default", "configuration": { "separator": "/" } },
        "fill_value": "NaN",
        "codecs": [{ "name": "bytes", "configuration": { "endian": "little" } }],
        "dimension_names": axes,
        "attributes": attributes,
    })
}

/// Names of channels: Zarr's extension for text.
fn texts_json(count: usize) -> Value {
    let mut texts = array_json("string", &[count], &[count], &["channel"], &json!({}));
    texts["fill_value"] = json!("");
    texts["codecs"] = json!([{ "name": "vlen-utf8", "configuration": {} }]);
    texts
}

/// How many there are, then each one's length and its bytes.
fn texts(names: &[&str]) -> Vec<u8> {
    let length = |n: usize| u32::try_from(n).expect("names of channels are short").to_le_bytes();
    let each = names.iter().flat_map(|name| [&length(name.len())[..], name.as_bytes()].concat());
    length(names.len()).into_iter().chain(each).collect()
}
