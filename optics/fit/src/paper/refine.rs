//! From the best record to a continuous optimum of Eq. 1 over the smooth model of the dictionary.
//!
//! A sum of norms Σ c_b ‖r_b(x)‖ is decreased by iteratively reweighted least squares: ‖r‖ ≤ ‖r‖²/(2ρ) + ρ/2 with
//! equality at ρ = ‖r‖, so a Gauss–Newton step of the weighted squares decreases the sum; it is shortened until it
//! does.

use glam::{DMat4, DVec4};
use optics_model::fit::{Bounds, Candidate, FitOptions};
use optics_model::{Grid, Medium};

use crate::dictionary::sum::{dot, rms};
use crate::paper::question::{Question, Term};
use crate::surrogate::{ALBEDO, G, Prediction, SIGMA_T, Surrogate, albedo, coordinates, g, sigma_t};

/// What Eq. 1 is minimised over: the medium's coordinates, and the logarithm of a factor on the question's μ.
pub(crate) type Unknowns = [f64; 4];
/// Index of the factor's logarithm.
pub(crate) const SCALE: usize = 3;

/// Steps that one optimisation may take.
const MOST_STEPS: usize = 40;
/// A step that lowers the error by less than this share is the last.
const CONVERGED: f64 = 1e-8;

/// Value and gradient part of one term of Eq. 1 at some unknowns.
#[derive(Debug)]
pub(crate) struct Block {
    /// Index of the term.
    pub term: usize,
    /// 1 for values, λ for gradients.
    pub weight: f64,
    /// What of the measurement the model leaves.
    pub residual: Vec<f64>,
    /// Derivatives of the model by the unknowns.
    pub jacobian: [Vec<f64>; 4],
    pub rms: f64,
    /// Signs by which gradients became magnitudes, of the measured profile and of the model; none for values.
    pub signs: Option<(Vec<f64>, Vec<f64>)>,
}

/// Eq. 1 as a function of continuous unknowns.
///
/// With a factor e^m on the question's μ it is e^(−m) d(e^m μ F_A, F_S) = d(μ F_A, e^(−m) F_S), as Eq. 3 has it: without
/// the division a smaller factor would always be better.
#[derive(Debug)]
pub(crate) struct Objective<'a> {
    pub question: &'a Question<'a>,
    pub surrogate: Surrogate<'a>,
    pub limits: [(f64, f64); 4],
    /// Parameters that cannot move: by the bounds, or since the dictionary has one value only.
    held: [Option<f64>; 3],
    /// Signed gradients of the measured profiles.
    slopes: Vec<Vec<f64>>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Optimum {
    pub x: Unknowns,
    pub error: f64,
}

/// Parameters that cannot move: by the bounds, or since the dictionary has one value only.
pub(crate) fn held(grid: &Grid, options: &FitOptions) -> [Option<f64>; 3] {
    let settings = options.settings();
    let held = |axis: &[f64], bounds: Bounds| match axis {
        [one] => Some(*one),
        _ => bounds.is_fixed().then_some(bounds.min()),
    };
    [
        held(grid.sigma_t_per_mm(), settings.sigma_t_per_mm),
        held(grid.albedo(), settings.albedo),
        held(grid.g(), settings.g),
    ]
}

/// Least and greatest coordinates within both the dictionary and the bounds.
pub(crate) fn limits(surrogate: &Surrogate, options: &FitOptions) -> [(f64, f64); 4] {
    let settings = options.settings();
    let within = |(low, high): (f64, f64), bounds: Bounds, forward: fn(f64) -> f64| {
        let (a, b) = (forward(bounds.min()), forward(bounds.max()));
        let (a, b) = if a.is_nan() || b.is_nan() { (low, high) } else { (a.min(b), a.max(b)) };
        (a.clamp(low, high), b.clamp(low, high))
    };
    let [sigma_t, albedo, g] = surrogate.limits();
    [
        within(sigma_t, settings.sigma_t_per_mm, |v| if v > 0.0 { v.ln() } else { f64::NEG_INFINITY }),
        within(albedo, settings.albedo, |v| if v < 1.0 { (1.0 - v).sqrt() } else { 0.0 }),
        within(g, settings.g, |v| if v < 1.0 { (1.0 - v).ln() } else { f64::NEG_INFINITY }),
        (0.0, 0.0),
    ]
}

