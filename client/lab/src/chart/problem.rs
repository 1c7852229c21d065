//! A chart's file as the numerics take it: numbers for names, views for geometries, and media of an earlier measurement as
//! the prior.

use anyhow::{Context, Result, bail};
use nalgebra::{DMatrix, DVector};
use optics_chart::{Chart, ChartCamera, ChartView, LOW_ABSORPTION, MediaPrior, StackPatch};
use std::path::Path;

use super::file::ChartFile;
use super::patch::{NamedPatch, REST};
use super::settings::PatchGeometry;
use crate::media_file::{MediaChannel, MediaFile};

/// Fewest patches with places from which the light of photographs is estimated.
const LIT: usize = 60;
/// Standard error of values where the table does not say it.
const ASSUMED_ERROR: f64 = 0.003;
/// Reflectances of bases called black and white: of usual backings (ISO 13655 asks for matt, neutral ones).
pub const NAMED_BASES: [(&str, f64); 2] = [("black", 0.03), ("white", 0.9)];
/// Variances of both coordinates of a medium that no earlier measurement has, and of ln(1 − g).
const UNKNOWN: [f64; 2] = [2.25, 9.0];

/// A chart with the names that its numbers stand for.
#[derive(Debug)]
pub(super) struct NamedChart {
    pub chart: Chart,
    pub materials: Vec<String>,
    pub bases: Vec<String>,
    /// Names of photographs.
    pub photos: Vec<String>,
    /// Media of the prior, by channel and material.
    pub before: Option<BeforeMedia>,
}

/// Media of an earlier measurement: mean and covariance of both coordinates of a medium and of ln(1 − g), three numbers by
/// channel and material.
#[derive(Debug)]
pub(super) struct BeforeMedia {
    pub mean: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

impl NamedChart {
    pub fn new(file: &ChartFile, order: impl Fn(&NamedPatch) -> Vec<(String, f64)>) -> Result<Self> {
        let settings = &file.settings;
        let materials = file.materials();
        let (mut bases, mut geometries, mut photos): (Vec<String>, Vec<PatchGeometry>, Vec<String>) =
            Default::default();
        let places = file.patches.iter().filter(|patch| patch.place.is_some()).count();
        let light = settings.light && places >= LIT && places == file.patches.len();
        let mut patches = Vec::new();
        for patch in &file.patches {
            let geometry = patch.geometry.unwrap_or(settings.geometry);
            let place = patch.place.as_ref().map(|place| {
                let on_photo = || {
                    file.patches.iter().filter_map(|p| p.place.as_ref()).filter(|p| p.photo == place.photo)
                };
                let within = |own: f64, all: &dyn Fn() -> Vec<f64>| {
                    let (low, high) = all().into_iter().fold((own, own), |(a, b), v| (a.min(v), b.max(v)));
                    if high > low { 2.0 * (own - low) / (high - low) - 1.0 } else { 0.0 }
                };
                let x = within(place.column, &|| on_photo().map(|p| p.column).collect());
                let y = within(place.row, &|| on_photo().map(|p| p.row).collect());
                (number(&mut photos, &place.photo), [x, y])
            });
            let slab =
                |(name, mm): (String, f64)| (materials.iter().position(|m| *m == name).unwrap_or(0), mm);
            patches.push(StackPatch {
                slabs: order(patch).into_iter().map(slab).collect(),
                view: number(&mut geometries, &geometry),
                base: number(&mut bases, &patch.base),
                values: patch.values.clone(),
                std_errors: patch
                    .std_errors
                    .iter()
                    .map(|e| if *e > 0.0 { *e } else { ASSUMED_ERROR })
                    .collect(),
                place: place.filter(|_| light),
            });
        }
        let view = |geometry: &PatchGeometry| {
            Ok(ChartView {
                scene: geometry.scene()?,
                transmitted: *geometry == PatchGeometry::Transmission,
                has_sheen: *geometry == PatchGeometry::FortyFiveZero,
            })
        };
        let before = settings.media.as_ref().map(|media| {
            let media = MediaFile::read(&settings.place(media))?;
            BeforeMedia::new(&media, &materials, &file.channels, settings.g)
        });
        let before = before.transpose()?;
        let g = |material: usize| {
            before.as_ref().map_or(settings.g, |before| 1.0 - libm::exp(before.mean[3 * material + 2]))
        };
        let chart = Chart {
            channels: file.channels.len(),
            views: geometries.iter().map(view).collect::<Result<_>>()?,
            bases: bases.iter().map(|base| reflectances(file, base)).collect::<Result<_>>()?,
            patches,
            camera: camera(file)?,
            g: (0..materials.len()).map(g).collect(),
            thickness: settings.thickness_std_error,
            ior: [settings.sample_ior, settings.sample_ior_std_error],
            prior: before.as_ref().map(BeforeMedia::prior),
            light,
            materials: materials.len(),
        };
        Ok(Self { chart, materials, bases, photos, before })
    }
}

/// The slabs of a stack from the top.
pub(super) fn downwards(patch: &NamedPatch) -> Vec<(String, f64)> {
    patch.slabs.iter().map(|slab| (slab.shares[0].0.clone(), slab.thickness_mm)).collect()
}

/// The stack upside down on the same base, the lowest slab.
pub(super) fn upwards(patch: &NamedPatch) -> Vec<(String, f64)> {
    let mut slabs = downwards(patch);
    let printed = slabs.len().saturating_sub(1);
    slabs[..printed].reverse();
    slabs
}

/// The number of an entry, which is added if it is new.
fn number<T: PartialEq + Clone>(all: &mut Vec<T>, own: &T) -> usize {
    all.iter().position(|known| known == own).unwrap_or_else(|| {
        all.push(own.clone());
        all.len() - 1
    })
}

/// Reflectances of a base by channel.
fn reflectances(file: &ChartFile, base: &str) -> Result<Vec<Option<f64>>> {
    let known =
        NAMED_BASES.iter().find(|(name, _)| *name == base).map(|(_, rho)| *rho).or_else(|| base.parse().ok());
    if let Some(rho) = known {
        if !(0.0..=0.99).contains(&rho) {
            bail!("base = {base} is not valid: allowed are 0 to 0.99, and names");
        }
        return Ok(vec![Some(rho); file.channels.len()]);
    }
    let given = |channel: &String| {
        let given = (base == REST).then_some(&file.settings.base);
        given.and_then(|rho| rho.get(channel).or_else(|| rho.get("all")).copied())
    };
    let other = file.settings.base.keys().find(|name| *name != "all" && !file.channels.contains(name));
    if let Some(other) = other {
        bail!(
            "base.{other} is not known: the chart has the channels {}, and base.all is for all",
            file.channels.join(", ")
        );
    }
    Ok(file.channels.iter().map(given).collect())
}

/// The camera of a chart of colours.
fn camera(file: &ChartFile) -> Result<Option<ChartCamera>> {
    const SAME: optics_chart::Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    if !file.is_colour {
        return Ok(None);
    }
    Ok(Some(match file.settings.matrix.as_str() {
        "free" => ChartCamera::Free,
        "none" => ChartCamera::Held(SAME),
        path => {
            let media = MediaFile::read(&file.settings.place(Path::new(path)))?;
            let matrix = media.chart.and_then(|chart| chart.matrix);
            ChartCamera::Held(
                matrix
                    .with_context(|| format!("matrix = {path:?}: these media have no matrix of a camera"))?,
            )
        }
    }))
}

impl BeforeMedia {
    fn new(file: &MediaFile, materials: &[String], channels: &[String], g: f64) -> Result<Self> {
        let mut mean = DVector::zeros(3 * materials.len() * channels.len());
        let mut covariance = DMatrix::zeros(mean.len(), mean.len());
        let sources =
            file.materials.iter().flat_map(|m| &m.channels).map(|c| c.shared.len()).max().unwrap_or(0);
        let mut columns = DMatrix::zeros(mean.len(), sources);
        if !materials.iter().any(|name| file.material(name).is_ok()) {
            bail!("media: none of the chart's materials {} is in that file", materials.join(", "));
        }
        for (c, channel) in channels.iter().enumerate() {
            for (m, material) in materials.iter().enumerate() {
                let first = 3 * (c * materials.len() + m);
                let known = file.material(material).ok().and_then(|found| found.channel(channel));
                let Some(known) = known else {
                    mean[first] = libm::log(6.0);
                    mean[first + 2] = libm::log(1.0 - g);
                    for (i, variance) in UNKNOWN.into_iter().chain([0.25]).enumerate() {
                        covariance[(first + i, first + i)] = variance;
                    }
                    continue;
                };
                let (own, jacobian) = coordinates(known);
                mean.rows_mut(first, 3).copy_from_slice(&own);
                let all = DMatrix::from_fn(3, 3, |i, j| known.covariance[i][j]);
                let shared = DMatrix::from_fn(3, known.shared.len(), |i, k| known.shared[k][i]);
                let rest = &jacobian * (all - &shared * shared.transpose()) * jacobian.transpose();
                covariance.view_mut((first, first), (3, 3)).copy_from(&rest);
                columns.view_mut((first, 0), (3, shared.ncols())).copy_from(&(&jacobian * &shared));
            }
        }
        covariance += &columns * columns.transpose();
        // Held numbers have no variance.
        (0..mean.len()).for_each(|i| covariance[(i, i)] += 1e-8);
        Ok(Self { mean, covariance })
    }

