//! Fits blur and place of the bare edge.
//!
//! Convention of all profiles: a value is the average over its bin of the scene convolved with a Gaussian of standard
//! deviation σ. That Gaussian holds the lens and the pixel's own aperture, whose variance is p²/12. On an edge
//! F(x) = d + (l − d) [G(x + w/2) − G(x − w/2)]/w, G(z) = z Φ(z/σ) + σ φ(z/σ). Light that spreads within the board adds
//! exponentials to both sides.

use optics_model::descent::{Descended, Descent, DescentEnd, DescentStep};

use crate::estimate::Estimate;
use crate::least_squares::{FittedParameters, NormalEquations};

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
    /// Spread of light within the board; 0 with its error where it does not show.
    pub spread: Estimate,
    pub dark: f64,
    pub light: f64,
    pub end: DescentEnd,
}

/// Dark, light, origin, σ, slopes of both sides, spread.
type Parameters = [f64; 7];
const ORIGIN: usize = 2;
const BLUR: usize = 3;
const SPREAD: usize = 6;

/// Parameters but some that are held.
fn all_but(held: &[usize]) -> Vec<usize> {
    (0..=SPREAD).filter(|i| !held.contains(i)).collect()
}

/// Standard errors from which on a spread shows.
const SHOWS: f64 = 4.0;

/// The edge of a board in which light may spread; None if the data show no edge.
///
/// Light enters at one place and leaves at another, and crosses the ink at both. So the sides approach the geometric mean
/// of their radiance factors at the edge, as an exponential with the spread as its length. The camera's blur is known from
/// another edge, or it is found with the spread.
pub(crate) fn fit_spread(edge: &EdgeBins, blur: Option<Estimate>) -> Option<EdgeFit> {
    let Some(blur) = blur else { return fit_held(edge, None) };
    let found = fit_held(edge, Some(blur.value))?;
    // The spread follows the error of the blur.
    let there = fit_held(edge, Some(blur.value + blur.std_error))?;
    let std_error = libm::hypot(found.spread.std_error, there.spread.value - found.spread.value);
    Some(EdgeFit { blur, spread: Estimate::new(found.spread.value, std_error), ..found })
}

/// The edge with its spread, at a blur if there is one.
fn fit_held(edge: &EdgeBins, blur: Option<f64>) -> Option<EdgeFit> {
    let mut start = start(edge)?;
    start[BLUR] = blur.unwrap_or(start[BLUR]);
    let free = |spread: &[usize]| {
        let of_blur = if blur.is_some() { &[BLUR][..] } else { &[] };
        all_but(&[spread, of_blur].concat())
    };
    let clean = descend(edge, start, &free(&[SPREAD]))?.edge();
    if !clean.is_inside(edge) {
        return None;
    }
    // A small spread has the effect of another place of the edge: it is held at values, and followed from the best.
    let held = |spread: f64| {
        let mut start = start;
        start[SPREAD] = spread;
        descend(edge, start, &free(&[SPREAD]))
    };
    let values = (0..).map(|i| 0.2 * edge.width * f64::from(i) * libm::pow(1.3, f64::from(i)));
    let tried = values.take_while(|b| *b < 0.5 * edge.reach);
    let tried: Vec<(f64, Minimum)> = tried.filter_map(|b| Some((b, held(b)?))).collect();
    let best = tried.iter().min_by(|(_, a), (_, b)| a.squares.total_cmp(&b.squares))?;
    let noise: f64 = edge.inside().iter().map(|p| p[2] * p[2]).sum();
    // χ² above that of the best, with the noise that the best leaves where it is above that of the bins.
    let rise =
        |m: &Minimum| (m.squares - best.1.squares) / noise.max(best.1.squares) * edge.inside().len() as f64;
    if rise(&tried[0].1) < SHOWS * SHOWS {
        let first = tried.iter().find(|(b, m)| *b > best.0 && rise(m) > 1.0);
        let std_error = first.map_or(edge.reach, |(b, _)| *b);
        return Some(EdgeFit { spread: Estimate::new(0.0, std_error), ..clean });
    }
    descend(edge, best.1.p, &free(&[])).map(|found| found.edge()).filter(|found| found.is_inside(edge))
}

/// The edge of a board in which light does not spread; None if the data show no edge.
pub(crate) fn fit(edge: &EdgeBins) -> Option<EdgeFit> {
    let fitted = descend(edge, start(edge)?, &all_but(&[SPREAD]))?.edge();
    fitted.is_inside(edge).then_some(fitted)
}

