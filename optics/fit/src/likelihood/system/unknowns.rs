//! Defines unknowns with their priors and limits, and the linear algebra of a quadratic form in them.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{Cholesky, DMatrix, DVector};
use optics_model::fit::FitSettings;

/// Ridge, added to the information of every unknown when a step is taken: undetermined unknowns must not make it singular.
const RIDGE: f64 = 1e-6;

/// The limits of an unknown without limits.
pub(crate) const ANYWHERE: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

/// A quantity that profiles share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Unknown {
    /// Mean and standard deviation of the prior.
    pub prior: Option<(f64, f64)>,
    /// The unknown that is added to the mean of the prior.
    pub about: Option<usize>,
    pub limits: (f64, f64),
    /// Whether it is held: it was given, or the dictionary has one value only.
    pub held: bool,
}

/// The unknowns of a system under construction, with their initial values.
#[derive(Debug, Default)]
pub(crate) struct Unknowns {
    pub all: Vec<Unknown>,
    pub x: Vec<f64>,
}

impl Unknowns {
    pub(crate) fn add(&mut self, prior: Option<(f64, f64)>, limits: (f64, f64), held: bool, x: f64) -> usize {
        self.all.push(Unknown { prior, about: None, limits, held });
        self.x.push(x.clamp(limits.0, limits.1));
        self.all.len() - 1
    }

    /// Adds an unknown of `sd` about another one, at which it starts.
    pub(crate) fn about(&mut self, mean: usize, sd: f64, limits: (f64, f64)) -> usize {
        let slot = self.add(Some((0.0, sd)), limits, sd == 0.0, self.x[mean]);
        self.all[slot].about = Some(mean);
        slot
    }

    /// Adds an unknown that starts at the mean of its prior, and is held there if the prior is exact.
    pub(crate) fn known(&mut self, prior: (f64, f64), limits: (f64, f64)) -> usize {
        self.add(Some(prior), limits, prior.1 == 0.0, prior.0)
    }
}

/// Standard deviation of the mean over all slabs of a session, and of a slab's difference from it, over that of the prior
/// of a quantity that each slab has separately. Slabs are mounted in the same way: their values have a correlation of ½.
/// Likewise for the mean over the channels of a slab.
pub(crate) const OF_MEAN: f64 = FRAC_1_SQRT_2;

/// Mean and standard deviation of the logarithm of a slab's thickness.
pub(crate) fn thickness_prior(thickness_mm: f64, set_up: &FitSettings) -> (f64, f64) {
    (libm::log(thickness_mm), set_up.thickness_std_error_mm / thickness_mm)
}

/// An uncertain quantity of the scene among the unknowns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SceneUnknown {
    /// Index into the scene's priors.
    pub prior: usize,
    /// The material that it belongs to; none if it is common to the session.
    pub material: Option<usize>,
    /// Thickness of the slab that it belongs to.
    pub slab_mm: Option<f64>,
    /// The scene's channel that it belongs to.
    pub channel: Option<usize>,
    pub slot: usize,
    /// Whether its prior is a measurement of the session.
    pub is_measured: bool,
}

/// Indices of the unknowns that can move.
pub(crate) fn free(unknowns: &[Unknown]) -> Vec<usize> {
    (0..unknowns.len()).filter(|i| !unknowns[*i].held).collect()
}

pub(crate) fn clamped(unknowns: &[Unknown], mut x: DVector<f64>) -> DVector<f64> {
    for (x, unknown) in x.iter_mut().zip(unknowns) {
        *x = x.clamp(unknown.limits.0, unknown.limits.1);
    }
    x
}

/// The step to the minimum of a quadratic, over the unknowns that can move and are not pulled over their limits. An
/// unknown that the step would push over a limit stops there, and the others follow.
pub(crate) fn limited_step(
    unknowns: &[Unknown],
    x: &DVector<f64>,
    information: &DMatrix<f64>,
    downhill: &DVector<f64>,
) -> Option<DVector<f64>> {
    let inwards = |i: &usize| {
        let (low, high) = unknowns[*i].limits;
        !((x[*i] <= low && downhill[*i] < 0.0) || (x[*i] >= high && downhill[*i] > 0.0))
    };
    let mut moving: Vec<usize> = free(unknowns).into_iter().filter(inwards).collect();
    let mut step = DVector::zeros(x.len());
    loop {
        let pull = downhill - information * &step;
        let mut matrix = submatrix(information, &moving);
        (0..moving.len()).for_each(|i| matrix[(i, i)] += RIDGE);
        let solved = Cholesky::new(matrix)?.solve(&subvector(&pull, &moving));
        let before = moving.len();
        let mut at = 0;
        moving.retain(|i| {
            let (low, high) = unknowns[*i].limits;
            let to = x[*i] + solved[at];
            at += 1;
            let stays = (low..=high).contains(&to);
            if !stays {
                step[*i] = to.clamp(low, high) - x[*i];
            }
            stays
        });
        if moving.len() == before {
            moving.iter().zip(solved.iter()).for_each(|(i, s)| step[*i] = *s);
            return Some(step);
        }
    }
}

/// The inverse of an information matrix over the unknowns that can move, with `ridge` added to the diagonal; zeros
/// elsewhere.
pub(crate) fn inverse_over_free(
    unknowns: &[Unknown],
    information: &DMatrix<f64>,
    ridge: f64,
) -> Option<DMatrix<f64>> {
    inverse_over(&free(unknowns), information, ridge)
}

/// The inverse over the unknowns of these indices; zeros elsewhere.
pub(crate) fn inverse_over(
    indices: &[usize],
    information: &DMatrix<f64>,
    ridge: f64,
) -> Option<DMatrix<f64>> {
    let mut matrix = submatrix(information, indices);
    (0..indices.len()).for_each(|i| matrix[(i, i)] += ridge);
    let small = Cholesky::new(matrix)?.inverse();
    let mut whole = DMatrix::zeros(information.nrows(), information.nrows());
    for (i, to_i) in indices.iter().enumerate() {
        for (j, to_j) in indices.iter().enumerate() {
            whole[(*to_i, *to_j)] = small[(i, j)];
        }
    }
    Some(whole)
}

/// The rows and columns of these indices.
pub(crate) fn submatrix(matrix: &DMatrix<f64>, indices: &[usize]) -> DMatrix<f64> {
    DMatrix::from_fn(indices.len(), indices.len(), |i, j| matrix[(indices[i], indices[j])])
}

/// The elements of these indices.
pub(crate) fn subvector(vector: &DVector<f64>, indices: &[usize]) -> DVector<f64> {
    DVector::from_iterator(indices.len(), indices.iter().map(|i| vector[*i]))
}

/// The quadratic over some unknowns that remains after the elimination of others.
pub(crate) fn eliminate(
    information: &DMatrix<f64>,
    downhill: &DVector<f64>,
    kept: &[usize],
    others: &[usize],
) -> (DMatrix<f64>, DVector<f64>) {
    let inner = submatrix(information, kept);
    let part = |indices: &[usize]| subvector(downhill, indices);
    let mixed = DMatrix::from_fn(others.len(), kept.len(), |i, k| information[(others[i], kept[k])]);
    let ridge = DMatrix::identity(others.len(), others.len()) * 1e-9;
    match Cholesky::new(submatrix(information, others) + ridge) {
        Some(root) if !others.is_empty() => (
            inner - mixed.transpose() * root.solve(&mixed),
            part(kept) - mixed.transpose() * root.solve(&part(others)),
        ),
        _ => (inner, part(kept)),
    }
}
