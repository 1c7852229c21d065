//! Where intervals end: Eq. 1 is followed until it has risen as the noise allows.

use glam::DMat4;
use optics_model::fit::Interval;

use crate::paper::noise::Spread;
use crate::paper::refine::{Block, Objective, Optimum, PARAMETERS};
use crate::surrogate::{ALBEDO, G, SIGMA_T};

/// Two-sided 95 % of the normal distribution.
pub(crate) const Z: f64 = 1.959_964;
/// What the ends of intervals are found with.
#[derive(Clone, Copy)]
pub(crate) struct Intervals<'a> {
    pub objective: &'a Objective<'a>,
    pub optimum: &'a Optimum,
    /// At the optimum.
    pub blocks: &'a [Block],
    pub spread: &'a Spread,
    /// Covariance from what is not the channel's own noise; negative where that is counted twice.
    pub systematic: DMat4,
    pub free: [bool; 4],
}

/// One end of an interval in a coordinate; open if the limit is reached before the error has risen enough.
struct End {
    x: f64,
    open: bool,
}

impl Intervals<'_> {
    /// The intervals of all parameters. Where the data do not bound σ_t the albedo's systematic error is that at any
    /// one σ_t: the linear theory would let it run along with the other.
    pub(crate) fn all(&self, systematic_at_any_sigma_t: impl Fn() -> DMat4) -> [Interval; 3] {
        let sigma_t = self.of(SIGMA_T);
        let mut others = *self;
        if sigma_t.open_low || sigma_t.open_high {
            others.systematic = systematic_at_any_sigma_t();
        }
        [sigma_t, others.of(ALBEDO), others.of(G)]
    }

    /// The 95 % interval of one parameter.
    fn of(&self, parameter: usize) -> Interval {
        let tell = |x: f64| self.objective.parameter(parameter, x);
        if !self.free[parameter] {
            let value = tell(self.optimum.x[parameter]);
            return Interval { low: value, high: value, open_low: false, open_high: false };
        }
        let (low, high) = (self.end(parameter, -1.0), self.end(parameter, 1.0));
        // √(1 − α) and ln(1 − g) fall where the parameters rise.
        let (low, high) = if parameter == SIGMA_T { (low, high) } else { (high, low) };
        Interval { low: tell(low.x), high: tell(high.x), open_low: low.open, open_high: high.open }
    }

    /// Where the noise alone ends the interval, and the systematic part in quadrature.
    fn end(&self, parameter: usize, side: f64) -> End {
        let from = self.optimum.x[parameter];
        let (low, high) = self.objective.limits[parameter];
        let furthest = if side < 0.0 { from - low } else { high - from };
        let random = self.random_reach(parameter, side, furthest);
        let systematic = Z * self.systematic.col(parameter)[parameter].max(0.0).sqrt();
        let reach = random.hypot(systematic);
        End { x: from + side * reach.min(furthest), open: reach >= furthest }
    }

    /// How far the noise lets the parameter go to a side; infinite if further than `furthest`.
    fn random_reach(&self, parameter: usize, side: f64, furthest: f64) -> f64 {
        let from = self.optimum.x[parameter];
        let deviation = self.spread.random.col(parameter)[parameter].sqrt();
        // Roots of the rise are close to linear in the distance.
        let wanted = self.linear_rise(parameter, side * Z * deviation).sqrt();
        let mut free = self.free;
        free[parameter] = false;
        let mut warm = self.optimum.x;
        let mut rise = |distance: f64| {
            let mut x = warm;
            x[parameter] = from + side * distance;
            let found = self.objective.descend(x, free);
            warm = found.x;
            (found.error - self.optimum.error).max(0.0).sqrt()
        };
        let (mut inside, mut inside_rise) = (0.0, 0.0);
        let mut distance = (Z * deviation).max(1e-9);
        let (mut outside, mut outside_rise) = loop {
            distance = distance.min(furthest);
            let rise = rise(distance);
            if rise >= wanted {
                break (distance, rise);
            }
            if distance >= furthest {
                return f64::INFINITY;
            }
            (inside, inside_rise) = (distance, rise);
            distance *= 1.5;
        };
        for _ in 0..6 {
            if outside - inside <= 0.02 * outside {
                break;
            }
            let share = (wanted - inside_rise) / (outside_rise - inside_rise).max(f64::MIN_POSITIVE);
            let between = inside + share.clamp(0.05, 0.95) * (outside - inside);
            let rise = rise(between);
            if (rise - wanted).abs() < 0.01 * wanted {
                return between;
            }
            if rise < wanted {
                (inside, inside_rise) = (between, rise);
            } else {
                (outside, outside_rise) = (between, rise);
            }
        }
        outside
    }

    /// By how much the error would rise at a distance from the optimum, all else optimised, if the model were linear.
    fn linear_rise(&self, parameter: usize, distance: f64) -> f64 {
        let column = self.spread.inverse_hessian.col(parameter);
        let step = column * (distance / column[parameter].max(f64::MIN_POSITIVE));
        // The mean over both sides: at a bound the error need not be flat.
        let rise = |block: &Block| {
            let (mut below, mut above) = (0.0, 0.0);
            for (i, r) in block.residual.iter().enumerate() {
                let change: f64 = PARAMETERS.iter().map(|c| block.jacobian[*c][i] * step[*c]).sum();
                below += (r - change).powi(2);
                above += (r + change).powi(2);
            }
            let n = block.residual.len() as f64;
            block.weight * (0.5 * ((below / n).sqrt() + (above / n).sqrt()) - block.rms)
        };
        self.blocks.iter().map(rise).sum::<f64>().max(0.0)
    }
}
