//! Intervals: how far a quantity can be moved, all else following, before −2 ln L has risen by 1.96².

use nalgebra::DMatrix;
use optics_model::fit::Interval;

use super::system::{Held, Normal, Quantity, State, System};
use crate::intervals::Z;

/// Cost by which descents may miss their minimum.
const TOLERANCE: f64 = 0.02;
/// Share of the wanted rise that an end may be off by.
const CLOSE: f64 = 0.08;
/// Most places that are tried on each side.
const TRIALS: usize = 12;

/// One end of an interval; open if a limit comes first.
#[derive(Debug, Clone, Copy)]
pub(super) struct End {
    pub value: f64,
    pub open: bool,
}

/// A minimum, and how far things may rise from it.
#[derive(Debug)]
pub(super) struct Profile<'a> {
    pub system: &'a System<'a>,
    pub optimum: &'a State,
    /// At the optimum.
    pub normal: &'a Normal,
    pub covariance: &'a DMatrix<f64>,
    /// Factor on the rise that noise alone allows, where residuals are larger than their noise.
    pub inflation: f64,
}

impl Profile<'_> {
    /// Both ends for a quantity, within limits.
    pub(super) fn ends(&self, quantity: Quantity, limits: (f64, f64)) -> [End; 2] {
        let gradient = quantity.gradient(&self.optimum.x);
        let variance = gradient.dot(&(self.covariance * &gradient));
        if variance <= 0.0 {
            // It is held.
            let value = quantity.value(&self.optimum.x);
            return [End { value, open: false }; 2];
        }
        let deviation = variance.sqrt();
        [self.end(quantity, deviation, -1.0, limits.0), self.end(quantity, deviation, 1.0, limits.1)]
    }

    fn end(&self, quantity: Quantity, deviation: f64, side: f64, limit: f64) -> End {
        let from = quantity.value(&self.optimum.x);
        let furthest = (side * (limit - from)).max(0.0);
        let open = End { value: limit, open: true };
        if furthest <= 0.0 || !deviation.is_finite() {
            return open;
        }
        let wanted = Z * self.inflation.sqrt();
        let stiffness = 1e6 / (deviation * deviation);
        let mut warm: Option<State> = None;
        let root_rise = |distance: f64, warm: &mut Option<State>| {
            let at = from + side * distance;
            let held = Held { quantity, at, stiffness };
            let from = self.along(warm.as_ref().unwrap_or(self.optimum), quantity, at);
            let found = self.system.descend(from, Some(&held), TOLERANCE);
            let rise = (found.cost - self.optimum.cost).max(0.0).sqrt();
            *warm = Some(found);
            rise
        };
        match reach(wanted, deviation, furthest, |distance| root_rise(distance, &mut warm)) {
            Some(distance) => {
                // Where another quantity cannot follow any further, the dictionary ends the interval, not the data.
                let open = warm.as_ref().is_some_and(|state| self.system.at_end(state, quantity));
                End { value: from + side * distance, open }
            }
            None => open,
        }
    }

    /// A state, moved as it would follow the quantity if all were linear.
    fn along(&self, from: &State, quantity: Quantity, at: f64) -> State {
        let mut state = from.clone();
        let gradient = quantity.gradient(&state.x);
        let direction = self.covariance * &gradient;
        let step =
            direction * ((at - quantity.value(&state.x)) / gradient.dot(&(self.covariance * &gradient)));
        self.system.advance(&mut state, self.normal, &step);
        state
    }
}

/// At which distance the root of the rise is the wanted one; none if it is not up to the furthest. At `deviation` it is
/// one if all is linear.
pub(super) fn reach(
    wanted: f64,
    deviation: f64,
    furthest: f64,
    mut root_rise: impl FnMut(f64) -> f64,
) -> Option<f64> {
    // The root of the rise is close to linear in the distance.
    let (mut inside, mut outside) = ((0.0, 0.0), None);
    let mut distance = (wanted * deviation).min(furthest);
    for _ in 0..TRIALS {
        let rise = root_rise(distance);
        if (rise / wanted - 1.0).abs() < CLOSE {
            return Some((distance * wanted / rise).min(furthest));
        }
        if rise < wanted {
            if distance >= furthest {
                return None;
            }
            inside = (distance, rise);
        } else {
            outside = Some((distance, rise));
        }
        distance = match outside {
            Some((far, high)) => {
                let share = (wanted - inside.1) / (high - inside.1).max(1e-12);
                inside.0 + share.clamp(0.05, 0.95) * (far - inside.0)
            }
            None => (distance * (wanted / rise.max(0.2 * wanted)).min(3.0) * 1.02).min(furthest),
        };
    }
    // What never rose enough has no end that was found.
    outside.map(|_| distance)
}

/// The interval of a parameter from the ends of its coordinate.
pub(super) fn interval([low, high]: [End; 2], forward: impl Fn(f64) -> f64, falls: bool) -> Interval {
    let (low, high) = if falls { (high, low) } else { (low, high) };
    Interval { low: forward(low.value), high: forward(high.value), open_low: low.open, open_high: high.open }
}
