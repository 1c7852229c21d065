//! Searches all records (Eq. 1): for every channel the media that explain all its thicknesses best.
//!
//! The answer equals that of a comparison with every record, but most records are ruled out by a lower bound of their
//! distance (see `sketch`): a medium is left out only if its bound exceeds the error of the last requested medium.

use std::ops::Range;

use optics_model::fit::Candidate;

use crate::dictionary::view::PairDescription;
use crate::dictionary::wide::wide;
use crate::paper::question::{ComparedProfile, Question};

/// Number of media that are compared before any can be ruled out.
const FIRST_LOOK: usize = 8;

/// A medium and its error, ordered by error, then by record.
#[derive(Debug, Clone, Copy)]
struct Compared {
    error: f64,
    medium: usize,
}

impl Compared {
    fn precedes(&self, other: &Self) -> bool {
        self.error.total_cmp(&other.error).then(self.medium.cmp(&other.medium)).is_lt()
    }
}

/// The best media, best first; equal errors are in the order of the records.
pub(crate) fn best(question: &Question, top: usize) -> Vec<Candidate> {
    best_within(question, &question.admissible.g, top)
}

/// The best media among those of a range of the grid's anisotropies.
pub(crate) fn best_within(question: &Question, g: &Range<usize>, top: usize) -> Vec<Candidate> {
    // Cancellation is checked first: gradients without descriptions are described below.
    question.dictionary.stop.check();
    let targets: Vec<&PairDescription> = question.terms.iter().map(ComparedProfile::description).collect();
    let mut media: Vec<(f32, u32)> = bounds(question, &targets, g);
    let mut kept = KeptMedia { top: top.min(media.len()), compared: Vec::new() };
    let compare = |medium: u32| {
        let medium = medium as usize;
        Compared { error: question.error(question.place(medium)), medium }
    };
    let first_look = FIRST_LOOK.max(kept.top).min(media.len());
    if first_look < media.len() {
        media.select_nth_unstable_by(first_look, |a, b| a.0.total_cmp(&b.0));
    }
    for (_, medium) in &media[..first_look] {
        kept.offer(compare(*medium));
    }
    let mut rest: Vec<(f32, u32)> =
        media[first_look..].iter().copied().filter(|(bound, _)| kept.may_hold(*bound)).collect();
    rest.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    for (bound, medium) in rest {
        if !kept.may_hold(bound) {
            break;
        }
        kept.offer(compare(medium));
    }
    kept.compared.into_iter().map(|c| question.candidate(question.place(c.medium))).collect()
}

/// The best media so far, in order.
struct KeptMedia {
    top: usize,
    compared: Vec<Compared>,
}

impl KeptMedia {
    fn offer(&mut self, new: Compared) {
        let place = self.compared.partition_point(|c| c.precedes(&new));
        if place < self.top {
            self.compared.insert(place, new);
            self.compared.truncate(self.top);
        }
    }

    /// Whether a medium with this lower bound could still be among the best.
    fn may_hold(&self, bound: f32) -> bool {
        self.compared.len() < self.top || f64::from(bound) <= self.compared[self.top - 1].error
    }
}

/// Lower bounds of Eq. 1 for all admissible media, given descriptions of the measured profiles.
pub(super) fn bounds(question: &Question, targets: &[&PairDescription], g: &Range<usize>) -> Vec<(f32, u32)> {
    let lambda = question.options.settings().lambda;
    let mut media = Vec::new();
    let mut bounds = Vec::new();
    for range in question.media(g) {
        bounds.clear();
        bounds.resize(range.len(), 0.0_f32);
        for (term, target) in question.terms.iter().zip(targets) {
            let sketch = term.view.sketch(term.thickness);
            wide(
                #[inline(always)]
                || sketch.add_bounds(target, lambda, range.start, &mut bounds),
            );
        }
        // A sum of many terms rounds by less than this.
        let safe = |bound: f32| bound * (1.0 - 1e-5);
        media.extend(bounds.iter().zip(range).map(|(bound, medium)| (safe(*bound), medium as u32)));
    }
    media
}

#[cfg(test)]
mod tests;
