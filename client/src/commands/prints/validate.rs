//! Implements `farmctl validate`: compares a chart of printed patches with what measured media predict for it.

mod stacks;
#[cfg(test)]
mod tests;
mod wavelengths;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Args;
use farm_figures::numbers::{fixed, short, significant, to_error};
use farm_figures::{ChartPoint, chart_figure};
use farm_lab::chart::is_chart;
use farm_lab::colour::{Colorimetry, delta_e_2000};
use farm_lab::document::{Block, ValueTable};
use farm_lab::measurement_file::MeasurementFile;
use farm_lab::media_file::MediaFile;
use farm_lab::mixture_file::read_mixtures;
use nalgebra::{DMatrix, DVector};
use optics_model::fit::{FitSettings, Mixtures};
use optics_model::measurement::wavelength_nm;
use optics_model::{MeasuredProfile, Measurement};
use serde::Serialize;

use super::view_args::ViewArgs;
use crate::cli::FigureArgs;
use crate::figure_files;
use crate::output::Output;
use crate::prints::bases::PrintBase;
use crate::prints::errors::{ErrorKey, changes, sum_std_error};
use crate::prints::geometry::Geometry;
use crate::prints::view::{PrintView, materials_of};
use farm_lab::slabs::NamedSlab;
use wavelengths::{left_out, measured_at};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl validate media chart.csv --mixtures chart.toml
  farmctl validate media slabs.csv --over white --geometry 45:0
  farmctl validate media stacks.csv                     printed stacks, with slabs, L, a and b

The chart has the columns of a measurement, a row for a patch and channel, with an empty x_mm:
material, channel, thickness_mm, x_mm, value, std_error. Tables of spectrophotometers in CGATS.17 are read as well;
they need a line such as THICKNESS_MM 2, and are predicted for 45:0 unless --geometry is given. Its materials are those of the media, or mixtures of them.")]
pub(crate) struct ValidateArgs {
    /// Measured media: media.json, or the folder that contains it.
    media: PathBuf,
    /// Measured patches, as a measurement without x or a CGATS table.
    chart: PathBuf,
    /// TOML file with the mixtures of the chart and their volume fractions.
    #[arg(long, value_name = "FILE")]
    mixtures: Option<PathBuf>,
    /// Base under the patches: a reflectance, black (0.03), white (0.9), or light or dark, a side of the measured
    /// board.
    #[arg(long, value_name = "BASE", default_value = "light")]
    over: String,
    /// Standard error of each patch's brightness, as a share of it: of the white reference and the even light.
    #[arg(long, value_name = "SHARE", default_value_t = FitSettings::default().gain_std_error)]
    gain_std_error: f64,
    /// Standard error of the patches' thickness in mm.
    #[arg(long, value_name = "MM", default_value_t = FitSettings::default().thickness_std_error_mm)]
    thickness_std_error: f64,
    /// Draw measured against predicted values, and their differences: FILE.svg, FILE.png or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    figure: FigureArgs,
    #[command(flatten)]
    view: ViewArgs,
}

/// A patch in one channel.
#[derive(Debug, Serialize)]
struct PatchJson {
    material: String,
    thickness_mm: f64,
    channel: String,
    measured: f64,
    predicted: f64,
    /// Standard error of the difference: of the value, the gain, the thickness and the media.
    expected_std_error: f64,
    /// Difference, measured less predicted, in expected standard errors.
    z: f64,
    #[serde(skip)]
    parts: DifferenceParts,
}

/// Errors of a difference: the value's own, and those that it shares with other channels or patches.
#[derive(Debug, Clone, Default)]
struct DifferenceParts {
    own: f64,
    shared: Vec<(ErrorKey, f64)>,
}

impl DifferenceParts {
    fn of(&self, key: &ErrorKey) -> f64 {
        self.shared.iter().find(|(of, _)| of == key).map_or(0.0, |(_, change)| *change)
    }

    fn std_error(&self) -> f64 {
        libm::hypot(self.shared.iter().map(|(_, change)| change * change).sum::<f64>().sqrt(), self.own)
    }
}

/// Mean deviation of the patches that contain a material.
#[derive(Debug, Serialize)]
struct InkJson {
    material: String,
    patches: usize,
    /// Mean difference of the patches, weighted by its share, over its standard error: beyond ± 3 they contradict it
    /// together.
    z: f64,
}

#[derive(Debug, Serialize)]
struct PatchColourJson {
    material: String,
    thickness_mm: f64,
    delta_e_2000: f64,
}

