//! The set-up of a print as the measurement found it: the scene of each channel, and scenes with a quantity changed, for
//! the errors of predictions.

use std::cell::RefCell;

use anyhow::{Context, Result};
use farm_lab::media_file::{MediaFile, MediaSetUp};
use optics_model::Scene;
use optics_model::scene::Channel;
use optics_tracer::BareBoard;

use super::slabs::NamedSlab;

/// The scene of the measurement with its quantities as found.
#[derive(Debug)]
pub(crate) struct FoundSetUp {
    /// As the measurement assumed it.
    assumed: Scene,
    /// By prior of the scene: estimates for the print.
    found: Vec<FoundQuantity>,
    boards: RefCell<Vec<(Scene, BareBoard)>>,
}

/// The estimate of a quantity, and its changes by source of errors.
#[derive(Debug, Clone, Default)]
struct FoundQuantity {
    difference: f64,
    shared: Vec<f64>,
}

/// A quantity at a value one step away from its estimate.
#[derive(Debug)]
pub(crate) struct ChangedSetUp<'a> {
    set_up: &'a FoundSetUp,
    quantity: usize,
    /// Standard error, or its negative if larger values are impossible.
    step: f64,
}

impl FoundSetUp {
    /// What materials have separately is averaged over the volume of these slabs.
    pub(crate) fn new(file: &MediaFile, slabs: &[NamedSlab]) -> Result<Self> {
        let assumed = Scene::try_from(file.scene.clone()).context("the scene of the media file")?;
        let mut found = vec![FoundQuantity::default(); assumed.priors().len()];
        let total: f64 = slabs.iter().map(|slab| slab.thickness_mm).sum();
        for of_file in &file.set_up {
            let of_name = |prior| assumed.name_of(prior) == of_file.quantity;
            let number = assumed.priors().iter().position(of_name).with_context(|| {
                format!("set_up {:?} of the media file is not uncertain in its scene", of_file.quantity)
            })?;
            let weight = of_file.material.as_ref().map_or(1.0, |name| volume(slabs, name) / total);
            found[number].add(of_file, weight);
        }
        Ok(Self { assumed, found, boards: RefCell::default() })
    }

    /// The scene in a channel, as found; its ρ are not used.
    pub(crate) fn scene(&self, channel: &str) -> Result<Scene> {
        self.scene_with(channel, &self.differences())
    }

    /// The changes of one standard error of each quantity.
    pub(crate) fn changed(&self) -> Vec<ChangedSetUp<'_>> {
        let changed = |quantity: usize| {
            let error = self.found[quantity].std_error();
            let is_possible = |step: &f64| ChangedSetUp { set_up: self, quantity, step: *step }.is_possible();
            let step = [error, -error].into_iter().filter(|step| *step != 0.0).find(is_possible)?;
            Some(ChangedSetUp { set_up: self, quantity, step })
        };
        (0..self.found.len()).filter_map(changed).collect()
    }

    /// The reflectances of the light and the dark side of the board in a channel: those with which it looks through a scene
    /// as it did in the photographs, for which `measure` assumed another one.
    pub(crate) fn board(&self, channel: &str, scene: &Scene) -> Result<[f64; 2]> {
        let found = self.assumed.channels().iter().find(|c| c.name() == channel);
        let side = found
            .with_context(|| format!("the scene of the media file has no board in channel {channel}"))?;
        let (assumed, seen) = (self.bare_board(&self.assumed)?, self.bare_board(scene)?);
        Ok([side.rho_light(), side.rho_dark()]
            .map(|rho| seen.reflectance(assumed.apparent(rho)).clamp(0.0, 1.0)))
    }

    /// The bare board of a scene, each once: its coat is the lowest layer.
    fn bare_board(&self, scene: &Scene) -> Result<BareBoard> {
        let of = |s: &Scene| (s.layers().last().cloned(), s.light(), s.sensor().polar_deg());
        let mut boards = self.boards.borrow_mut();
        if let Some((_, board)) = boards.iter().find(|(known, _)| of(known) == of(scene)) {
            return Ok(*board);
        }
        let board = BareBoard::of(scene)?;
        boards.push((scene.clone(), board));
        Ok(board)
    }

    fn differences(&self) -> Vec<f64> {
        self.found.iter().map(|quantity| quantity.difference).collect()
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

    fn std_error(&self) -> f64 {
        self.shared.iter().map(|change| change * change).sum::<f64>().sqrt()
    }
}

impl ChangedSetUp<'_> {
    /// The scene in a channel.
    pub(crate) fn scene(&self, channel: &str) -> Result<Scene> {
        let mut differences = self.set_up.differences();
        differences[self.quantity] += self.step;
        self.set_up.scene_with(channel, &differences)
    }

    /// Changes of the quantity by source, in steps.
    pub(crate) fn shared(&self) -> Vec<f64> {
        self.set_up.found[self.quantity].shared.iter().map(|change| change / self.step).collect()
    }

    fn is_possible(&self) -> bool {
        self.set_up.assumed.channels().first().is_some_and(|channel| self.scene(channel.name()).is_ok())
    }
}

/// Volume of a material over the area of slabs.
fn volume(slabs: &[NamedSlab], material: &str) -> f64 {
    let share = |slab: &NamedSlab| slab.shares.iter().find(|(name, _)| name == material).map(|(_, s)| *s);
    slabs.iter().map(|slab| slab.thickness_mm * share(slab).unwrap_or(0.0)).sum()
}