impl EdgeFit {
    fn is_inside(&self, edge: &EdgeBins) -> bool {
        self.origin.value.abs() < edge.reach && self.blur.value.is_finite()
    }
}

impl EdgeBins {
    fn inside(&self) -> Vec<[f64; 3]> {
        let inside = |p: &&[f64; 3]| p[0].abs() < self.reach && p[1].is_finite() && p[2] > 0.0;
        self.points.iter().filter(inside).copied().collect()
    }
}

fn start(edge: &EdgeBins) -> Option<Parameters> {
    let points = edge.inside();
    let outer = |sign: f64| {
        let values = points.iter().filter(|p| sign * p[0] > 0.5 * edge.reach).map(|p| p[1]);
        let (sum, n) = values.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
        sum / n
    };
    let (dark, light) = (outer(-1.0), outer(1.0));
    let blur = rise(&points, dark, light)?.clamp(0.5 * edge.width, 0.3 * edge.reach);
    Some([dark, light, 0.0, blur, 0.0, 0.0, 0.0])
}

/// The tolerance is the square of a step in standard errors. The first steps know nothing of the misfit.
const DESCENT: Descent = Descent { most_steps: 25, tolerance: 1e-6 };
const LEAST_STEPS: usize = 3;

/// A minimum.
struct Minimum {
    p: Parameters,
    parameters: FittedParameters,
    /// Those that are not held.
    free: Vec<usize>,
    /// Sum of squares of the residuals.
    squares: f64,
    end: DescentEnd,
}

impl Minimum {
    fn estimate(&self, i: usize) -> Estimate {
        let place = self.free.iter().position(|free| *free == i);
        Estimate::new(self.p[i], place.map_or(0.0, |place| self.parameters.std_error(place)))
    }

    fn edge(&self) -> EdgeFit {
        let is_free = self.free.contains(&SPREAD);
        let spread = if is_free { self.estimate(SPREAD) } else { Estimate::new(0.0, f64::INFINITY) };
        let [dark, light, ..] = self.p;
        let (origin, blur) = (self.estimate(ORIGIN), self.estimate(BLUR));
        EdgeFit { origin, blur, spread, dark, light, end: self.end }
    }
}

