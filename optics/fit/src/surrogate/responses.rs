//! Interpolates the response of a profile to the uncertain quantities of the scene, between the media at which responses
//! were traced.
//!
//! With u a quantity's difference from the scene's value in units of its prior's standard deviation, the profile changes
//! by h(u) L: see [`crate::dictionary::responses`]. L is interpolated by cubics in ln σ_t and √(1 − α), and by a parabola
//! in ln(1 − g): responses are smooth, and a few per cent of a profile. Those to a second lobe of the phase function grow
//! as (1 − g)⁻³ in bright media, so there the parabola is one in (1 − g)^{−3/2}.

use std::f64::consts::PI;

use noise::Stencil;

use super::{ALBEDO, Coordinates, G, SIGMA_T, Surrogate, add_scaled};
use crate::dictionary::base_spread::BaseSpread;
use crate::dictionary::responses::{ResponseCurve, ResponseRecords};

pub(crate) mod noise;

/// The response of a quantity about one medium: Σ h(u) L.
#[derive(Debug, Clone)]
pub(crate) struct LocalResponse {
    /// The channel's difference from the scene's value, in standard deviations: n(λ) − n_D of an index.
    in_channel: f64,
    /// h; L, then its derivatives by the medium's coordinates.
    parts: Vec<(ResponseCurve, [Vec<f64>; 4])>,
}

/// All responses about one medium.
#[derive(Debug, Clone)]
pub(crate) struct LocalResponses {
    /// The medium, with the optical thickness in place of σ_t.
    at: Coordinates,
    /// By prior of the scene.
    each: Vec<LocalResponse>,
    /// The first-order effect of a spread within the base; its response is what differs from it.
    spread: Option<BaseSpread>,
}

/// The change of a profile by the quantities.
#[derive(Debug)]
pub(crate) struct ProfileChange {
    pub values: Vec<f64>,
    /// Derivatives by the medium's coordinates.
    pub slopes: [Vec<f64>; 3],
    /// Derivatives by each quantity.
    pub by_quantity: Vec<Vec<f64>>,
}

impl LocalResponses {
    /// Number of quantities.
    pub(crate) fn count(&self) -> usize {
        self.each.len()
    }

    fn pixels(&self) -> usize {
        self.each.first().map_or(0, |r| r.parts[0].1[0].len())
    }

    /// The change of a profile of a medium and a thickness near by, with the quantities at these differences from the scene;
    /// `slopes` are the profile's derivatives by the medium's coordinates. Its derivative by the logarithm of the thickness
    /// is that by ln σ_t.
    pub(crate) fn change(
        &self,
        profile: &[f64],
        slopes: &[Vec<f64>],
        thickness_mm: f64,
        mut x: Coordinates,
        quantities: &[f64],
    ) -> ProfileChange {
        let pixels = self.pixels();
        x[SIGMA_T] += libm::log(thickness_mm);
        let off: [f64; 3] = std::array::from_fn(|i| x[i] - self.at[i]);
        let zero = || vec![0.0; pixels];
        let mut change =
            ProfileChange { values: zero(), slopes: [zero(), zero(), zero()], by_quantity: Vec::new() };
        // The profile that a spread within the base acts on.
        let mut seen = profile.to_vec();
        for (response, u) in self.each.iter().zip(quantities) {
            let mut by_quantity = zero();
            for (curve, [linear, by_s, by_a, by_g]) in &response.parts {
                let (height, slope) = curve.at(response.in_channel + u);
                let mut there = linear.clone();
                for (off, by) in off.iter().zip([by_s, by_a, by_g]) {
                    add_scaled(&mut there, *off, by);
                }
                add_scaled(&mut change.values, height, &there);
                if !curve.is_of_spread() {
                    add_scaled(&mut seen, height, &there);
                }
                for (slopes, by) in change.slopes.iter_mut().zip([by_s, by_a, by_g]) {
                    add_scaled(slopes, height, by);
                }
                add_scaled(&mut by_quantity, slope, &there);
            }
            change.by_quantity.push(by_quantity);
        }
        self.add_spread(&seen, slopes, quantities, &mut change);
        change
    }

    /// Adds the first-order effect of a spread on a profile to the change by all quantities.
    fn add_spread(&self, seen: &[f64], slopes: &[Vec<f64>], quantities: &[f64], change: &mut ProfileChange) {
        let Some(spread) = &self.spread else { return };
        for ((i, by), response) in change.by_quantity.iter_mut().enumerate().zip(&self.each) {
            if !response.parts[0].0.is_of_spread() {
                let effect = spread.effect(by, quantities);
                add_scaled(by, 1.0, &effect);
            }
            spread.slope(seen, quantities, i).iter().for_each(|slope| add_scaled(by, 1.0, slope));
        }
        for (slope, of_profile) in change.slopes.iter_mut().zip(slopes) {
            let mut of_seen = of_profile.clone();
            add_scaled(&mut of_seen, 1.0, slope);
            add_scaled(slope, 1.0, &spread.effect(&of_seen, quantities));
        }
        add_scaled(&mut change.values, 1.0, &spread.effect(seen, quantities));
    }
}

