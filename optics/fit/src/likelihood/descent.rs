//! The damped descent: Gauss–Newton steps whose damping grows where they would rise (Levenberg and Marquardt).

/// How a descent damps its steps, and when it ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Descent {
    pub most_steps: usize,
    /// Damping of the first step, the least after a step that rose, and the one from which on none is tried.
    pub damping: (f64, f64, f64),
    /// Factors on the damping after a step that rose, and after one that fell.
    pub factors: (f64, f64),
    /// A step that lowers the cost by less is the last.
    pub tolerance: f64,
}

impl Descent {
    /// Where a descent from `here` ends. `step` is the place to which a step with some damping leads.
    pub(super) fn run<P>(
        &self,
        mut here: P,
        cost: impl Fn(&P) -> f64,
        step: impl Fn(&P, f64) -> Option<P>,
    ) -> P {
        let (mut damping, least, most) = self.damping;
        for _ in 0..self.most_steps {
            let Some(there) = step(&here, damping) else { break };
            let gain = cost(&here) - cost(&there);
            if gain.is_nan() || gain < 0.0 {
                if gain > -self.tolerance || damping > most {
                    break;
                }
                damping = (damping * self.factors.0).max(least);
                continue;
            }
            here = there;
            damping *= self.factors.1;
            if gain < self.tolerance {
                break;
            }
        }
        here
    }
}
