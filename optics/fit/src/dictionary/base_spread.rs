//! Predicts the effect of a spread of light within the base on a profile to first order: as if light met the base once.
//!
//! Light that enters the base at one place leaves it at another, at a distance with the density e^(−|s|/b)/2b, and crosses
//! the ink at both, with √ρ each. A bare board of ρ_d and ρ_l then has the reflectance ρ(x) + s(x),
//!
//! s(x) = −½ (ρ_l − √(ρ_l ρ_d)) e^(−x/b) on the light side, ½ (√(ρ_l ρ_d) − ρ_d) e^(x/b) on the dark side.
//!
//! A profile P is the response to a step of ρ, so that of s is P′ ∗ s/(ρ_l − ρ_d). Traced effects differ from it by what
//! light does that meets the base more than once, which is smooth and small.

use optics_model::scene::{Prior, PriorKind};
use optics_model::{Grid, Scene};

/// Least ρ of a light side.
const LEAST_LIGHT: f64 = 0.01;
/// Step of a spread in mm, and of other quantities in standard deviations, for derivatives.
const STEP_MM: f64 = 1e-6;
const STEP: f64 = 1e-4;

/// The spread of a scene, as an uncertain quantity.
#[derive(Debug, Clone)]
pub(crate) struct BaseSpread {
    /// Index among the scene's priors.
    prior: usize,
    /// ρ of the dark and the light side, and their changes by one standard deviation of each prior.
    rho: [f64; 2],
    by_quantity: Vec<[f64; 2]>,
    pitch_mm: f64,
    /// The scene's own spread, and the standard deviation of its prior.
    own_mm: f64,
    std_error_mm: f64,
}

impl BaseSpread {
    /// None if the spread of a grid's scene is not uncertain.
    pub(crate) fn uncertain(grid: &Grid, channel: usize) -> Option<Self> {
        let (scene, responses) = (grid.scene(), grid.responses()?);
        let prior = scene.priors().iter().position(|prior| prior.kind() == PriorKind::BaseSpread)?;
        let sides = |scene: &Scene| {
            let channel = &scene.channels()[channel];
            [channel.rho_dark(), channel.rho_light()]
        };
        let rho = sides(scene);
        let by_quantity = |(index, prior): (usize, &Prior)| {
            let variant = responses.variants().iter().position(|variant| variant.prior == index);
            variant.map_or([0.0; 2], |variant| {
                let u = responses.variants()[variant].step / prior.std_error();
                let there = sides(responses.scene(variant));
                [0, 1].map(|side| (there[side] - rho[side]) / u)
            })
        };
        Some(Self {
            prior,
            rho,
            by_quantity: scene.priors().iter().enumerate().map(by_quantity).collect(),
            pitch_mm: scene.sensor().pitch_mm(),
            own_mm: scene.base_spread_mm(),
            std_error_mm: scene.priors()[prior].std_error(),
        })
    }

    /// The effect on the scene's own profile of a spread that is u standard deviations above the scene's.
    pub(crate) fn effect_at(&self, profile: &[f64], u: f64) -> Vec<f64> {
        let mut quantities = vec![0.0; self.by_quantity.len()];
        quantities[self.prior] = u;
        self.effect(profile, &quantities)
    }

    /// The effect on a profile, or on its change, with the quantities at these standard deviations from the scene.
    pub(crate) fn effect(&self, profile: &[f64], quantities: &[f64]) -> Vec<f64> {
        let there = self.own_mm + quantities[self.prior] * self.std_error_mm;
        self.between(profile, [self.own_mm, there], self.heights(quantities))
    }

    /// The derivative of the effect on a profile by a quantity, the profile unchanged; None if it is 0.
    pub(crate) fn slope(&self, profile: &[f64], quantities: &[f64], by: usize) -> Option<Vec<f64>> {
        let scaled = |effect: Vec<f64>, by: f64| effect.iter().map(|v| v * by).collect();
        let here = self.own_mm + quantities[self.prior] * self.std_error_mm;
        let heights = self.heights(quantities);
        if by == self.prior {
            let step = self.between(profile, [here, here + STEP_MM], heights);
            return Some(scaled(step, self.std_error_mm / STEP_MM));
        }
        let mut moved = quantities.to_vec();
        moved[by] += STEP;
        let there = self.heights(&moved);
        let change = [0, 1].map(|side| there[side] - heights[side]);
        (change != [0.0; 2]).then(|| scaled(self.between(profile, [self.own_mm, here], change), 1.0 / STEP))
    }

    /// s at the edge on the dark and the light side, over ρ_l − ρ_d: ½ √ρ_d/(√ρ_l + √ρ_d) and −½ √ρ_l/(√ρ_l + √ρ_d).
    fn heights(&self, quantities: &[f64]) -> [f64; 2] {
        let [dark, light] = [0, 1].map(|side| {
            let changes = self.by_quantity.iter().zip(quantities).map(|(by, u)| by[side] * u);
            self.rho[side] + changes.sum::<f64>()
        });
        let [dark, light] = [dark.max(0.0), light.max(LEAST_LIGHT)].map(f64::sqrt);
        [0.5 * dark / (light + dark), -0.5 * light / (light + dark)]
    }

