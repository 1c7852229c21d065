//! Interpolates an integral between the nodes at which it is known, with fifth order.
//!
//! Pixels are box averages, so the integral of a profile is known exactly at their edges. Light that reaches the base
//! unscattered makes a step at the edge between black and white, so no polynomial crosses it if it lies on a node.

use std::ops::Range;

/// Number of nodes that one polynomial passes through.
pub(crate) const NODES: usize = 6;
/// Number of integrals that are interpolated side by side.
pub(crate) const LANES: usize = 8;

const ENOUGH: &str = "there are as many nodes";

/// A place between nodes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    first: usize,
    /// Weights of the nodes from `first` on that give the integral and the integrand at this place. Weights without a
    /// node are 0.
    integral: [f64; NODES],
    integrand: [f64; NODES],
}

impl Place {
    /// `at` counts cells from the first node. The polynomial passes through the nodes of `side` alone, a range of cells.
    pub(crate) fn new(at: f64, side: Range<usize>) -> Self {
        let count = NODES.min(side.len() + 1);
        let cell = (at.max(0.0) as usize).clamp(side.start, side.end - 1);
        let first = (cell + 1).saturating_sub(count / 2).clamp(side.start, side.end + 1 - count);
        Self::through(first, count, at)
    }

    /// A place at a node where a step may be, or negligibly near it: with symmetric weights the integrand is the mean of
    /// those at either side.
    pub(crate) fn at_step(node: usize, at: f64) -> Self {
        Self::through(node - 2, 5, at)
    }

    /// Weights are the products of the distances from the other nodes, over those products at the node itself.
    fn through(first: usize, count: usize, at: f64) -> Self {
        let x = at - first as f64;
        // Products over the nodes before and after each, with their derivatives.
        let (mut before, mut after) = ([(1.0, 0.0); NODES], [(1.0, 0.0); NODES]);
        let times = |(value, slope): (f64, f64), node: usize| {
            let distance = x - node as f64;
            (value * distance, slope * distance + value)
        };
        for i in 1..count {
            before[i] = times(before[i - 1], i - 1);
            after[count - 1 - i] = times(after[count - i], count - i);
        }
        let mut place = Self { first, integral: [0.0; NODES], integrand: [0.0; NODES] };
        for (i, own) in OVER_AT_NODE[count - 1][..count].iter().enumerate() {
            let ((left, left_slope), (right, right_slope)) = (before[i], after[i]);
            place.integral[i] = own * left * right;
            place.integrand[i] = own * (left_slope * right + left * right_slope);
        }
        place
    }

    /// The integral at this place. There must be at least [`NODES`] nodes, whatever the side.
    pub(crate) fn integral(&self, nodes: &[f64]) -> f64 {
        self.weigh(&self.integral, nodes)
    }

    /// Several integrals at this place.
    #[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
    #[inline(always)]
    pub(crate) fn integrals(&self, nodes: &[[f64; LANES]]) -> [f64; LANES] {
        let (w, n): (_, &[_; NODES]) = (&self.integral, nodes[self.first..].first_chunk().expect(ENOUGH));
        let mut sums = [0.0; LANES];
        for i in 0..LANES {
            sums[i] = (w[0] * n[0][i] + w[1] * n[1][i])
                + (w[2] * n[2][i] + w[3] * n[3][i])
                + (w[4] * n[4][i] + w[5] * n[5][i]);
        }
        sums
    }

    /// The integrand at this place, per cell.
    pub(crate) fn integrand(&self, nodes: &[f64]) -> f64 {
        self.weigh(&self.integrand, nodes)
    }

    fn weigh(&self, w: &[f64; NODES], nodes: &[f64]) -> f64 {
        let n: &[f64; NODES] = nodes[self.first..].first_chunk().expect(ENOUGH);
        // In three independent sums, since much of a fit's time is spent here.
        (w[0] * n[0] + w[1] * n[1]) + (w[2] * n[2] + w[3] * n[3]) + (w[4] * n[4] + w[5] * n[5])
    }
}

/// One over the product of a node's distances from the other nodes, by their number less one and the node.
const OVER_AT_NODE: [[f64; NODES]; NODES] = over_at_node();

const fn over_at_node() -> [[f64; NODES]; NODES] {
    let mut table = [[0.0; NODES]; NODES];
    let mut last = 0;
    while last < NODES {
        let mut node = 0;
        while node <= last {
            let (mut product, mut other) = (1.0, 0);
            while other <= last {
                if other != node {
                    product *= node as f64 - other as f64;
                }
                other += 1;
            }
            table[last][node] = 1.0 / product;
            node += 1;
        }
        last += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integrals of polynomials up to degree five are exact next to a step.
    #[test]
    fn integrals_are_exact_next_to_a_step() {
        let value = |x: f64| {
            if x < 9.0 { 0.1 * (x - 9.0).powi(5) } else { 0.4 * (x - 9.0) - 0.02 * (x - 9.0).powi(4) }
        };
        let nodes: Vec<f64> = (0..20).map(|i| value(f64::from(i))).collect();
        for at in [0.3, 4.5, 8.7, 9.2, 13.1, 18.9] {
            let place = Place::new(at, if at < 9.0 { 0..9 } else { 9..19 });
            let slope = (value(at + 1e-5) - value(at - 1e-5)) / 2e-5;
            assert!((place.integral(&nodes) - value(at)).abs() < 1e-9, "{at}");
            assert!((place.integrand(&nodes) - slope).abs() < 1e-5 * (1.0 + slope.abs()), "{at}");
        }
    }

    /// At a step the integrand is the mean of both sides.
    #[test]
    fn integrand_at_a_step_is_the_mean() {
        let nodes: Vec<f64> =
            (0..20).map(|i| f64::from(i - 9)).map(|x| x * if x < 0.0 { 0.2 } else { 0.8 }).collect();
        let place = Place::at_step(9, 9.0);
        assert!(place.integral(&nodes).abs() < 1e-15);
        assert!((place.integrand(&nodes) - 0.5).abs() < 1e-12);
    }
}