/// Error of a profile's change by the scene's quantities, as a share of it: what is left by one curve for all media, by sums
/// instead of joint effects, and by the interpolation between the nodes.
const MODEL_ERROR: f64 = 0.1;
/// Distance in mm over which such errors are alike.
const ALIKE_MM: f64 = 0.7;

impl LocalResponses {
    /// Profiles f_k such that Σ f_k f_kᵀ is the covariance of the model's error, with the quantities at these differences
    /// from the scene: ε² s(x) s(x′) c(x − x′), with s² = Σ_q (h_q L_q)² and c a Gaussian.
    pub(crate) fn model_errors(&self, quantities: &[f64], width_mm: f64) -> Vec<Vec<f64>> {
        let pixels = self.pixels();
        let mut squares = vec![0.0; pixels];
        for (response, u) in self.each.iter().zip(quantities) {
            let mut change = vec![0.0; pixels];
            for (curve, linear) in &response.parts {
                add_scaled(&mut change, curve.at(response.in_channel + u).0, &linear[0]);
            }
            squares.iter_mut().zip(&change).for_each(|(s, v)| *s += v * v);
        }
        // The spectrum of c, by cosines over the width.
        let frequency = |k: usize| PI * k as f64 * ALIKE_MM / width_mm;
        let weights = (0..pixels).map(|k| libm::exp(-0.5 * frequency(k).powi(2))).take_while(|w| *w > 0.01);
        let weights: Vec<f64> = weights.collect();
        let sum = weights.iter().sum::<f64>() - 0.5;
        let mode = |(k, weight): (usize, &f64)| -> Vec<f64> {
            let share = if k == 0 { *weight } else { 2.0 * weight };
            let size = MODEL_ERROR * (share / sum).sqrt();
            let wave = |i: usize| libm::cos(PI * k as f64 * (i as f64 + 0.5) / pixels as f64);
            squares.iter().enumerate().map(|(i, s)| size * s.sqrt() * wave(i)).collect()
        };
        weights.iter().enumerate().map(mode).collect()
    }
}

impl Surrogate<'_> {
    /// The responses of a slab of this thickness, about a medium; None if the dictionary has none.
    ///
    /// They are those of the nearest of the dictionary's thicknesses, at the same optical thickness.
    pub(crate) fn responses(&self, thickness_mm: f64, x: Coordinates) -> Option<LocalResponses> {
        let grid = self.grid();
        grid.responses()?;
        let records = self.dictionary.responses(self.channel)?;
        let (thickness, at) = self.response_place(thickness_mm, x);
        let stencil = self.response_stencil(thickness, at);
        let response = |prior: usize| LocalResponse {
            in_channel: self.in_channel(prior),
            parts: self.linear_responses(records, prior, &stencil),
        };
        let each = (0..grid.scene().priors().len()).map(response).collect();
        let mut optical = x;
        optical[SIGMA_T] += libm::log(thickness_mm);
        let spread = BaseSpread::uncertain(grid, self.channel);
        Some(LocalResponses { at: optical, each, spread })
    }

    /// The channel's difference of a quantity from the scene's value, in standard deviations.
    fn in_channel(&self, prior: usize) -> f64 {
        let scene = self.grid().scene();
        let (channel, prior) = (&scene.channels()[self.channel], &scene.priors()[prior]);
        scene.difference_in(channel, prior).expect("the grid has checked its scene") / prior.std_error()
    }

    /// The nearest of the dictionary's thicknesses, and the coordinates at which a slab of it has the same optical
    /// thickness.
    fn response_place(&self, thickness_mm: f64, mut x: Coordinates) -> (usize, Coordinates) {
        let (index, ratio) = self.nearest_thickness(thickness_mm);
        x[SIGMA_T] += libm::log(ratio);
        (index, x)
    }

    /// The curves of a quantity, each with its L and the derivatives of that by the medium's coordinates.
    fn linear_responses(
        &self,
        records: &ResponseRecords,
        prior: usize,
        stencil: &Stencil,
    ) -> Vec<(ResponseCurve, [Vec<f64>; 4])> {
        let grid = self.grid();
        let nodes = grid.responses().expect("the grid has responses");
        let Stencil { thickness, sigma_t: s, albedo: a, .. } = stencil;
        let mut rows = Vec::new();
        for (j, (wa, da)) in a.values.iter().zip(&a.slopes).enumerate() {
            let g = stencil.along_g(&grid.scene().priors()[prior], self.albedo[a.first + j]);
            for (i, (ws, ds)) in s.values.iter().zip(&s.slopes).enumerate() {
                for (k, (wg, dg)) in g.values.iter().zip(&g.slopes).enumerate() {
                    let (sigma_t, g) = (nodes.sigma_t()[s.first + i], nodes.g()[g.first + k]);
                    let record = grid.record_at(self.ior, sigma_t, g, *thickness, a.first + j);
                    let row = records.row(record).expect("responses are traced at their nodes");
                    rows.push((row, [ws * wa * wg, -ds * wa * wg, ws * da * wg, ws * wa * dg]));
                }
            }
        }
        records.parts(prior).iter().map(|(curve, linear)| (curve.clone(), linear.sums(&rows))).collect()
    }
}

#[cfg(test)]
mod tests;
