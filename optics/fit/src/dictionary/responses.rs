//! Estimates the effect of the uncertain quantities of a scene on the records of a dictionary in one channel, from
//! records that were traced in varied scenes and in the scene itself with the same random walks.
//!
//! A quantity that is off by u standard deviations of its prior changes a profile by h(u) L. The profile L depends on the
//! medium; the curve h does not: it is estimated from all records at once, so that its noise is negligible. The effect of a
//! spread within the base changes its width with the spread: it is that of [`BaseSpread`] and Σ h_k(u) L_k, interpolated
//! between those traced.

use std::borrow::Cow;
use std::sync::Arc;

use optics_model::Grid;
use optics_model::grid::Responses;
use optics_model::scene::Prior;
use rayon::prelude::*;

use crate::dictionary::base_spread::BaseSpread;
use crate::dictionary::records::Records;
use linear::LinearResponse;
use signal::{LinearRows, NodeOrder};

pub(crate) mod linear;
mod signal;

/// Relative change of a profile by one standard deviation below which a quantity's curve is taken to be straight.
const NO_EFFECT: f64 = 1e-4;
/// The slope of a curve is at least a tenth of that at 0 over all of the prior's range: 1 + 2 q w ≥ 0.1.
const MOST_CURVATURE: f64 = 0.45;

/// Bytes that a grid's responses take in one channel while they are made.
pub(crate) fn bytes_of(grid: &Grid) -> usize {
    let records = grid.stored_records() - grid.record_count();
    records.saturating_mul(grid.scene().sensor().pixels() * size_of::<f32>())
}

/// h(u): of a bent curve w (1 + q w) with w = u (1 + b u).
///
/// For a roughness α, w is linear in α², as is the variance of a face's slopes; for all else b = 0. q follows from the
/// differences traced at two values; it is 0 if one value is traced.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum ResponseCurve {
    Bent(BentCurve),
    /// 1 at one of the rising places u and 0 at the others and at 0: Lagrange's polynomial in u/(u + [`HALF_WAY`]).
    Node {
        nodes: Arc<[f64]>,
        node: usize,
    },
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct BentCurve {
    pub bend: f64,
    pub curvature: f64,
}

/// Standard deviations at which the coordinate of a spread is ½. With the traced spreads, e^(−x/b) of all spreads b is
/// interpolated to 0.5 % of its height.
const HALF_WAY: f64 = 1.0;

impl ResponseCurve {
    /// h and its derivative.
    pub(crate) fn at(&self, u: f64) -> (f64, f64) {
        match self {
            Self::Bent(curve) => curve.at(u),
            Self::Node { nodes, node } => at_node(nodes, *node, u),
        }
    }

    /// Whether it is that of a spread within the base.
    pub(crate) fn is_of_spread(&self) -> bool {
        matches!(self, Self::Node { .. })
    }

    /// Standard deviations of the prior by which fits leave the quantity uncertain. Six materials determine a spread of u
    /// standard deviations to about 0.02 to 0.12 of one.
    pub(crate) fn reach(&self, u: f64) -> f64 {
        match self {
            Self::Bent(_) => 1.0,
            Self::Node { .. } => 0.03 * (1.0 + u),
        }
    }
}

impl BentCurve {
    fn at(self, u: f64) -> (f64, f64) {
        let w = self.bent(u);
        let slope = (1.0 + 2.0 * self.curvature * w) * (1.0 + 2.0 * self.bend * u);
        (w * (1.0 + self.curvature * w), slope)
    }

    fn bent(self, u: f64) -> f64 {
        u * (1.0 + self.bend * u)
    }
}

fn at_node(nodes: &[f64], node: usize, u: f64) -> (f64, f64) {
    let coordinate = |u: f64| u / (u + HALF_WAY);
    let (at, own) = (coordinate(u), coordinate(nodes[node]));
    let others = nodes.iter().enumerate().filter(|(k, _)| *k != node).map(|(_, u)| coordinate(*u));
    let (mut value, mut slope) = (1.0, 0.0);
    for other in others.chain([0.0]) {
        let factor = (at - other) / (own - other);
        slope = slope * factor + value / (own - other);
        value *= factor;
    }
    (value, slope * HALF_WAY / (u + HALF_WAY).powi(2))
}

