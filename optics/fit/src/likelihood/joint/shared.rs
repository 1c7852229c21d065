//! Finds the errors that the media of a joint fit share: a covariance of all of them would have a million numbers, but
//! they are correlated through few unknowns only.
//!
//! Given the unknowns that several channels have (set-up, thicknesses, g, μ), those of different channels are independent.
//! So the covariance is F Fᵀ plus a block of each channel, where F are regressions on a root of the covariance of these
//! unknowns. Of F the principal components are kept that cause nearly all of its variance.

use nalgebra::{Cholesky, DMatrix, Matrix3, RowDVector, SymmetricEigen};
use optics_model::fit::{Refined, SetUpDifference, SharedErrors};
use optics_model::scene::{Prior, PriorKind};

use super::minimum::Joint;
use crate::likelihood::system::unknowns::{SceneUnknown, submatrix};

/// Share of each variance that left-out components may cause.
const LEFT_OUT: f64 = 0.01;
/// Added to correlations, which may be singular by rounding.
const JITTER: f64 = 1e-10;

/// The errors that channels share; `refined` are their answers, whose covariances these errors are part of.
pub(super) fn shared_errors(joint: &Joint, priors: &[Prior], refined: &[&Refined]) -> SharedErrors {
    let system = &joint.assembly.system;
    let of_scene: Vec<&SceneUnknown> = system.of_scene.iter().filter(|u| is_of_print(u, priors)).collect();
    let roots = joint.covariance.as_ref().and_then(|covariance| Roots::new(joint, covariance));
    let kept = roots.map_or_else(
        || DMatrix::zeros(SharedErrors::OF_MEDIUM * refined.len() + of_scene.len(), 0),
        |roots| principal(&rows(joint, priors, refined, &of_scene, &roots), roots.shared.len()),
    );
    let sources = kept.ncols();
    let media = |channel: usize| {
        let kept = &kept;
        (0..sources).map(move |k| std::array::from_fn(|j| kept[(SharedErrors::OF_MEDIUM * channel + j, k)]))
    };
    let first = SharedErrors::OF_MEDIUM * refined.len();
    let scene = of_scene.iter().enumerate().map(|(i, u)| SetUpDifference {
        prior: u.prior,
        material: u.material,
        channel: u.channel,
        difference: priors[u.prior].std_error() * joint.state.x[u.slot],
        changes: kept.row(first + i).iter().copied().collect(),
    });
    SharedErrors { sources, media: (0..refined.len()).flat_map(media).collect(), scene: scene.collect() }
}

/// Changes by the roots: five rows of each channel, then one of each quantity of the scene.
fn rows(
    joint: &Joint,
    priors: &[Prior],
    refined: &[&Refined],
    of_scene: &[&SceneUnknown],
    roots: &Roots,
) -> Vec<RowDVector<f64>> {
    let system = &joint.assembly.system;
    let prior_index = |kind: PriorKind| priors.iter().position(|prior| prior.kind() == kind);
    let lobe = [PriorKind::SecondLobeWeight, PriorKind::SecondLobeG].map(prior_index);
    let (mut rows, mut growth) = (Vec::new(), Vec::new());
    let mut of_lobes = Vec::new();
    for (i, refined) in refined.iter().enumerate() {
        let slots = &system.slots[joint.assembly.terms[i].start];
        let own = [slots[0], slots[1], slots[2]];
        growth.extend(roots.growth(own[0], refined.covariance[0][0]));
        rows.extend(roots.of_medium(&own, &refined.covariance));
        for prior in lobe {
            let own = |u: &&SceneUnknown| Some(u.prior) == prior && slots.contains(&u.slot);
            let unknown = system.of_scene.iter().find(own);
            of_lobes.push(rows.len());
            rows.push(
                unknown
                    .map_or_else(|| roots.none(), |u| roots.regression(u.slot) * priors[u.prior].std_error()),
            );
        }
    }
    let first = rows.len();
    rows.extend(of_scene.iter().map(|u| roots.regression(u.slot) * priors[u.prior].std_error()));
    // The covariances of media contain what residuals exceed noise by. Set-up and lobes are inflated alike, so that errors
    // which cancel still do.
    growth.sort_by(f64::total_cmp);
    let factor = growth.get(growth.len() / 2).copied().unwrap_or(1.0).max(joint.disagreement).sqrt();
    of_lobes.into_iter().chain(first..rows.len()).for_each(|i| rows[i] *= factor);
    rows
}

/// Quantities that each slab has separately, of the board and of its photographs are not those of other prints, and the
/// phase function is the medium's.
fn is_of_print(unknown: &SceneUnknown, priors: &[Prior]) -> bool {
    let kind = priors[unknown.prior].kind();
    unknown.slab_mm.is_none() && !kind.is_of_phase() && !kind.is_of_base() && kind.is_traced()
}

