//! Intervals of an ink: how far a quantity can be moved, all else following, before −2 ln L has risen by 1.96².

use nalgebra::DMatrix;
use optics_model::fit::{Interval, Z};

use super::blend::{Ink, InkQuantity};
use super::system::{Chart, Held};
use crate::likelihood::profile::{End, interval, reach};
use crate::likelihood::system::State;
use crate::surrogate::{albedo, g};

/// Cost by which descents may miss their minimum.
const TOLERANCE: f64 = 0.02;

/// A minimum, and how far things may rise from it.
#[derive(Debug)]
pub(super) struct Profile<'a> {
    pub chart: &'a Chart<'a>,
    pub optimum: &'a State,
    pub covariance: &'a DMatrix<f64>,
    /// Factor on the rise that noise alone allows, where measurements disagree by more than their noise.
    pub inflation: f64,
}

/// The intervals of an ink's σ_t, α, g, σ_s (1 − g) and σ_a.
#[derive(Debug)]
pub(super) struct InkIntervals {
    pub sigma_t_per_mm: Interval,
    pub albedo: Interval,
    pub g: Interval,
    pub reduced_scattering_per_mm: Interval,
    pub absorption_per_mm: Interval,
}

impl Profile<'_> {
    pub(super) fn intervals(&self, ink: Ink, common_g: Option<Interval>) -> InkIntervals {
        let [s, a, g_] = ink.map(|slot| self.chart.unknowns[slot].limits);
        let limits =
            [(s.0 + a.0 * a.0, s.1 + a.1 * a.1), (0.0, 1.0), g_, (s.0 * g_.0.exp(), s.1 * g_.1.exp()), a];
        let [of_sigma_t, of_root, of_g, of_reduced, of_absorption] = InkQuantity::all(ink);
        let ends = |quantity, i: usize| self.ends(quantity, limits[i]);
        let positive = |v: f64| v.max(0.0);
        InkIntervals {
            sigma_t_per_mm: from_nothing(interval(ends(of_sigma_t, 0), positive, false)),
            albedo: Interval {
                open_high: false,
                ..from_nothing(interval(ends(of_root, 1), |x| albedo(x.clamp(0.0, 1.0)), true))
            },
            g: common_g.unwrap_or_else(|| interval(ends(of_g, 2), g, true)),
            reduced_scattering_per_mm: from_nothing(interval(ends(of_reduced, 3), positive, false)),
            absorption_per_mm: from_nothing(interval(ends(of_absorption, 4), |x| positive(x).powi(2), false)),
        }
    }

    fn ends(&self, quantity: InkQuantity, limits: (f64, f64)) -> [End; 2] {
        let gradient = quantity.gradient(&self.optimum.x);
        let variance = gradient.dot(&(self.covariance * &gradient));
        if variance <= 0.0 {
            let value = quantity.value(&self.optimum.x);
            return [End { value, open: false }; 2];
        }
        [(-1.0, limits.0), (1.0, limits.1)]
            .map(|(side, limit)| self.end(quantity, variance.sqrt(), side, limit))
    }

    fn end(&self, quantity: InkQuantity, deviation: f64, side: f64, limit: f64) -> End {
        let from = quantity.value(&self.optimum.x);
        let furthest = (side * (limit - from)).max(0.0);
        if furthest <= 0.0 || !deviation.is_finite() {
            return End { value: limit, open: true };
        }
        let wanted = Z * self.inflation.sqrt();
        let stiffness = 1e6 / (deviation * deviation);
        let mut warm = self.optimum.clone();
        let root_rise = |distance: f64| {
            let held = Held { quantity, at: from + side * distance, stiffness };
            let found = self.chart.descend(self.along(&warm, quantity, held.at), Some(&held), TOLERANCE);
            let rise = (found.cost - self.optimum.cost).max(0.0).sqrt();
            warm = found;
            rise
        };
        match reach(wanted, deviation, furthest, root_rise) {
            Some(distance) => End { value: from + side * distance, open: false },
            None => End { value: limit, open: true },
        }
    }

    /// The state moved along the likeliest way to where the quantity is wanted.
    fn along(&self, state: &State, quantity: InkQuantity, at: f64) -> State {
        let gradient = quantity.gradient(&state.x);
        let way = self.covariance * &gradient;
        let size = gradient.dot(&way);
        let mut moved = state.clone();
        if size > 0.0 {
            moved.x += way * ((at - quantity.value(&state.x)) / size);
            for (x, unknown) in moved.x.iter_mut().zip(&self.chart.unknowns) {
                *x = x.clamp(unknown.limits.0, unknown.limits.1);
            }
        }
        moved
    }
}

/// Nothing scatters or absorbs less than nothing: where a search ends there, the lower end is one of the quantity.
fn from_nothing(found: Interval) -> Interval {
    Interval { open_low: false, ..found }
}