#[derive(Debug, Serialize)]
pub(crate) struct ValidateJson {
    /// Lamps and sensor of the prediction.
    geometry: &'static str,
    /// Channels of the media that are compared.
    channels: Vec<String>,
    /// Channels of the chart that the media lack.
    left_out: Vec<String>,
    patches: Vec<PatchJson>,
    chi2: f64,
    inks: Vec<InkJson>,
    /// Empty unless the channels are wavelengths that cover the visible range.
    colours: Vec<PatchColourJson>,
}

pub(crate) fn run(args: &ValidateArgs, output: &Output) -> Result<()> {
    args.figure.check(args.plot.as_deref())?;
    if is_chart(&args.chart) {
        return stacks::run(args, output);
    }
    let media = MediaFile::read(&args.media)?;
    let mixtures = args.mixtures.as_deref().map(read_mixtures).transpose()?;
    let chart = output.read_measurements(&args.chart)?;
    let data = validated(args, &media, mixtures.as_ref(), &chart)?;
    let point = |p: &PatchJson| ChartPoint {
        predicted: p.predicted,
        measured: p.measured,
        std_error: p.expected_std_error,
    };
    let points: Vec<ChartPoint> = data.patches.iter().map(point).collect();
    if let (Some(path), Some(picture)) = (&args.plot, chart_figure(&points)) {
        figure_files::write(&picture, path, args.figure.size()?)?;
    }
    output.answer("validate", &data, || [blocks(&data), figure_files::drawn(&args.plot)].concat())
}

/// A patch with all of its channels.
struct ChartPatch<'a> {
    material: &'a str,
    slab: NamedSlab,
    /// Channel, value and standard error.
    values: Vec<(&'a str, f64, f64)>,
}

fn validated(
    args: &ValidateArgs,
    media: &MediaFile,
    mixtures: Option<&Mixtures>,
    chart: &MeasurementFile,
) -> Result<ValidateJson> {
    for (field, value) in
        [("gain_std_error", args.gain_std_error), ("thickness_std_error", args.thickness_std_error)]
    {
        if !(0.0..=1.0).contains(&value) {
            bail!("--{} {value}: allowed are 0 to 1", field.replace('_', "-"));
        }
    }
    let of_each =
        chart.materials.iter().map(|m| of_material(m, media, mixtures)).collect::<Result<Vec<_>>>()?;
    let patches: Vec<ChartPatch> = of_each.into_iter().flatten().collect();
    let slabs: Vec<NamedSlab> = patches.iter().map(|patch| patch.slab.clone()).collect();
    let materials = materials_of(&slabs);
    let is_of_instrument = chart.notes.iter().any(|note| note.code == "CGATS");
    let usual = if is_of_instrument { Geometry::FortyFiveZero } else { Geometry::Session };
    let options = args.view.options_or(usual);
    let view = PrintView::new(media, &slabs, &[PrintBase::parsed(&args.over)?], &options)?;
    let (mut of_patches, mut colours) = (Vec::new(), Vec::new());
    for (number, patch) in patches.iter().enumerate() {
        let found = compared(args, &view, number, patch)?;
        colours.extend(colour(args, patch, &found));
        of_patches.push(found);
    }
    if of_patches.iter().all(Vec::is_empty) {
        bail!("the chart has no channel of the media: these have {}", view.names().join(", "));
    }
    let chi2 = chi2(&of_patches);
    let inks = materials.iter().map(|name| ink(name, &patches, &of_patches)).collect();
    let compared: BTreeSet<&str> = of_patches.iter().flatten().map(|p| p.channel.as_str()).collect();
    let channels = view.names().into_iter().filter(|name| compared.contains(name)).map(str::to_owned);
    let channels: Vec<String> = channels.collect();
    let measured = patches.iter().flat_map(|patch| &patch.values).map(|(channel, ..)| *channel);
    let left_out = left_out(measured, &channels);
    let patches = of_patches.into_iter().flatten().collect();
    Ok(ValidateJson { geometry: options.geometry.name(), channels, left_out, patches, chi2, inks, colours })
}

/// The patches of a material, by thickness.
fn of_material<'a>(
    measured: &'a Measurement,
    media: &MediaFile,
    mixtures: Option<&Mixtures>,
) -> Result<Vec<ChartPatch<'a>>> {
    let name = measured.material();
    let parts = mixtures.and_then(|mixtures| mixtures.all().iter().find(|m| m.material() == name));
    let shares: Vec<(String, f64)> = match parts {
        Some(mixture) => mixture.parts().iter().map(|p| (p.ink().to_owned(), p.volume_fraction())).collect(),
        None => vec![(name.to_owned(), 1.0)],
    };
    for (ink, _) in &shares {
        media
            .material(ink)
            .with_context(|| format!("patch {name:?}: neither measured nor a mixture (--mixtures)"))?;
    }
    let mut patches: Vec<ChartPatch> = Vec::new();
    for profile in measured.profiles() {
        let value = (profile.channel(), value_of(profile, name)?);
        let (channel, (value, error)) = value;
        let thickness_mm = profile.thickness_mm();
        match patches.iter_mut().find(|patch| patch.slab.thickness_mm == thickness_mm) {
            Some(patch) => patch.values.push((channel, value, error)),
            None => patches.push(ChartPatch {
                material: name,
                slab: NamedSlab { shares: shares.clone(), thickness_mm },
                values: vec![(channel, value, error)],
            }),
        }
    }
    Ok(patches)
}