/// Regressions of unknowns on a root of the covariance of those that several channels have.
struct Roots<'a> {
    covariance: &'a DMatrix<f64>,
    shared: Vec<usize>,
    /// Standard deviations of the shared unknowns.
    deviations: Vec<f64>,
    /// Lower root of their correlations.
    root: DMatrix<f64>,
}

impl<'a> Roots<'a> {
    fn new(joint: &Joint, covariance: &'a DMatrix<f64>) -> Option<Self> {
        let system = &joint.assembly.system;
        let mut users = vec![0; system.unknowns.len()];
        for terms in &joint.assembly.terms {
            let terms: Vec<usize> = terms.clone().collect();
            system.used_by(&terms).into_iter().for_each(|slot| users[slot] += 1);
        }
        system.of_scene.iter().for_each(|u| users[u.slot] += 1);
        let is_shared = |slot: &usize| users[*slot] > 1 && covariance[(*slot, *slot)] > 0.0;
        let shared: Vec<usize> = (0..system.unknowns.len()).filter(is_shared).collect();
        let deviations: Vec<f64> = shared.iter().map(|slot| covariance[(*slot, *slot)].sqrt()).collect();
        let mut correlations = submatrix(covariance, &shared);
        for i in 0..shared.len() {
            for j in 0..shared.len() {
                correlations[(i, j)] /= deviations[i] * deviations[j];
            }
            correlations[(i, i)] += JITTER;
        }
        let root = Cholesky::new(correlations)?.l();
        Some(Self { covariance, shared, deviations, root })
    }

    fn none(&self) -> RowDVector<f64> {
        RowDVector::zeros(self.shared.len())
    }

    /// Changes of an unknown by the sources.
    fn regression(&self, slot: usize) -> RowDVector<f64> {
        let with = |(shared, sd): (&usize, &f64)| self.covariance[(slot, *shared)] / sd;
        let mut column = nalgebra::DVector::from_iterator(
            self.shared.len(),
            self.shared.iter().zip(&self.deviations).map(with),
        );
        self.root.solve_lower_triangular_mut(&mut column);
        column.transpose()
    }

    /// Ratio of the variance in an answer to that of the joint fit; None for exact numbers.
    fn growth(&self, slot: usize, answered: f64) -> Option<f64> {
        let joint = self.covariance[(slot, slot)];
        (joint > 0.0 && answered > 0.0).then(|| answered / joint)
    }

    /// Changes of a medium whose covariance in the answer is `answered`: that of the joint fit, transformed into it.
    fn of_medium(&self, slots: &[usize; 3], answered: &[[f64; 3]; 3]) -> [RowDVector<f64>; 3] {
        let joint = Matrix3::from_fn(|i, j| self.covariance[(slots[i], slots[j])]);
        let answered = Matrix3::from_fn(|i, j| answered[i][j]);
        let regressions = slots.map(|slot| self.regression(slot));
        let Some(into) = transformation(&joint, &answered) else {
            return std::array::from_fn(|_| self.none());
        };
        std::array::from_fn(|i| (0..3).fold(self.none(), |sum, j| sum + &regressions[j] * into[(i, j)]))
    }
}

/// T with T C Tᵀ = D for covariances C and D, near 1 if they are alike. A number that is exact in one of them is exact.
fn transformation(from: &Matrix3<f64>, to: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let is_free = |i: usize| from[(i, i)] > 0.0 && to[(i, i)] > 0.0;
    let root = |of: &Matrix3<f64>| {
        let entry = |i: usize, j: usize| match () {
            () if is_free(i) && is_free(j) => of[(i, j)] * if i == j { 1.0 + JITTER } else { 1.0 },
            () => f64::from(u8::from(i == j)),
        };
        Cholesky::new(Matrix3::from_fn(entry)).map(|c| c.l())
    };
    let mut into = root(to)? * root(from)?.try_inverse()?;
    for i in (0..3).filter(|i| !is_free(*i)) {
        into.row_mut(i).fill(0.0);
        into.column_mut(i).fill(0.0);
    }
    Some(into)
}

/// The rows in their principal components: the fewest that leave out little of the variance of each.
fn principal(rows: &[RowDVector<f64>], columns: usize) -> DMatrix<f64> {
    // Channels may share nothing.
    if columns == 0 || rows.is_empty() {
        return DMatrix::zeros(rows.len(), 0);
    }
    let all = DMatrix::from_rows(rows);
    let norms: Vec<f64> = rows.iter().map(RowDVector::norm).collect();
    let mut scaled = all.clone();
    for (mut row, norm) in scaled.row_iter_mut().zip(&norms) {
        row /= if *norm > 0.0 { *norm } else { 1.0 };
    }
    let eigen = SymmetricEigen::new(scaled.transpose() * &scaled);
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let turned = &all * eigen.eigenvectors.select_columns(&order);
    let is_enough = |kept: &usize| {
        let caused = |i: usize| turned.row(i).columns(0, *kept).norm_squared();
        (0..rows.len()).all(|i| caused(i) >= (1.0 - LEFT_OUT) * norms[i] * norms[i])
    };
    let kept = (0..order.len()).find(is_enough).unwrap_or(order.len());
    turned.columns(0, kept).into_owned()
}