/// Collects the records of varied scenes and those of the baseline: `[record beyond those of the axes][pixel]`.
#[derive(Debug)]
pub(crate) struct VariedRecords {
    grid: Arc<Grid>,
    values: Vec<f32>,
}

impl VariedRecords {
    /// All values are 0 at first.
    pub(crate) fn new(grid: Arc<Grid>) -> Self {
        let numbers = bytes_of(&grid) / size_of::<f32>();
        Self { grid, values: vec![0.0; numbers] }
    }

    /// Sets the values of a record beyond those of the axes.
    pub(crate) fn set(&mut self, record: usize, values: impl Iterator<Item = f32>) {
        let (pixels, first) = (self.pixels(), self.grid.record_count());
        let row = &mut self.values[(record - first) * pixels..][..pixels];
        row.iter_mut().zip(values).for_each(|(v, new)| *v = new);
    }

    /// Computes the responses, once all records are set.
    pub(crate) fn responses(self, records: &Records, channel: usize) -> ResponseRecords {
        let grid = self.grid.clone();
        let spread = BaseSpread::uncertain(&grid, channel);
        let mut parts = Vec::new();
        if let Some(responses) = grid.responses() {
            let priors = grid.scene().priors().par_iter().enumerate();
            let of_prior = priors.map(|(index, prior)| {
                let steps = steps_of(responses, index, prior);
                if !prior.kind().is_traced() {
                    let even = LinearResponse::Even { value: prior.std_error(), pixels: self.pixels() };
                    return vec![(ResponseCurve::Bent(BentCurve::default()), even)];
                }
                if steps.len() <= 2 {
                    let curve = ResponseCurve::Bent(self.curve(prior, &steps, records));
                    let linear = self.linear(&steps, &curve, records, None);
                    return vec![(curve, linear)];
                }
                let nodes: Arc<[f64]> = steps.iter().map(|(_, u)| *u).collect();
                let at_node = |(node, step): (usize, &(usize, f64))| {
                    let curve = ResponseCurve::Node { nodes: nodes.clone(), node };
                    let linear = self.linear(&[*step], &curve, records, spread.as_ref());
                    (curve, linear)
                };
                steps.iter().enumerate().map(at_node).collect()
            });
            parts = of_prior.collect();
        }
        ResponseRecords { grid, parts }
    }

    /// L of a quantity at all nodes, by least squares of its differences, without most of their noise; of a spread of what
    /// they are beyond its first-order effect.
    fn linear(
        &self,
        steps: &[(usize, f64)],
        curve: &ResponseCurve,
        records: &Records,
        spread: Option<&BaseSpread>,
    ) -> LinearResponse {
        let heights: Vec<f64> = steps.iter().map(|(_, u)| curve.at(*u).0).collect();
        let square: f64 = heights.iter().map(|h| h * h).sum();
        let weights: Vec<f64> = heights.iter().map(|h| h / square).collect();
        let room = || Vec::with_capacity(self.values.len() / self.variants());
        let (mut linear, mut of_scene) = (room(), room());
        let mut add = |differences: &[Vec<f64>], row: &[f32]| {
            let first_order = spread.map(|spread| {
                let plain: Vec<f64> = row.iter().map(|v| f64::from(*v)).collect();
                spread.effect_at(&plain, steps[0].1)
            });
            let pixel_response = |p: usize| {
                let sum = weights.iter().zip(differences).map(|(w, d)| w * d[p]).sum::<f64>();
                sum - first_order.as_ref().map_or(0.0, |effect| effect[p])
            };
            linear.extend((0..row.len()).map(|p| pixel_response(p) as f32));
            of_scene.extend_from_slice(row);
        };
        self.each_row(steps, records, &mut add);
        let pixels = self.pixels();
        let reduced = LinearRows::new(&linear, &of_scene, pixels).without_noise(&NodeOrder::of(&self.grid));
        reduced.unwrap_or(LinearResponse::Rows { values: linear, pixels })
    }

