//! Makes files to save: media with their statement of uncertainty, and figures, as `-o` and `--plot` write them.

use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};
use std::path::Path;

use anyhow::{Context, Result};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use farm_figures::{Picture, fit_figure, map_figure, profile_figure};
use farm_lab::media_file::MEDIA_FILE;
use farm_lab::session_folder::SessionFolder;
use farm_lab::uncertainty::UNCERTAINTY_FILE;
use farm_proto::wire::ProfileRequest;
use optics_model::Medium;
use optics_model::fit::{DistanceMap, MaterialFit, PredictedProfiles, ProfileQuestion};
use serde::{Deserialize, Serialize};
use tokio::task::block_in_place;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::PageState;
use super::measure::{MapInputs, MeasureInputs, MeasuredAnswer, maps};
use crate::answers::media_files;
use crate::figure_files::{self, FigureSize, file_name};

/// A file, or several in an archive: browsers allow one download per click.
#[derive(Debug, Serialize)]
pub(super) struct SavedFile {
    name: String,
    base64: String,
}

/// Inputs of the figures of a verb.
#[derive(Debug, Deserialize)]
pub(super) struct FigureInputs {
    /// The extension: svg or png.
    format: String,
    #[serde(flatten)]
    verb: FigureVerb,
}

#[derive(Debug, Deserialize)]
#[serde(tag = "verb", rename_all = "lowercase")]
enum FigureVerb {
    Measure(Box<MeasureInputs>),
    Map(Box<MapInputs>),
    Profile(ProfileInputs),
}

/// Inputs of `farmctl profile` by the names of its options.
#[derive(Debug, Deserialize)]
struct ProfileInputs {
    dictionary: String,
    sigma_t: f64,
    albedo: f64,
    g: f64,
    thickness: f64,
    channel: Vec<String>,
}

/// The files that `farmctl measure -o` writes.
pub(super) async fn media(state: &PageState, asked: MeasureInputs) -> Result<SavedFile> {
    let measured = MeasuredAnswer::ask(state, asked).await?;
    block_in_place(|| {
        let mut files: BTreeMap<String, Vec<u8>> = BTreeMap::new();
        let mut add = |name: &str, text: String| files.insert(name.to_owned(), text.into_bytes());
        for (name, text) in media_files(&measured.found.materials)? {
            add(name, text);
        }
        if measured.has_intervals() {
            let (found, dictionary, grid) = (&measured.found, measured.dictionary(), &measured.grid);
            let record = measured.folder.as_ref().map(SessionFolder::record).transpose()?;
            add(MEDIA_FILE, found.media_file(dictionary, grid).text()?);
            add(UNCERTAINTY_FILE, found.uncertainty(dictionary, grid, record.as_ref()));
        }
        saved("media", files)
    })
}

/// The figures that `--plot` draws.
pub(super) async fn figures(state: &PageState, asked: FigureInputs) -> Result<SavedFile> {
    let FigureInputs { format, verb } = asked;
    let (archive, pictures): (_, Vec<(String, Picture)>) = match verb {
        FigureVerb::Measure(asked) => {
            let measured = MeasuredAnswer::ask(state, *asked).await?;
            let figure = |fit: &MaterialFit| Ok((fit.material.clone(), fit_figure(fit)?));
            ("figures", measured.found.materials.iter().map(figure).collect::<Result<_>>()?)
        }
        FigureVerb::Map(asked) => {
            let figure = |(material, map): (String, DistanceMap)| {
                Ok((format!("{material}-{}-map", map.channel), map_figure(&material, &map)?))
            };
            let maps = maps(state, *asked).await?.into_iter().map(|m| (m.material, m.map));
            ("maps", maps.map(figure).collect::<Result<_>>()?)
        }
        FigureVerb::Profile(asked) => {
            let profiles = profiles(state, asked).await?;
            ("profile", vec![("profile".to_owned(), profile_figure(&profiles)?)])
        }
    };
    block_in_place(|| {
        let mut files = BTreeMap::new();
        for (name, picture) in pictures {
            let mut file = format!("{}.{format}", file_name(&name));
            // Names that differ in unsuitable signs alone become alike.
            if files.contains_key(&file) {
                file = format!("{}-{file}", files.len() + 1);
            }
            let content = figure_files::content(&picture, Path::new(&file), FigureSize::default())?;
            files.insert(file, content);
        }
        saved(archive, files)
    })
}

async fn profiles(state: &PageState, asked: ProfileInputs) -> Result<PredictedProfiles> {
    let ProfileInputs { dictionary, sigma_t, albedo, g, thickness, channel } = asked;
    let question = ProfileQuestion::new(Medium::new(sigma_t, albedo, g)?, thickness, None, channel)?;
    let connection = state.farm.connection().await?;
    let mut fits = connection.fits();
    let request = ProfileRequest { dictionary, ..(&question).into() };
    let asking = async { Ok(fits.profile(request).await?) };
    Ok(state.farm.answer(&connection, asking).await?.into_inner().try_into()?)
}

/// A single file as it is, several in an archive of this name.
fn saved(archive: &str, mut files: BTreeMap<String, Vec<u8>>) -> Result<SavedFile> {
    if files.len() == 1 {
        let (name, content) = files.pop_first().context("there is one file")?;
        return Ok(SavedFile { name, base64: STANDARD.encode(content) });
    }
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        writer
            .start_file(name, SimpleFileOptions::default().compression_method(CompressionMethod::Stored))?;
        writer.write_all(&content)?;
    }
    let content = writer.finish()?.into_inner();
    Ok(SavedFile { name: format!("{archive}.zip"), base64: STANDARD.encode(content) })
}
