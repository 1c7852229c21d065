//! Decides which channels share an unknown anisotropy: none, all, or those of one wavelength.
//!
//! Over wavelength ln(1 − g) is a random walk from the middle wavelength: neighbours differ by 0 ± s √(Δλ/100 nm).

use optics_model::measurement::wavelength_nm;

use crate::likelihood::problem::ChannelData;
use crate::likelihood::system::unknowns::{Unknown, Unknowns};

/// Distance of wavelengths in nm over which the change has its stated standard deviation.
const APART_NM: f64 = 100.0;

/// Anisotropies of the channels of a system under construction.
#[derive(Debug)]
pub(crate) enum Anisotropies {
    /// Each channel has its own.
    Own,
    /// All have one; its slot, once it exists.
    One(Option<usize>),
    /// A curve over wavelength.
    Curve(GCurve),
}

/// ln(1 − g) at each wavelength.
#[derive(Debug)]
pub(crate) struct GCurve {
    nm: Vec<f64>,
    /// Standard deviation of the change over 100 nm.
    change: f64,
    /// One for each wavelength, once they exist.
    slots: Vec<usize>,
}

impl Anisotropies {
    pub(crate) fn new(channels: &[ChannelData], is_common: bool, change: f64) -> Self {
        match curve_nm(channels).filter(|_| change > 0.0) {
            _ if !is_common => Self::Own,
            Some(nm) => Self::Curve(GCurve { nm, change, slots: Vec::new() }),
            None => Self::One(None),
        }
    }

    /// The slot of a channel; new ones are like `unknown` and start at `x`.
    pub(crate) fn slot(&mut self, channel: &str, unknowns: &mut Unknowns, unknown: Unknown, x: f64) -> usize {
        let mut add = || unknowns.add(None, unknown.limits, unknown.held, x);
        match self {
            Self::Own => add(),
            Self::One(slot) => *slot.get_or_insert_with(add),
            Self::Curve(curve) => {
                if curve.slots.is_empty() {
                    curve.add_to(unknowns, unknown, x);
                }
                let nm = wavelength_nm(channel).expect("all channels of a curve are wavelengths");
                curve.slots[curve.nm.partition_point(|at| *at < nm)]
            }
        }
    }
}

impl GCurve {
    /// The middle wavelength is free; from it the prior of each is about its neighbour.
    fn add_to(&mut self, unknowns: &mut Unknowns, unknown: Unknown, x: f64) {
        let middle = self.nm.len() / 2;
        let root = unknowns.add(None, unknown.limits, unknown.held, x);
        self.slots = vec![root; self.nm.len()];
        if unknown.held {
            return;
        }
        let outwards =
            (0..middle).rev().map(|i| (i, i + 1)).chain((middle + 1..self.nm.len()).map(|i| (i, i - 1)));
        for (i, inner) in outwards {
            let sd = self.change * ((self.nm[i] - self.nm[inner]).abs() / APART_NM).sqrt();
            self.slots[i] = unknowns.about(self.slots[inner], sd, unknown.limits);
        }
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

    /// Unknowns start at the given value; those next to the middle are about it, the others about their neighbours.
    #[test]
    fn curves_grow_from_the_middle() {
        let curve = GCurve { nm: vec![400.0, 500.0, 600.0, 625.0], change: 0.1, slots: Vec::new() };
        let (mut anisotropies, mut unknowns) = (Anisotropies::Curve(curve), Unknowns::default());
        let unknown = Unknown { prior: None, about: None, limits: (-2.0, 0.0), held: false };
        let slots =
            ["400", "500", "600", "625 nm"].map(|name| anisotropies.slot(name, &mut unknowns, unknown, -0.5));
        let about = slots.map(|slot| unknowns.all[slot].about);
        assert_eq!(about, [Some(slots[1]), Some(slots[2]), None, Some(slots[2])]);
        let sd = slots.map(|slot| unknowns.all[slot].prior.map_or(0.0, |(_, sd)| sd));
        for (found, expected) in sd.into_iter().zip([0.1, 0.1, 0.0, 0.05]) {
            assert!((found - expected).abs() < 1e-12, "{sd:?}");
        }
        assert!(unknowns.x.iter().all(|x| *x == -0.5));
    }
}
