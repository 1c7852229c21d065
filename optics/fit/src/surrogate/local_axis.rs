//! Fits local models over the irregular nodes of one axis: smooths, and interpolates where nodes are few.
//!
//! A model is a sum of powers of the coordinate, and of shapes that profiles are known to have along the axis.

use optics_model::phase::PhaseShape;

use crate::bases::orthonormal;

/// Weights of the nodes from `first` on, and their derivatives by the coordinate.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Weights {
    pub first: usize,
    pub values: Vec<f64>,
    pub slopes: Vec<f64>,
}

/// Weights of the nodes from `first` on.
#[derive(Debug, Default)]
pub(crate) struct Direction {
    first: usize,
    values: Vec<f64>,
}

impl Direction {
    pub(super) fn of(weights: &Weights) -> Self {
        Self { first: weights.first, values: weights.values.clone() }
    }

    /// Cosine of the angle between both: 1 for the same weights, 0 for weights that share no node.
    pub(crate) fn cosine(&self, other: &Self) -> f64 {
        self.cosine_where(other, |node, of_other| node == of_other)
    }

    /// Cosine of the angle between directions of two axes; `same` decides which of their nodes are the same.
    pub(crate) fn cosine_where(&self, other: &Self, same: impl Fn(usize, usize) -> bool) -> f64 {
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

/// Cosines of the scattering angles whose phase function serves as a shape along g: straight back, and about as oblique
/// as profiles show. With powers of ln(1 − g) alone, the model of light that is scattered once, and so of a dark medium's
/// profile, has errors of up to 5 %.
const BACKWARDS: [f64; 2] = [-1.0, -0.6];

/// Dependence of light that is scattered once on y = ln(1 − g): 4π p(cos θ) of the phase function with that g.
#[derive(Debug, Clone)]
struct BackscatterShape {
    phase: PhaseShape,
    cosine: f64,
}

impl BackscatterShape {
    fn at(&self, y: f64) -> f64 {
        self.phase.function_near(1.0 - libm::exp(y)).over_isotropic(self.cosine)
    }
}

/// Local models over the nodes of one axis.
#[derive(Debug)]
pub(crate) struct LocalAxis {
    /// Strictly rising or falling.
    nodes: Vec<f64>,
    /// Number of powers of the coordinate in a model, from 0 on.
    powers: usize,
    /// Further terms of a model.
    shapes: Vec<BackscatterShape>,
    /// Number of nodes on each side that a model uses.
    half_width: f64,
}

impl LocalAxis {
    /// Models of powers alone. `reach` is the distance, in the coordinate, over which a model describes the profiles
    /// well.
    pub(crate) fn new(nodes: Vec<f64>, reach: f64) -> Self {
        let half_width = half_width(&nodes, reach);
        // Fewer nodes than a fit needs are interpolated.
        let powers = match nodes.len() {
            n @ 1..5 => n,
            15.. if half_width >= 7.0 => 6,
            9.. if half_width >= 4.5 => 5,
            7.. if half_width >= 3.5 => 4,
            _ => 3,
        };
        Self { nodes, powers, shapes: Vec::new(), half_width }
    }

    /// Models along ln(1 − g) that have the shapes of backscattered light, too, as far as there are nodes for them.
    pub(crate) fn along_g(nodes: Vec<f64>, reach: f64, phase: &PhaseShape) -> Self {
        let half_width = half_width(&nodes, reach);
        let (powers, room) = match nodes.len() {
            n @ 1..5 => (n, 0),
            7.. if half_width >= 3.5 => (3, BACKWARDS.len()),
            _ => (3, 1),
        };
        let shape = |&cosine: &f64| BackscatterShape { phase: phase.clone(), cosine };
        let shapes = BACKWARDS[..room].iter().map(shape).collect();
        Self { nodes, powers, shapes, half_width }
    }

    pub(crate) fn range(&self) -> (f64, f64) {
        let (a, b) = (self.nodes[0], self.nodes[self.nodes.len() - 1]);
        (a.min(b), a.max(b))
    }

    /// The fractional index of a coordinate among the nodes.
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

    /// Tricube weights about the coordinate: the window is wider near the ends of the axis, so that it contains as many
    /// nodes.
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

    /// Linear functionals of the window's nodes that give the model's value at each of `at`.
    fn functionals(&self, first: usize, window: &[f64], centre: f64, at: &[f64]) -> Vec<Vec<f64>> {
        let nodes = &self.nodes[first..first + window.len()];
        let terms = (self.powers + self.shapes.len()).min(window.len());
        let value = |term: usize, x: f64| match term.checked_sub(self.powers) {
            Some(shape) => self.shapes[shape].at(x),
            None => (x - centre).powi(term as i32),
        };
        let term_values = |term: usize| nodes.iter().chain(at).map(|x| value(term, *x)).collect();
        let basis = orthonormal((0..terms).map(term_values).collect(), window);
        let weights = |j: usize| {
            let weight = |i: usize| basis.iter().map(|b| window[i] * b[i] * b[nodes.len() + j]).sum();
            (0..nodes.len()).map(weight).collect()
        };
        (0..at.len()).map(weights).collect()
    }

    fn values_at(&self, x: f64) -> (usize, Vec<f64>) {
        let (first, window) = self.window(x);
        let values = self.functionals(first, &window, x, &[x]).swap_remove(0);
        (first, values)
    }

    pub(crate) fn weights(&self, x: f64) -> Weights {
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
    pub(crate) fn direction(&self, x: f64) -> Direction {
        let (first, values) = if self.nodes.len() == 1 { (0, vec![1.0]) } else { self.values_at(x) };
        Direction { first, values }
    }

    /// The window about a coordinate: its first node, the weights of its nodes, and the functionals that give the
    /// window's model at each of them.
    pub(crate) fn hat(&self, x: f64) -> (usize, Vec<f64>, Vec<Vec<f64>>) {
        let (first, window) = self.window(x);
        let at: Vec<f64> = self.nodes[first..first + window.len()].to_vec();
        let hat = self.functionals(first, &window, x, &at);
        (first, window, hat)
    }
}

/// Number of nodes on each side of a coordinate that a model of this reach uses.
fn half_width(nodes: &[f64], reach: f64) -> f64 {
    let n = nodes.len();
    let spacing = (nodes[n - 1] - nodes[0]).abs() / (n.max(2) - 1) as f64;
    (reach / spacing).clamp(2.5, 8.5)
}

#[cfg(test)]
mod tests {
    use optics_model::phase::PhaseFunction;

    use super::*;

    fn shape(cosine: f64) -> BackscatterShape {
        BackscatterShape { phase: PhaseShape::default(), cosine }
    }

    /// The tracer samples the same function, and scores with its azimuthal mean.
    #[test]
    fn shapes_are_densities_of_the_phase_function() {
        for cosine in BACKWARDS {
            for g in [0.0_f64, 0.3, 0.6, 0.9] {
                let phase = PhaseFunction::henyey_greenstein(g).unwrap();
                let density = 4.0 * std::f64::consts::PI * phase.density(cosine);
                let shape = shape(cosine).at(libm::log(1.0 - g));
                assert!((shape / density - 1.0).abs() < 1e-12, "g {g}, cosine {cosine}");
            }
        }
    }

    fn nodes(n: usize) -> Vec<f64> {
        (0..n).map(|i| libm::log(1.0 + i as f64 + 0.3 * (i % 3) as f64)).collect()
    }

    /// Weights at nearby places are similar, and those without a common node are orthogonal.
    #[test]
    fn nearby_weights_share_nodes() {
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
        for (n, degree) in [(2, 1), (3, 2), (4, 3), (6, 2), (12, 2), (40, 5)] {
            let axis = LocalAxis::new(nodes(n), 0.75);
            let (low, high) = axis.range();
            for share in [0.0, 0.21, 0.5, 0.83, 1.0] {
                let x = low + share * (high - low);
                let w = axis.weights(x);
                for power in 0..=degree {
                    let weighted_sum = |weights: &[f64]| {
                        let nodes = &axis.nodes[w.first..];
                        weights.iter().zip(nodes).map(|(w, x)| w * x.powi(power)).sum::<f64>()
                    };
                    let slope = f64::from(power) * x.powi((power - 1).max(0));
                    assert!((weighted_sum(&w.values) - x.powi(power)).abs() < 1e-8, "{n} nodes, {x}^{power}");
                    // At the ends the quotient is one-sided.
                    assert!(
                        (weighted_sum(&w.slopes) - slope).abs() < 1e-3 * (1.0 + slope),
                        "{n} nodes, slope of {x}^{power}"
                    );
                }
            }
        }
    }

    /// Along ln(1 − g), at the paper's anisotropies and between them, models reproduce backscattered light, and by their
    /// powers diffuse light.
    #[test]
    fn single_and_diffuse_scattering_is_recovered() {
        let g = [0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.8];
        let nodes: Vec<f64> = g.iter().map(|g: &f64| libm::log(1.0 - g)).collect();
        let axis = LocalAxis::along_g(nodes, 1.0, &PhaseShape::default());
        let diffuse = |y: f64, depth: f64| 1.0 / (1.0 + depth * libm::exp(y));
        for g in [0.0, 0.03, 0.13, 0.25, 0.4, 0.52, 0.65, 0.75, 0.8] {
            let y = libm::log(1.0 - g);
            let w = axis.weights(y);
            let off = |f: &dyn Fn(f64) -> f64| {
                let sum: f64 = w.values.iter().zip(&axis.nodes[w.first..]).map(|(w, y)| w * f(*y)).sum();
                (sum / f(y) - 1.0).abs()
            };
            for cosine in [-1.0, -0.85, -0.7, -0.6] {
                assert!(off(&|y| shape(cosine).at(y)) < 2e-3, "g {g}, cosine {cosine}");
            }
            for depth in [0.5, 2.0, 8.0, 30.0] {
                assert!(off(&|y| diffuse(y, depth)) < 2e-3, "g {g}, depth {depth}");
            }
        }
    }

    /// Axes of powers alone, and along ln(1 − g) with shapes; the last has all its anisotropies near 0.7.
    fn axes() -> Vec<LocalAxis> {
        let anisotropies = |n: usize, from: f64, to: f64| {
            let g = |i: usize| from + (to - from) * i as f64 / (n - 1) as f64;
            LocalAxis::along_g((0..n).map(|i| libm::log(1.0 - g(i))).collect(), 1.0, &PhaseShape::default())
        };
        let powers = [5, 9, 38].map(|n| LocalAxis::new(nodes(n), 0.75));
        let shapes = [2, 4, 5, 6, 9, 11, 25].map(|n| anisotropies(n, 0.0, 0.8));
        powers.into_iter().chain(shapes).chain([anisotropies(11, 0.68, 0.72)]).collect()
    }

    /// Weights change without jumps, and their slopes are the derivatives.
    #[test]
    fn weights_are_smooth_with_matching_slopes() {
        for axis in axes() {
            let n = axis.nodes.len();
            let (low, high) = axis.range();
            let padded = |first: usize, values: &[f64]| {
                let mut all = vec![0.0; n];
                all[first..first + values.len()].copy_from_slice(values);
                all
            };
            let steps = 20_000;
            let step = (high - low) / f64::from(steps);
            let at = |i: i32| axis.weights(low + f64::from(i) * step);
            let mut before = at(0);
            for i in 1..=steps {
                let now = at(i);
                let [a, b] = [&before, &now].map(|w| padded(w.first, &w.values));
                let [from, to] = [&before, &now].map(|w| padded(w.first, &w.slopes));
                for node in 0..n {
                    let moved = b[node] - a[node];
                    assert!(moved.abs() < 0.02, "{n} nodes, step {i}: {moved}");
                    let told = 0.5 * step * (from[node] + to[node]);
                    assert!(
                        (moved - told).abs() < 1e-3,
                        "{n} nodes, step {i}: {moved}, by its slopes {told}"
                    );
                }
                before = now;
            }
        }
    }

    /// Smoothing over many nodes averages their noise; interpolation over few cannot.
    #[test]
    fn noise_is_averaged_where_nodes_are_dense() {
        let leverage = |n: usize| {
            let axis = LocalAxis::new((0..n).map(|i| i as f64 * 0.09).collect(), 0.75);
            axis.weights(0.09 * (n / 2) as f64).values.iter().map(|w| w * w).sum::<f64>()
        };
        assert!(leverage(40) < 0.35 && leverage(4) > 0.9, "{} {}", leverage(40), leverage(4));
    }
}
