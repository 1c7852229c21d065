//! Computes intervals: the values of a quantity for which −2 ln L, minimised over all else, rises by at most 1.96².

use nalgebra::{DMatrix, DVector};
use optics_model::fit::{Interval, Z};

use crate::likelihood::point::Line;
use crate::likelihood::system::minimum::HeldQuantity;
use crate::likelihood::system::quantity::Quantity;
use crate::likelihood::system::unknowns::{Unknown, free, inverse_over};
use crate::likelihood::system::{Normal, State, System};

/// Cost by which descents may miss their minimum.
const TOLERANCE: f64 = 0.02;
/// Relative tolerance of the root of the rise at an end.
const CLOSE: f64 = 0.08;
/// Share of a distance to which an end is bracketed at most: where descents end in kinks, the rise may have a jump there.
const NARROW: f64 = 0.01;
/// Maximum number of places that are tried on each side.
const TRIALS: usize = 12;
/// Stiffness of the penalty that holds a quantity, over its information.
const STIFF: f64 = 1e6;
/// Maximum number of places at which the quadratic is evaluated on the way to an end.
const LOOKS: usize = 40;
/// Steps may grow by this factor.
const LONGER: f64 = 1.5;
/// An end that the quadratic at the optimum predicts is certain if the quadratic there agrees to this share of the way, and
/// promises no larger fall of −2 ln L than this by other unknowns.
const CERTAIN: (f64, f64) = (0.03, 0.01);
/// An end by the quadratic is accepted after a step of at most this share of the way, if no other unknowns would lower
/// −2 ln L by more than this.
const GOOD: (f64, f64) = (0.1, 0.3);

/// One end of an interval; open if a limit comes first.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IntervalEnd {
    pub value: f64,
    pub open: bool,
}

/// A minimum, and the factor on the rise that intervals allow.
#[derive(Debug)]
pub(crate) struct ProfileLikelihood<'a> {
    pub system: &'a System<'a>,
    pub optimum: &'a State,
    /// At the optimum.
    pub normal: &'a Normal,
    pub covariance: &'a DMatrix<f64>,
    /// Factor on the rise that noise alone allows, where residuals are larger than their noise.
    pub inflation: f64,
}

