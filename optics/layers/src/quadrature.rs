//! Polar angles at which radiances are computed, the same in all layers.
//!
//! A ray keeps s = n sin θ at smooth faces (Snell), and s² measures its projected solid angle: n² cos θ dω = π d(s²).
//! Radiances over n² change smoothly with s, except where a layer reflects totally and at the ends of the ring. Near these
//! places they change with the square root of the distance in s², so between two of them, a and b, nodes are
//! Gauss–Legendre in t, s² = a + (b − a) sin²(πt/2).

use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::Range;

use nalgebra::DMatrix;

/// Nodes per unit of the cosine in the slabs, times the width of the narrowest peak of a phase function, and its limits.
const PER_PEAK: f64 = 3.0;
const PER_COSINE: (f64, f64) = (20.0, 120.0);
/// Share of them that slopes need.
const SLOPES_SHARE: f64 = 0.3;
/// Nodes between two places, besides these. Few of them are too few where their number changes with an index.
const FEWEST: usize = 4;

/// How many nodes there are between two places.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NodeCounts {
    fewest: usize,
    /// Nodes per unit of the cosine in the slabs.
    per_cosine: f64,
}

impl NodeCounts {
    /// Those of predictions that err by 0.3 %, in a thirtieth of the time.
    pub(crate) const COARSE: Self = Self { fewest: 2, per_cosine: 6.0 };

    /// As many as phase functions with peaks of this width need, in steps, so that media of similar g have the same.
    pub(crate) fn fine(peak: f64) -> Self {
        let per_cosine = (10.0 * (0.1 * PER_PEAK / peak).ceil()).clamp(PER_COSINE.0, PER_COSINE.1);
        Self { fewest: FEWEST, per_cosine }
    }

    /// As many as slopes of predictions need, which err by 1 %.
    pub(crate) fn slopes(peak: f64) -> Self {
        Self { per_cosine: SLOPES_SHARE * Self::fine(peak).per_cosine, ..Self::fine(peak) }
    }
}

/// Nodes between two places.
#[derive(Debug, Clone)]
pub(crate) struct Segment {
    /// Indices of its nodes.
    pub nodes: Range<usize>,
    /// Whether it is in the ring.
    pub lit: bool,
    /// s² at its ends.
    ends: (f64, f64),
    /// t of its nodes, and the weights of barycentric interpolation.
    places: Vec<f64>,
    barycentric: Vec<f64>,
    /// ∫ ℓ_i ℓ_k d(s²), ℓ_i being the polynomial in t that is 1 at node i and 0 at the others.
    pub mass: DMatrix<f64>,
}

/// The nodes: those with weights, in rising s², then the sensor's direction, whose weight is 0.
#[derive(Debug, Clone)]
pub(crate) struct Quadrature {
    /// s².
    pub s2: Vec<f64>,
    /// Weights of d(s²).
    pub weights: Vec<f64>,
    segments: Vec<Segment>,
    /// The numbers that it follows from.
    key: Vec<u64>,
}

