//! Polar angles at which radiances are computed, the same in all layers.
//!
//! A ray keeps s = n sin θ at smooth faces (Snell), and s² measures its projected solid angle: n² cos θ dω = π d(s²).
//! Radiances over n² change smoothly with s, except where a layer reflects totally and at the ends of the ring; between
//! these places there are Gauss–Legendre nodes.

use std::f64::consts::PI;

/// Nodes per unit of the cosine between smooth faces.
const SMOOTH: f64 = 20.0;
/// Nodes per unit of the cosine times the least roughness α of a face, which blurs the ends of the ring; times the width
/// of the narrowest peak of a phase function; and their maximum.
const PER_ROUGHNESS: f64 = 2.0;
const PER_PEAK: f64 = 4.0;
const MOST: f64 = 120.0;
/// Width of a ring over α up to which the blurred ring has nodes of its own.
const NARROW: f64 = 2.0;
/// Fewest nodes between two places.
const FEWEST: usize = 4;
/// Places of a histogram of rays in each segment.
const PLACES: usize = 256;

/// Nodes between two places.
#[derive(Debug, Clone)]
struct Segment {
    /// Indices of its nodes.
    nodes: std::ops::Range<usize>,
    /// s² at its ends.
    ends: (f64, f64),
    /// The index in whose cosine its nodes are Gauss–Legendre; None of those in s².
    ior: Option<f64>,
    /// Weights of barycentric interpolation.
    barycentric: Vec<f64>,
}

/// The nodes: those with weights, in rising s², then the sensor's direction, whose weight is 0.
#[derive(Debug, Clone)]
pub(crate) struct Quadrature {
    /// s².
    pub s2: Vec<f64>,
    /// Weights of d(s²).
    pub weights: Vec<f64>,
    segments: Vec<Segment>,
}

impl Quadrature {
    /// `iors` are the indices of all layers; `scattering` is that of the slabs, in which the nodes are spread evenly over
    /// the cosine; `roughness` is the least α of a rough face, `peak` the width of the narrowest peak of a phase function;
    /// `ring` are sin θ of its ends, and `sensor` is s² of the sensor.
    pub(crate) fn new(
        iors: &[f64],
        scattering: f64,
        roughness: Option<f64>,
        peak: f64,
        ring: [f64; 2],
        sensor: f64,
    ) -> Self {
        let for_faces = roughness.map_or(0.0, |alpha| PER_ROUGHNESS / alpha);
        let per_cosine = for_faces.max(PER_PEAK / peak).clamp(SMOOTH, MOST);
        let blurred = roughness.filter(|alpha| ring[1] - ring[0] < NARROW * alpha);
        let around =
            |alpha: f64| ring.into_iter().flat_map(move |end| [end - NARROW * alpha, end + NARROW * alpha]);
        let others: Vec<f64> = ring.into_iter().chain(blurred.into_iter().flat_map(around)).collect();
        let others: Vec<f64> = others.iter().map(|sin| sin.clamp(0.0, 1.0).powi(2)).collect();
        let greatest = iors.iter().fold(scattering.max(1.0), |a, b| a.max(*b)).powi(2);
        let squares = iors.iter().map(|n| n * n).chain(others.iter().copied());
        let mut places: Vec<f64> = squares.chain([0.0, 1.0, scattering * scattering]).collect();
        places.retain(|s2| (0.0..=greatest).contains(s2));
        places.sort_by(f64::total_cmp);
        places.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        let (mut s2, mut weights, mut segments) = (Vec::new(), Vec::new(), Vec::new());
        for pair in places.windows(2) {
            let first = s2.len();
            let ior = (pair[0] < scattering * scattering - 1e-9).then_some(scattering);
            let (of_segment, of_weights) = nodes(pair[0], pair[1], ior, per_cosine);
            let coordinates: Vec<f64> = of_segment.iter().map(|s2| coordinate(*s2, ior)).collect();
            segments.push(Segment {
                nodes: first..first + of_segment.len(),
                ends: (pair[0], pair[1]),
                ior,
                barycentric: barycentric(&coordinates),
            });
            s2.extend(of_segment);
            weights.extend(of_weights);
        }
        s2.push(sensor);
        weights.push(0.0);
        Self { s2, weights, segments }
    }

    pub(crate) fn len(&self) -> usize {
        self.s2.len()
    }

