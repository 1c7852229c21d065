//! Extracts some of a system's profiles as a separate system.

use nalgebra::{DMatrix, DVector};

use crate::likelihood::point::LN_SCALE;
use crate::likelihood::system::unknowns::{SceneUnknown, Unknown, eliminate};
use crate::likelihood::system::{Coupling, Normal, State, System};
use crate::likelihood::term::Term;

/// The slot of an unknown in a part with these unknowns, in ascending order.
///
/// # Panics
/// If the part does not have it.
pub(crate) fn slot_in(used: &[usize], slot: usize) -> usize {
    used.binary_search(&slot).expect("a part has the unknowns of its profiles")
}

impl System<'_> {
    /// The information of some profiles on the unknowns at a state, and their pull.
    pub(crate) fn contribution(
        &self,
        terms: &[usize],
        state: &State,
        normal: &Normal,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.unknowns.len();
        let (mut information, mut downhill) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for i in terms {
            self.add_reduced(*i, &state.x, &normal.reduced[*i], &mut information, &mut downhill);
        }
        (information, downhill)
    }

    /// The unknowns that some profiles share, and the means that the priors of these are about, in ascending order.
    pub(crate) fn used_by(&self, terms: &[usize]) -> Vec<usize> {
        let term_slots = |i: &usize| -> Vec<usize> {
            match &self.terms[*i].blend {
                None => self.slots[*i].clone(),
                Some(blend) => blend.slots().chain(self.slots[*i][LN_SCALE..].iter().copied()).collect(),
            }
        };
        let mut used: Vec<usize> = terms.iter().flat_map(term_slots).collect();
        let mut means = used.clone();
        while !means.is_empty() {
            means = means.iter().filter_map(|slot| self.unknowns[*slot].about).collect();
            means.dedup();
            used.extend(&means);
        }
        used.sort_unstable();
        used.dedup();
        used
    }

    /// Some profiles as a separate system at a state, with the others as a quadratic, weighted by `share`. Its unknowns
    /// are those of [`Self::used_by`].
    pub(crate) fn part(&self, terms: &[usize], state: &State, normal: &Normal, share: f64) -> (Self, State) {
        let used = self.used_by(terms);
        let (mut own, mut own_downhill) = self.contribution(terms, state, normal);
        for slot in &used {
            self.add_prior(*slot, &state.x, &mut own, &mut own_downhill);
        }
        let (rest, downhill) = (&normal.information - own, &normal.downhill - own_downhill);
        let others: Vec<usize> = self.free().into_iter().filter(|i| !used.contains(i)).collect();
        let (information, downhill) = eliminate(&rest, &downhill, &used, &others);
        let centre = DVector::from_iterator(used.len(), used.iter().map(|i| state.x[*i]));
        let coupling =
            Coupling { centre: centre.clone(), information: information * share, downhill: downhill * share };
        let place = |slot: &usize| slot_in(&used, *slot);
        let unknown = |i: &usize| {
            let unknown = self.unknowns[*i];
            Unknown { about: unknown.about.as_ref().map(place), ..unknown }
        };
        let term = |i: &usize| {
            let term = self.terms[*i].clone();
            Term { blend: term.blend.as_ref().map(|blend| blend.renumbered(place)), ..term }
        };
        // The medium of a mixture follows from its inks: its own slots are not read.
        let slots = |i: &usize| -> Vec<usize> {
            let unread = if self.terms[*i].blend.is_some() { LN_SCALE } else { 0 };
            let read = self.slots[*i][unread..].iter().map(place);
            std::iter::repeat_n(0, unread).chain(read).collect()
        };
        let system = Self {
            terms: terms.iter().map(term).collect(),
            surrogates: terms.iter().map(|i| self.surrogates[*i]).collect(),
            slots: terms.iter().map(slots).collect(),
            unknowns: used.iter().map(unknown).collect(),
            of_scene: self
                .of_scene
                .iter()
                .filter(|u| used.contains(&u.slot))
                .map(|u| SceneUnknown { slot: place(&u.slot), ..*u })
                .collect(),
            coupling: Some(coupling),
            most_steps: self.most_steps,
        };
        let own = terms.iter().map(|i| state.own[*i].clone()).collect();
        (system, State { end: state.end, ..State::new(centre, own) })
    }
}
