//! Local polynomials over the irregular nodes of one axis: smoothing, and interpolation where nodes are few.

/// Weights of the nodes from `first` on, and their derivatives by the coordinate.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Weights {
    pub first: usize,
    pub values: Vec<f64>,
    pub slopes: Vec<f64>,
}

/// Weights of the nodes from `first` on.
#[derive(Debug)]
pub(super) struct Direction {
    first: usize,
    values: Vec<f64>,
}

impl Direction {
    /// 1 for the same weights, 0 for weights that share no node.
    pub(super) fn cosine(&self, other: &Self) -> f64 {
        self.cosine_where(other, |node, of_other| node == of_other)
    }

    /// The same between two axes, whose nodes are told to be the same or not.
    pub(super) fn cosine_where(&self, other: &Self, same: impl Fn(usize, usize) -> bool) -> f64 {
        let products = self.nodes().flat_map(|(node, a)| {
            let alike = other.nodes().filter(|(of_other, _)| same(node, *of_other)).map(|(_, b)| b);
            alike.map(move |b| a * b).collect::<Vec<_>>()
        });
        let product: f64 = products.sum();
        let square = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>();
        (product / (square(&self.values) * square(&other.values)).sqrt()).max(0.0)
    }

    fn nodes(&self) -> impl Iterator<Item = (usize, f64)> {
        self.values.iter().enumerate().map(|(i, value)| (self.first + i, *value))
    }
}

/// Local polynomials over the nodes of one axis.
#[derive(Debug)]
pub(super) struct LocalAxis {
    /// Strictly rising or falling.
    nodes: Vec<f64>,
    degree: usize,
    /// Nodes on each side that are looked at.
    half_width: f64,
}

impl LocalAxis {
    /// `reach` is how far, in the coordinate, one polynomial describes the profiles well.
    pub(super) fn new(nodes: Vec<f64>, reach: f64) -> Self {
        let n = nodes.len();
        let spacing = (nodes[n - 1] - nodes[0]).abs() / (n.max(2) - 1) as f64;
        let half_width = (reach / spacing).clamp(2.5, 6.5);
        // Fewer nodes than a fit needs are interpolated.
        let degree = match n {
            1..5 => n - 1,
            7.. if half_width >= 3.5 => 3,
            _ => 2,
        };
        Self { nodes, degree, half_width }
    }

    pub(super) fn range(&self) -> (f64, f64) {
        let (a, b) = (self.nodes[0], self.nodes[self.nodes.len() - 1]);
        (a.min(b), a.max(b))
    }

    /// The index, with a fraction, at which the coordinate lies.
    fn position(&self, x: f64) -> f64 {
        let n = self.nodes.len();
        let rising = self.nodes[n - 1] > self.nodes[0];
        let after = self.nodes.partition_point(|v| if rising { *v <= x } else { *v >= x });
        if after == 0 {
            return 0.0;
        }
        if after == n {
            return (n - 1) as f64;
        }
        let (a, b) = (self.nodes[after - 1], self.nodes[after]);
        (after - 1) as f64 + (x - a) / (b - a)
    }

    /// Tricube weights about the coordinate: the window is wider where the axis ends, so that it holds as many nodes.
    fn window(&self, x: f64) -> (usize, Vec<f64>) {
        let n = self.nodes.len();
        let position = self.position(x);
        let to_end = position.min((n - 1) as f64 - position);
        let bandwidth = (self.half_width + 0.5).max(2.0 * self.half_width - to_end);
        let bandwidth = if n < 5 { n as f64 } else { bandwidth };
        let weight = |i: usize| {
            let d = (i as f64 - position).abs() / bandwidth;
            if d < 1.0 { (1.0 - d * d * d).powi(3) } else { 0.0 }
        };
        let first = (0..n).find(|i| weight(*i) > 0.0).unwrap_or(0);
        (first, (first..n).map(weight).take_while(|w| *w > 0.0).collect())
    }

    /// Linear functionals of the window's nodes that give the polynomial's value at each of `at`.
    fn functionals(&self, first: usize, window: &[f64], centre: f64, at: &[f64]) -> Vec<Vec<f64>> {
        let nodes = &self.nodes[first..first + window.len()];
        let terms = self.degree.min(window.len() - 1) + 1;
        let powers = |x: f64| (0..terms).map(move |k| (x - centre).powi(k as i32)).collect::<Vec<f64>>();
        // Normal equations: few terms, and the coordinates are of the order of one.
        let mut normal = vec![vec![0.0; terms]; terms];
        for (x, w) in nodes.iter().zip(window) {
            let p = powers(*x);
            for i in 0..terms {
                for j in 0..terms {
                    normal[i][j] += w * p[i] * p[j];
                }
            }
        }
        at.iter()
            .map(|x| {
                let c = solve(normal.clone(), powers(*x));
                let functional =
                    |(x, w): (&f64, &f64)| w * powers(*x).iter().zip(&c).map(|(p, c)| p * c).sum::<f64>();
                nodes.iter().zip(window).map(functional).collect()
            })
            .collect()
    }

    fn values_at(&self, x: f64) -> (usize, Vec<f64>) {
        let (first, window) = self.window(x);
        let values = self.functionals(first, &window, x, &[x]).swap_remove(0);
        (first, values)
    }

