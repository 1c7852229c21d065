//! Implements `farmctl predict`: the reflectance and the colour of slabs of measured media over bases.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use farm_figures::numbers::{minus, significant, with_error};
use farm_lab::colour::{Colorimetry, SeenColour, StandardObserver, Viewing};
use farm_lab::media_file::MediaFile;
use optics_layers::Predicted;
use optics_model::Invalid;
use optics_model::fit::Z;
use optics_model::measurement::wavelength_nm;
use serde::Serialize;

use super::bases::PrintBase;
use super::errors::{lab_std_errors, std_error};
use super::slabs::{NamedSlab, parsed};
use super::view::{PrintView, ViewArgs, materials_of, unresolved};
use crate::output::{Output, table, wrapped};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl predict media white:1                         over black and white, in the measured set-up
  farmctl predict media cyan:0.2 white:2 --over 0.5     a layer on a thick one
  farmctl predict media white=0.9,cyan=0.1:1 --geometry d:8

The media are those that `farmctl measure` wrote to media.json, in the folder of -o or of a session.
Set-up and index of the print are those that the measurement found; intervals contain the errors of
the media and of the set-up.")]
pub(crate) struct PredictArgs {
    /// Measured media: media.json, or the folder that contains it.
    media: PathBuf,
    /// Slabs from top to bottom: MATERIAL:MM, or a mixture by volume, MATERIAL=SHARE,MATERIAL=SHARE:MM.
    #[arg(value_name = "SLAB", required = true)]
    slabs: Vec<String>,
    /// Lambertian bases under the print: reflectances; black (0.03) and white (0.9); light and dark, the sides of the
    /// measured board.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "black,white")]
    over: Vec<String>,
    #[command(flatten)]
    view: ViewArgs,
}

pub(crate) fn run(args: &PredictArgs, output: &Output) -> Result<()> {
    let data = data(args)?;
    output.print("predict", &data, || text(&data))
}

#[derive(Debug, Serialize)]
pub(crate) struct PredictJson {
    slabs: Vec<SlabJson>,
    geometry: &'static str,
    channels: Vec<PredictedChannelJson>,
    /// Null unless the channels are wavelengths that cover the visible range.
    colours: Option<ColoursJson>,
    /// Why there are no colours.
    #[serde(skip_serializing_if = "Option::is_none")]
    no_colours: Option<String>,
    /// Materials that the measurement leaves undetermined, with their channels.
    unresolved: Vec<String>,
}

#[derive(Debug, Serialize)]
struct SlabJson {
    label: String,
    thickness_mm: f64,
    shares: Vec<ShareJson>,
}

#[derive(Debug, Serialize)]
struct ShareJson {
    material: String,
    share: f64,
}

#[derive(Debug, Serialize)]
struct PredictedChannelJson {
    channel: String,
    bases: Vec<ReflectanceJson>,
}

/// A radiance factor with its 95 % interval.
#[derive(Debug, Serialize)]
struct ReflectanceJson {
    base: PrintBase,
    radiance_factor: f64,
    std_error: f64,
    interval: [f64; 2],
}

#[derive(Debug, Serialize)]
struct ColoursJson {
    #[serde(flatten)]
    viewing: Viewing,
    bases: Vec<ColourJson>,
    /// Least Y over all bases over the greatest, and its standard error; null with one base.
    contrast_ratio: Option<[f64; 2]>,
}

#[derive(Debug, Serialize)]
struct ColourJson {
    base: PrintBase,
    #[serde(flatten)]
    colour: SeenColour,
    lab_std_errors: [f64; 3],
    /// Null for the 10° observer.
    srgb: Option<[u8; 3]>,
}