impl<'a> Objective<'a> {
    pub(crate) fn new(question: &'a Question<'a>, start: &Candidate) -> Self {
        let iors = question.dictionary.grid().sample_ior();
        let ior = iors.iter().position(|v| *v == start.sample_ior).unwrap_or(0);
        let surrogate = Surrogate::new(question.dictionary, question.channel, ior);
        let limits = limits(&surrogate, &question.options);
        let slopes = question.terms.iter().map(|t| t.view.slope().of(&t.values)).collect();
        Self {
            question,
            surrogate,
            limits,
            held: held(question.dictionary.grid(), &question.options),
            slopes,
        }
    }

    /// The parameter that a coordinate stands for; what is held comes back as it was given.
    pub(crate) fn parameter(&self, index: usize, x: f64) -> f64 {
        let grid = self.question.dictionary.grid();
        let axis = [grid.sigma_t_per_mm(), grid.albedo(), grid.g()][index];
        // Exponentials and logarithms come back a rounding beside the ends.
        let within = |v: f64| v.clamp(axis[0], axis[axis.len() - 1]);
        self.held[index].unwrap_or_else(|| within([sigma_t, albedo, g][index](x)))
    }

    pub(crate) fn sample_ior(&self) -> f64 {
        self.question.dictionary.grid().sample_ior()[self.surrogate.ior()]
    }

    pub(crate) fn medium(&self, x: Unknowns) -> Medium {
        let [s, a, g] = PARAMETERS.map(|i| self.parameter(i, x[i]));
        Medium::new(s, a, g).expect("the limits are those of a grid")
    }

    pub(crate) fn start(&self, medium: &Medium) -> Unknowns {
        let [s, a, g] = coordinates(medium);
        self.clamp([s, a, g, 0.0])
    }

    pub(crate) fn clamp(&self, mut x: Unknowns) -> Unknowns {
        for (x, (low, high)) in x.iter_mut().zip(self.limits) {
            *x = x.clamp(low, high);
        }
        x
    }

    /// Which unknowns may move; the factor on μ does only in the search of what all channels share.
    pub(crate) fn free(&self) -> [bool; 4] {
        let free = |i: usize| self.held[i].is_none() && self.limits[i].1 > self.limits[i].0;
        [free(SIGMA_T), free(ALBEDO), free(G), false]
    }

    /// The model's profile of a term, with its derivatives by the medium's coordinates.
    pub(crate) fn predict(&self, term: &Term, x: Unknowns) -> Prediction {
        let [sigma_t, albedo, g, scale] = x;
        let mut model = self.surrogate.predict(term.thickness, term.view.pixels(), [sigma_t, albedo, g]);
        if scale != 0.0 {
            let factor = (-scale).exp();
            let rows = model.slopes.iter_mut().chain([&mut model.values]);
            rows.flatten().for_each(|v| *v *= factor);
        }
        model
    }

    pub(crate) fn blocks(&self, x: Unknowns) -> Vec<Block> {
        let lambda = self.question.options.settings().lambda;
        let mut blocks = Vec::with_capacity(2 * self.question.terms.len());
        for (i, term) in self.question.terms.iter().enumerate() {
            let prediction = self.predict(term, x);
            blocks.push(gradient_block(i, lambda, term, &self.slopes[i], &prediction));
            let residual = difference(&term.values, &prediction.values);
            let rms = rms(&residual);
            let [by_sigma_t, by_albedo, by_g] = prediction.slopes;
            let jacobian = [by_sigma_t, by_albedo, by_g, negative(&prediction.values)];
            blocks.push(Block { term: i, weight: 1.0, residual, jacobian, rms, signs: None });
        }
        blocks
    }

    /// Goes down from `x`, moving only the unknowns that are free, to a minimum of Eq. 1.
    pub(crate) fn descend(&self, x: Unknowns, free: [bool; 4]) -> Optimum {
        self.descend_until(x, free, CONVERGED)
    }

    /// The same, until a step lowers the error by less than the share `converged`.
    pub(crate) fn descend_until(&self, mut x: Unknowns, free: [bool; 4], converged: f64) -> Optimum {
        let mut blocks = self.blocks(x);
        let mut error = total(&blocks);
        let mut damping = 1e-6;
        for _ in 0..MOST_STEPS {
            let Some(step) = self.step(x, &blocks, free, damping) else { break };
            let there = self.clamp((DVec4::from(x) + step).into());
            let new_blocks = self.blocks(there);
            let new_error = total(&new_blocks);
            let gain = error - new_error;
            if gain <= 0.0 {
                if damping > 1e4 || -gain < converged * error {
                    break;
                }
                damping = (damping * 10.0).max(1e-3);
                continue;
            }
            (x, blocks, error) = (there, new_blocks, new_error);
            damping *= 0.1;
            if gain < converged * error {
                break;
            }
        }
        Optimum { x, error }
    }