    pub(super) fn weights(&self, x: f64) -> Weights {
        if self.nodes.len() == 1 {
            return Weights { first: 0, values: vec![1.0], slopes: vec![0.0] };
        }
        let (low, high) = self.range();
        let step = 1e-5 * (high - low);
        let (below, above) = ((x - step).max(low), (x + step).min(high));
        let around = [self.values_at(below), self.values_at(x), self.values_at(above)];
        let first = around.iter().map(|(first, _)| *first).min().unwrap_or(0);
        let end = around.iter().map(|(first, v)| first + v.len()).max().unwrap_or(0);
        let padded = |(start, values): &(usize, Vec<f64>)| {
            let mut padded = vec![0.0; end - first];
            padded[start - first..start - first + values.len()].copy_from_slice(values);
            padded
        };
        let [before, values, after] = around.each_ref().map(padded);
        let slopes = before.iter().zip(&after).map(|(a, b)| (b - a) / (above - below)).collect();
        Weights { first, values, slopes }
    }

    /// The weights at a coordinate, as a vector over the nodes.
    pub(super) fn direction(&self, x: f64) -> Direction {
        let (first, values) = if self.nodes.len() == 1 { (0, vec![1.0]) } else { self.values_at(x) };
        Direction { first, values }
    }

    /// For the nodes of the window about a coordinate: their weight, and the functionals that give the window's
    /// polynomial at each of them.
    pub(super) fn hat(&self, x: f64) -> (usize, Vec<f64>, Vec<Vec<f64>>) {
        let (first, window) = self.window(x);
        let at: Vec<f64> = self.nodes[first..first + window.len()].to_vec();
        let hat = self.functionals(first, &window, x, &at);
        (first, window, hat)
    }
}

/// Solves a small symmetric positive definite system by elimination.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for i in 0..n {
        let (above, below) = a.split_at_mut(i + 1);
        let pivot = &above[i];
        for (j, row) in (i + 1..n).zip(below) {
            let factor = row[i] / pivot[i];
            for (cell, upper) in row.iter_mut().zip(pivot).skip(i) {
                *cell -= factor * upper;
            }
            b[j] -= factor * b[i];
        }
    }
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|k| a[i][k] * b[k]).sum();
        b[i] = (b[i] - known) / a[i][i];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nodes(n: usize) -> Vec<f64> {
        (0..n).map(|i| (1.0 + i as f64 + 0.3 * (i % 3) as f64).ln()).collect()
    }

    #[test]
    fn weights_are_alike_where_they_share_nodes() {
        let axis = LocalAxis::new(nodes(40), 0.6);
        let (low, high) = axis.range();
        let middle = 0.5 * (low + high);
        let cosine = |a: f64, b: f64| axis.direction(a).cosine(&axis.direction(b));
        assert!((cosine(middle, middle) - 1.0).abs() < 1e-12);
        assert_eq!(cosine(low, high), 0.0);
        let near = [0.02, 0.1, 0.3].map(|d| cosine(middle, middle + d));
        assert!(near[0] > 0.9 && near.is_sorted_by(|a, b| a > b), "{near:?}");
        let only = LocalAxis::new(vec![1.0], 0.6);
        assert_eq!(only.direction(1.0).cosine(&only.direction(1.0)), 1.0);
    }

    /// A local fit of degree k reproduces polynomials of degree k, and its slopes are their derivatives.
    #[test]
    fn polynomials_come_back_with_their_slopes() {
        for (n, degree) in [(2, 1), (3, 2), (4, 3), (6, 2), (12, 2), (40, 3)] {
            let axis = LocalAxis::new(nodes(n), 0.6);
            let (low, high) = axis.range();
            for share in [0.0, 0.21, 0.5, 0.83, 1.0] {
                let x = low + share * (high - low);
                let w = axis.weights(x);
                for power in 0..=degree {
                    let of = |weights: &[f64]| {
                        let nodes = &axis.nodes[w.first..];
                        weights.iter().zip(nodes).map(|(w, x)| w * x.powi(power)).sum::<f64>()
                    };
                    let slope = f64::from(power) * x.powi((power - 1).max(0));
                    assert!((of(&w.values) - x.powi(power)).abs() < 1e-8, "{n} nodes, {x}^{power}");
                    // At the ends the quotient is one-sided.
                    assert!(
                        (of(&w.slopes) - slope).abs() < 1e-3 * (1.0 + slope),
                        "{n} nodes, slope of {x}^{power}"
                    );
                }
            }
        }
    }

    #[test]
    fn weights_change_without_jumps() {
        for n in [5, 9, 38] {
            let axis = LocalAxis::new(nodes(n), 0.6);
            let (low, high) = axis.range();
            let padded = |x: f64| {
                let w = axis.weights(x);
                let mut all = vec![0.0; n];
                all[w.first..w.first + w.values.len()].copy_from_slice(&w.values);
                all
            };
            let steps = 20_000;
            let at = |i: i32| padded(low + f64::from(i) / f64::from(steps) * (high - low));
            let mut before = at(0);
            for i in 1..=steps {
                let now = at(i);
                let jump = now.iter().zip(&before).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(jump < 0.02, "{n} nodes, step {i}: {jump}");
                before = now;
            }
        }
    }

    /// Smoothing over many nodes averages their noise; interpolation over few cannot.
    #[test]
    fn noise_is_averaged_where_nodes_are_dense() {
        let leverage = |n: usize| {
            let axis = LocalAxis::new((0..n).map(|i| i as f64 * 0.09).collect(), 0.6);
            axis.weights(0.09 * (n / 2) as f64).values.iter().map(|w| w * w).sum::<f64>()
        };
        assert!(leverage(40) < 0.35 && leverage(4) > 0.9, "{} {}", leverage(40), leverage(4));
    }
}
