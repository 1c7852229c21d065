//! The set-up of a print as the measurement found it: the scene of each channel, and scenes with a quantity changed, for
//! the errors of predictions and for prints of other materials.

use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, bail};
use farm_lab::media_file::{MediaFile, MediaSetUp, quantity_names};
use optics_model::Scene;
use optics_model::scene::{Channel, Prior, PriorKind};
use optics_tracer::BareBoard;

use farm_lab::slabs::NamedSlab;

/// The scene of the measurement with its quantities as found.
#[derive(Debug)]
pub(crate) struct FoundSetUp {
    /// As the measurement assumed it.
    assumed: Scene,
    /// Estimates, each with the index of its prior.
    estimates: Vec<(usize, MediaSetUp)>,
    /// Quantities of each material are averaged over the volume of these.
    slabs: Vec<NamedSlab>,
    boards: Mutex<Vec<(Scene, BareBoard)>>,
}

/// The estimate of a quantity for a print, and its changes by source of errors.
#[derive(Debug, Clone, Default)]
struct FoundQuantity {
    difference: f64,
    shared: Vec<f64>,
}

/// A quantity at a value one step away from its estimate.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ChangedSetUp {
    quantity: usize,
    step: f64,
}

impl FoundSetUp {
    pub(crate) fn new(file: &MediaFile, slabs: &[NamedSlab]) -> Result<Self> {
        let assumed = Scene::try_from(file.scene.clone()).context("the scene of the media file")?;
        let names = quantity_names(&assumed);
        let mut estimates: Vec<(usize, MediaSetUp)> = Vec::new();
        for found in &file.set_up {
            let name = &found.quantity;
            let quantity = names.iter().position(|known| known == name).with_context(|| {
                format!("set_up {name:?} of the media file is not uncertain in its scene")
            })?;
            let key = |s: &MediaSetUp| (s.material.clone(), s.channel.clone());
            if estimates.iter().any(|(other, known)| *other == quantity && key(known) == key(found)) {
                bail!("set_up {name:?} of the media file occurs twice");
            }
            estimates.push((quantity, found.clone()));
        }
        Ok(Self { assumed, estimates, slabs: slabs.to_vec(), boards: Mutex::default() })
    }

    /// The scene as the measurement assumed it.
    pub(crate) fn assumed(&self) -> &Scene {
        &self.assumed
    }

    /// The scene in a channel, as found; its ρ are not used.
    pub(crate) fn scene(&self, channel: &str) -> Result<Scene> {
        self.scene_with(channel, &self.differences(channel))
    }

    /// The scene with a quantity changed by its step.
    pub(crate) fn changed_scene(&self, changed: &ChangedSetUp, channel: &str) -> Result<Scene> {
        let mut differences = self.differences(channel);
        differences[changed.quantity] += changed.step;
        self.scene_with(channel, &differences)
    }

    /// A change of each quantity with errors: one standard error, or its negative if larger values are impossible.
    pub(crate) fn changed(&self, channel: &str) -> Vec<ChangedSetUp> {
        let changed = |quantity: usize| {
            let own = self.estimates.iter().filter(|(of, _)| *of == quantity);
            let error = own.map(|(_, s)| norm(&s.shared)).fold(0.0, f64::max);
            let steps = [error, -error].map(|step| ChangedSetUp { quantity, step });
            steps.into_iter().find(|c| c.step != 0.0 && self.changed_scene(c, channel).is_ok())
        };
        (0..self.assumed.priors().len()).filter_map(changed).collect()
    }

    /// For a print of these slabs, in steps: the difference of a quantity from that of the scene, and its changes by source.
    pub(crate) fn steps(
        &self,
        changed: &ChangedSetUp,
        channel: &str,
        slabs: &[NamedSlab],
    ) -> (f64, Vec<f64>) {
        let own = self.estimate(changed.quantity, channel, slabs);
        let average = self.estimate(changed.quantity, channel, &self.slabs);
        let offset = (own.difference - average.difference) / changed.step;
        (offset, own.shared.iter().map(|change| change / changed.step).collect())
    }

    /// The reflectances of the light and the dark side of the board in a channel: those with which it looks through a scene
    /// as it did in the photographs, for which `measure` assumed another one.
    pub(crate) fn board(&self, channel: &str, scene: &Scene) -> Result<[f64; 2]> {
        let found = self.assumed.channels().iter().find(|c| c.name() == channel);
        let side = found
            .with_context(|| format!("the scene of the media file has no board in channel {channel}"))?;
        let (assumed, seen) = (self.bare_board(&self.assumed)?, self.bare_board(scene)?);
        Ok([side.rho_light(), side.rho_dark()].map(|rho| seen.reflectance(assumed.apparent(rho))))
    }

    /// The bare board of a scene, each once: its coat is the lowest layer.
    fn bare_board(&self, scene: &Scene) -> Result<BareBoard> {
        let look = |s: &Scene| (s.layers().last().cloned(), s.light(), s.sensor().polar_deg());
        let mut boards = self.boards.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, board)) = boards.iter().find(|(known, _)| look(known) == look(scene)) {
            return Ok(*board);
        }
        let board = BareBoard::of(scene)?;
        boards.push((scene.clone(), board));
        Ok(board)
    }

    fn differences(&self, channel: &str) -> Vec<f64> {
        let priors = self.assumed.priors().iter().enumerate();
        let difference =
            |(i, prior)| possible(&self.assumed, prior, self.estimate(i, channel, &self.slabs).difference);
        priors.map(difference).collect()
    }

    fn estimate(&self, quantity: usize, channel: &str, slabs: &[NamedSlab]) -> FoundQuantity {
        let total: f64 = slabs.iter().map(|slab| slab.thickness_mm).sum();
        let mut sum = FoundQuantity::default();
        for (_, found) in self.estimates.iter().filter(|(of, _)| *of == quantity) {
            if found.channel.as_ref().is_none_or(|of| of == channel) {
                sum.add(found, found.material.as_ref().map_or(1.0, |name| volume(slabs, name) / total));
            }
        }
        sum
    }

    fn scene_with(&self, channel: &str, differences: &[f64]) -> Result<Scene> {
        Ok(self.assumed.found_in(&Channel::new(channel, 0.5, 0.5)?, differences)?)
    }
}

