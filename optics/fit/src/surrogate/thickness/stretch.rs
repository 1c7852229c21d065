//! Scales the x of a profile about the edge, and keeps its pixels.
//!
//! The integral of the profile is interpolated, and not across the edge if that lies between two pixels.

use crate::surrogate::interpolation::{NODES, Place};

/// Share of the pixels, at an end, whose mean and slope determine the tail beyond it.
const TAIL_SHARE: f64 = 1.0 / 15.0;

/// The continuation of a profile beyond its pixels.
#[derive(Debug, Clone, Copy)]
pub(super) enum Tail {
    /// Its slope decays, with this length in pixels.
    Levels(f64),
    /// The profile itself decays, with this length in pixels.
    Vanishes(f64),
}

impl Tail {
    /// Value beyond the end at `distance` from the middle of a stretch with this mean and outward slope.
    fn value(self, mean: f64, slope: f64, distance: f64) -> f64 {
        match self {
            Self::Levels(length) => mean + slope * length * (1.0 - libm::exp(-distance / length)),
            Self::Vanishes(length) => mean * libm::exp(-distance / length),
        }
    }
}

/// The map from a profile to the profile whose x is `ratio` times as large.
#[derive(Debug)]
pub(super) struct Stretch {
    pixels: usize,
    ratio: f64,
    /// Number of pixels that are needed beyond each end.
    margin: usize,
    edges: Vec<CellEdge>,
}

/// An edge of a pixel, mapped to the profile before scaling.
#[derive(Debug)]
struct CellEdge {
    /// Pixels from x = 0.
    position: f64,
    place: Place,
}

impl Stretch {
    pub(super) fn new(pixels: usize, ratio: f64) -> Self {
        let half = 0.5 * pixels as f64;
        let margin = (half * (1.0 / ratio - 1.0)).max(0.0).ceil() as usize;
        let edge = |i: usize| CellEdge::new((i as f64 - half) / ratio, pixels, margin);
        Self { pixels, ratio, margin, edges: (0..=pixels).map(edge).collect() }
    }

    pub(super) fn apply(&self, profile: &[f64], tail: Tail) -> Vec<f64> {
        let integral = self.integral(profile, tail);
        self.means(|edge| edge.place.integral(&integral))
    }

    /// The result, and its derivative by the logarithm of the ratio.
    pub(super) fn apply_with_slope(&self, profile: &[f64], tail: Tail) -> (Vec<f64>, Vec<f64>) {
        let integral = self.integral(profile, tail);
        let values = self.means(|edge| edge.place.integral(&integral));
        let mut slope = self.means(|edge| -edge.position * edge.place.integrand(&integral));
        slope.iter_mut().zip(&values).for_each(|(s, v)| *s += v);
        (values, slope)
    }

    /// Means over the pixels, from the integral up to each edge.
    fn means(&self, integral: impl Fn(&CellEdge) -> f64) -> Vec<f64> {
        let mut before = integral(&self.edges[0]);
        let mean = |edge: &CellEdge| {
            let up_to = integral(edge);
            let mean = self.ratio * (up_to - before);
            before = up_to;
            mean
        };
        self.edges[1..].iter().map(mean).collect()
    }

    /// Integral up to each edge of the pixels, those beyond the ends included, with zeros after them.
    fn integral(&self, profile: &[f64], tail: Tail) -> Vec<f64> {
        let (mut left, right) = (self.beyond(profile.iter(), tail), self.beyond(profile.iter().rev(), tail));
        left.reverse();
        let mut integral = Vec::with_capacity(profile.len() + 2 * self.margin + NODES);
        let mut sum = 0.0;
        integral.push(0.0);
        for part in [&left, profile, &right] {
            for v in part {
                sum += v;
                integral.push(sum);
            }
        }
        integral.resize(integral.len() + NODES, 0.0);
        integral
    }

    /// Values beyond the end at which `inward` begins, the nearest first.
    fn beyond<'a>(&self, inward: impl Iterator<Item = &'a f64>, tail: Tail) -> Vec<f64> {
        if self.margin == 0 {
            return Vec::new();
        }
        let count = ((TAIL_SHARE * self.pixels as f64) as usize).max(4).min(self.pixels);
        let middle = 0.5 * (count - 1) as f64;
        let (mut mean, mut moment, mut square) = (0.0, 0.0, 0.0);
        for (i, v) in inward.take(count).enumerate() {
            let outward = middle - i as f64;
            mean += v / count as f64;
            moment += outward * v;
            square += outward * outward;
        }
        let slope = if square > 0.0 { moment / square } else { 0.0 };
        (1..=self.margin).map(|i| tail.value(mean, slope, i as f64 + middle)).collect()
    }
}