    /// Places of the two coordinates that a chart determines.
    pub fn determined(&self) -> Vec<usize> {
        (0..self.mean.len()).filter(|i| i % 3 < 2).collect()
    }

    fn prior(&self) -> MediaPrior {
        let known = self.determined();
        MediaPrior {
            mean: DVector::from_fn(known.len(), |i, _| self.mean[known[i]]),
            covariance: DMatrix::from_fn(known.len(), known.len(), |i, j| {
                self.covariance[(known[i], known[j])]
            }),
        }
    }
}

/// ln σ_s(1 − g), arsinh(σ_a/a) and ln(1 − g) of a medium, and their slopes in ln σ_t, √(1 − α) and ln(1 − g).
fn coordinates(c: &MediaChannel) -> ([f64; 3], DMatrix<f64>) {
    // Where nothing is absorbed, slopes are those at one standard error.
    let root = (1.0 - c.albedo).max(c.covariance[1][1]).max(1e-10).sqrt();
    let [absorption, seen] = [1.0 - c.albedo, root * root].map(|share| c.sigma_t_per_mm * share);
    let ln_scattering = libm::log(c.sigma_t_per_mm * c.albedo.max(1e-9) * (1.0 - c.g));
    let by_absorption = seen / libm::hypot(seen, LOW_ABSORPTION);
    #[rustfmt::skip]
    let slopes = DMatrix::from_row_slice(3, 3, &[
        1.0, -2.0 * root / c.albedo.max(1e-9), 1.0,
        by_absorption, 2.0 * by_absorption / root, 0.0,
        0.0, 0.0, 1.0,
    ]);
    ([ln_scattering, libm::asinh(absorption / LOW_ABSORPTION), libm::log(1.0 - c.g)], slopes)
}
