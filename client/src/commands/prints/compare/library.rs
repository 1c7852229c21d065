//! Finds the materials of a folder of measurements that are like those of a measurement.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use farm_figures::numbers::{short, significant};
use farm_lab::document::{Block, ValueTable};
use farm_lab::media_file::{MEDIA_FILE, MediaFile, MediaMaterial};
use serde::Serialize;

use crate::prints::comparison::{ComparedQuantity, invariants};

/// How deep folders are searched.
const DEPTH: usize = 4;
/// How many materials are listed for each.
const LISTED: usize = 5;

/// Materials of a library near one of a measurement.
#[derive(Debug, Serialize)]
pub(super) struct LibraryMatches {
    material: String,
    /// Nearest first.
    nearest: Vec<LibraryMatch>,
}

#[derive(Debug, Serialize)]
struct LibraryMatch {
    folder: PathBuf,
    material: String,
    /// Number of channels that both have.
    channels: usize,
    /// Root mean square over channels of the relative differences of σ_s(1 − g) and of √σ_a, in per cent.
    difference_percent: f64,
    /// Greatest |E_n| of σ_s(1 − g) and σ_a; null where all intervals are open.
    e_n: Option<f64>,
}

/// The media files below a folder.
fn files(folder: &Path, depth: usize) -> Result<Vec<PathBuf>> {
    let place = || format!("library {}", folder.display());
    let mut found = Vec::new();
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder)
        .with_context(place)?
        .map(|entry| Ok(entry.with_context(place)?.path()))
        .collect::<Result<_>>()?;
    entries.sort();
    for path in entries {
        // Links are not followed: they may lead upwards.
        let Ok(kind) = path.symlink_metadata() else { continue };
        if kind.is_dir() && depth > 0 {
            found.extend(files(&path, depth - 1)?);
        } else if kind.is_file() && path.file_name().is_some_and(|name| name == MEDIA_FILE) {
            found.push(path);
        }
    }
    Ok(found)
}

/// Whether a path is a folder of folders.
pub(super) fn is_library(path: &Path) -> bool {
    path.is_dir() && !path.join(MEDIA_FILE).exists()
}

/// The nearest materials of a library for each material of a measurement, and why files were left out.
pub(super) fn nearest(measured: &MediaFile, library: &Path) -> Result<(Vec<LibraryMatches>, Vec<String>)> {
    let paths = files(library, DEPTH)?;
    if paths.is_empty() {
        bail!("{}: neither media.json nor a folder with media.json is in it", library.display());
    }
    let (mut all, mut left_out) = (Vec::new(), Vec::new());
    for path in paths {
        match MediaFile::read(&path) {
            Ok(file) => all.push((path, file)),
            Err(e) => left_out.push(format!("left out: {e:#}")),
        }
    }
    let material_matches = |one: &MediaMaterial| {
        let others = all.iter().flat_map(|(path, file)| file.materials.iter().map(move |m| (path, m)));
        let mut nearest: Vec<LibraryMatch> =
            others.filter_map(|(path, other)| compared(one, other, path, library)).collect();
        nearest.sort_by(|a, b| a.difference_percent.total_cmp(&b.difference_percent));
        nearest.truncate(LISTED);
        LibraryMatches { material: one.material.clone(), nearest }
    };
    Ok((measured.materials.iter().map(material_matches).collect(), left_out))
}

fn compared(one: &MediaMaterial, other: &MediaMaterial, path: &Path, library: &Path) -> Option<LibraryMatch> {
    let pairs: Vec<[ComparedQuantity; 2]> =
        one.channels.iter().filter_map(|c| Some(invariants(c, other.channel(&c.channel)?))).collect();
    let folder = path.parent().unwrap_or(path);
    let squares: f64 = pairs.iter().map(difference).sum();
    let e_n = pairs.iter().flatten().filter_map(|q| Some(q.e_n?.abs())).max_by(f64::total_cmp);
    (!pairs.is_empty()).then(|| LibraryMatch {
        folder: folder.strip_prefix(library).unwrap_or(folder).to_owned(),
        material: other.material.clone(),
        channels: pairs.len(),
        difference_percent: 100.0 * (squares / (2 * pairs.len()) as f64).sqrt(),
        e_n,
    })
}

/// Sum of the squares of relative differences. The reflectance of a thick slab changes with √σ_a, and a clear medium has
/// hardly any, so that it is compared with that of both.
fn difference(invariants: &[ComparedQuantity; 2]) -> f64 {
    let relative = |a: f64, b: f64| if a + b > 0.0 { 2.0 * (a - b) / (a + b) } else { 0.0 };
    let [scattering, absorption] = invariants;
    relative(scattering.a, scattering.b).powi(2) + relative(absorption.a.sqrt(), absorption.b.sqrt()).powi(2)
}

pub(super) fn blocks(all: &[LibraryMatches], left_out: &[String]) -> Vec<Block> {
    let head = "material | like | of | >channels | >differs by | >largest E_n";
    let row = |of: &LibraryMatches, m: &LibraryMatch| {
        vec![
            short(&of.material),
            short(&m.material),
            m.folder.display().to_string(),
            m.channels.to_string(),
            format!("{} %", significant(m.difference_percent, 2)),
            m.e_n.map_or_else(|| "–".to_owned(), |e| significant(e, 2)),
        ]
    };
    let rows = all.iter().flat_map(|of| of.nearest.iter().map(move |m| row(of, m)));
    vec![ValueTable::new(head, rows).block(), Block::List(left_out.to_vec())]
}
