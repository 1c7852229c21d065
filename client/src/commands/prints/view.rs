//! How prints are seen: geometry, bases, illuminant and observer, and the prepared layers of each channel.

use std::sync::Arc;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use farm_lab::colour::{Illuminant, StandardObserver, Viewing};
use farm_lab::media_file::{MediaChannel, MediaFile, MediaMaterial};
use optics_layers::{Predicted, Print, Uncertain, predict};
use optics_model::{Invalid, Scene};
use rayon::prelude::*;
use serde::Serialize;

use super::geometry::Geometry;
use super::slabs::NamedSlab;

#[derive(Debug, Clone, Args)]
pub(crate) struct ViewArgs {
    /// Lamps and sensor.
    #[arg(long, value_enum, default_value = "session")]
    pub(super) geometry: Geometry,
    /// GGX roughness of a bare print's faces; 0 is polished [default: that of the measured samples].
    #[arg(long, value_name = "ALPHA", allow_negative_numbers = true)]
    roughness: Option<f64>,
    /// Illuminant of colours, for channels that are wavelengths.
    #[arg(long, value_enum, default_value = "d50")]
    illuminant: IlluminantArg,
    /// Observer of colours: 2 or 10 degrees.
    #[arg(long, value_enum, default_value = "2")]
    observer: ObserverArg,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum IlluminantArg {
    D50,
    D65,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ObserverArg {
    #[value(name = "2")]
    Two,
    #[value(name = "10")]
    Ten,
}

impl ViewArgs {
    pub(super) fn viewing(&self) -> Viewing {
        let illuminant = match self.illuminant {
            IlluminantArg::D50 => Illuminant::D50,
            IlluminantArg::D65 => Illuminant::D65,
        };
        let observer = match self.observer {
            ObserverArg::Two => StandardObserver::TwoDegrees,
            ObserverArg::Ten => StandardObserver::TenDegrees,
        };
        Viewing { illuminant, observer }
    }
}

/// Reflectances of the bases called black and white: of usual backings (ISO 13655 asks for matt, neutral ones).
const BASES: [(&str, f64); 2] = [("black", 0.03), ("white", 0.9)];

/// A base under a print.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub(super) struct PrintBase {
    pub name: String,
    #[serde(skip)]
    kind: BaseKind,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum BaseKind {
    Neutral(f64),
    /// A side of the board of the measurement.
    Light,
    Dark,
}

impl PrintBase {
    pub(super) fn parsed(text: &str) -> Result<Self, Invalid> {
        let named = BASES.iter().find(|(name, _)| *name == text).map(|(_, rho)| BaseKind::Neutral(*rho));
        let number = || text.parse().ok().filter(|rho| (0.0..=1.0).contains(rho)).map(BaseKind::Neutral);
        let kind = match text {
            "light" => BaseKind::Light,
            "dark" => BaseKind::Dark,
            _ => named.or_else(number).ok_or_else(|| {
                let allowed = "allowed are black (0.03), white (0.9), reflectances from 0 to 1, and light and dark, the \
                               sides of the measured board";
                Invalid::new("over", text, allowed)
            })?,
        };
        Ok(Self { name: text.to_owned(), kind })
    }

    /// Its reflectance in a channel.
    fn rho(&self, session: &Scene, channel: &str) -> Result<f64> {
        let side = || {
            let found = session.channels().iter().find(|c| c.name() == channel);
            found.with_context(|| format!("the scene of the media file has no board in channel {channel}"))
        };
        Ok(match self.kind {
            BaseKind::Neutral(rho) => rho,
            BaseKind::Light => side()?.rho_light(),
            BaseKind::Dark => side()?.rho_dark(),
        })
    }
}

/// One channel, ready for predictions.
#[derive(Debug)]
struct ViewedChannel {
    name: String,
    print: Arc<Print>,
    /// Reflectances of the bases.
    rho: Vec<f64>,
    /// By material of the file; None if it has no medium in this channel.
    media: Vec<Option<Uncertain>>,
}

/// The channels of some materials over bases.
#[derive(Debug)]
pub(super) struct PrintView<'a> {
    file: &'a MediaFile,
    channels: Vec<ViewedChannel>,
}

impl<'a> PrintView<'a> {
    /// The channels that all of these materials have.
    pub(super) fn new(
        file: &'a MediaFile,
        materials: &[&str],
        bases: &[PrintBase],
        args: &ViewArgs,
    ) -> Result<Self> {
        let session = Scene::try_from(file.scene.clone()).context("the scene of the media file")?;
        let all = materials.iter().map(|name| file.material(name)).collect::<Result<Vec<_>>>()?;
        let first = all.first().context("a print has at least one slab")?;
        let names = first.channels.iter().filter(|c| all.iter().all(|m| m.channel(&c.channel).is_some()));
        let mut peak = f64::INFINITY;
        for material in &all {
            for channel in &material.channels {
                peak = narrowest_peak(&material.material, channel)?.min(peak);
            }
        }
        let mut prints: Vec<(Scene, f64, Arc<Print>)> = Vec::new();
        let mut channel = |c: &MediaChannel| -> Result<ViewedChannel> {
            let name = c.channel.clone();
            let scene = args.geometry.scene(&session, &name, args.roughness)?;
            let sample_ior = common_ior(&all, &name)? + scene.sample_ior_offset();
            let known = prints.iter().find(|(s, ior, _)| s.layers() == scene.layers() && *ior == sample_ior);
            let print = known.map(|(.., print)| print.clone());
            let print = print.unwrap_or_else(|| Arc::new(Print::new(&scene, sample_ior, peak)));
            prints.push((scene, sample_ior, print.clone()));
            let medium = |m: &MediaMaterial| -> Result<Option<Uncertain>> {
                let Some(found) = m.channel(&name) else { return Ok(None) };
                let (medium, second_lobe) = (found.medium()?, found.second_lobe()?);
                Ok(Some(Uncertain { medium, second_lobe, covariance: found.covariance }))
            };
            Ok(ViewedChannel {
                print,
                rho: bases.iter().map(|base| base.rho(&session, &name)).collect::<Result<_>>()?,
                media: file.materials.iter().map(medium).collect::<Result<_>>()?,
                name,
            })
        };
        let channels = names.map(&mut channel).collect::<Result<Vec<_>>>()?;
        if channels.is_empty() {
            bail!("no channel has a medium of {}", materials.join(" and "));
        }
        Ok(Self { file, channels })
    }

