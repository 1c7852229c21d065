//! `farmctl validate` of a chart of stacks: what media predict for them, as colours or by channel.

use anyhow::{Context, Result, bail};
use farm_figures::numbers::significant;
use farm_figures::{ChartPoint, chart_figure};
use farm_lab::chart::{ChartFile, JudgedChart, NamedPatch, PatchGeometry, REST, judged, judged_blocks};
use farm_lab::colour::{Colorimetry, Illuminant, StandardObserver, Viewing};
use farm_lab::document::Block;
use farm_lab::media_file::MediaFile;
use farm_lab::slabs::NamedSlab;
use optics_chart::linear_srgb;
use serde::Serialize;

use super::ValidateArgs;
use crate::figure_files;
use crate::output::Output;
use crate::prints::bases::PrintBase;
use crate::prints::geometry::Geometry;
use crate::prints::view::{PrintView, ViewOptions};

/// Standard error of the cube root of a value in the figure.
const ROOT_ERROR: f64 = 0.015;

#[derive(Debug, Serialize)]
struct StacksJson {
    geometry: String,
    #[serde(flatten)]
    judged: JudgedChart,
    /// The difference that 95 % of patches should stay below after the chart of the media, and the share that does; null if
    /// the media are not from such a chart.
    bound: Option<[f64; 2]>,
}

pub(super) fn run(args: &ValidateArgs, output: &Output) -> Result<()> {
    if args.mixtures.is_some() {
        bail!("--mixtures is for patches that are no stacks: leave it out");
    }
    let media = MediaFile::read(&args.media)?;
    let file = ChartFile::read(&args.chart)?;
    output.notes(&file.notes, &args.chart);
    let (expected, geometry) = expected(args, &media, &file)?;
    let judged = judged(&file.patches, &expected, file.is_colour).context("a chart has patches")?;
    let below = media.chart.as_ref().and_then(|chart| chart.delta_e_2000_below).filter(|_| file.is_colour);
    let share = |below: f64| {
        let within = judged.all.iter().filter(|difference| **difference <= below).count();
        [below, within as f64 / judged.all.len() as f64]
    };
    let data = StacksJson { geometry, bound: below.map(share), judged };
    if let Some(path) = &args.plot {
        let points = file.patches.iter().zip(&expected).flat_map(|(patch, expected)| {
            patch.values.iter().zip(expected).map(|(measured, predicted)| ChartPoint {
                predicted: *predicted,
                measured: *measured,
                std_error: 3.0 * ROOT_ERROR * libm::pow(predicted.max(1e-3), 2.0 / 3.0),
            })
        });
        if let Some(picture) = chart_figure(&points.collect::<Vec<_>>()) {
            figure_files::write(&picture, path, args.figure.size()?)?;
        }
    }
    output.answer("validate_stacks", &data, || [blocks(&data), figure_files::drawn(&args.plot)].concat())
}

/// The geometry in which a patch was measured.
fn geometry(file: &ChartFile, patch: &NamedPatch) -> Result<Geometry> {
    match patch.geometry.unwrap_or(file.settings.geometry) {
        PatchGeometry::FortyFiveZero => Ok(Geometry::FortyFiveZero),
        PatchGeometry::DiffuseEight => Ok(Geometry::DiffuseEight),
        PatchGeometry::Transmission => {
            bail!("the chart has transmittances: only reflected light is validated")
        }
    }
}

/// Linear sRGB, or the chart's channels, of each patch, and the geometries for which they are predicted.
fn expected(args: &ValidateArgs, media: &MediaFile, file: &ChartFile) -> Result<(Vec<Vec<f64>>, String)> {
    let own = file.patches.iter().map(|patch| geometry(file, patch)).collect::<Result<Vec<_>>>()?;
    let options: Vec<ViewOptions> = own.into_iter().map(|own| args.view.options_or(own)).collect();
    let mut all = vec![Vec::new(); options.len()];
    let mut names: Vec<&str> = Vec::new();
    for first in &options {
        if names.contains(&first.geometry.name()) {
            continue;
        }
        names.push(first.geometry.name());
        let alike: Vec<usize> = (0..all.len()).filter(|i| options[*i].geometry == first.geometry).collect();
        let patches: Vec<&NamedPatch> = alike.iter().map(|i| &file.patches[*i]).collect();
        let found = expected_in(args, first, media, file, &patches)?;
        alike.iter().zip(found).for_each(|(i, values)| all[*i] = values);
    }
    Ok((all, names.join(", ")))
}