impl Quadrature {
    /// `iors` are the indices of all layers; `scattering` is that of the slabs; `ring` are s² of its ends, and `sensor` is
    /// s² of the sensor.
    pub(crate) fn new(
        iors: &[f64],
        scattering: f64,
        NodeCounts { fewest, per_cosine }: NodeCounts,
        ring: [f64; 2],
        sensor: f64,
    ) -> Self {
        let numbers = iors.iter().chain([&scattering, &per_cosine]).chain(&ring).chain([&sensor]);
        let key = numbers.map(|number| number.to_bits()).collect();
        let greatest = iors.iter().fold(scattering.max(1.0), |a, b| a.max(*b)).powi(2);
        let squares = iors.iter().map(|n| n * n).chain(ring);
        let mut places: Vec<f64> = squares.chain([0.0, 1.0, scattering * scattering]).collect();
        places.retain(|s2| (0.0..=greatest).contains(s2));
        places.sort_by(f64::total_cmp);
        places.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        let cosine = |s2: f64| (1.0 - s2 / (scattering * scattering)).max(0.0).sqrt();
        let (mut s2, mut weights, mut segments) = (Vec::new(), Vec::new(), Vec::new());
        for ends in places.windows(2).map(|pair| (pair[0], pair[1])) {
            let extent = cosine(ends.0) - cosine(ends.1);
            let (x, w) = gauss_legendre(fewest + (per_cosine * extent).round() as usize);
            let places: Vec<f64> = x.iter().map(|x| 0.5 * (1.0 + x)).collect();
            let first = s2.len();
            let at: Vec<(f64, f64)> = places.iter().map(|place| square_sine(ends, *place)).collect();
            s2.extend(at.iter().map(|(s2, _)| s2));
            // Exact for light that is alike from all directions, so that no light is lost.
            let sum: f64 = at.iter().zip(&w).map(|((_, slope), w)| slope * w).sum();
            weights.extend(at.iter().zip(&w).map(|((_, slope), w)| (ends.1 - ends.0) * slope * w / sum));
            let nodes = first..s2.len();
            let lit = ring[0] <= s2[first] && s2[first] <= ring[1];
            let mass = DMatrix::zeros(nodes.len(), nodes.len());
            let mut segment = Segment { nodes, lit, ends, barycentric: barycentric(&places), places, mass };
            segment.mass = segment.masses();
            segments.push(segment);
        }
        s2.push(sensor);
        weights.push(0.0);
        Self { s2, weights, segments, key }
    }

    pub(crate) fn len(&self) -> usize {
        self.s2.len()
    }

    /// The numbers that it follows from, as bits.
    pub(crate) fn key(&self) -> &[u64] {
        &self.key
    }

    /// Index of the sensor's direction.
    pub(crate) fn sensor(&self) -> usize {
        self.len() - 1
    }

    pub(crate) fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Whether a node with a weight is in the ring.
    pub(crate) fn is_lit(&self, node: usize) -> bool {
        self.segments.iter().any(|segment| segment.lit && segment.nodes.contains(&node))
    }

    /// Whether a direction exists in a medium.
    pub(crate) fn exists(&self, node: usize, ior: f64) -> bool {
        self.s2[node] < ior * ior
    }

    /// cos θ of a node in a medium.
    pub(crate) fn cosine(&self, node: usize, ior: f64) -> f64 {
        (1.0 - self.s2[node] / (ior * ior)).max(0.0).sqrt()
    }

    /// Weight of dμ, the cosine in a medium: d(s²) = 2 n² μ dμ.
    pub(crate) fn cosine_weight(&self, node: usize, ior: f64) -> f64 {
        self.weights[node] / (2.0 * ior * ior * self.cosine(node, ior))
    }

    /// The segment of a direction.
    pub(crate) fn segment(&self, s2: f64) -> &Segment {
        let last = self.segments.len() - 1;
        &self.segments[self.segments.partition_point(|segment| segment.ends.1 <= s2).min(last)]
    }
}

impl Segment {
    /// s² at a place t, and its derivative by t.
    pub(crate) fn at(&self, t: f64) -> (f64, f64) {
        square_sine(self.ends, t)
    }

    /// Whether its directions exist in a medium.
    pub(crate) fn exists(&self, ior: f64) -> bool {
        0.5 * (self.ends.0 + self.ends.1) < ior * ior
    }

    /// t of an s².
    pub(crate) fn place(&self, s2: f64) -> f64 {
        let share = ((s2 - self.ends.0) / (self.ends.1 - self.ends.0)).clamp(0.0, 1.0);
        libm::asin(share.sqrt()) / FRAC_PI_2
    }

    fn masses(&self) -> DMatrix<f64> {
        let count = self.nodes.len();
        let (mut sum, mut weights) = (DMatrix::zeros(count, count), Vec::new());
        let (x, w) = gauss_legendre(2 * count);
        for (x, w) in x.iter().zip(&w) {
            let t = 0.5 * (1.0 + x);
            self.interpolation(t, &mut weights);
            let slope = 0.5 * w * self.at(t).1;
            sum += DMatrix::from_fn(count, count, |i, k| slope * weights[i] * weights[k]);
        }
        sum
    }