impl ProfileLikelihood<'_> {
    /// Both ends for a quantity, within limits.
    pub(crate) fn ends(&self, quantity: Quantity, limits: (f64, f64)) -> [IntervalEnd; 2] {
        let gradient = quantity.gradient(&self.optimum.x);
        let variance = gradient.dot(&(self.covariance * &gradient));
        if variance <= 0.0 {
            // The quantity is held.
            let value = quantity.value(&self.optimum.x);
            return [IntervalEnd { value, open: false }; 2];
        }
        let deviation = variance.sqrt();
        [self.end(quantity, deviation, -1.0, limits.0), self.end(quantity, deviation, 1.0, limits.1)]
    }

    fn end(&self, quantity: Quantity, deviation: f64, side: f64, limit: f64) -> IntervalEnd {
        let from = quantity.value(&self.optimum.x);
        let furthest = (side * (limit - from)).max(0.0);
        let open = IntervalEnd { value: limit, open: true };
        if furthest <= 0.0 || !deviation.is_finite() {
            return open;
        }
        let wanted = Z * self.inflation.sqrt();
        let stiffness = STIFF / (deviation * deviation);
        let found = self.by_parabolas(quantity, wanted, side, furthest);
        let confirm = |found: EndByParabolas| match found {
            EndByParabolas { at, certain: true, .. } => Some(IntervalEnd { value: at, open: false }),
            EndByParabolas { state, at, .. } => {
                self.confirmed(state, &HeldQuantity { quantity, at, stiffness }, wanted)
            }
        };
        if let Some(end) = found.and_then(confirm) {
            return end;
        }
        let mut warm: Option<State> = None;
        let root_rise = |distance: f64, warm: &mut Option<State>| {
            let at = from + side * distance;
            let held = HeldQuantity { quantity, at, stiffness };
            let from = self.along(warm.as_ref().unwrap_or(self.optimum), quantity, at);
            let found = self.system.descend(from, Some(&held), TOLERANCE);
            let rise = (found.cost - self.optimum.cost).max(0.0).sqrt();
            *warm = Some(found);
            rise
        };
        match reach(wanted, deviation, furthest, |distance| root_rise(distance, &mut warm)) {
            Some(distance) => {
                let open = warm.as_ref().is_some_and(|state| self.is_open(state, quantity));
                IntervalEnd { value: from + side * distance, open }
            }
            None => open,
        }
    }

    /// The end where −2 ln L is close to a quadratic, as it mostly is: each evaluation predicts the distance at which the
    /// minimum with the quantity held has the required rise, and the next one is made there (Venzon and Moolgavkar 1988).
    /// None if that does not converge, or if it leads beyond the furthest.
    fn by_parabolas(
        &self,
        quantity: Quantity,
        wanted: f64,
        side: f64,
        furthest: f64,
    ) -> Option<EndByParabolas> {
        let (from, unknowns) = (quantity.value(&self.optimum.x), &self.system.unknowns);
        let gradient = quantity.gradient(&self.optimum.x);
        let rise = wanted * wanted;
        let first = outwards(unknowns, &self.optimum.x, self.normal, &gradient, (rise, side))?;
        let mut state = self.optimum.clone();
        let mut inside = state.clone();
        // Greatest step of the quantity: where a valley bends, the quadratic is good for a part of the way only.
        let mut furthest_step = f64::INFINITY;
        self.system.advance(&mut state, self.normal, &first.whole);
        for look in 0..LOOKS {
            let (cost, normal) = self.system.look(&state);
            let gradient = quantity.gradient(&state.x);
            let room = self.optimum.cost + rise - cost;
            let Some(step) = outwards(unknowns, &state.x, &normal, &gradient, (room, side)) else {
                state = halfway(&inside, &state);
                furthest_step = (quantity.value(&state.x) - quantity.value(&inside.x)).abs();
                continue;
            };
            let moved = gradient.dot(&step.whole);
            let distance = side * (quantity.value(&state.x) + moved - from);
            if !(distance > 0.0 && distance < furthest) {
                return None;
            }
            let share = (furthest_step / moved.abs()).min(1.0);
            inside = state.clone();
            self.system.advance(&mut state, &normal, &(step.whole * share));
            if share == 1.0 && moved.abs() < GOOD.0 * distance && step.slack < GOOD.1 {
                let agrees = moved.abs() < CERTAIN.0 * distance && step.slack < CERTAIN.1;
                let certain = look == 0 && agrees && is_inside(unknowns, &state.x);
                return Some(EndByParabolas { state, at: from + side * distance, certain });
            }
            furthest_step *= LONGER;
        }
        None
    }

    /// An end found by the quadratic, if a descent with the quantity held there has the required rise as well: at limits
    /// of other unknowns the quadratic may mislead.
    fn confirmed(&self, state: State, held: &HeldQuantity, wanted: f64) -> Option<IntervalEnd> {
        let found = self.system.descend(state, Some(held), TOLERANCE);
        let rise = (found.cost - self.optimum.cost).max(0.0).sqrt();
        let open = || self.is_open(&found, held.quantity);
        ((rise / wanted - 1.0).abs() < CLOSE).then(|| IntervalEnd { value: held.at, open: open() })
    }

    /// Whether the data allow values beyond an end. If another quantity cannot follow any further, the dictionary ends the
    /// interval, not the data; and where a descent did not find its minimum, the true end lies further away.
    fn is_open(&self, at_end: &State, quantity: Quantity) -> bool {
        !at_end.end.is_minimum() || self.system.at_end(at_end, quantity)
    }

    /// A state at this value of the quantity, which the other unknowns follow as if all were linear.
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

/// An end to which quadratics have led.
struct EndByParabolas {
    state: State,
    /// The quantity there.
    at: f64,
    /// Whether no descent has to confirm it.
    certain: bool,
}

/// Whether no unknown that can move is at a limit.
fn is_inside(unknowns: &[Unknown], x: &DVector<f64>) -> bool {
    let inside = |i: usize| unknowns[i].limits.0 < x[i] && x[i] < unknowns[i].limits.1;
    free(unknowns).into_iter().all(inside)
}

/// The middle between a state and one to which its quadratic has led too far.
fn halfway(from: &State, to: &State) -> State {
    let between = |(a, b): (&Line, &Line)| a.iter().zip(b).map(|(a, b)| 0.5 * (a + b)).collect();
    let own = from.own.iter().zip(&to.own).map(between).collect();
    State::new((&from.x + &to.x) * 0.5, own)
}

