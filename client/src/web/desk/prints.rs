//! Predicts prints of the media of a measurement.

use anyhow::{Result, bail};
use clap::ValueEnum;
use farm_figures::numbers::{minus, with_error};
use farm_lab::colour::{Illuminant, StandardObserver, Viewing};
use farm_lab::media_file::MediaFile;
use optics_model::{Grid, Invalid};

use super::api::{
    MediaRequest, NumberWithInterval, PredictPrintRequest, PredictPrintResponse, PrintChannel, PrintColour,
};
use super::found;
use crate::answers::MeasureAnswer;
use crate::prints::geometry::Geometry;
use crate::prints::prediction::{ColourJson, PredictJson, PredictedChannelJson, ReflectanceJson, predicted};
use crate::prints::view::ViewOptions;

/// The answer of a measurement, with name and grid of its dictionary if they are given.
pub(super) fn measured(media: MediaRequest) -> Result<(MeasureAnswer, Option<(String, Grid)>)> {
    let grid = media.grid.map(Grid::try_from).transpose()?;
    Ok((found(media.found)?, grid.map(|grid| (media.dictionary, grid))))
}

pub(super) fn print(request: PredictPrintRequest) -> Result<PredictPrintResponse> {
    let Some(media) = request.media else { bail!(Invalid::new("media", "nothing", "an answer is needed")) };
    let (found, dictionary) = measured(media)?;
    let Some((name, grid)) = dictionary else {
        bail!(Invalid::new("media.grid", "nothing", "the grid of the dictionary is needed"))
    };
    let file: MediaFile = found.media_file(&name, &grid);
    let geometry = if request.geometry.is_empty() { "session" } else { &request.geometry };
    let geometry = Geometry::from_str(geometry, false)
        .map_err(|_| Invalid::new("geometry", geometry, "allowed are session, 45:0 and d:8"))?;
    let over =
        if request.over.is_empty() { vec!["black".to_owned(), "white".to_owned()] } else { request.over };
    if request.slabs.is_empty() {
        bail!(Invalid::new("slabs", "none", "a print has at least one slab"));
    }
    let viewing = Viewing { illuminant: Illuminant::D50, observer: StandardObserver::TwoDegrees };
    let options = ViewOptions { geometry, roughness: request.roughness, viewing };
    let found = predicted(&file, &request.slabs, &over, &options)?;
    Ok(response(&found))
}

fn response(found: &PredictJson) -> PredictPrintResponse {
    let colours = found.colours.as_ref();
    let text = |of: Option<[f64; 2]>| of.map(|[v, error]| minus(&with_error(v, error))).unwrap_or_default();
    PredictPrintResponse {
        bases: found.channels.iter().take(1).flat_map(|c| &c.bases).map(|b| b.base.name.clone()).collect(),
        channels: found.channels.iter().map(channel).collect(),
        colours: colours.map(|c| c.bases.iter().map(colour).collect()).unwrap_or_default(),
        contrast_ratio: text(colours.and_then(|c| c.contrast_ratio)),
        delta_e_2000: text(colours.and_then(|c| c.delta_e_2000)),
        remarks: found.remarks(),
    }
}

fn channel(channel: &PredictedChannelJson) -> PrintChannel {
    let number = |b: &ReflectanceJson| {
        let [value, interval] = b.texts();
        NumberWithInterval { value, interval }
    };
    PrintChannel {
        channel: channel.channel.clone(),
        radiance_factors: channel.bases.iter().map(|b| b.radiance_factor).collect(),
        numbers: channel.bases.iter().map(number).collect(),
    }
}

fn colour(colour: &ColourJson) -> PrintColour {
    PrintColour {
        lab: (0..3).map(|k| minus(&with_error(colour.colour.lab[k], colour.lab_std_errors[k]))).collect(),
        srgb: colour.hex().unwrap_or_default(),
    }
}
