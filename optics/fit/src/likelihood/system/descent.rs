//! The damped descent of Levenberg and Marquardt: Gauss–Newton steps whose damping follows from how well the quadratic
//! model predicts the fall of the cost (Nielsen 1999). It ends where the undamped model predicts a fall of less than a
//! tolerance.

/// Tolerances of −2 ln L: of a start that is refined later, and of an estimate, which is then off by at most 1 % of its
/// standard error.
pub(crate) const COARSE: f64 = 0.5;
pub(crate) const FINE: f64 = 1e-4;

/// Damping of the first step, and the least after a step that raised the cost.
const FIRST_DAMPING: f64 = 1e-3;
const LEAST_DAMPING: f64 = 1e-4;
/// Factor on the damping after the first of several steps that raised the cost; it doubles with each further one.
const GROWTH: f64 = 4.0;
/// Least factor on the damping after a step that lowered the cost.
const DECAY: f64 = 1.0 / 3.0;
/// A damped step with a predicted fall of less than this share of the tolerance is the last: the place is a kink of the
/// cost.
const KINK: f64 = 0.01;

/// A place with the fall of the cost that the quadratic model predicts for the step to it.
pub(crate) struct DescentStep<P> {
    pub to: P,
    pub predicted: f64,
}

/// A descent to within a tolerance of the cost, with at most this many evaluations.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Descent {
    pub most_steps: usize,
    pub tolerance: f64,
}

impl Descent {
    /// The end of a descent from `here`. `decrement` is the predicted fall of an undamped step, `step` a damped step.
    pub(crate) fn run<P>(
        &self,
        mut here: P,
        cost: impl Fn(&P) -> f64,
        decrement: impl Fn(&P) -> f64,
        step: impl Fn(&P, f64) -> Option<DescentStep<P>>,
    ) -> P {
        let (mut damping, mut growth) = (FIRST_DAMPING, GROWTH);
        for _ in 0..self.most_steps {
            if decrement(&here) < self.tolerance {
                break;
            }
            let Some(DescentStep { to, predicted }) = step(&here, damping) else { break };
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
                break;
            }
        }
        here
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

    fn damped([x, y]: [f64; 2], damping: f64) -> [f64; 2] {
        let [r, s] = residuals([x, y]);
        let (a, b, c) = (400.0 * x * x + 1.0, -200.0 * x, 100.0);
        let (a, c) = (a * (1.0 + damping), c * (1.0 + damping));
        let (p, q) = (20.0 * x * r + s, -10.0 * r);
        let determinant = a * c - b * b;
        [(c * p - b * q) / determinant, (a * q - b * p) / determinant]
    }

    /// A bending valley is followed to its minimum within a few steps.
    #[test]
    fn bending_valley_is_followed_to_its_end() {
        let cost = |at: &[f64; 2]| residuals(*at).iter().map(|r| r * r).sum::<f64>();
        let decrement = |at: &[f64; 2]| predicted(*at, damped(*at, 0.0));
        let step = |at: &[f64; 2], damping: f64| {
            let step = damped(*at, damping);
            Some(DescentStep { to: [at[0] + step[0], at[1] + step[1]], predicted: predicted(*at, step) })
        };
        for start in [[-1.2, 1.0], [-3.0, 4.0], [0.0, 8.0]] {
            let end = Descent { most_steps: 60, tolerance: FINE }.run(start, cost, decrement, step);
            assert!(cost(&end) < FINE && decrement(&end) < FINE, "{start:?}: {end:?}");
        }
    }
}