fn data(args: &PredictArgs) -> Result<PredictJson> {
    let file = MediaFile::read(&args.media)?;
    let is_material = |name: &str| file.material(name).is_ok();
    let slabs: Vec<NamedSlab> =
        args.slabs.iter().map(|text| parsed(text, is_material)).collect::<Result<_>>()?;
    let bases: Vec<PrintBase> =
        args.over.iter().map(|text| PrintBase::parsed(text.trim())).collect::<Result<_, _>>()?;
    let materials = materials_of(&slabs);
    let view = PrintView::new(&file, &slabs, &bases, &args.view)?;
    let channels = view.names();
    let found = view.predicted(&slabs)?;
    let unresolved = unresolved(&file, &materials, &channels)?;
    let (colours, no_colours) = match colours(&channels, &found, &bases, args.view.viewing()) {
        Ok(colours) => (Some(colours), None),
        Err(reason) if wavelength_nm(channels[0]).is_none() => (None, Some(reason.allowed().to_owned())),
        Err(reason) => (None, Some(format!("{}: {}", reason.given(), reason.allowed()))),
    };
    Ok(PredictJson {
        slabs: slabs.iter().map(slab_json).collect(),
        geometry: args.view.geometry.name(),
        channels: channels
            .iter()
            .zip(&found)
            .map(|(channel, found)| channel_json(channel, found, &bases))
            .collect(),
        colours,
        no_colours,
        unresolved,
    })
}

fn slab_json(slab: &NamedSlab) -> SlabJson {
    let share = |(material, share): &(String, f64)| ShareJson { material: material.clone(), share: *share };
    SlabJson {
        label: slab.label(),
        thickness_mm: slab.thickness_mm,
        shares: slab.shares.iter().map(share).collect(),
    }
}

fn channel_json(channel: &str, found: &[Predicted], bases: &[PrintBase]) -> PredictedChannelJson {
    let reflectance = |(found, base): (&Predicted, &PrintBase)| {
        let (value, std_error) = (found.value, found.std_error());
        let interval = [(value - Z * std_error).max(0.0), value + Z * std_error];
        ReflectanceJson { base: base.clone(), radiance_factor: value, std_error, interval }
    };
    PredictedChannelJson {
        channel: channel.to_owned(),
        bases: found.iter().zip(bases).map(reflectance).collect(),
    }
}

/// Colours over all bases.
fn colours(
    channels: &[&str],
    found: &[Vec<Predicted>],
    bases: &[PrintBase],
    viewing: Viewing,
) -> Result<ColoursJson, Invalid> {
    let wavelengths: Option<Vec<f64>> = channels.iter().map(|channel| wavelength_nm(channel)).collect();
    let mut sorted: Vec<(f64, usize)> =
        wavelengths.unwrap_or_default().into_iter().enumerate().map(|(i, nm)| (nm, i)).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (nm, order): (Vec<f64>, Vec<usize>) = sorted.into_iter().unzip();
    let colorimetry = Colorimetry::new(&nm, viewing)?;
    let colour = |(i, base): (usize, &PrintBase)| {
        let values: Vec<f64> = order.iter().map(|channel| found[*channel][i].value).collect();
        let colour = colorimetry.colour(&values);
        ColourJson {
            base: base.clone(),
            colour,
            lab_std_errors: lab_std_errors(&colorimetry, found, &order, i),
            srgb: colorimetry.srgb(&colour),
        }
    };
    let all: Vec<ColourJson> = bases.iter().enumerate().map(colour).collect();
    let contrast_ratio = (all.len() > 1).then(|| contrast_ratio(&colorimetry, found, &order, &all));
    Ok(ColoursJson { viewing, bases: all, contrast_ratio })
}