impl FoundQuantity {
    fn add(&mut self, found: &MediaSetUp, weight: f64) {
        self.difference += weight * found.difference;
        self.shared.resize(found.shared.len(), 0.0);
        self.shared.iter_mut().zip(&found.shared).for_each(|(sum, change)| *sum += weight * change);
    }
}

fn norm(changes: &[f64]) -> f64 {
    changes.iter().map(|change| change * change).sum::<f64>().sqrt()
}

/// The nearest difference that a scene can have: fits also follow angles beyond the vertical and the horizontal. A view
/// from −θ is that from θ.
fn possible(scene: &Scene, prior: &Prior, difference: f64) -> f64 {
    let (polar, light) = (scene.sensor().polar_deg(), scene.light());
    match prior.kind() {
        PriorKind::SensorAngle => (polar + difference).abs() - polar,
        PriorKind::RingAngle => difference.clamp(-light.inner_deg(), 90.0 - light.outer_deg()),
        _ => difference,
    }
}

/// Volume of a material over the area of slabs.
fn volume(slabs: &[NamedSlab], material: &str) -> f64 {
    let share = |slab: &NamedSlab| slab.shares.iter().find(|(name, _)| name == material).map(|(_, s)| *s);
    slabs.iter().map(|slab| slab.thickness_mm * share(slab).unwrap_or(0.0)).sum()
}

#[cfg(test)]
mod tests {
    use farm_lab::media_file::MediaFile;
    use optics_model::SceneFile;
    use serde_json::json;

    use super::*;

    fn estimate(quantity: &str, of: [Option<&str>; 2], difference: f64) -> MediaSetUp {
        let [material, channel] = of.map(|name| name.map(ToOwned::to_owned));
        MediaSetUp { quantity: quantity.to_owned(), material, channel, difference, shared: vec![0.01, 0.0] }
    }

    fn set_up(scene: &Scene, set_up: &[MediaSetUp], slabs: &[NamedSlab]) -> Result<FoundSetUp> {
        let file = json!({
            "format": "farmctl-media/1", "program": "", "dictionary": "", "dictionary_digest": "", "mu": 1.0,
            "mu_std_error": 0.0, "scene": SceneFile::from(scene), "set_up": set_up, "materials": [],
        });
        let file: MediaFile = serde_json::from_value(file)?;
        FoundSetUp::new(&file, slabs)
    }

    fn slab(shares: &[(&str, f64)], thickness_mm: f64) -> NamedSlab {
        let shares = shares.iter().map(|(name, share)| ((*name).to_owned(), *share)).collect();
        NamedSlab { shares, thickness_mm }
    }

    /// Indices of materials are averaged by volume; a print of one of them differs from the average by steps.
    #[test]
    fn materials_are_averaged_by_volume() {
        let index = |name, difference| estimate("sample index", [Some(name), None], difference);
        let slabs = [slab(&[("a", 1.0)], 3.0), slab(&[("b", 1.0)], 1.0)];
        let found = set_up(&Scene::lab(), &[index("a", 0.02), index("b", -0.02)], &slabs).unwrap();
        assert!((found.scene("R").unwrap().sample_ior_offset() - 0.01).abs() < 1e-12);
        let changed = found.changed("R");
        assert_eq!(changed.len(), 1);
        let (offset, shared) = found.steps(&changed[0], "R", &slabs[..1]);
        assert!((offset - 1.0).abs() < 1e-9 && (shared[0] - 1.0).abs() < 1e-9, "{offset} {shared:?}");
        let twice =
            set_up(&Scene::lab(), &[index("a", 0.02), index("a", 0.02)], &slabs).unwrap_err().to_string();
        assert!(twice.contains("set_up \"sample index\" of the media file occurs twice"), "{twice}");
    }

    /// An index of each channel is that channel's.
    #[test]
    fn channels_have_their_own_estimates() {
        let index = |name, difference| estimate("sample index", [Some("a"), Some(name)], difference);
        let found = [index("R", 0.01), index("G", 0.02), index("B", 0.03)];
        let found = set_up(&Scene::lab(), &found, &[slab(&[("a", 1.0)], 1.0)]).unwrap();
        let offset = |channel| found.scene(channel).unwrap().sample_ior_offset();
        assert_eq!([offset("R"), offset("G"), offset("B")], [0.01, 0.02, 0.03]);
    }

    /// Angles that a fit follows beyond the horizontal are those at the horizontal.
    #[test]
    fn impossible_angles_are_the_nearest_possible() {
        let ring = estimate("ring angle", [None, None], 45.0);
        let found = set_up(&Scene::lab(), &[ring], &[slab(&[("a", 1.0)], 1.0)]).unwrap();
        assert_eq!(found.scene("R").unwrap().light().outer_deg(), 90.0);
        // The step goes downwards there.
        assert!(found.changed("R")[0].step < 0.0);
    }
}