/// The values of patches of one geometry.
fn expected_in(
    args: &ValidateArgs,
    options: &ViewOptions,
    media: &MediaFile,
    file: &ChartFile,
    patches: &[&NamedPatch],
) -> Result<Vec<Vec<f64>>> {
    let mut names: Vec<&str> = Vec::new();
    for patch in patches {
        if !names.contains(&patch.base.as_str()) {
            names.push(&patch.base);
        }
    }
    let base = |name: &&str| match *name {
        REST if !file.settings.base.is_empty() => Ok(PrintBase::by_channel(&file.settings.base)),
        REST => PrintBase::parsed(&args.over),
        name => PrintBase::parsed(name),
    };
    let bases: Vec<PrintBase> = names.iter().map(base).collect::<Result<_, _>>()?;
    let all: Vec<NamedSlab> = patches.iter().flat_map(|patch| patch.slabs.clone()).collect();
    let view = PrintView::new(media, &all, &bases, options)?;
    let stacks: Vec<(&[NamedSlab], usize)> = patches
        .iter()
        .map(|patch| (&patch.slabs[..], names.iter().position(|name| *name == patch.base).unwrap_or(0)))
        .collect();
    let values = view.stacks(&stacks)?;
    let channels = view.names();
    if file.is_colour {
        let viewing = Viewing { illuminant: Illuminant::D65, observer: StandardObserver::TwoDegrees };
        let (colorimetry, order) = Colorimetry::for_channels(&channels, media.chart.as_ref(), viewing)
            .context("the chart has colours of a camera, or CIELAB, and the media have none")?;
        let colour = |of: &Vec<f64>| {
            let spectrum: Vec<f64> = order.iter().map(|channel| of[*channel]).collect();
            linear_srgb(colorimetry.colour(&spectrum).lab).to_vec()
        };
        return Ok(values.iter().map(colour).collect());
    }
    let place = |name: &String| {
        let found = channels.iter().position(|channel| channel == name);
        found.with_context(|| format!("the media have no channel {name}: they have {}", channels.join(", ")))
    };
    let places: Vec<usize> = file.channels.iter().map(place).collect::<Result<_>>()?;
    // The mirrored light of other geometries contains it.
    let has_sheen = options.geometry == Geometry::FortyFiveZero;
    let sheen = media.chart.as_ref().filter(|_| has_sheen).map_or(0.0, |chart| chart.sheen);
    Ok(values.iter().map(|of| places.iter().map(|channel| of[*channel] + sheen).collect()).collect())
}

fn blocks(data: &StacksJson) -> Vec<Block> {
    let judged = &data.judged;
    let number = |v: f64| {
        if judged.unit == "share" { format!("{} %", significant(100.0 * v, 2)) } else { significant(v, 3) }
    };
    let unit = if judged.unit == "share" { "differ by" } else { "differ by CIEDE2000" };
    let mut verdict = format!(
        "{} patches {unit} {} in the median, 95 % of them by less than {}.",
        judged.patches,
        number(judged.median),
        number(judged.below_95)
    );
    if let Some([below, share]) = data.bound {
        verdict += &format!(
            " {} % are within {}, which the chart of the media states for 95 %.",
            significant(100.0 * share, 3),
            significant(below, 3)
        );
    }
    let mut blocks = vec![Block::Verdict(verdict)];
    blocks.extend(judged_blocks(judged));
    blocks.push(Block::Paragraph(format!("predicted for the geometry {}", data.geometry)));
    blocks
}
