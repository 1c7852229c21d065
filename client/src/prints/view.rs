//! How prints are seen: geometry, bases, illuminant and observer, and the prepared layers of each channel.

use std::collections::BTreeSet;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use farm_lab::colour::Viewing;
use farm_lab::media_file::{MediaChannel, MediaFile, MediaMaterial};
use optics_layers::{Predicted, Print, SetUpChange, Stacks, Uncertain, predict, radiance_factors};
use optics_model::Scene;
use optics_model::phase::SecondLobe;
use rayon::prelude::*;

use super::bases::PrintBase;
use super::geometry::Geometry;
use super::model_error::ModelError;
use super::prepared::{Prints, looks_different};
use super::set_up::{ChangedSetUp, FoundSetUp};
use farm_lab::slabs::NamedSlab;

/// How a print is seen.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ViewOptions {
    pub geometry: Geometry,
    /// Roughness of the faces of a bare print; None for that of the measured samples.
    pub roughness: Option<f64>,
    pub viewing: Viewing,
}

impl ViewOptions {
    /// The scene of a print, given that of the measurement.
    fn seen(&self, session: Scene) -> Result<Scene> {
        self.geometry.scene(session, self.roughness)
    }

    /// The errors of the set-up that change how a print looks, or its base.
    fn changes(
        &self,
        set_up: &FoundSetUp,
        bases: &[PrintBase],
        channel: &str,
        ior: f64,
        prints: &mut Prints,
    ) -> Result<Vec<ViewedChange>> {
        let rho = |scene: &Scene| PrintBase::all_rho(bases, set_up, channel, scene);
        let found = set_up.scene(channel)?;
        let (found_rho, found) = (rho(&found)?, self.seen(found)?);
        let mut changes = Vec::new();
        for changed in set_up.changed(channel) {
            let scene = set_up.changed_scene(&changed, channel)?;
            let (to_rho, to) = (rho(&scene)?, self.seen(scene)?);
            let rho_by: Vec<f64> = to_rho.iter().zip(&found_rho).map(|(to, from)| to - from).collect();
            if looks_different(&to, &found) || rho_by.iter().any(|by| *by != 0.0) {
                let (from, to) = (prints.of(&found, ior), prints.of(&to, ior));
                changes.push(ViewedChange { from, to, rho_by, changed });
            }
        }
        Ok(changes)
    }
}

/// One channel, ready for predictions.
#[derive(Debug)]
struct ViewedChannel {
    name: String,
    print: Arc<Print>,
    /// The print for standard errors.
    slopes: Arc<Print>,
    /// Reflectances of the bases.
    rho: Vec<f64>,
    /// By material of the file; None if it has no medium in this channel.
    media: Vec<Option<Uncertain>>,
}

/// Prints before and after a change of the set-up, for all channels: errors of an index hardly depend on the index.
#[derive(Debug)]
struct ViewedChange {
    from: Arc<Print>,
    to: Arc<Print>,
    /// Changes of the bases' reflectances: the board looks as photographed through another coat.
    rho_by: Vec<f64>,
    changed: ChangedSetUp,
}

/// The channels of some materials over bases.
#[derive(Debug)]
pub(crate) struct PrintView<'a> {
    file: &'a MediaFile,
    set_up: FoundSetUp,
    channels: Vec<ViewedChannel>,
    changes: Vec<ViewedChange>,
}

