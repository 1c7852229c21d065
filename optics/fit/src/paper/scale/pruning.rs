//! Finds the media that may be the best at some scale factor, by lower bounds of their distances.
//!
//! A norm of μa − s changes by at most |μ' − μ| ‖a‖ between two factors. So from a lower bound at one μ follow bounds at
//! those near by, and likewise an upper bound of the least error.

use crate::dictionary::view::PairDescription;
use crate::dictionary::wide::wide;
use crate::paper::question::Question;
use crate::paper::scale::Scalable;
use crate::paper::search::bounds;

/// Number of successive factors that are bounded together.
const TOGETHER: usize = 8;
/// Rounding error of a distance by its closed form, which is greatest where the fit is perfect, as a share of the norms.
const ROUNDING: f64 = 1e-6;

/// Whether each medium may have the least error of all media of its anisotropy at one of the factors, which ascend.
pub(super) fn possible(question: &Question, terms: &[Scalable], mu: &[f64]) -> Vec<bool> {
    question.dictionary.stop.check();
    let grid = question.dictionary.grid();
    let mut possible = vec![false; grid.record_count() / grid.thickness_mm().len()];
    let lambda = question.options.settings().lambda;
    let norms: f64 = terms.iter().map(|t| t.value_square.sqrt() + lambda * t.gradient_square.sqrt()).sum();
    for near in mu.chunks(TOGETHER) {
        let middle = near[near.len() / 2];
        let furthest = (middle - near[0]).max(near[near.len() - 1] - middle);
        let slack = norms * (2.0 * furthest + ROUNDING);
        let described: Vec<PairDescription> = terms.iter().map(|t| t.term.described_at(middle)).collect();
        let targets: Vec<&PairDescription> = described.iter().collect();
        for g in question.admissible.g.clone() {
            let bounds = bounds(question, &targets, &(g..g + 1));
            let lowest = bounds.iter().min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, lowest)) = lowest else { continue };
            let most = error(question, terms, *lowest as usize, middle) + slack;
            let kept = bounds.iter().filter(|(bound, _)| f64::from(*bound) <= most);
            kept.for_each(|(_, medium)| possible[*medium as usize] = true);
        }
    }
    possible
}

/// Σ d(μ F_A, F_S) of a medium.
fn error(question: &Question, terms: &[Scalable], medium: usize, mu: f64) -> f64 {
    let (place, lambda) = (question.place(medium), question.options.settings().lambda);
    let mut error = [0.0];
    for scalable in terms {
        let (values, gradient) = scalable.term.view.profile(question.record(scalable.term, place));
        wide(
            #[inline(always)]
            || scalable.add_distances(&values, &gradient, lambda, &[mu], &mut error),
        );
    }
    error[0]
}

#[cfg(test)]
mod tests {
    use optics_model::fit::FitOptions;

    use super::*;
    use crate::paper::question::questions;
    use crate::testing::{dense, noisy_measurement};

    /// With each anisotropy, media that are left out have greater errors than one that is not, at every factor; those are
    /// most of all media.
    #[test]
    fn best_media_are_never_left_out() {
        let dictionary = dense(120, 0.002);
        let mu: Vec<f64> = (0..60).map(|i| 0.85 + 0.005 * f64::from(i)).collect();
        let (mut kept, mut all) = (0, 0);
        for (medium, seed) in [((2.117, 0.99, 0.3), 1), ((4.17, 0.2, 0.1), 2)] {
            let measured = noisy_measurement(medium, seed, false);
            let question = questions(dictionary, &measured, &FitOptions::default()).unwrap().remove(0);
            let terms: Vec<Scalable> = question.terms.iter().map(Scalable::new).collect();
            let possible = possible(&question, &terms, &mu);
            for g in question.admissible.g.clone() {
                let media: Vec<usize> = question.media(&(g..g + 1)).into_iter().flatten().collect();
                for mu in &mu {
                    let errors = media.iter().map(|medium| (error(&question, &terms, *medium, *mu), medium));
                    let best = errors.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
                    assert!(possible[*best.1], "g {g}, μ {mu}: {best:?}");
                }
                kept += media.iter().filter(|medium| possible[**medium]).count();
                all += media.len();
            }
        }
        assert!(2 * kept < all, "{kept} of {all} are kept");
    }
}
