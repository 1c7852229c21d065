//! Determines the media that the dictionary predicts for a slab, and the grid to compute for others.

use crate::dictionary::axes::list;
use crate::likelihood::point::{LN_SIGMA_T, ROOT_CO_ALBEDO};
use crate::likelihood::system::{State, System};
use crate::surrogate::{Surrogate, albedo, sigma_t};

/// Limits of the media that are predicted at a thickness. Albedos are continued below the least by as much as the least
/// two differ, where profiles are smooth and nearly dark.
pub(super) fn predicted(surrogate: &Surrogate, thickness_mm: f64) -> [(f64, f64); 3] {
    let [_, (bright, dark), g] = surrogate.limits();
    let axis = surrogate.grid().albedo();
    let root = |i: usize| axis.get(i).map_or(dark, |albedo| (1.0 - albedo).sqrt());
    let further = (dark + (root(0) - root(1)).max(0.0)).min(1.0);
    // Thicknesses were checked when the slabs were read.
    let along = surrogate.supported(thickness_mm).unwrap_or(surrogate.limits()[LN_SIGMA_T]);
    [along, (bright, further), g]
}

/// The reason why the dictionary does not predict a profile; None if it does.
pub(super) fn outside(system: &System, term: usize, state: &State) -> Option<String> {
    let (surrogate, term) = (system.surrogates[term], &system.terms[term]);
    let blend = term.blend.as_ref()?;
    let medium = blend.at(&state.x).medium;
    let [along, (_, dark), _] = blend.limits;
    let grid = surrogate.grid();
    let lacking = |name: &str, value: f64, axis: &[f64], range: String| {
        let value = (value * 1e4).round() / 1e4;
        format!(
            "{name} = {value} at {} mm lies outside of the dictionary's {range}: `farmctl submit GRID.toml` computes one \
             that reaches it if the grid file adds {value} to {name} = [{}]",
            term.thickness_mm,
            list(axis)
        )
    };
    if !(along.0 - 1e-9..=along.1 + 1e-9).contains(&medium[LN_SIGMA_T]) {
        let range = format!("{:.4} to {:.4} per mm", sigma_t(along.0), sigma_t(along.1));
        let axis = grid.sigma_t_per_mm();
        return Some(lacking("sigma_t_per_mm", sigma_t(medium[LN_SIGMA_T]), axis, range));
    }
    if medium[ROOT_CO_ALBEDO] > dark {
        let axis = grid.albedo();
        let range = format!("{} to {}", axis[0], axis[axis.len() - 1]);
        return Some(lacking("albedo", albedo(medium[ROOT_CO_ALBEDO]), axis, range));
    }
    None
}