impl<'a> PrintView<'a> {
    /// The channels that all materials of these slabs have. What the set-up of each material has separately is averaged over
    /// the volume of the slabs.
    pub(crate) fn new(
        file: &'a MediaFile,
        slabs: &[NamedSlab],
        bases: &[PrintBase],
        args: &ViewOptions,
    ) -> Result<Self> {
        let materials = materials_of(slabs);
        let all = materials.iter().map(|name| file.material(name)).collect::<Result<Vec<_>>>()?;
        let first = all.first().context("a print has at least one slab")?;
        let is_common = |c: &&MediaChannel| all.iter().all(|m| m.channel(&c.channel).is_some());
        let names: Vec<&str> = first.channels.iter().filter(is_common).map(|c| c.channel.as_str()).collect();
        let Some(middle) = names.get(names.len() / 2) else {
            bail!("no channel has a medium of {}", materials.join(" and "));
        };
        let mut peak = f64::INFINITY;
        for (material, channel) in all.iter().flat_map(|m| m.channels.iter().map(|c| (&m.material, c))) {
            peak = narrowest_peak(material, channel)?.min(peak);
        }
        let set_up = FoundSetUp::new(file, slabs)?;
        let [mut prints, mut slopes] = [Prints::new(peak), Prints::for_slopes(peak)];
        let changes = args.changes(&set_up, bases, middle, common_ior(&all, middle)?, &mut slopes)?;
        let mut channel = |name: &&str| -> Result<ViewedChannel> {
            let scene = set_up.scene(name)?;
            let medium =
                |m: &MediaMaterial| m.channel(name).map(|c| uncertain(c, set_up.assumed())).transpose();
            let rho = PrintBase::all_rho(bases, &set_up, name, &scene)?;
            let rho: Vec<f64> = rho.into_iter().map(|rho| rho.clamp(0.0, 1.0)).collect();
            let (seen, ior) = (args.seen(scene)?, common_ior(&all, name)?);
            Ok(ViewedChannel {
                print: prints.of(&seen, ior),
                slopes: slopes.of(&seen, ior),
                media: file.materials.iter().map(medium).collect::<Result<_>>()?,
                name: (*name).to_owned(),
                rho,
            })
        };
        let channels = names.iter().map(&mut channel).collect::<Result<_>>()?;
        Ok(Self { file, set_up, channels, changes })
    }

    pub(crate) fn names(&self) -> Vec<&str> {
        self.channels.iter().map(|c| c.name.as_str()).collect()
    }

    /// Radiance factors of a print, by channel and base.
    pub(crate) fn predicted(&self, slabs: &[NamedSlab]) -> Result<Vec<Vec<Predicted>>> {
        let mut found = self.each(|channel, media| {
            let steps = |c: &ViewedChange| {
                let to_rho: Vec<f64> = channel.rho.iter().zip(&c.rho_by).map(|(rho, by)| rho + by).collect();
                (to_rho, self.set_up.steps(&c.changed, &channel.name, slabs))
            };
            let steps: Vec<_> = self.changes.iter().map(steps).collect();
            let all = self.changes.iter().zip(&steps);
            let changes: Vec<SetUpChange> = all
                .map(|(c, (to_rho, (offset, shared)))| SetUpChange {
                    from: &c.from,
                    to: &c.to,
                    to_rho,
                    offset: *offset,
                    shared,
                })
                .collect();
            let slabs = self.printed(slabs)?;
            Ok(predict(&channel.print, &channel.slopes, media, &changes, &slabs, &channel.rho)?)
        })?;
        if let Some(error) = ModelError::new(self.file, &self.names()) {
            error.add(slabs, &mut found);
        }
        Ok(found)
    }

    /// Radiance factors without their errors, which take most of the time, in the set-up of the view's own slabs.
    pub(crate) fn values(&self, slabs: &[NamedSlab]) -> Result<Vec<Vec<f64>>> {
        self.each(|channel, media| {
            Ok(radiance_factors(&channel.print, media, &self.printed(slabs)?, &channel.rho)?)
        })
    }

