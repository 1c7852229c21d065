//! Fits blur and place of the bare edge.
//!
//! Convention of all profiles: a value is the average over its bin of the scene convolved with a Gaussian of standard
//! deviation σ. That Gaussian holds the lens and the pixel's own aperture, whose variance is p²/12. On an edge
//! F(x) = d + (l − d) [G(x + w/2) − G(x − w/2)]/w, G(z) = z Φ(z/σ) + σ φ(z/σ).

use crate::estimate::Estimate;
use crate::least_squares::NormalEquations;

/// An edge in bins: their width w, the distance within which it is fitted, and place, value and error of each bin. The
/// results are in the same unit of length.
#[derive(Debug, Clone)]
pub(crate) struct EdgeBins {
    pub width: f64,
    pub reach: f64,
    pub points: Vec<[f64; 3]>,
}

/// The fitted edge between two even sides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EdgeFit {
    pub origin: Estimate,
    pub blur: Estimate,
    pub dark: f64,
    pub light: f64,
}

/// None if the data show no edge.
pub(crate) fn fit(edge: &EdgeBins) -> Option<EdgeFit> {
    let EdgeBins { width, reach, .. } = *edge;
    let inside = |p: &&[f64; 3]| p[0].abs() < reach && p[1].is_finite() && p[2] > 0.0;
    let points: Vec<[f64; 3]> = edge.points.iter().filter(inside).copied().collect();
    let outer = |sign: f64| {
        let values = points.iter().filter(|p| sign * p[0] > 0.5 * reach).map(|p| p[1]);
        let (sum, n) = values.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
        sum / n
    };
    // Dark, light, origin, σ, and slopes of both sides.
    let mut p = [
        outer(-1.0),
        outer(1.0),
        0.0,
        rise(&points, outer(-1.0), outer(1.0))?.clamp(0.5 * width, 0.3 * reach),
        0.0,
        0.0,
    ];
    let mut found = None;
    let mut misfit = 0.0;
    for _ in 0..25 {
        // Dust was rejected in the bins, so all bins count here. Model error is assumed equal in all bins; otherwise
        // the dark side, with its low noise, would dominate.
        let mut normal = NormalEquations::new(p.len());
        let (mut found_squares, mut noise_squares) = (0.0, 0.0);
        for [x, v, e] in &points {
            let r = v - model(&p, *x, width);
            found_squares += r * r;
            noise_squares += e * e;
            normal.add(&gradient(&p, *x, width), r, 1.0 / (e * e + misfit));
        }
        let share = points.len() as f64 / (points.len() as f64 - p.len() as f64).max(1.0);
        misfit = ((found_squares * share - noise_squares) / points.len() as f64).max(0.0);
        let solution = normal.solve()?;
        for (p, d) in p.iter_mut().zip(solution.x.iter()) {
            *p += d;
        }
        p[3] = p[3].clamp(0.1 * width, reach);
        found = Some(solution);
    }
    let solution = found?;
    let estimate = |i: usize| Estimate::new(p[i], solution.std_error(i));
    let fitted = EdgeFit { origin: estimate(2), blur: estimate(3), dark: p[0], light: p[1] };
    (fitted.origin.value.abs() < reach && fitted.blur.value.is_finite()).then_some(fitted)
}

/// σ from the distance between a quarter and three quarters of the rise: of several crossings that nearest to 0 counts,
/// since a bright bin on the dark side has two of its own.
fn rise(points: &[[f64; 3]], dark: f64, light: f64) -> Option<f64> {
    let crossing = |share: f64| {
        let level = dark + share * (light - dark);
        let is_above = |p: &[f64; 3]| (p[1] - level) * (light - dark).signum() >= 0.0;
        let pairs = points.windows(2).filter(|pair| is_above(&pair[0]) != is_above(&pair[1]));
        pairs.map(|pair| f64::midpoint(pair[0][0], pair[1][0])).min_by(|a, b| a.abs().total_cmp(&b.abs()))
    };
    Some((crossing(0.75)? - crossing(0.25)?) / 1.35)
}

/// ∫ Φ(z/σ) dz
fn primitive(z: f64, sigma: f64) -> f64 {
    let u = z / sigma;
    let phi = libm::exp(-0.5 * u * u) / (2.0 * std::f64::consts::PI).sqrt();
    z * cumulative(u) + sigma * phi
}

fn cumulative(u: f64) -> f64 {
    0.5 * libm::erfc(-u / std::f64::consts::SQRT_2)
}

fn model(p: &[f64; 6], x: f64, width: f64) -> f64 {
    let z = x - p[2];
    let share = (primitive(z + 0.5 * width, p[3]) - primitive(z - 0.5 * width, p[3])) / width;
    let (dark, light) = (p[0] + p[4] * z, p[1] + p[5] * z);
    dark + (light - dark) * share
}

fn gradient(p: &[f64; 6], x: f64, width: f64) -> [f64; 6] {
    std::array::from_fn(|i| {
        let step = 1e-6;
        let (mut up, mut down) = (*p, *p);
        up[i] += step;
        down[i] -= step;
        (model(&up, x, width) - model(&down, x, width)) / (2.0 * step)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An exact edge in bins of 0.03 mm, its origin off by 0.011 mm.
    fn edge(error: f64) -> EdgeBins {
        let p = [0.02, 0.8, 0.011, 0.029, 0.0, -0.004];
        let point = |k: i32| f64::from(k) * 0.03;
        let points = (-40..=40).map(|k| [point(k), model(&p, point(k), 0.03), error]).collect();
        EdgeBins { width: 0.03, reach: 0.6, points }
    }

    /// The fit of an exact edge returns its place and its blur; their errors are proportional to those of the bins.
    #[test]
    fn exact_edge_gives_place_and_blur() {
        let [one, two] = [1e-3, 2e-3].map(|e| fit(&edge(e)).unwrap());
        assert!((one.origin.value - 0.011).abs() < 1e-8 && (one.blur.value - 0.029).abs() < 1e-8, "{one:?}");
        for (one, two) in [(one.origin, two.origin), (one.blur, two.blur)] {
            assert!((two.std_error / one.std_error - 2.0).abs() < 1e-6);
        }
    }

    /// A bin on the dark side that is as bright as a third of the edge hides neither place nor blur.
    #[test]
    fn bright_bin_hides_no_edge() {
        let hot = |at: usize| {
            let mut edge = edge(1e-3);
            edge.points[at][1] += 0.3 * 0.78;
            fit(&edge).unwrap()
        };
        for at in [22, 28, 33] {
            let found = hot(at);
            for (estimate, truth) in [(found.origin, 0.011), (found.blur, 0.029)] {
                assert!((estimate.value - truth).abs() < estimate.std_error, "{at}: {found:?}");
                assert!(estimate.std_error < 0.2 * 0.029, "{at}: {found:?}");
            }
        }
    }

    /// Bins that do not rise are not an edge.
    #[test]
    fn flat_bins_are_no_edge() {
        let flat =
            EdgeBins { points: edge(1e-3).points.iter().map(|p| [p[0], 0.5, p[2]]).collect(), ..edge(1e-3) };
        assert!(fit(&flat).is_none());
    }
}
