//! Decides which channels share an unknown anisotropy: none, those of a material, or those of a material and a wavelength.
//!
//! ln(1 − g) of a material is normal about the mean of all materials. Over wavelength it is a random walk from the middle
//! wavelength: neighbours differ by 0 ± s √(Δλ/100 nm).

use std::collections::BTreeMap;

use optics_model::measurement::wavelength_nm;

use crate::likelihood::problem::ChannelData;
use crate::likelihood::system::unknowns::{Unknown, Unknowns};

/// Distance of wavelengths in nm over which the change has its stated standard deviation.
const APART_NM: f64 = 100.0;

/// Anisotropies of the channels of a system under construction.
#[derive(Debug)]
pub(crate) struct Anisotropies {
    /// Whether each channel has its own.
    own: bool,
    /// Standard deviation of a material about the mean; 0 for one value of all materials.
    spread: f64,
    /// Standard deviation of the change over 100 nm, and the wavelengths, if g is a curve.
    change: f64,
    nm: Vec<f64>,
    /// Slot of the mean, once it exists.
    mean: Option<usize>,
    /// Slots of each material, one for each wavelength.
    of_materials: BTreeMap<usize, Vec<usize>>,
}

impl Anisotropies {
    /// `related` are the standard deviations of a material about the mean, and of the change over 100 nm; none if each
    /// channel has its own.
    pub(crate) fn new(channels: &[ChannelData], related: Option<[f64; 2]>) -> Self {
        let [spread, change] = related.unwrap_or_default();
        let nm = curve_nm(channels).filter(|_| change > 0.0).unwrap_or_default();
        let several = channels.iter().any(|data| data.material != channels[0].material);
        Self {
            own: related.is_none(),
            spread: if several { spread } else { 0.0 },
            change,
            nm,
            mean: None,
            of_materials: BTreeMap::new(),
        }
    }

    /// The slot of a material in a channel; new ones are like `unknown` and start at `x`.
    pub(crate) fn slot(
        &mut self,
        (material, channel): (usize, &str),
        unknowns: &mut Unknowns,
        unknown: Unknown,
        x: f64,
    ) -> usize {
        let mut add = || unknowns.add(None, unknown.limits, unknown.held, x);
        if self.own {
            return add();
        }
        let mean = *self.mean.get_or_insert_with(add);
        let is_spread = self.spread > 0.0 && !unknown.held;
        let key = if is_spread { material } else { 0 };
        if !self.of_materials.contains_key(&key) {
            let root = if is_spread { unknowns.about(mean, self.spread, unknown.limits) } else { mean };
            let curve = self.curve(root, unknowns, unknown);
            self.of_materials.insert(key, curve);
        }
        let at = wavelength_nm(channel).map_or(0, |nm| self.nm.partition_point(|at| *at < nm));
        self.of_materials[&key][at]
    }

    /// From the middle wavelength, which is `root`, the prior of each is about its neighbour.
    fn curve(&self, root: usize, unknowns: &mut Unknowns, unknown: Unknown) -> Vec<usize> {
        let mut slots = vec![root; self.nm.len().max(1)];
        let middle = self.nm.len() / 2;
        let outwards =
            (0..middle).rev().map(|i| (i, i + 1)).chain((middle + 1..self.nm.len()).map(|i| (i, i - 1)));
        for (i, inner) in outwards.filter(|_| !unknown.held) {
            let sd = self.change * ((self.nm[i] - self.nm[inner]).abs() / APART_NM).sqrt();
            slots[i] = unknowns.about(slots[inner], sd, unknown.limits);
        }
        slots
    }

    pub(crate) fn is_curve(&self) -> bool {
        !self.own && !self.nm.is_empty()
    }

    /// The mean, and the slot of each material at the middle wavelength, if they differ.
    pub(crate) fn of_materials(self) -> Option<(usize, Vec<usize>)> {
        let mean = self.mean.filter(|_| self.of_materials.len() > 1)?;
        Some((mean, self.of_materials.values().map(|slots| slots[slots.len() / 2]).collect()))
    }
}

/// The wavelengths of all channels, rising, if they are at least two.
pub(crate) fn curve_nm(channels: &[ChannelData]) -> Option<Vec<f64>> {
    let mut nm = channels.iter().map(|data| wavelength_nm(data.name)).collect::<Option<Vec<f64>>>()?;
    nm.sort_by(f64::total_cmp);
    nm.dedup();
    (nm.len() > 1).then_some(nm)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Unknowns start at the given value. Those of materials are about their mean, at the middle wavelength; the others are
    /// about their neighbours.
    #[test]
    fn curves_grow_from_the_middle() {
        let nm = vec![400.0, 500.0, 600.0, 625.0];
        let (own, mean, of_materials) = (false, None, BTreeMap::new());
        let mut anisotropies = Anisotropies { own, spread: 0.2, change: 0.1, nm, mean, of_materials };
        let mut unknowns = Unknowns::default();
        let unknown = Unknown { prior: None, about: None, limits: (-2.0, 0.0), held: false };
        let mut material_slots = |m| {
            ["400", "500", "600", "625 nm"]
                .map(|name| anisotropies.slot((m, name), &mut unknowns, unknown, -0.5))
        };
        let slots = [material_slots(0), material_slots(1)];
        assert_eq!(slots[0], material_slots(0));
        for slots in slots {
            let about = slots.map(|slot| unknowns.all[slot].about);
            assert_eq!(about, [Some(slots[1]), Some(slots[2]), Some(0), Some(slots[2])]);
            let sd = slots.map(|slot| unknowns.all[slot].prior.map_or(0.0, |(_, sd)| sd));
            for (found, expected) in sd.into_iter().zip([0.1, 0.1, 0.2, 0.05]) {
                assert!((found - expected).abs() < 1e-12, "{sd:?}");
            }
        }
        assert!(unknowns.x.iter().all(|x| *x == -0.5));
        assert_eq!(anisotropies.of_materials(), Some((0, vec![slots[0][2], slots[1][2]])));
    }
}