    /// Weights of its nodes in the interpolation at a place t, by a polynomial in t.
    pub(crate) fn interpolation(&self, t: f64, weights: &mut Vec<f64>) {
        weights.clear();
        if let Some(exact) = self.places.iter().position(|place| (t - place).abs() < 1e-14) {
            weights.extend((0..self.places.len()).map(|i| if i == exact { 1.0 } else { 0.0 }));
            return;
        }
        weights.extend(self.places.iter().zip(&self.barycentric).map(|(place, b)| b / (t - place)));
        let sum: f64 = weights.iter().sum();
        for weight in weights {
            *weight /= sum;
        }
    }
}

/// a + (b − a) sin²(πt/2) and its derivative.
fn square_sine((a, b): (f64, f64), t: f64) -> (f64, f64) {
    let (sin, cos) = libm::sincos(FRAC_PI_2 * t);
    (a + (b - a) * sin * sin, (b - a) * PI * sin * cos)
}

/// Nodes of [−1, 1], rising, and weights: roots of Legendre's polynomial by Newton's method.
fn gauss_legendre(n: usize) -> (Vec<f64>, Vec<f64>) {
    let polynomial = |x: f64| {
        let (mut before, mut now) = (1.0, x);
        for k in 2..=n {
            let k = k as f64;
            (before, now) = (now, ((2.0 * k - 1.0) * x * now - (k - 1.0) * before) / k);
        }
        let slope = n as f64 * (x * now - before) / (x * x - 1.0);
        (now, slope)
    };
    let root = |i: usize| {
        let mut x = -libm::cos(PI * (i as f64 + 0.75) / (n as f64 + 0.5));
        for _ in 0..50 {
            let (value, slope) = polynomial(x);
            x -= value / slope;
        }
        let (_, slope) = polynomial(x);
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..n).map(root).unzip()
}

fn barycentric(nodes: &[f64]) -> Vec<f64> {
    let scale = (nodes[nodes.len() - 1] - nodes[0]).abs().max(1e-300);
    let weight = |i: usize| -> f64 {
        let others = (0..nodes.len()).filter(|j| *j != i);
        others.map(|j| scale / (4.0 * (nodes[i] - nodes[j]))).product()
    };
    (0..nodes.len()).map(weight).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The weights of all nodes below n² add up to n², for every layer, and the integral of s² is exact to 2e-6.
    #[test]
    fn weights_measure_projected_solid_angles() {
        let iors = [1.0, 1.52, 1.33, 1.49];
        let quadrature = Quadrature::new(&iors, 1.53, NodeCounts::fine(1.0), [0.41, 0.59], 0.0);
        for n in iors.into_iter().chain([1.53]) {
            for power in 0..2 {
                let nodes = (0..quadrature.len()).filter(|i| quadrature.exists(*i, n));
                let sum: f64 = nodes.map(|i| quadrature.weights[i] * quadrature.s2[i].powi(power)).sum();
                let expected = n.powi(2 * power + 2) / f64::from(power + 1);
                let room = if power == 0 { 1e-12 } else { 2e-6 };
                assert!((sum / expected - 1.0).abs() < room, "{n} {power}: {sum} {expected}");
            }
        }
    }

    /// Polynomials in t are interpolated exactly, also at the ends of segments.
    #[test]
    fn polynomials_are_interpolated() {
        let quadrature = Quadrature::new(&[1.0], 1.5, NodeCounts::fine(1.0), [0.0, 1.0], 0.0);
        let mut weights = Vec::new();
        for s2 in [0.0, 0.3, 0.999, 1.0, 1.7, 2.24] {
            let segment = quadrature.segment(s2);
            let f = |s2: f64| 1.0 - 2.0 * segment.place(s2) + 0.5 * segment.place(s2).powi(3);
            segment.interpolation(segment.place(s2), &mut weights);
            let nodes = &quadrature.s2[segment.nodes.clone()];
            let found: f64 = weights.iter().zip(nodes).map(|(weight, s2)| weight * f(*s2)).sum();
            assert!((found - f(s2)).abs() < 1e-9, "{s2}: {found}");
        }
    }
}