    /// Index of the sensor's direction.
    pub(crate) fn sensor(&self) -> usize {
        self.len() - 1
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

    /// Adds the light of a ray of this s² to a histogram of [`Self::places`] places: to the two that it lies between.
    pub(crate) fn deposit(&self, s2: f64, share: f64, histogram: &mut [f64]) {
        let last = self.segments.len() - 1;
        let at = self.segments.partition_point(|segment| segment.ends.1 <= s2).min(last);
        let [from, to] = self.segments[at].coordinates();
        let place = coordinate(s2, self.segments[at].ior);
        let place = ((place - from) / (to - from)).clamp(0.0, 1.0) * (PLACES - 1) as f64;
        let (first, part) = ((place as usize).min(PLACES - 2), place);
        let part = part - first as f64;
        histogram[at * PLACES + first] += share * (1.0 - part);
        histogram[at * PLACES + first + 1] += share * part;
    }

    /// Number of places of a histogram.
    pub(crate) fn places(&self) -> usize {
        self.segments.len() * PLACES
    }

    /// The light of a histogram, spread over the nodes: ∫ f is Σ f(node) weight for polynomials f of each segment.
    pub(crate) fn spread(&self, histogram: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.len()];
        for (segment, histogram) in self.segments.iter().zip(histogram.chunks(PLACES)) {
            let [from, to] = segment.coordinates();
            for (i, light) in histogram.iter().enumerate().filter(|(_, light)| **light != 0.0) {
                let place = from + (to - from) * i as f64 / (PLACES - 1) as f64;
                self.interpolate(segment, place, |node, weight| sums[node] += light * weight);
            }
        }
        sums
    }

    /// Calls a function with the nodes of a segment and their weights in an interpolation: a polynomial in the segment's
    /// coordinate.
    fn interpolate(&self, segment: &Segment, place: f64, mut each: impl FnMut(usize, f64)) {
        let off = |i: usize| place - coordinate(self.s2[segment.nodes.start + i], segment.ior);
        if let Some(exact) = (0..segment.nodes.len()).find(|i| off(*i).abs() < 1e-14) {
            return each(segment.nodes.start + exact, 1.0);
        }
        let term = |i: usize| segment.barycentric[i] / off(i);
        let sum: f64 = (0..segment.nodes.len()).map(term).sum();
        (0..segment.nodes.len()).for_each(|i| each(segment.nodes.start + i, term(i) / sum));
    }
}

impl Segment {
    fn coordinates(&self) -> [f64; 2] {
        [self.ends.0, self.ends.1].map(|s2| coordinate(s2, self.ior))
    }
}

/// The cosine in a medium of this index, or s².
fn coordinate(s2: f64, ior: Option<f64>) -> f64 {
    ior.map_or(s2, |n| (1.0 - s2 / (n * n)).max(0.0).sqrt())
}

/// Nodes and weights between two s²: Gauss–Legendre in the cosine where directions exist in the slabs, else in s².
fn nodes(from: f64, to: f64, ior: Option<f64>, per_cosine: f64) -> (Vec<f64>, Vec<f64>) {
    let Some(ior) = ior else {
        let (x, w) = gauss_legendre(FEWEST);
        let half = 0.5 * (to - from);
        return (x.iter().map(|x| from + half * (1.0 + x)).collect(), w.iter().map(|w| half * w).collect());
    };
    let n2 = ior * ior;
    let (high, low) = (coordinate(from, Some(ior)), coordinate(to, Some(ior)));
    let count = FEWEST + (per_cosine * (high - low)).round() as usize;
    let (x, w) = gauss_legendre(count);
    let half = 0.5 * (high - low);
    let mu = |x: &f64| high - half * (1.0 + x);
    let s2 = x.iter().map(|x| n2 * (1.0 - mu(x).powi(2))).collect();
    (s2, x.iter().zip(&w).map(|(x, w)| 2.0 * n2 * mu(x) * half * w).collect())
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

    /// The weights of all nodes below n² add up to n², for every layer, and integrals of powers of s² are exact.
    #[test]
    fn weights_measure_projected_solid_angles() {
        let iors = [1.0, 1.52, 1.33, 1.49];
        let quadrature = Quadrature::new(&iors, 1.53, None, 1.0, [0.64, 0.76], 0.0);
        for n in iors.into_iter().chain([1.53]) {
            for power in 0..3 {
                let nodes = (0..quadrature.len()).filter(|i| quadrature.exists(*i, n));
                let sum: f64 = nodes.map(|i| quadrature.weights[i] * quadrature.s2[i].powi(power)).sum();
                let expected = n.powi(2 * power + 2) / f64::from(power + 1);
                assert!((sum / expected - 1.0).abs() < 1e-9, "{n} {power}: {sum} {expected}");
            }
        }
    }

    /// A polynomial is interpolated exactly, also at the ends of segments.
    #[test]
    fn polynomials_are_interpolated() {
        let quadrature = Quadrature::new(&[1.0], 1.5, None, 1.0, [0.0, 1.0], 0.0);
        let f = |s2: f64| 1.0 - 2.0 * s2 + 0.5 * s2 * s2;
        for s2 in [0.0, 0.3, 0.999, 1.0, 1.7, 2.24] {
            let mut histogram = vec![0.0; quadrature.places()];
            quadrature.deposit(s2, 2.0, &mut histogram);
            let weights = quadrature.spread(&histogram);
            let found: f64 = weights.iter().zip(&quadrature.s2).map(|(weight, s2)| weight * f(*s2)).sum();
            assert!((found - 2.0 * f(s2)).abs() < 1e-4, "{s2}: {found}");
        }
    }
}
