//! The scale factor and the anisotropy that all channels of a set share, by the paper's distance of refined fits.
//!
//! Errors of the best *records* follow the gaps of the grid: whichever anisotropy has a record near by wins. Sums of
//! refined errors are smooth in both, with their least value at the truth but for noise. A mesh of both finds the valley;
//! from its lowest point damped Gauss–Newton steps of the shared unknowns, with every channel's own optimum
//! followed, go down to its bottom.

use std::ops::Range;

use glam::{DMat4, DVec4};
use optics_model::fit::{FitOptions, GError, MuRange};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
use crate::paper::question::{Question, questions};
use crate::paper::refine::{Descent, Objective, Optimum, SCALE, UNKNOWNS, Unknowns, invert, masked};
use crate::paper::search;
use crate::paper::shared::inverse_of_shared;
use crate::surrogate::{ALBEDO, G, SIGMA_T};

/// Widest distance of two scale factors of the mesh, in the logarithm.
const MESH_STEP: f64 = 0.05;
/// Most channels that are looked at on the mesh.
const MESH_CHANNELS: usize = 16;
/// How well a channel's optimum is followed on the mesh, and at its end.
const ROUGHLY: f64 = 1e-4;
const WELL: f64 = 1e-7;
/// Steps of the shared unknowns.
const MOST_STEPS: usize = 20;

/// What is looked for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub mu: Option<MuRange>,
    pub g: bool,
}

/// What was found.
#[derive(Debug, Clone)]
pub(crate) struct Found {
    pub mu: f64,
    /// None if every channel keeps its own, or was told it.
    pub g: Option<f64>,
    /// Eq. 3's refined error with each anisotropy of the dictionary, at the scale factor found and at its own best.
    pub by_g: Vec<GError>,
}

/// Searches what `wanted` says, with the options' bounds; their μ is kept unless it is looked for.
pub(crate) fn find(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    options: &FitOptions,
    wanted: &Wanted,
) -> Result<Found, Invalid> {
    let base = options.settings().mu;
    let scales = scales(wanted.mu.as_ref(), base);
    let reference = all_questions(dictionary, materials, &options.with_mu(base, 0.0)?)?;
    let at_scale = |scale: &f64| {
        let scaled = |values: &[f64]| values.iter().map(|v| v * scale.exp()).collect();
        reference.iter().map(|q| q.changed(scaled)).collect()
    };
    let at_scales: Vec<Vec<Question>> = scales.iter().map(at_scale).collect();
    let joint = Joint::new(&reference, wanted, (scales[0], scales[scales.len() - 1]));
    let start = joint.lowest_of_mesh(&scales, &at_scales);
    let bottom = joint.descend(&start, joint.shared);
    let mu = base * bottom.shared[SCALE].exp();
    let g = wanted.g.then(|| joint.objectives[0].parameter(G, bottom.shared[G]));
    let by_g = if wanted.g { joint.by_g(&bottom, base) } else { Vec::new() };
    Ok(Found { mu, g, by_g })
}

pub(crate) fn all_questions<'a>(
    dictionary: &'a FitDictionary,
    materials: &'a [Measurement],
    options: &FitOptions,
) -> Result<Vec<Question<'a>>, Invalid> {
    let mut all = Vec::new();
    for (i, material) in materials.iter().enumerate() {
        let asked = questions(dictionary, material, options);
        all.extend(asked.map_err(|e| e.within(format_args!("materials[{i}]")))?);
    }
    Ok(all)
}

/// Logarithms of factors on μ, evenly over the range.
pub(crate) fn scales(range: Option<&MuRange>, base: f64) -> Vec<f64> {
    let Some(range) = range else { return vec![0.0] };
    let (min, max, _) = range.parts();
    let (low, high) = ((min / base).ln(), (max / base).ln());
    let steps = ((high - low) / MESH_STEP).ceil().max(1.0);
    (0..=steps as usize).map(|i| low + (high - low) * i as f64 / steps).collect()
}

/// All channels, with what they share.
struct Joint<'a> {
    objectives: Vec<Objective<'a>>,
    shared: [bool; 4],
    /// Indices of the anisotropies to look at.
    nodes: Range<usize>,
}

/// The shared unknowns, and every channel's optimum there.
#[derive(Clone)]
struct State {
    shared: Unknowns,
    optima: Vec<Optimum>,
    error: f64,
}