    /// A damped Gauss–Newton step; none where nothing may move.
    fn step(&self, x: Unknowns, blocks: &[Block], free: [bool; 4], damping: f64) -> Option<DVec4> {
        let Descent { downhill, mut normal } = Descent::new(blocks);
        let free = self.inwards(x, downhill, free);
        for i in UNKNOWNS {
            let diagonal = normal.col(i)[i];
            normal.col_mut(i)[i] = diagonal * (1.0 + damping) + 1e-12;
        }
        Some(invert(normal, free)? * masked(downhill, free))
    }

    /// Of the free unknowns those that are not pulled over their limits.
    pub(crate) fn inwards(&self, x: Unknowns, downhill: DVec4, mut free: [bool; 4]) -> [bool; 4] {
        for (i, (free, (low, high))) in free.iter_mut().zip(self.limits).enumerate() {
            let outwards = (x[i] <= low && downhill[i] < 0.0) || (x[i] >= high && downhill[i] > 0.0);
            *free &= !outwards;
        }
        free
    }
}

/// Where Eq. 1 falls, and how fast the fall ends: gradient and matrix of the weighted squares that bound it.
pub(crate) struct Descent {
    pub downhill: DVec4,
    pub normal: DMat4,
}

impl Descent {
    pub(crate) fn new(blocks: &[Block]) -> Self {
        let mut descent = Self { downhill: DVec4::ZERO, normal: DMat4::ZERO };
        for block in blocks {
            let weight = block.weight / (block.residual.len() as f64 * block.rms.max(1e-9));
            for i in UNKNOWNS {
                descent.downhill[i] += weight * dot(&block.jacobian[i], &block.residual);
                for j in 0..=i {
                    let product = weight * dot(&block.jacobian[i], &block.jacobian[j]);
                    descent.normal.col_mut(i)[j] += product;
                    if i != j {
                        descent.normal.col_mut(j)[i] += product;
                    }
                }
            }
        }
        descent
    }
}

/// The vector with zeros where nothing is free.
pub(crate) fn masked(v: DVec4, free: [bool; 4]) -> DVec4 {
    DVec4::from_array(UNKNOWNS.map(|i| if free[i] { v[i] } else { 0.0 }))
}

/// The inverse over the free unknowns, zero in the others; none if nothing is free or it is singular.
pub(crate) fn invert(mut matrix: DMat4, free: [bool; 4]) -> Option<DMat4> {
    if free == [false; 4] {
        return None;
    }
    let held = || UNKNOWNS.into_iter().filter(|i| !free[*i]);
    for i in held() {
        for j in UNKNOWNS {
            matrix.col_mut(i)[j] = 0.0;
            matrix.col_mut(j)[i] = 0.0;
        }
        matrix.col_mut(i)[i] = 1.0;
    }
    let mut inverse = matrix.inverse();
    if !inverse.is_finite() {
        return None;
    }
    for i in held() {
        inverse.col_mut(i)[i] = 0.0;
    }
    Some(inverse)
}

fn gradient_block(i: usize, lambda: f64, term: &Term, measured: &[f64], prediction: &Prediction) -> Block {
    let slope = term.view.slope();
    let model = slope.of(&prediction.values);
    let sign = |v: &f64| if *v < 0.0 { -1.0 } else { 1.0 };
    let signs: Vec<f64> = model.iter().map(sign).collect();
    let magnitudes: Vec<f64> = model.iter().map(|v| v.abs()).collect();
    let [by_sigma_t, by_albedo, by_g] = prediction.slopes.each_ref().map(|by| {
        let mut by = slope.of(by);
        by.iter_mut().zip(&signs).for_each(|(v, s)| *v *= s);
        by
    });
    let jacobian = [by_sigma_t, by_albedo, by_g, negative(&magnitudes)];
    let residual = difference(&term.gradient, &magnitudes);
    let rms = rms(&residual);
    let signs = Some((measured.iter().map(sign).collect(), signs));
    Block { term: i, weight: lambda, residual, jacobian, rms, signs }
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn negative(values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| -v).collect()
}

/// Eq. 1.
pub(crate) fn total(blocks: &[Block]) -> f64 {
    blocks.iter().map(|b| b.weight * b.rms).sum()
}

/// The medium's coordinates, for loops over parameters.
pub(crate) const PARAMETERS: [usize; 3] = [SIGMA_T, ALBEDO, G];
/// All unknowns.
pub(crate) const UNKNOWNS: [usize; 4] = [SIGMA_T, ALBEDO, G, SCALE];

#[cfg(test)]
mod tests;