/// Value and standard error of a patch, whose pixels all have its value.
fn value_of(profile: &MeasuredProfile, material: &str) -> Result<(f64, f64)> {
    let values = profile.values();
    let errors = profile.std_errors().filter(|_| values.iter().all(|v| *v == values[0]));
    let errors = errors.with_context(|| {
        format!(
            "{material} {}: it is a profile over an edge; a patch is one row without x_mm, with std_error",
            profile.channel()
        )
    })?;
    Ok((values[0], errors[0] / (values.len() as f64).sqrt()))
}

fn compared(
    args: &ValidateArgs,
    view: &PrintView,
    number: usize,
    patch: &ChartPatch,
) -> Result<Vec<PatchJson>> {
    let slab = &patch.slab;
    let thicker = NamedSlab { thickness_mm: slab.thickness_mm + args.thickness_std_error, ..slab.clone() };
    let found = view.predicted(std::slice::from_ref(slab))?;
    let [thin, thick] = [slab, &thicker].map(|slab| view.values(std::slice::from_ref(slab)));
    let (thin, thick) = (thin?, thick?);
    let names = view.names();
    // Each patch has an error of the model of its own.
    let own_model = |(key, change): (ErrorKey, f64)| match key {
        ErrorKey::Model { direction, .. } => (ErrorKey::Model { print: number, direction }, change),
        _ => (key, change),
    };
    let comparison = |at: usize| {
        let (value, error) = measured_at(names[at], &patch.values)?;
        let predicted = &found[at][0];
        let gain = (ErrorKey::Gain(number), args.gain_std_error * value);
        let thickness = (ErrorKey::Thickness(number), thick[at][0] - thin[at][0]);
        let parts = DifferenceParts {
            own: error,
            shared: [gain, thickness].into_iter().chain(changes(at, predicted).map(own_model)).collect(),
        };
        let expected = parts.std_error();
        Some(PatchJson {
            material: patch.material.to_owned(),
            thickness_mm: slab.thickness_mm,
            channel: names[at].to_owned(),
            measured: value,
            predicted: predicted.value,
            expected_std_error: expected,
            z: (value - predicted.value) / expected,
            parts,
        })
    };
    Ok((0..names.len()).filter_map(comparison).collect())
}

/// The difference of measured and predicted colour; None unless the channels are wavelengths of the visible range.
fn colour(args: &ValidateArgs, patch: &ChartPatch, found: &[PatchJson]) -> Option<PatchColourJson> {
    let mut spectrum: Vec<(f64, f64, f64)> = found
        .iter()
        .map(|p| Some((wavelength_nm(&p.channel)?, p.measured, p.predicted)))
        .collect::<Option<_>>()?;
    spectrum.sort_by(|a, b| a.0.total_cmp(&b.0));
    let nm: Vec<f64> = spectrum.iter().map(|(nm, ..)| *nm).collect();
    let colorimetry = Colorimetry::new(&nm, args.view.options().viewing).ok()?;
    let lab = |of: fn(&(f64, f64, f64)) -> f64| {
        colorimetry.colour(&spectrum.iter().map(of).collect::<Vec<_>>()).lab
    };
    Some(PatchColourJson {
        material: patch.material.to_owned(),
        thickness_mm: patch.slab.thickness_mm,
        delta_e_2000: delta_e_2000(lab(|p| p.1), lab(|p| p.2)),
    })
}

