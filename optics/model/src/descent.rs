//! Descends to the minimum of a sum of squares, for media, poses and blurs alike. A problem gives the direction, the descent
//! the length of steps, and its end is a value that belongs to the answer.

use serde::Serialize;

/// How a descent ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DescentEnd {
    /// At a minimum, to within the tolerance.
    #[default]
    Converged,
    /// At the lowest place that limits allow.
    AtBound,
    /// No step is known: the data determine too little.
    NoDescent,
    OutOfSteps,
}

impl DescentEnd {
    /// Whether the place is a minimum, so that its intervals hold.
    pub fn is_minimum(self) -> bool {
        self <= Self::AtBound
    }

    /// This end at a place where limits hold an unknown, or not.
    #[must_use]
    pub fn within(self, is_held: bool) -> Self {
        if is_held { self.max(Self::AtBound) } else { self }
    }
}

/// A place with the fall of the cost that the quadratic promises for the step to it.
#[derive(Debug)]
pub struct DescentStep<P> {
    pub to: P,
    pub predicted: f64,
}

/// A descent to within a tolerance of the cost.
#[derive(Debug, Clone, Copy)]
pub struct Descent {
    pub most_steps: usize,
    pub tolerance: f64,
}

/// Where a descent ended, and how.
#[derive(Debug)]
pub struct Descended<P> {
    pub at: P,
    pub end: DescentEnd,
}

/// Damping of the first step, and the least after a step that raised the cost.
const FIRST_DAMPING: f64 = 1e-3;
const LEAST_DAMPING: f64 = 1e-4;
/// Factor on the damping after the first of several steps that raised the cost; it doubles with each further one.
const GROWTH: f64 = 4.0;
/// Least factor on the damping after a step that lowered the cost.
const DECAY: f64 = 1.0 / 3.0;
/// A damped step with a predicted fall of less than this share of the tolerance is the last: the place is a kink of the
/// cost, and no lower one is near.
const KINK: f64 = 0.01;

impl Descent {
    /// The end of damped steps: the damping of Levenberg and Marquardt follows from how well the quadratic predicts the fall
    /// of the cost (Nielsen 1999). `decrement` is the predicted fall of an undamped step; without one there is no descent.
    pub fn damped<P>(
        &self,
        mut here: P,
        cost: impl Fn(&P) -> f64,
        decrement: impl Fn(&P) -> Option<f64>,
        step: impl Fn(&P, f64) -> Option<DescentStep<P>>,
    ) -> Descended<P> {
        let (mut damping, mut growth) = (FIRST_DAMPING, GROWTH);
        for _ in 0..self.most_steps {
            let Some(decrement) = decrement(&here) else {
                return Descended { at: here, end: DescentEnd::NoDescent };
            };
            if decrement < self.tolerance {
                return Descended { at: here, end: DescentEnd::Converged };
            }
            let Some(DescentStep { to, predicted }) = step(&here, damping) else {
                return Descended { at: here, end: DescentEnd::NoDescent };
            };
            let fall = cost(&here) - cost(&to);
            if fall > 0.0 {
                here = to;
                damping *= (1.0 - (2.0 * fall / predicted - 1.0).powi(3)).clamp(DECAY, GROWTH);
                growth = GROWTH;
            } else {
                damping = (damping * growth).max(LEAST_DAMPING);
                growth *= 2.0;
            }
            if predicted < KINK * self.tolerance {
                return Descended { at: here, end: DescentEnd::Converged };
            }
        }
        Descended { at: here, end: DescentEnd::OutOfSteps }
    }

    /// The end of `least` whole steps or more: for weights that change with the place, so that costs cannot be compared.
    pub fn whole<P>(
        &self,
        least: usize,
        mut here: P,
        step: impl Fn(&P) -> Option<DescentStep<P>>,
    ) -> Descended<P> {
        for taken in 1..=self.most_steps {
            let Some(DescentStep { to, predicted }) = step(&here) else {
                return Descended { at: here, end: DescentEnd::NoDescent };
            };
            here = to;
            if predicted < self.tolerance && taken >= least {
                return Descended { at: here, end: DescentEnd::Converged };
            }
        }
        Descended { at: here, end: DescentEnd::OutOfSteps }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley, as residuals 10 (y − x²) and 1 − x.
    fn residuals([x, y]: [f64; 2]) -> [f64; 2] {
        [10.0 * (y - x * x), 1.0 - x]
    }

    /// Fall of the sum of squares that the linear model predicts for a step.
    fn predicted(at: [f64; 2], [dx, dy]: [f64; 2]) -> f64 {
        let [r, s] = residuals(at);
        let (to_r, to_s) = (r + 10.0 * (dy - 2.0 * at[0] * dx), s - dx);
        r * r + s * s - to_r * to_r - to_s * to_s
    }

    #[expect(clippy::unnecessary_wraps, reason = "a descent takes steps that may be unknown")]
    fn step([x, y]: &[f64; 2], damping: f64) -> Option<DescentStep<[f64; 2]>> {
        let [r, s] = residuals([*x, *y]);
        let (a, b, c) = (400.0 * x * x + 1.0, -200.0 * x, 100.0);
        let (a, c) = (a * (1.0 + damping), c * (1.0 + damping));
        let (p, q) = (20.0 * x * r + s, -10.0 * r);
        let determinant = a * c - b * b;
        let [dx, dy] = [(c * p - b * q) / determinant, (a * q - b * p) / determinant];
        Some(DescentStep { to: [x + dx, y + dy], predicted: predicted([*x, *y], [dx, dy]) })
    }

    fn cost(at: &[f64; 2]) -> f64 {
        residuals(*at).iter().map(|r| r * r).sum()
    }

    fn found(most_steps: usize, start: [f64; 2]) -> Descended<[f64; 2]> {
        let decrement = |at: &[f64; 2]| step(at, 0.0).map(|step| step.predicted);
        Descent { most_steps, tolerance: 1e-4 }.damped(start, cost, decrement, step)
    }

    /// A bending valley is followed to its minimum within a few steps; with too few of them, the descent says so.
    #[test]
    fn bending_valley_is_followed_to_its_end() {
        for start in [[-1.2, 1.0], [-3.0, 4.0], [0.0, 8.0]] {
            let Descended { at, end } = found(60, start);
            assert!(cost(&at) < 1e-4 && end == DescentEnd::Converged, "{start:?}: {at:?} {end:?}");
            assert_eq!(found(3, start).end, DescentEnd::OutOfSteps, "{start:?}");
        }
    }

    /// Data that determine no step end a descent where it begins; a limit is no failure, and hides none.
    #[test]
    fn ends_of_descents_have_names() {
        let descent = Descent { most_steps: 9, tolerance: 1e-4 };
        let nothing = descent.whole(1, 2.0, |_: &f64| None);
        assert_eq!((nothing.at, nothing.end), (2.0, DescentEnd::NoDescent));
        let halved = descent.whole(3, 1.0, |at| Some(DescentStep { to: 0.5 * at, predicted: 0.0 }));
        assert_eq!((halved.at, halved.end), (0.125, DescentEnd::Converged));
        assert!(halved.end.within(true) == DescentEnd::AtBound && halved.end.within(true).is_minimum());
        assert!(!nothing.end.within(true).is_minimum());
    }
}