/// Least Y over the greatest, q = Y₁/Y₂, and its standard error, by dq = (dY₁ − q dY₂)/Y₂.
fn contrast_ratio(
    colorimetry: &Colorimetry,
    found: &[Vec<Predicted>],
    order: &[usize],
    colours: &[ColourJson],
) -> [f64; 2] {
    let y = |base: &usize| colours[*base].colour.xyz[1];
    let all = || 0..colours.len();
    let least = all().min_by(|a, b| y(a).total_cmp(&y(b))).unwrap_or(0);
    let greatest = all().max_by(|a, b| y(a).total_cmp(&y(b))).unwrap_or(0);
    let ratio = y(&least) / y(&greatest);
    // Y is linear in the spectrum.
    let mut weights = vec![0.0; found.len()];
    for (at, channel) in order.iter().enumerate() {
        let unit: Vec<f64> = (0..order.len()).map(|i| if i == at { 1.0 } else { 0.0 }).collect();
        weights[*channel] = colorimetry.xyz(&unit)[1] / y(&greatest);
    }
    let error = std_error(found, |channel, base| match base {
        _ if base == least => weights[channel],
        _ if base == greatest => -ratio * weights[channel],
        _ => 0.0,
    });
    [ratio, if least == greatest { 0.0 } else { error }]
}

fn text(data: &PredictJson) -> String {
    let bases: Vec<&str> = data.channels[0].bases.iter().map(|b| b.base.name.as_str()).collect();
    let heads: Vec<String> =
        bases.iter().flat_map(|base| [format!("over {base}"), "95 %".to_owned()]).collect();
    let head: Vec<&str> = std::iter::once("ch").chain(heads.iter().map(String::as_str)).collect();
    let row = |channel: &PredictedChannelJson| {
        let cells = channel.bases.iter().flat_map(|b| {
            let digits = (-b.std_error.max(1e-5).log10().floor()).clamp(2.0, 6.0) as usize + 1;
            [
                format!("{:.digits$}", b.radiance_factor),
                format!("{:.digits$}…{:.digits$}", b.interval[0], b.interval[1]),
            ]
        });
        std::iter::once(channel.channel.clone()).chain(cells).collect()
    };
    let right: Vec<usize> = (0..bases.len()).map(|i| 2 * i + 1).collect();
    let slabs: Vec<&str> = data.slabs.iter().map(|slab| slab.label.as_str()).collect();
    let mut text = format!(
        "radiance factor of {}, {}\n{}",
        slabs.join(" on "),
        match data.geometry {
            "session" => "in the measured set-up".to_owned(),
            other => format!("a bare print at {other}"),
        },
        table(&head, &right, data.channels.iter().map(row))
    );
    match (&data.colours, &data.no_colours) {
        (Some(colours), _) => text += &format!("\n\n{}", colours_text(colours)),
        (None, Some(reason)) => text += &format!("\n{}", wrapped(&format!("no colours: {reason}"))),
        _ => {}
    }
    if !data.unresolved.is_empty() {
        let list = data.unresolved.join(", ");
        text += &format!("\n{}", wrapped(&format!("not determined by the measurement: {list}")));
    }
    text
}

fn colours_text(colours: &ColoursJson) -> String {
    let head = ["", "L*", "a*", "b*", "Y", "sRGB"];
    let row = |c: &ColourJson| {
        let mut cells = vec![format!("over {}", c.base.name)];
        cells.extend((0..3).map(|k| with_error(c.colour.lab[k], c.lab_std_errors[k])));
        cells.push(significant(c.colour.xyz[1], 3));
        cells.push(c.srgb.map_or_else(|| "–".to_owned(), |[r, g, b]| format!("#{r:02x}{g:02x}{b:02x}")));
        cells
    };
    let Viewing { illuminant, observer } = colours.viewing;
    let observer = if observer == StandardObserver::TwoDegrees { "2°" } else { "10°" };
    let mut text = format!(
        "colour, {illuminant:?}, {observer}\n{}",
        table(&head, &[1, 2, 3, 4], colours.bases.iter().map(row))
    );
    if let Some([ratio, std_error]) = colours.contrast_ratio {
        text += &format!("\ncontrast ratio Y/Y {}", minus(&with_error(ratio, std_error)));
    }
    text
}
