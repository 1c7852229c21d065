//! The thicknesses of a dictionary for slabs: nominal ones, so that laboratories with nearly the same slabs share it.

use optics_model::grid::{Axes, NoiseLevel};
use optics_model::{Grid, Invalid, Scene};

use crate::grid_file::with_responses;

/// Thicknesses that differ by less than this factor share a thickness of the dictionary: the fit allows for much more.
const ALIKE: f64 = 1.04;
/// A thickness that differs from one of these in mm, or from twice another one, by less than this factor is
/// replaced by it: sessions with slabs of the same nominal thickness share a dictionary, and slabs of the same optical
/// thickness their walks.
const NEAR: f64 = 1.03;
const NOMINAL_MM: [f64; 14] = [0.1, 0.2, 0.25, 0.3, 0.4, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 5.0];

/// The grid of `lab` for slabs of these thicknesses, with responses.
///
/// # Errors
/// If the optical thickness of a slab is beyond what is traced.
pub fn slab_grid(thicknesses: Vec<f64>) -> Result<Grid, Invalid> {
    let axes = Axes { thickness_mm: dictionary_mm(thicknesses), ..Axes::lab() };
    with_responses(Grid::new(Scene::lab(), axes, NoiseLevel::Paper, 1, false)?)
}

/// The midpoints of groups of thicknesses that are nearly alike, or a nominal thickness, or twice another, near that.
pub(crate) fn dictionary_mm(mut thicknesses: Vec<f64>) -> Vec<f64> {
    thicknesses.sort_by(f64::total_cmp);
    let mut groups: Vec<[f64; 2]> = Vec::new();
    for t in thicknesses {
        match groups.last_mut() {
            Some(group) if t <= ALIKE * group[0] => group[1] = t,
            _ => groups.push([t, t]),
        }
    }
    let mut axis: Vec<f64> =
        groups.into_iter().map(|[from, to]| (1e4 * f64::midpoint(from, to)).round() / 1e4).collect();
    for i in 0..axis.len() {
        let next = axis.get(i + 1).copied().unwrap_or(f64::INFINITY);
        let before = if i == 0 { 0.0 } else { axis[i - 1] };
        let is_near = |t: &f64| libm::log(axis[i] / t).abs() < libm::log(NEAR);
        // The axis must rise.
        let fits = |t: &f64| before < *t && *t < next;
        let doubles = axis[..i].iter().map(|t| 2.0 * t);
        let other = NOMINAL_MM.into_iter().chain(doubles).find(|t| is_near(t) && fits(t));
        axis[i] = other.unwrap_or(axis[i]);
    }
    axis
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearly_equal_slabs_share_a_dictionary_thickness() {
        assert_eq!(dictionary_mm(vec![1.01, 0.512, 0.5, 0.498]), [0.5, 1.0]);
        assert_eq!(dictionary_mm(vec![0.62, 0.55]), [0.55, 0.62]);
        // The thickest is twice another one.
        assert_eq!(dictionary_mm(vec![0.512, 0.64, 1.006, 1.3]), [0.5, 0.64, 1.0, 1.28]);
        // Two thicknesses near a nominal one or near twice another stay apart.
        assert_eq!(dictionary_mm(vec![0.512, 1.006, 1.05]), [0.5, 1.0, 1.05]);
        assert_eq!(dictionary_mm(vec![0.45, 0.88, 0.923]), [0.45, 0.9, 0.923]);
    }

    /// The grid for the slabs of `lab` is that of `lab`.
    #[test]
    fn usual_slabs_have_the_usual_grid() {
        assert_eq!(slab_grid(vec![1.01, 0.5]).unwrap(), with_responses(Grid::lab()).unwrap());
        assert!(slab_grid(vec![1e6]).is_err());
    }
}