/// χ² of all values, dᵀ C⁻¹ d. Patches have errors of their own, C_p, and errors that they share, the columns of U; with
/// A = Σ Uᵀ C_p⁻¹ U and b = Σ Uᵀ C_p⁻¹ d it is Σ dᵀ C_p⁻¹ d − bᵀ (1 + A)⁻¹ b (Woodbury).
fn chi2(patches: &[Vec<PatchJson>]) -> f64 {
    let is_of_patch =
        |key: &ErrorKey| matches!(key, ErrorKey::Gain(_) | ErrorKey::Thickness(_) | ErrorKey::Model { .. });
    let all = patches.iter().flatten().flat_map(|p| &p.parts.shared).map(|(key, _)| *key);
    let columns: BTreeSet<ErrorKey> = all.filter(|key| !is_of_patch(key)).collect();
    let columns: BTreeMap<ErrorKey, usize> =
        columns.into_iter().enumerate().map(|(i, key)| (key, i)).collect();
    let mut information = DMatrix::identity(columns.len(), columns.len());
    let (mut pull, mut sum) = (DVector::zeros(columns.len()), 0.0);
    for patch in patches {
        let n = patch.len();
        let mut own = DMatrix::from_fn(n, n, |i, j| if i == j { patch[i].parts.own.powi(2) } else { 0.0 });
        let mut shared = DMatrix::zeros(n, columns.len());
        for (i, p) in patch.iter().enumerate() {
            for (key, change) in &p.parts.shared {
                if let Some(column) = columns.get(key) {
                    shared[(i, *column)] += change;
                    continue;
                }
                patch.iter().enumerate().for_each(|(j, other)| own[(i, j)] += change * other.parts.of(key));
            }
        }
        let Some(root) = own.cholesky() else { continue };
        let difference = DVector::from_iterator(n, patch.iter().map(|p| p.measured - p.predicted));
        let weighted = root.solve(&difference);
        sum += difference.dot(&weighted);
        pull += shared.tr_mul(&weighted);
        information += shared.tr_mul(&root.solve(&shared));
    }
    sum - information.cholesky().map_or(0.0, |root| pull.dot(&root.solve(&pull)))
}

/// The mean difference of the patches that contain a material.
fn ink(name: &str, patches: &[ChartPatch], found: &[Vec<PatchJson>]) -> InkJson {
    let (mut sum, mut variance, mut count) = (0.0, 0.0, 0);
    let mut shared: Vec<(ErrorKey, f64)> = Vec::new();
    for (patch, channels) in patches.iter().zip(found) {
        let Some((_, share)) = patch.slab.shares.iter().find(|(ink, _)| ink == name) else { continue };
        for p in channels {
            // Relative differences: bright and dark patches count alike.
            let weight = share / p.predicted.max(f64::MIN_POSITIVE);
            sum += weight * (p.measured - p.predicted);
            variance += (weight * p.parts.own).powi(2);
            shared.extend(p.parts.shared.iter().map(|(key, change)| (*key, weight * change)));
        }
        count += usize::from(!channels.is_empty());
    }
    let std_error = libm::hypot(sum_std_error(shared.into_iter()), variance.sqrt());
    InkJson { material: name.to_owned(), patches: count, z: sum / std_error.max(f64::MIN_POSITIVE) }
}

/// Deviation in standard errors that is marked.
const FAR: f64 = 3.0;

fn blocks(data: &ValidateJson) -> Vec<Block> {
    let row = |p: &PatchJson| {
        let mark = if p.z.abs() >= FAR { " !" } else { "" };
        let [predicted, expected] = to_error(p.predicted, p.expected_std_error, 2);
        vec![
            short(&p.material),
            p.thickness_mm.to_string(),
            p.channel.clone(),
            significant(p.measured, 4),
            predicted,
            expected,
            format!("{}{mark}", fixed(p.z, 1)),
        ]
    };
    let head = "patch | >mm | ch | >measured | >predicted | >± expected | >z";
    let (n, far) = (data.patches.len(), data.patches.iter().filter(|p| p.z.abs() >= FAR).count());
    let chi2 = significant(data.chi2, 3);
    let mut seen = format!("predicted for the geometry {}", data.geometry);
    if !data.left_out.is_empty() {
        seen += &format!("; the media have no channel for {} of the chart", data.left_out.join(", "));
    }
    let mut blocks = vec![
        ValueTable::new(head, data.patches.iter().map(row)).block(),
        Block::Paragraph(format!("χ² {chi2} of {n} values, {far} beyond {FAR} standard errors")),
        Block::Paragraph(seen),
    ];
    let off = data.inks.iter().filter(|ink| ink.z.abs() >= FAR).map(|ink| {
        let how = if ink.z > 0.0 { "brighter" } else { "darker" };
        format!("{} ({how} by {:.1} σ)", ink.material, ink.z.abs())
    });
    let off = off.collect::<Vec<_>>().join(", ");
    if !off.is_empty() {
        blocks.push(Block::Paragraph(format!("patches contradict: {off}")));
    }
    let mut colours: Vec<f64> = data.colours.iter().map(|c| c.delta_e_2000).collect();
    colours.sort_by(f64::total_cmp);
    if let Some(worst) = colours.last() {
        let [median, worst] = [colours[colours.len() / 2], *worst].map(|v| significant(v, 2));
        blocks.push(Block::Paragraph(format!("CIEDE2000: median {median}, greatest {worst}")));
    }
    blocks
}