/// A step to where the quadratic has the required rise.
struct Outwards {
    whole: DVector<f64>,
    /// The fall of the quadratic if the quantity stayed at its value.
    slack: f64,
}

/// The step that moves a quantity to the given side until the least −2 ln L is higher than here by `rise`. Unknowns that
/// the step would push over a limit stop there.
fn outwards(
    unknowns: &[Unknown],
    x: &DVector<f64>,
    normal: &Normal,
    gradient: &DVector<f64>,
    (rise, side): (f64, f64),
) -> Option<Outwards> {
    let information = &normal.information;
    let mut moving = free(unknowns);
    let mut limited = DVector::zeros(x.len());
    loop {
        let covariance = inverse_over(&moving, information, 0.0)?;
        let downhill = &normal.downhill - information * &limited;
        let (lowest, way) = (&covariance * &downhill, &covariance * gradient);
        let fall = downhill.dot(&lowest) + (&normal.downhill + &downhill).dot(&limited);
        let (pulled, variance) = (gradient.dot(&lowest), gradient.dot(&way));
        let room = rise + fall;
        if !(variance > 0.0 && room > 0.0) {
            return None;
        }
        let whole = &limited + lowest + way * (side * (room / variance).sqrt());
        let before = moving.len();
        moving.retain(|i| {
            let (low, high) = unknowns[*i].limits;
            let to = x[*i] + whole[*i];
            if !(low..=high).contains(&to) {
                limited[*i] = to.clamp(low, high) - x[*i];
            }
            (low..=high).contains(&to)
        });
        if moving.len() == before {
            let held = pulled + gradient.dot(&limited);
            return Some(Outwards { whole, slack: fall - held * held / variance });
        }
    }
}

/// The distance at which the root of the rise is `wanted`; none if it is not reached up to the furthest, or if the least
/// step rises more: then the start is no minimum, and no interval follows. If all is linear, the root is 1 at
/// `deviation`.
pub(crate) fn reach(
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
        if outside.is_some_and(|(far, _)| far - inside.0 < NARROW * far) {
            break;
        }
        distance = match outside {
            Some((far, high)) => {
                let share = (wanted - inside.1) / (high - inside.1).max(1e-12);
                inside.0 + share.clamp(0.05, 0.95) * (far - inside.0)
            }
            None => (distance * (wanted / rise.max(0.2 * wanted)).min(3.0) * 1.02).min(furthest),
        };
    }
    // If the rise was never too small, or never too large, no end was found.
    outside.filter(|_| inside.0 > 0.0).map(|_| distance)
}

/// The interval of a parameter from the ends of its coordinate.
pub(crate) fn interval([low, high]: [IntervalEnd; 2], forward: impl Fn(f64) -> f64, falls: bool) -> Interval {
    let (low, high) = if falls { (high, low) } else { (low, high) };
    Interval { low: forward(low.value), high: forward(high.value), open_low: low.open, open_high: high.open }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The end of an interval is where the objective has risen by the requested amount.
    #[test]
    fn interval_ends_at_the_requested_rise() {
        let curved = |distance: f64| distance + 0.3 * distance * distance;
        let found = reach(1.96, 1.0, 100.0, curved).unwrap();
        assert!((curved(found) / 1.96 - 1.0).abs() < CLOSE, "{found}");
        // The end is much nearer than the deviation predicts.
        let found = reach(1.96, 1e6, 1e9, |distance| 1e3 * distance).unwrap();
        assert!((1e3 * found / 1.96 - 1.0).abs() < CLOSE, "{found}");
    }

    /// A jump of the objective is bracketed to 1 %, by few descents.
    #[test]
    fn jump_is_bracketed() {
        let mut trials = 0;
        let jump = |distance: f64| {
            trials += 1;
            if distance < 2.5 { 0.5 * distance } else { 4.0 }
        };
        let found = reach(1.96, 1.0, 100.0, jump).unwrap();
        assert!((found / 2.5 - 1.0).abs() < NARROW && trials < TRIALS, "{found} after {trials}");
    }

    /// An objective that rises too little, or at once, gives no end of the interval.
    #[test]
    fn flat_or_steep_rise_has_no_end() {
        assert_eq!(reach(1.96, 1.0, 100.0, |_| 0.5), None);
        assert_eq!(reach(1.96, 1.0, 100.0, |_| 40.0), None);
    }
}
