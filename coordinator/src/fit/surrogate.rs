//! Profiles between the records: a smooth model of the dictionary that also averages its noise.
//!
//! The coordinates are those in which profiles change most evenly: ln σ_t; √(1 − α), to which diffusion is linear; and
//! ln(1 − g), in which similar media lie on straight lines. Across σ_t and g, where every record has walks of its own,
//! a local polynomial is fitted by weighted least squares, which averages the noise of the records about; across
//! albedos, which share their walks, the four nearest are interpolated.

use farm_proto::Medium;

use super::dictionary::FitDictionary;

/// Position in (ln σ_t, √(1 − α), ln(1 − g)).
pub(super) type Coordinates = [f64; 3];
pub(super) const SIGMA_T: usize = 0;
pub(super) const ALBEDO: usize = 1;
pub(super) const G: usize = 2;

pub(super) fn coordinates(medium: &Medium) -> Coordinates {
    [medium.sigma_t_per_mm().ln(), (1.0 - medium.albedo()).sqrt(), (1.0 - medium.g()).ln()]
}

pub(super) fn sigma_t(ln_sigma_t: f64) -> f64 {
    ln_sigma_t.exp()
}

pub(super) fn albedo(root_co_albedo: f64) -> f64 {
    1.0 - root_co_albedo * root_co_albedo
}

pub(super) fn g(ln_one_minus_g: f64) -> f64 {
    1.0 - ln_one_minus_g.exp()
}

/// Weights of the nodes from `first` on, and their derivatives by the coordinate.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Weights {
    pub first: usize,
    pub values: Vec<f64>,
    pub slopes: Vec<f64>,
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
    fn new(nodes: Vec<f64>, reach: f64) -> Self {
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

/// Cubic interpolation between the four nearest nodes, or all if there are fewer. `nodes` fall.
fn interpolation(nodes: &[f64], x: f64) -> Weights {
    let n = nodes.len();
    let count = n.min(4);
    let after = nodes.partition_point(|v| *v >= x);
    let first = after.saturating_sub(2).min(n - count);
    let near = &nodes[first..first + count];
    let weight = |i: usize| -> (f64, f64) {
        let others = || (0..count).filter(move |j| *j != i);
        let value = others().map(|j| (x - near[j]) / (near[i] - near[j])).product();
        let slope = others().map(|k| {
            let rest: f64 =
                others().filter(|j| *j != k).map(|j| (x - near[j]) / (near[i] - near[j])).product();
            rest / (near[i] - near[k])
        });
        (value, slope.sum())
    };
    let (values, slopes) = (0..count).map(weight).unzip();
    Weights { first, values, slopes }
}

/// A profile between the records and its derivatives by the coordinates.
#[derive(Debug, Clone)]
pub(super) struct Prediction {
    pub values: Vec<f64>,
    pub slopes: [Vec<f64>; 3],
}

/// The model of one channel at one refractive index of the sample.
#[derive(Debug)]
pub(super) struct Surrogate<'a> {
    dictionary: &'a FitDictionary,
    channel: usize,
    ior: usize,
    sigma_t: LocalAxis,
    g: LocalAxis,
    /// √(1 − α), falling.
    albedo: Vec<f64>,
}

impl<'a> Surrogate<'a> {
    pub(super) fn new(dictionary: &'a FitDictionary, channel: usize, ior: usize) -> Self {
        let grid = dictionary.grid();
        let sigma_t = grid.sigma_t_per_mm().iter().map(|v| v.ln()).collect();
        let g = grid.g().iter().map(|v| (1.0 - v).ln()).collect();
        let albedo = grid.albedo().iter().map(|v| (1.0 - v).sqrt()).collect();
        Self {
            dictionary,
            channel,
            ior,
            sigma_t: LocalAxis::new(sigma_t, 0.6),
            g: LocalAxis::new(g, 0.8),
            albedo,
        }
    }

    /// Least and greatest value of each coordinate.
    pub(super) fn limits(&self) -> [(f64, f64); 3] {
        let albedo = (self.albedo[self.albedo.len() - 1], self.albedo[0]);
        [self.sigma_t.range(), albedo, self.g.range()]
    }

    fn row(&self, sigma_t: usize, g: usize, thickness: usize, albedo: usize) -> &[f32] {
        let record = self.dictionary.grid().record_at(self.ior, sigma_t, g, thickness, albedo);
        self.dictionary.values(record, self.channel)
    }