    /// The curve that relates the differences of all records at two steps best, relative to the profiles. Pixels of value
    /// 0 are skipped, since they have no relative difference.
    fn curve(&self, prior: &Prior, steps: &[(usize, f64)], records: &Records) -> BentCurve {
        let straight = BentCurve { bend: prior.bend(self.grid.scene()), curvature: 0.0 };
        let &[(_, near), (_, far)] = steps else { return straight };
        let at = [near, far].map(|u| straight.bent(u));
        // Sums of squares and of products of both differences over w.
        let (mut squares, mut product) = ([0.0; 2], 0.0);
        let mut add = |differences: &[Vec<f64>], of_scene: &[f32]| {
            for (p, value) in of_scene.iter().enumerate().filter(|(_, value)| **value > 0.0) {
                let [a, b] = std::array::from_fn(|i| differences[i][p] / (f64::from(*value) * at[i]));
                let none = NO_EFFECT * NO_EFFECT;
                (squares[0], squares[1]) = (squares[0] + a * a + none, squares[1] + b * b + none);
                product += a * b + none;
            }
        };
        self.each_row(steps, records, &mut add);
        let steps = steps.iter().map(|(_, u)| u * prior.std_error()).collect::<Vec<_>>();
        let (low, high) = prior.range_of(self.grid.scene(), &steps);
        let ends = [low, high].map(|end| straight.bent(end / prior.std_error()));
        BentCurve { curvature: curvature(at, squares, product, ends), ..straight }
    }

    /// Calls a function with the differences at these variants and the scene's own values, for every record.
    fn each_row(
        &self,
        steps: &[(usize, f64)],
        records: &Records,
        each: &mut impl FnMut(&[Vec<f64>], &[f32]),
    ) {
        let (grid, pixels) = (&self.grid, self.pixels());
        let albedos = grid.albedo().len();
        let responses = grid.responses().expect("the grid has responses");
        let row = |job: usize, albedo: usize| {
            let row = (job - grid.nominal_jobs()) * albedos + albedo;
            &self.values[row * pixels..][..pixels]
        };
        let (first, ..) = steps[0];
        let mut differences = vec![vec![0.0; pixels]; steps.len()];
        let at_nodes = (0..grid.nominal_jobs()).filter(|job| grid.response_job(Some(first), *job).is_some());
        for (nominal, albedo) in at_nodes.flat_map(|job| (0..albedos).map(move |albedo| (job, albedo))) {
            let baseline = responses.is_by_baseline(first).then(|| grid.response_job(None, nominal));
            let of_scene = match baseline.flatten() {
                Some(job) => Cow::Borrowed(row(job, albedo)),
                None => records.values(grid.first_record(nominal) + albedo, 0..pixels),
            };
            for (difference, (variant, _)) in differences.iter_mut().zip(steps) {
                let job = grid.response_job(Some(*variant), nominal).expect("variants have the same nodes");
                let values = row(job, albedo).iter().zip(&*of_scene);
                difference.iter_mut().zip(values).for_each(|(d, (v, s))| *d = f64::from(*v) - f64::from(*s));
            }
            each(&differences, &of_scene);
        }
    }

    /// Number of scenes other than the grid's that its records are traced in.
    fn variants(&self) -> usize {
        self.grid.responses().map_or(1, |responses| responses.variants().len().max(1))
    }

    fn pixels(&self) -> usize {
        self.grid.scene().sensor().pixels()
    }
}

/// The variants of a prior, and their steps in its standard deviations.
fn steps_of(responses: &Responses, index: usize, prior: &Prior) -> Vec<(usize, f64)> {
    let variants = responses.variants().iter().enumerate().filter(|(_, v)| v.prior == index);
    variants.map(|(number, variant)| (number, variant.step / prior.std_error())).collect()
}

/// q from two places w, given the sums of squares and of products of the differences over w: that of the line through the
/// origin from which both deviate least, limited so that the curve rises between the given ends.
fn curvature(at: [f64; 2], squares: [f64; 2], product: f64, ends: [f64; 2]) -> f64 {
    let half = 0.5 * (squares[0] - squares[1]);
    // The first difference over w is this multiple of the second.
    let ratio = (half + libm::hypot(half, product)) / product;
    let found = (ratio - 1.0) / (at[0] - ratio * at[1]);
    let [low, high] = ends;
    let most = if low < 0.0 { -MOST_CURVATURE / low } else { f64::INFINITY };
    if found.is_finite() { found.clamp(-MOST_CURVATURE / high, most) } else { 0.0 }
}