/// The minimum below a start, with some parameters free; None if the data do not determine these.
fn descend(edge: &EdgeBins, start: Parameters, free: &[usize]) -> Option<Minimum> {
    let points = edge.inside();
    // Parameters and misfit, with the sum of squares and the solution of the place before.
    let step = |(from, misfit, ..): &(Parameters, f64, f64, Option<FittedParameters>)| {
        // Dust was rejected in the bins, so all bins count here. Model error is assumed equal in all bins; otherwise
        // the dark side, with its low noise, would dominate.
        let mut normal = NormalEquations::new(free.len());
        let (mut squares, mut noise_squares) = (0.0, 0.0);
        for [x, v, e] in &points {
            let r = v - model(from, *x, edge.width);
            squares += r * r;
            noise_squares += e * e;
            let gradient = gradient(from, *x, edge.width);
            let row: Vec<f64> = free.iter().map(|i| gradient[*i]).collect();
            normal.add(&row, r, 1.0 / (e * e + misfit));
        }
        let n = points.len() as f64;
        let share = n / (n - free.len() as f64).max(1.0);
        let misfit = ((squares * share - noise_squares) / n).max(0.0);
        let (solution, mut p) = (normal.solve()?, *from);
        for (i, d) in free.iter().zip(solution.x.iter()) {
            p[*i] += d;
        }
        p[BLUR] = p[BLUR].clamp(0.1 * edge.width, edge.reach);
        p[SPREAD] = p[SPREAD].clamp(0.0, edge.reach);
        let length = |i: usize| (solution.x[i] / solution.std_error(i)).powi(2);
        let predicted = (0..free.len()).map(length).fold(0.0, f64::max);
        Some(DescentStep { to: (p, misfit, squares, Some(solution)), predicted })
    };
    let Descended { at, end } = DESCENT.whole(LEAST_STEPS, (start, 0.0, f64::INFINITY, None), step);
    let (p, _, squares, solution) = at;
    let parameters = solution.filter(|_| end != DescentEnd::NoDescent)?;
    Some(Minimum { p, parameters, free: free.to_vec(), squares, end })
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

/// ∫ of e^(−t/b) for t > 0, blurred.
fn decayed(z: f64, sigma: f64, spread: f64) -> f64 {
    let (u, ratio) = (z / sigma, sigma / spread);
    let beyond = ratio - u;
    let tail = if beyond > 10.0 {
        // The factors overflow: the asymptotic series of Φ.
        let phi = libm::exp(-0.5 * u * u) / (2.0 * std::f64::consts::PI).sqrt();
        phi / beyond * (1.0 - beyond.powi(-2) + 3.0 * beyond.powi(-4))
    } else {
        libm::exp(ratio * (0.5 * ratio - u)) * cumulative(-beyond)
    };
    spread * (cumulative(u) - tail)
}

fn model(p: &Parameters, x: f64, width: f64) -> f64 {
    let [dark, light, origin, sigma, of_dark, of_light, spread] = *p;
    let z = x - origin;
    let mean =
        |integral: &dyn Fn(f64) -> f64| (integral(z + 0.5 * width) - integral(z - 0.5 * width)) / width;
    let share = mean(&|z| primitive(z, sigma));
    let (dark_here, light_here) = (dark + of_dark * z, light + of_light * z);
    let sharp = dark_here + (light_here - dark_here) * share;
    if spread == 0.0 {
        return sharp;
    }
    let between = (light.max(0.0) * dark.max(0.0)).sqrt();
    let on_light = mean(&|z| decayed(z, sigma, spread));
    let on_dark = mean(&|z| -decayed(-z, sigma, spread));
    sharp + 0.5 * ((between - light) * on_light + (between - dark) * on_dark)
}

fn gradient(p: &Parameters, x: f64, width: f64) -> Parameters {
    std::array::from_fn(|i| {
        let step = if i == SPREAD { 1e-5 } else { 1e-6 };
        let (mut up, mut down) = (*p, *p);
        up[i] += step;
        // A spread is not negative.
        down[i] -= if i == SPREAD && p[i] < step { 0.0 } else { step };
        (model(&up, x, width) - model(&down, x, width)) / (up[i] - down[i])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An exact edge in bins of 0.03 mm, its origin off by 0.011 mm.
    fn edge(error: f64) -> EdgeBins {
        let p = [0.02, 0.8, 0.011, 0.029, 0.0, -0.004, 0.0];
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

    /// Blur and spread of an exact edge are separated; without a spread it is 0, and the blur that of the plain fit.
    #[test]
    fn spread_is_separated_from_blur() {
        for spread in [0.02, 0.05, 0.1, 0.3] {
            let p = [0.02, 0.8, 0.011, 0.029, 0.0, 0.0, spread];
            let points = (-120..=120).map(|k| f64::from(k) * 0.01);
            let points = points.map(|x| [x, model(&p, x, 0.01), 1e-3]).collect();
            let edge = EdgeBins { width: 0.01, reach: 1.2, points };
            let found = fit_spread(&edge, None).unwrap();
            for (estimate, truth) in [(found.spread, spread), (found.blur, 0.029), (found.origin, 0.011)] {
                assert!((estimate.value - truth).abs() < 1e-4, "{spread}: {found:?}");
            }
            // A known blur makes the spread's error smaller; an error of the blur counts.
            let known = |std_error| fit_spread(&edge, Some(Estimate::new(0.029, std_error))).unwrap().spread;
            assert!((known(0.0).value - spread).abs() < 1e-4, "{spread}: {:?}", known(0.0));
            assert!(known(0.0).std_error < found.spread.std_error, "{spread}: {:?}", known(0.0));
            assert!(known(1e-3).std_error > 1.1 * known(0.0).std_error, "{spread}: {:?}", known(1e-3));
        }
        let (clean, found) = (fit(&edge(1e-3)).unwrap(), fit_spread(&edge(1e-3), None).unwrap());
        assert_eq!((found.spread.value, found.blur), (0.0, clean.blur));
        assert!((0.005..0.03).contains(&found.spread.std_error), "{found:?}");
    }

    /// The mean of bins of light that spreads has the value of the formula without blur far from the edge.
    #[test]
    fn blurred_exponential_is_exact_afar() {
        let [dark, light, spread] = [0.09_f64, 0.81, 0.2];
        let p = [dark, light, 0.0, 0.01, 0.0, 0.0, spread];
        for (x, plateau) in [(0.3, light), (-0.25, dark)] {
            let expected = plateau + 0.5 * libm::exp(-f64::abs(x) / spread) * (0.27 - plateau);
            // A blur of σ multiplies the exponential by e^(σ²/2b²).
            assert!(
                (model(&p, x, 1e-4) - expected).abs() < 2e-3 * expected,
                "{x}: {} {expected}",
                model(&p, x, 1e-4)
            );
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