    /// Radiance factors of many stacks of materials, each over one of the bases, by stack and channel.
    pub(crate) fn stacks(&self, all: &[(&[NamedSlab], usize)]) -> Result<Vec<Vec<f64>>> {
        // Materials by their places in the file, of which few occur.
        let names: BTreeSet<&str> = all.iter().flat_map(|(slabs, _)| materials_of(slabs)).collect();
        let is_used = |medium: &usize| names.contains(self.file.materials[*medium].material.as_str());
        let used: Vec<usize> = (0..self.file.materials.len()).filter(is_used).collect();
        let slab = |slab: &NamedSlab| {
            let name = &slab.shares[0].0;
            let medium = used.iter().position(|medium| self.file.materials[*medium].material == *name);
            medium.map(|medium| (medium, slab.thickness_mm)).context("a material is in the file")
        };
        let stack = |(slabs, _): &(&[NamedSlab], usize)| slabs.iter().map(slab).collect::<Result<Vec<_>>>();
        let tree: Vec<Vec<(usize, f64)>> = all.iter().map(stack).collect::<Result<_>>()?;
        let tree = Stacks::new(tree.iter().map(Vec::as_slice));
        let by_channel = self.each(|channel, media| {
            let levels = tree.levels(&channel.print, |medium, mm| media[used[medium]].slab(mm));
            Ok(levels
                .seen
                .iter()
                .zip(all)
                .map(|(seen, (_, base))| seen.at(channel.rho[*base]))
                .collect::<Vec<_>>())
        })?;
        Ok((0..all.len()).map(|i| by_channel.iter().map(|values| values[i]).collect()).collect())
    }

    fn each<T: Send>(&self, f: impl Fn(&ViewedChannel, &[Uncertain]) -> Result<T> + Sync) -> Result<Vec<T>> {
        let one = |channel: &ViewedChannel| {
            // Materials without a medium are not those of the slabs.
            let some = channel.media.iter().flatten().next().context("a channel has media")?;
            let media: Vec<Uncertain> =
                channel.media.iter().map(|m| m.as_ref().unwrap_or(some).clone()).collect();
            f(channel, &media)
        };
        self.channels.par_iter().map(one).collect()
    }

    /// The slabs with the materials' numbers.
    fn printed(&self, slabs: &[NamedSlab]) -> Result<Vec<optics_layers::PrintedSlab>> {
        let number = |name: &str| {
            let found = self.file.materials.iter().position(|m| m.material == name);
            found.with_context(|| format!("material {name:?} is not in the file"))
        };
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

/// A medium with its errors. A second lobe without weight has the anisotropy of the scene's.
pub(crate) fn uncertain(channel: &MediaChannel, assumed: &Scene) -> Result<Uncertain> {
    let of_scene = assumed.phase().second_lobe().map_or(0.0, SecondLobe::g);
    let none = SecondLobe::new(0.0, of_scene)?;
    Ok(Uncertain {
        medium: channel.medium()?,
        second_lobe: if channel.second_lobe.is_some() { channel.second_lobe()? } else { none },
        covariance: channel.covariance,
        shared: channel.shared.clone(),
    })
}

/// The index of all materials in a channel. A print of media that were measured at several indices is refused: it has
/// faces between its slabs, which predictions do not have.
fn common_ior(materials: &[&MediaMaterial], channel: &str) -> Result<f64> {
    let named_ior = |m: &&MediaMaterial| Some((m.material.clone(), m.channel(channel)?.sample_ior));
    let mut iors = materials.iter().filter_map(named_ior);
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
pub(crate) fn narrowest_peak(material: &str, channel: &MediaChannel) -> Result<f64> {
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
pub(crate) fn materials_of(slabs: &[NamedSlab]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in slabs.iter().flat_map(|slab| &slab.shares) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    names
}

/// Materials that the measurement does not determine, with their channels.
pub(crate) fn unresolved(file: &MediaFile, materials: &[&str], channels: &[&str]) -> Result<Vec<String>> {
    let mut all = Vec::new();
    for name in materials {
        let material = file.material(name)?;
        let open = channels.iter().filter(|c| material.channel(c).is_some_and(|found| !found.resolved));
        all.extend(open.map(|channel| format!("{name} {channel}")));
    }
    Ok(all)
}