/// L of every quantity of the scene at the nodes of the responses, and the curves.
#[derive(Debug)]
pub(crate) struct ResponseRecords {
    grid: Arc<Grid>,
    /// By prior of the scene; rows of L are records of the nodes.
    parts: Vec<Vec<(ResponseCurve, LinearResponse)>>,
}

impl ResponseRecords {
    /// The curves of a quantity, each with its L.
    pub(crate) fn parts(&self, prior: usize) -> &[(ResponseCurve, LinearResponse)] {
        &self.parts[prior]
    }

    /// The row of a record of the axes; None where responses are not traced.
    pub(crate) fn row(&self, record: usize) -> Option<usize> {
        let albedos = self.grid.albedo().len();
        // The jobs of the first variant come first.
        let job = self.grid.response_job(Some(0), record / albedos)? - self.grid.nominal_jobs();
        Some(job * albedos + record % albedos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The curvature of two exact differences is recovered; without an effect a curve is straight.
    #[test]
    fn curvature_follows_from_two_differences() {
        let (at, ends) = ([-1.3, 3.5], [-1.4, 3.8]);
        for q in [-0.1, 0.0, 0.2] {
            let [a, b] = at.map(|w: f64| 0.7 * (1.0 + q * w));
            let found = curvature(at, [a * a, b * b], a * b, ends);
            assert!((found - q).abs() < 1e-12, "{found} {q}");
        }
        assert_eq!(curvature(at, [1e-8; 2], 1e-8, ends), 0.0);
    }

    /// Whatever the differences at the steps, a curve rises over the whole range of its prior.
    #[test]
    fn curves_of_lab_rise_over_their_ranges() {
        let scene = optics_model::Scene::lab();
        for prior in scene.priors() {
            let straight = BentCurve { bend: prior.bend(&scene), curvature: 0.0 };
            let in_errors = |difference: f64| difference / prior.std_error();
            let steps: Vec<f64> = prior.steps(&scene).into_iter().map(in_errors).collect();
            let &[near, far] = &steps[..] else { continue };
            let (low, high) = prior.range(&scene);
            let ends = [low, high].map(in_errors);
            // The differences over w at one step are ten times those at the other.
            for squares in [[100.0, 1.0], [1.0, 100.0]] {
                let at = [near, far].map(|u| straight.bent(u));
                let curvature = curvature(at, squares, 10.0, ends.map(|u| straight.bent(u)));
                assert_ne!(curvature, 0.0);
                let curve = BentCurve { curvature, ..straight };
                for i in 0..=100 {
                    let u = ends[0] + f64::from(i) / 100.0 * (ends[1] - ends[0]);
                    assert!(curve.at(u).1 > 0.0, "{}: {u}", scene.name_of(prior));
                }
            }
        }
    }

    /// The slope of a curve is its derivative. Curves of nodes are 1 at their own and 0 at the others.
    #[test]
    fn curve_has_the_slope_of_its_heights() {
        let nodes: Arc<[f64]> = vec![0.2, 0.6, 1.5, 4.0].into();
        let at_node = |node| ResponseCurve::Node { nodes: nodes.clone(), node };
        for (node, u) in (0..4).flat_map(|node| [0.0, 0.2, 0.6, 1.5, 4.0].map(|u| (node, u))) {
            let expected = f64::from(u8::from(nodes[node] == u));
            assert!((at_node(node).at(u).0 - expected).abs() < 1e-12, "{node} {u}");
        }
        for curve in [ResponseCurve::Bent(BentCurve { bend: 0.3, curvature: -0.1 }), at_node(2)] {
            for u in [0.0, 0.4, 2.0] {
                let [low, high] = [u - 1e-6, u + 1e-6].map(|u| curve.at(u).0);
                assert!((curve.at(u).1 - (high - low) / 2e-6).abs() < 1e-8);
            }
        }
    }
}