    /// Index of a material, as in the changes of predictions.
    pub(super) fn number(&self, material: &str) -> Option<usize> {
        self.file.materials.iter().position(|m| m.material == material)
    }

    pub(super) fn names(&self) -> Vec<&str> {
        self.channels.iter().map(|c| c.name.as_str()).collect()
    }

    /// Radiance factors of a print, by channel and base.
    pub(super) fn predicted(&self, slabs: &[NamedSlab]) -> Result<Vec<Vec<Predicted>>> {
        self.each(|channel, media| Ok(predict(&channel.print, media, &self.printed(slabs)?, &channel.rho)?))
    }

    /// Radiance factors without standard errors, which takes a seventh of the time with one material.
    pub(super) fn values(&self, slabs: &[NamedSlab]) -> Result<Vec<Vec<f64>>> {
        let exact = |media: &[Uncertain]| -> Vec<Uncertain> {
            media.iter().map(|medium| Uncertain { covariance: [[0.0; 3]; 3], ..*medium }).collect()
        };
        let found = self.each(|channel, media| {
            Ok(predict(&channel.print, &exact(media), &self.printed(slabs)?, &channel.rho)?)
        })?;
        Ok(found.iter().map(|of| of.iter().map(|p| p.value).collect()).collect())
    }

    fn each<T: Send>(&self, f: impl Fn(&ViewedChannel, &[Uncertain]) -> Result<T> + Sync) -> Result<Vec<T>> {
        let one = |channel: &ViewedChannel| {
            // Materials without a medium are not those of the slabs.
            let some = channel.media.iter().flatten().next().context("a channel has media")?;
            let media: Vec<Uncertain> = channel.media.iter().map(|m| m.unwrap_or(*some)).collect();
            f(channel, &media)
        };
        self.channels.par_iter().map(one).collect()
    }

    /// The slabs with the materials' numbers.
    fn printed(&self, slabs: &[NamedSlab]) -> Result<Vec<optics_layers::PrintedSlab>> {
        let number =
            |name: &str| self.number(name).with_context(|| format!("material {name:?} is not in the file"));
        let slab = |slab: &NamedSlab| -> Result<optics_layers::PrintedSlab> {
            let shares = slab.shares.iter().map(|(name, share)| Ok((number(name)?, *share)));
            Ok(optics_layers::PrintedSlab {
                shares: shares.collect::<Result<_>>()?,
                thickness_mm: slab.thickness_mm,
            })
        };
        slabs.iter().map(slab).collect()
    }
}

/// The index of all materials in a channel. A print of media that were measured at several indices is refused: it has
/// faces between its slabs, which predictions do not have.
fn common_ior(materials: &[&MediaMaterial], channel: &str) -> Result<f64> {
    let of = |m: &&MediaMaterial| Some((m.material.clone(), m.channel(channel)?.sample_ior));
    let mut iors = materials.iter().filter_map(of);
    let (first, ior) = iors.next().context("a print has at least one medium")?;
    if let Some((other, own)) = iors.find(|(_, own)| *own != ior) {
        bail!(
            "{channel}: {first} was measured with the index {ior}, {other} with {own}; a print has one: measure them with a \
             dictionary of one sample_ior"
        );
    }
    Ok(ior)
}

/// Width of the narrowest peak of a phase function: 1 − |g| of a lobe. Narrower ones than directions resolve are refused.
pub(super) fn narrowest_peak(material: &str, channel: &MediaChannel) -> Result<f64> {
    let second = channel.second_lobe()?.limited_to(channel.g);
    let of_second = if second.weight() > 0.0 { second.g().abs() } else { 0.0 };
    let most = second.first(channel.g).abs().max(of_second);
    if most > Print::MOST_G {
        let (name, allowed) = (&channel.channel, Print::MOST_G);
        bail!("{material} {name}: a lobe of |g| = {most:.3}; predictions resolve up to {allowed}");
    }
    Ok(1.0 - most)
}

/// The materials of slabs, each once.
pub(super) fn materials_of(slabs: &[NamedSlab]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in slabs.iter().flat_map(|slab| &slab.shares) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    names
}

/// Materials that the measurement does not determine, with their channels.
pub(super) fn unresolved(file: &MediaFile, materials: &[&str], channels: &[&str]) -> Result<Vec<String>> {
    let mut all = Vec::new();
    for name in materials {
        let material = file.material(name)?;
        let open = channels.iter().filter(|c| material.channel(c).is_some_and(|found| !found.resolved));
        all.extend(open.map(|channel| format!("{name} {channel}")));
    }
    Ok(all)
}