#[cfg(test)]
mod tests {
    use optics_model::Measurement;
    use optics_model::fit::{Bounds, FitOptions, FitSettings, MeasurePlan, SharedErrors};

    use super::super::Set;
    use super::super::tests::measured;
    use super::*;
    use crate::testing::dense;

    /// Changes of two channels have their covariance in the joint fit, and those of one channel at most its own.
    #[test]
    fn shared_errors_have_the_joint_covariance() {
        let dictionary = dense(120, 0.003);
        let settings = FitSettings { thickness_std_error_mm: 0.01, ..FitSettings::default() };
        let materials = [measured(&[0.5])];
        let set = Set::new(dictionary, &materials, &FitOptions::new(settings).unwrap()).unwrap();
        let plan = MeasurePlan::default();
        let (cells, joint) = set.search(&plan);
        let answer = set.answer(&joint, &plan, &cells);
        let errors = &answer.shared_errors;
        let covariance = joint.covariance.as_ref().unwrap();
        let changes = |channel: usize, i: usize| errors.of_channel(channel).iter().map(move |c| c[i]);
        let slot = |channel: usize, i: usize| joint.assembly.system.slots[channel][i];
        let channels = answer.materials[0].channels.iter();
        let refined: Vec<&Refined> = channels.map(|c| c.refined.as_ref().unwrap()).collect();
        let mut greatest: f64 = 0.0;
        for (a, b, i) in [(0, 1, 0), (0, 2, 0), (1, 2, 0), (0, 2, 1), (0, 1, 2)] {
            let found: f64 = changes(a, i).zip(changes(b, i)).map(|(x, y)| x * y).sum();
            let sd = |c: usize| covariance[(slot(c, i), slot(c, i))].sqrt();
            let answered = |c: usize| refined[c].covariance[i][i].sqrt();
            let expected = covariance[(slot(a, i), slot(b, i))] / sd(a) / sd(b);
            let found = found / answered(a) / answered(b);
            assert!((found - expected).abs() < 0.05, "{a} {b} {i}: {found} {expected}");
            greatest = greatest.max(expected.abs());
        }
        assert!(greatest > 0.3 && errors.sources > 0, "{errors:?}");
        for (channel, refined) in refined.iter().enumerate() {
            for i in 0..3 {
                let variance = refined.covariance[i][i];
                let caused: f64 = changes(channel, i).map(|c| c * c).sum();
                assert!(caused <= variance * (1.0 + 1e-6), "{channel} {i}: {caused} {variance}");
            }
        }
    }

    /// Gains dominate: errors of different channels have the correlation of the gains of a slab.
    #[test]
    fn gains_of_a_slab_are_correlated() {
        let dictionary = dense(120, 0.0);
        let exact = Bounds::fixed(0.3);
        let settings =
            FitSettings { gain_std_error: 0.03, g: exact, blur_std_error_mm: 0.0, ..FitSettings::default() };
        let materials = [measured(&[0.5])];
        let set = Set::new(dictionary, &materials, &FitOptions::new(settings).unwrap()).unwrap();
        let (_, joint) = set.search(&MeasurePlan::default());
        let covariance = joint.covariance.as_ref().unwrap();
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            let [i, j] = [a, b].map(|channel| joint.assembly.system.slots[channel][1]);
            let found = covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt();
            assert!((0.35..0.53).contains(&found), "{a} {b}: {found}");
        }
    }

    /// One channel with a slab of exact thickness shares nothing, and differences of the scene need no sources.
    #[test]
    fn single_channels_share_nothing() {
        assert_eq!(principal(&[RowDVector::zeros(0), RowDVector::zeros(0)], 0).shape(), (2, 0));
        let dictionary = dense(120, 0.003);
        let one = Measurement::new("m", measured(&[0.5]).profiles()[..1].to_vec()).unwrap();
        let set = Set::new(dictionary, std::slice::from_ref(&one), &FitOptions::default()).unwrap();
        let plan = MeasurePlan::default();
        let (cells, joint) = set.search(&plan);
        assert_eq!(set.answer(&joint, &plan, &cells).shared_errors, SharedErrors::default());
    }

    #[test]
    fn transformations_keep_exact_numbers() {
        let from = Matrix3::new(1.0, 0.5, 0.0, 0.5, 2.0, 0.0, 0.0, 0.0, 0.0);
        let to = from * 4.0;
        let into = transformation(&from, &to).unwrap();
        assert!((into * from * into.transpose() - to).norm() < 1e-8, "{into}");
        assert_eq!(into.row(2).norm() + into.column(2).norm(), 0.0);
        assert_eq!(SharedErrors::default().of_channel(3), &[] as &[[f64; 5]]);
    }
}