impl CellEdge {
    /// `position` is in pixels from x = 0, of a profile with `margin` pixels beyond each end.
    fn new(position: f64, pixels: usize, margin: usize) -> Self {
        let cells = pixels + 2 * margin;
        let at = (position + 0.5 * cells as f64).clamp(0.0, cells as f64);
        let side = match cells / 2 {
            half if !pixels.is_multiple_of(2) || half == 0 => 0..cells,
            half if position < 0.0 => 0..half,
            half => half..cells,
        };
        Self { position, place: Place::new(at, side) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 100;
    const TAIL: Tail = Tail::Levels(20.0);

    /// Means over the pixels, 0.1 mm wide, of the function with this integral.
    fn means(integral: impl Fn(f64) -> f64) -> Vec<f64> {
        let edge = |i: usize| (i as f64 - 50.0) / 10.0;
        (0..PIXELS).map(|i| 10.0 * (integral(edge(i + 1)) - integral(edge(i)))).collect()
    }

    fn farthest(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// A step at the edge, and a different polynomial of fourth degree on either side of it.
    fn broken(x: f64) -> f64 {
        if x < 0.0 { 0.1 * x + 0.01 * x.powi(5) } else { 0.7 * x - 0.02 * x.powi(3) + 0.003 * x.powi(5) }
    }

    #[test]
    fn steps_and_polynomials_are_scaled_exactly() {
        for ratio in [1.0, 1.03, 1.7, 2.0] {
            let stretched = Stretch::new(PIXELS, ratio).apply(&means(broken), TAIL);
            let exact = means(|x| ratio * broken(x / ratio));
            assert!(farthest(&stretched, &exact) < 1e-10, "{ratio}: {}", farthest(&stretched, &exact));
        }
    }

    /// With the edge in the middle of a pixel, a straight line stays a straight line.
    #[test]
    fn edge_within_a_pixel_keeps_lines_straight() {
        let smooth: Vec<f64> = (0..9).map(|i| f64::from(i) - 4.0).collect();
        let stretched = Stretch::new(9, 1.25).apply(&smooth, TAIL);
        assert!(stretched.iter().zip(&smooth).all(|(a, b)| (a - b / 1.25).abs() < 1e-12), "{stretched:?}");
    }

    /// Profiles with few pixels are scaled as well.
    #[test]
    fn few_pixels_are_scaled() {
        for n in 1..8 {
            for ratio in [0.5, 0.9, 1.1] {
                let stretched = Stretch::new(n, ratio).apply(&vec![0.3; n], TAIL);
                assert!(stretched.iter().all(|v| (v - 0.3).abs() < 1e-12), "{n}, {ratio}: {stretched:?}");
            }
        }
    }

    /// The slope is the derivative by the logarithm of the ratio.
    #[test]
    fn slope_is_the_log_ratio_derivative() {
        let profile = means(|x| libm::log(libm::cosh(x / 0.7)) + 0.3 * x);
        for (ratio, tail) in [(0.88, TAIL), (0.613, Tail::Vanishes(30.0)), (1.0, TAIL), (1.31, TAIL)] {
            let (values, slope) = Stretch::new(PIXELS, ratio).apply_with_slope(&profile, tail);
            assert_eq!(values, Stretch::new(PIXELS, ratio).apply(&profile, tail));
            let at = |by: f64| Stretch::new(PIXELS, ratio * libm::exp(by)).apply(&profile, tail);
            let numerical: Vec<f64> = at(1e-5).iter().zip(at(-1e-5)).map(|(a, b)| (a - b) / 2e-5).collect();
            assert!(farthest(&slope, &numerical) < 1e-4, "{ratio}: {}", farthest(&slope, &numerical));
        }
    }

    /// Exponential tails of either kind are continued, if they have the given decay length.
    #[test]
    fn exponential_tails_are_continued() {
        let length = 2.0;
        let rising = |x: f64| 0.4 * x + 0.1 * length * libm::exp(-x.abs() / length);
        let stretched = Stretch::new(PIXELS, 0.8).apply(&means(rising), Tail::Levels(10.0 * length));
        let exact = means(|x| 0.8 * rising(x / 0.8));
        assert!(farthest(&stretched, &exact) < 1e-4, "{}", farthest(&stretched, &exact));
        let vanishing = |x: f64| -length * libm::exp(-x.abs() / length);
        let stretched = Stretch::new(PIXELS, 0.8).apply(&means(vanishing), Tail::Vanishes(10.0 * length));
        let exact = means(|x| 0.8 * vanishing(x / 0.8));
        assert!(farthest(&stretched, &exact) < 1e-3, "{}", farthest(&stretched, &exact));
    }

    /// Independent noise of the pixels is not amplified on average where records are scaled to thicknesses near by.
    #[test]
    fn noise_is_hardly_amplified() {
        for ratio in [0.9, 1.03, 1.1] {
            let stretch = Stretch::new(PIXELS, ratio);
            let mut variances = vec![0.0; PIXELS];
            for i in 0..PIXELS {
                let mut impulse = vec![0.0; PIXELS];
                impulse[i] = 1.0;
                let response = stretch.apply(&impulse, TAIL);
                variances.iter_mut().zip(response).for_each(|(v, r)| *v += r * r);
            }
            let mean = variances.iter().sum::<f64>() / PIXELS as f64;
            assert!(mean < 1.0, "{ratio}: {mean}");
        }
    }
}