    /// The effect of the second spread less that of the first.
    fn between(&self, profile: &[f64], spreads_mm: [f64; 2], heights: [f64; 2]) -> Vec<f64> {
        let mut effect = vec![0.0; profile.len()];
        self.add(profile, heights.map(|height| -height), spreads_mm[0], &mut effect);
        self.add(profile, heights, spreads_mm[1], &mut effect);
        effect
    }

    /// Adds the effect of a spread of these heights. The rise of a profile between two pixels is taken to be at their
    /// border, and the exponentials are averaged over pixels.
    fn add(&self, profile: &[f64], heights: [f64; 2], spread_mm: f64, effect: &mut [f64]) {
        if spread_mm <= 0.0 {
            return;
        }
        let fall = libm::exp(-self.pitch_mm / spread_mm);
        let mean = spread_mm / self.pitch_mm * (1.0 - fall);
        let [dark, light] = heights.map(|height| height * mean);
        let mut sum = 0.0;
        for i in 1..profile.len() {
            sum = sum * fall + profile[i] - profile[i - 1];
            effect[i] += light * sum;
        }
        sum = 0.0;
        for i in (1..profile.len()).rev() {
            sum = sum * fall + profile[i] - profile[i - 1];
            effect[i - 1] += dark * sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use optics_model::Walks;
    use optics_model::grid::{Axes, Responses};
    use optics_tracer::SeenBase;

    use super::*;

    fn lab_spread() -> (Scene, BaseSpread) {
        let (scene, axes) = (Scene::lab(), Axes::lab());
        let base = SeenBase::of(&scene);
        let responses = Responses::of(&scene, &axes, |varied| base.through(varied)).unwrap().unwrap();
        let grid = Grid::new(scene.clone(), axes, Walks::PAPER, 1, false).unwrap();
        (scene, BaseSpread::uncertain(&grid.with_responses(responses).unwrap(), 0).unwrap())
    }

    /// On a bare edge the effect is s itself, averaged over pixels.
    #[test]
    fn bare_edge_shows_the_spread_itself() {
        let (scene, spread) = lab_spread();
        let channel = &scene.channels()[0];
        let (light, dark) = (channel.rho_light(), channel.rho_dark());
        let edge: Vec<f64> = (0..360).map(|i| if i < 180 { dark } else { light }).collect();
        let (b, between) = (0.1, (light * dark).sqrt());
        let effect = spread.effect_at(&edge, 1.0);
        for i in [100, 170, 178, 179, 180, 181, 190, 260] {
            let x = (i as f64 - 179.5) * spread.pitch_mm;
            let own = if x > 0.0 { light } else { dark };
            let share = 2.0 * b / spread.pitch_mm * libm::sinh(0.5 * spread.pitch_mm / b);
            let expected = 0.5 * (between - own) * libm::exp(-x.abs() / b) * share;
            assert!((effect[i] - expected).abs() < 1e-12, "{i}: {} {expected}", effect[i]);
        }
        let (up, down) = (spread.effect_at(&edge, 1.001), spread.effect_at(&edge, 0.999));
        let mut quantities = vec![0.0; scene.priors().len()];
        quantities[spread.prior] = 1.0;
        let slope = spread.slope(&edge, &quantities, spread.prior).unwrap();
        for i in [150, 179, 185] {
            assert!((slope[i] - (up[i] - down[i]) / 2e-3).abs() < 1e-3 * slope[i].abs(), "{i}");
        }
    }

    /// A darker dark side sends less light under the ink: its derivative is that of differences.
    #[test]
    fn spread_follows_both_sides() {
        let (scene, spread) = lab_spread();
        let edge: Vec<f64> = (0..360).map(|i| if i < 180 { 0.1 } else { 0.8 }).collect();
        let dark = scene.priors().iter().position(|prior| prior.kind() == PriorKind::DarkSide).unwrap();
        let at = |u: f64| {
            let mut quantities = vec![0.0; scene.priors().len()];
            (quantities[spread.prior], quantities[dark]) = (1.0, u);
            quantities
        };
        let [up, down] = [0.01, -0.01].map(|u| spread.effect(&edge, &at(u)));
        let slope = spread.slope(&edge, &at(0.0), dark).unwrap();
        for i in [170, 180, 185] {
            let expected = (up[i] - down[i]) / 0.02;
            assert!(slope[i] > 0.0 && (slope[i] - expected).abs() < 1e-3 * expected.abs(), "{i}: {expected}");
        }
        let slip = scene.priors().iter().position(|prior| prior.kind() == PriorKind::Thickness).unwrap();
        assert!(spread.slope(&edge, &at(0.0), slip).is_none());
    }
}