    pub(super) fn predict(
        &self,
        thickness: usize,
        pixels: std::ops::Range<usize>,
        x: Coordinates,
    ) -> Prediction {
        let s = self.sigma_t.weights(x[SIGMA_T]);
        let a = interpolation(&self.albedo, x[ALBEDO]);
        let g = self.g.weights(x[G]);
        let zero = || vec![0.0; pixels.len()];
        let mut values = zero();
        let mut slopes = [zero(), zero(), zero()];
        for i in 0..s.values.len() {
            for k in 0..g.values.len() {
                for j in 0..a.values.len() {
                    let row = self.row(s.first + i, g.first + k, thickness, a.first + j);
                    let weight = s.values[i] * a.values[j] * g.values[k];
                    let by = [
                        s.slopes[i] * a.values[j] * g.values[k],
                        s.values[i] * a.slopes[j] * g.values[k],
                        s.values[i] * a.values[j] * g.slopes[k],
                    ];
                    accumulate(&row[pixels.clone()], weight, by, &mut values, &mut slopes);
                }
            }
        }
        Prediction { values, slopes }
    }

    /// What the records' noise does to functionals of the model's profile at `x`: their covariance.
    ///
    /// The noise is read off the records about: what the local polynomial leaves of them is noise, and a little of the
    /// polynomial's own failure. `functionals` are weights of the pixels of `pixels`.
    pub(super) fn noise(
        &self,
        thickness: usize,
        pixels: &std::ops::Range<usize>,
        x: Coordinates,
        functionals: &[Vec<f64>; 3],
    ) -> [[f64; 3]; 3] {
        let a = interpolation(&self.albedo, x[ALBEDO]);
        let (first_s, window_s, hat_s) = self.sigma_t.hat(x[SIGMA_T]);
        let (first_g, window_g, hat_g) = self.g.hat(x[G]);
        let image = |s: usize, g: usize| -> [f64; 3] {
            let mut image = [0.0; 3];
            for (j, weight) in a.values.iter().enumerate() {
                let row = &self.row(first_s + s, first_g + g, thickness, a.first + j)[pixels.clone()];
                for (out, f) in image.iter_mut().zip(functionals) {
                    *out += weight * row.iter().zip(f).map(|(v, f)| f64::from(*v) * f).sum::<f64>();
                }
            }
            image
        };
        let (ns, ng) = (window_s.len(), window_g.len());
        let images: Vec<[f64; 3]> = (0..ns * ng).map(|n| image(n / ng, n % ng)).collect();
        let mut scatter = [[0.0; 3]; 3];
        let mut total = 0.0;
        for i in 0..ns {
            for k in 0..ng {
                let mut rest = images[i * ng + k];
                let mut squares = 0.0;
                for (m, image) in images.iter().enumerate() {
                    let h = hat_s[i][m / ng] * hat_g[k][m % ng];
                    squares += h * h;
                    (0..3).for_each(|c| rest[c] -= h * image[c]);
                }
                // Variance of a rest over that of a record.
                let left = 1.0 - 2.0 * hat_s[i][i] * hat_g[k][k] + squares;
                if left < 1e-6 {
                    continue;
                }
                let weight = window_s[i] * window_g[k];
                total += weight;
                add_outer(&mut scatter, rest, weight / left);
            }
        }
        if total == 0.0 {
            return scatter;
        }
        let square = |w: Weights| w.values.iter().map(|w| w * w).sum::<f64>();
        let leverage = square(self.sigma_t.weights(x[SIGMA_T])) * square(self.g.weights(x[G]));
        scatter.map(|row| row.map(|v| v * leverage / total))
    }
}

/// Adds factor · v vᵀ.
pub(super) fn add_outer(matrix: &mut [[f64; 3]; 3], v: [f64; 3], factor: f64) {
    for (row, a) in matrix.iter_mut().zip(v) {
        for (cell, b) in row.iter_mut().zip(v) {
            *cell += factor * a * b;
        }
    }
}

fn accumulate(row: &[f32], weight: f64, by: [f64; 3], values: &mut [f64], slopes: &mut [Vec<f64>; 3]) {
    let [s, a, g] = slopes;
    let outs = values.iter_mut().zip(s).zip(a).zip(g);
    for (v, (((value, s), a), g)) in row.iter().zip(outs) {
        let v = f64::from(*v);
        *value += weight * v;
        *s += by[0] * v;
        *a += by[1] * v;
        *g += by[2] * v;
    }
}