impl<'a> Joint<'a> {
    fn new(questions: &'a [Question<'a>], wanted: &Wanted, scale_limits: (f64, f64)) -> Self {
        let objective = |question: &'a Question<'a>| {
            // The first record stands for the refractive index; a set is searched at one.
            let best = &search::best(question, 1)[0];
            let mut objective = Objective::new(question, best);
            objective.limits[SCALE] = scale_limits;
            objective
        };
        let objectives: Vec<Objective> = questions.par_iter().map(objective).collect();
        let scale = wanted.mu.is_some() && scale_limits.1 > scale_limits.0;
        let shared = [false, false, wanted.g && objectives[0].free()[G], scale];
        Self { objectives, shared, nodes: questions[0].admissible.g.clone() }
    }

    fn anisotropies(&self) -> &[f64] {
        &self.objectives[0].question.dictionary.grid().g()[self.nodes.clone()]
    }

    /// The unknowns that a channel has for itself.
    fn own(&self, objective: &Objective) -> [bool; 4] {
        let free = objective.free();
        [free[SIGMA_T], free[ALBEDO], free[G] && !self.shared[G], false]
    }

    /// Every channel's optimum with the shared unknowns as they are.
    fn at(&self, shared: Unknowns, from: &[Optimum], converged: f64) -> State {
        let follow = |(objective, from): (&Objective, &Optimum)| {
            let x = UNKNOWNS.map(|i| if self.shared[i] { shared[i] } else { from.x[i] });
            objective.descend_until(objective.clamp(x), self.own(objective), converged)
        };
        let optima: Vec<Optimum> = self.objectives.par_iter().zip(from).map(follow).collect();
        let error = optima.iter().map(|o| o.error).sum();
        State { shared, optima, error }
    }

    /// The lowest point of a mesh over the scale factors and the dictionary's anisotropies, from the best records there.
    /// With many channels some of them, evenly spaced, are enough to find it.
    fn lowest_of_mesh(&self, scales: &[f64], at_scales: &[Vec<Question>]) -> State {
        let nodes: Vec<Range<usize>> = if self.shared[G] {
            self.nodes.clone().map(|n| n..n + 1).collect()
        } else {
            vec![self.nodes.clone()]
        };
        let stride = self.objectives.len().div_ceil(MESH_CHANNELS);
        let (mut lowest, mut place) = (f64::INFINITY, (0, 0));
        for (i, scale) in scales.iter().enumerate() {
            for (k, nodes) in nodes.iter().enumerate() {
                let error = self.over_records(*scale, &at_scales[i], nodes, stride).error;
                if error < lowest {
                    (lowest, place) = (error, (i, k));
                }
            }
        }
        let (i, k) = place;
        self.over_records(scales[i], &at_scales[i], &nodes[k], 1)
    }

    /// The optima of every `stride`th channel, from its best record at a scale factor and at some of the anisotropies.
    fn over_records(&self, scale: f64, questions: &[Question], nodes: &Range<usize>, stride: usize) -> State {
        let optimum = |(objective, question): (&Objective, &Question)| {
            let best = &search::best_within(question, nodes, 1)[0];
            let mut x = objective.start(&best.medium);
            x[SCALE] = scale;
            objective.descend_until(objective.clamp(x), self.own(objective), ROUGHLY)
        };
        let pairs: Vec<_> = self.objectives.iter().zip(questions).step_by(stride).collect();
        let optima: Vec<Optimum> = pairs.into_par_iter().map(optimum).collect();
        let error = optima.iter().map(|o| o.error).sum();
        State { shared: optima[0].x, optima, error }
    }

    /// Goes down from a state, moving what is shared and `free`.
    fn descend(&self, start: &State, free: [bool; 4]) -> State {
        let mut state = self.at(start.shared, &start.optima, WELL);
        let mut shorter = 1.0;
        for _ in 0..MOST_STEPS {
            let Some(step) = self.step(&state, free) else { break };
            let there = DVec4::from(state.shared) + step * shorter;
            let next = self.at(self.objectives[0].clamp(there.into()), &state.optima, WELL);
            let gain = state.error - next.error;
            if gain > 0.0 {
                state = next;
                shorter = 1.0_f64.min(2.0 * shorter);
                if gain < WELL * state.error {
                    break;
                }
            } else {
                shorter *= 0.3;
                if shorter < 1e-3 {
                    break;
                }
            }
        }
        state
    }

    /// A Gauss–Newton step of the shared unknowns, the others following.
    fn step(&self, state: &State, free: [bool; 4]) -> Option<DVec4> {
        let descents: Vec<(Descent, DMat4)> = self
            .objectives
            .par_iter()
            .zip(&state.optima)
            .map(|(objective, optimum)| {
                let descent = Descent::new(&objective.blocks(optimum.x));
                let own = objective.inwards(optimum.x, descent.downhill, self.own(objective));
                let ridge = DMat4::from_diagonal(DVec4::splat(1e-12));
                let inverse_own = invert(descent.normal + ridge, own).unwrap_or(DMat4::ZERO);
                (descent, inverse_own)
            })
            .collect();
        let downhill = descents.iter().fold(DVec4::ZERO, |sum, (d, inverse_own)| {
            // The part of the own unknowns is zero but for what their descent left.
            sum + d.downhill - d.normal * (*inverse_own * d.downhill)
        });
        let free = self.objectives[0].inwards(state.shared, downhill, free);
        if free == [false; 4] {
            return None;
        }
        let inverse = inverse_of_shared(descents.iter().map(|(d, own)| (d.normal, *own)), free);
        Some(inverse * masked(downhill, free))
    }

    /// The error with each of the dictionary's anisotropies, going outwards from the bottom.
    fn by_g(&self, bottom: &State, base: f64) -> Vec<GError> {
        let nodes: Vec<f64> = self.anisotropies().iter().map(|g| (1.0 - g).ln()).collect();
        let mut errors: Vec<Option<GError>> = vec![None; nodes.len()];
        // ln(1 − g) falls where g rises.
        let above = nodes.partition_point(|x| *x > bottom.shared[G]);
        let walks: [Vec<usize>; 2] = [(above..nodes.len()).collect(), (0..above).rev().collect()];
        for walk in walks {
            let (mut here, mut own) = (bottom.clone(), bottom.clone());
            for n in walk {
                let mut shared = bottom.shared;
                shared[G] = nodes[n];
                here = self.at(shared, &here.optima, ROUGHLY);
                shared[SCALE] = own.shared[SCALE];
                own = self.descend(&State { shared, ..own }, [false, false, false, self.shared[SCALE]]);
                errors[n] = Some(GError {
                    g: self.anisotropies()[n],
                    error: here.error.max(own.error) / base,
                    best_mu: base * own.shared[SCALE].exp(),
                    best_mu_error: own.error / base,
                });
            }
        }
        errors.into_iter().flatten().collect()
    }
}
