//! How sure a refined fit is.
//!
//! The optimum x of Eq. 1 is a function of the data: with H the second derivative of Eq. 1 at the optimum, a change δr
//! of the residuals moves it by δx = H⁻¹ Σ_b K_b δr_b, K_b = c_b/(n ρ_b) Jᵀ(1 − r rᵀ/(n ρ_b²)), ρ_b being the root mean
//! square of r_b. So every source of noise gives a covariance of x: the measurement's pixels, the records about, the
//! scale factor, and the gain and the zero of each profile. Noise of the measurement that is smaller than the residuals is scaled up to them.
//!
//! Intervals are not ±1.96 of these standard deviations but follow Eq. 1 as it is: a value belongs to the interval if
//! the error with all else optimised rises no further than it would at ±1.96 standard deviations if profiles were linear
//! in the coordinates. They are therefore lopsided or open where the data are.

use farm_proto::fit::{Candidate, Interval, Refined, ThicknessError};
use farm_proto::measurement::MIN_PIXELS;
use glam::{DMat3, DVec3};

use super::gradient::derivative_adjoint;
use super::intervals::Intervals;
use super::question::{Question, Term};
use super::refine::{Block, Objective, Optimum, PARAMETERS, invert, optimum};
use super::sum::dot;
use super::surrogate::{ALBEDO, Coordinates, G, SIGMA_T, albedo, coordinates, sigma_t};
use super::view::REFERENCE_PITCH_MM;

/// Two-sided 95 % of the normal distribution.
pub(super) const Z: f64 = 1.959_964;
/// A channel is resolved if its intervals of σ_t and of the albedo span at most this factor …
const RESOLVED_FACTOR: f64 = 2.0;
/// … and that of the albedo at most this.
const RESOLVED_ALBEDO: f64 = 0.2;
/// Correlation of ln σ_t with ln(1 − g) from which on they are said to trade off.
const VALLEY: f64 = 0.9;

/// The refined fit of a channel from its best records.
pub(super) fn refined(question: &Question, candidates: &[Candidate]) -> Refined {
    let objective = Objective::new(question, &candidates[0]);
    let optimum = optimum(&objective, candidates);
    let blocks = objective.blocks(optimum.x);
    let noise = Noise::new(&objective, optimum.x, &blocks);
    let free = objective.free();
    let spread = noise.spread(free);
    let intervals = Intervals {
        objective: &objective,
        optimum: &optimum,
        blocks: &blocks,
        spread: &spread,
        systematic: spread.systematic,
        free,
    };
    let [sigma_t_interval, albedo_interval, g_interval] = intervals.all(&noise);
    let resolved = if free[G] {
        let free = [free[SIGMA_T], free[ALBEDO], false];
        let spread = noise.spread(free);
        let held = Intervals { spread: &spread, systematic: spread.systematic, free, ..intervals };
        let [sigma_t, albedo, _] = held.all(&noise);
        is_resolved(&sigma_t, &albedo)
    } else {
        is_resolved(&sigma_t_interval, &albedo_interval)
    };
    let v = spread.total;
    let deviation = |i: usize| v.col(i)[i].sqrt();
    let both = deviation(SIGMA_T) * deviation(G);
    let correlation = if both > 0.0 { v.col(SIGMA_T)[G] / both } else { 0.0 };
    Refined {
        best: candidate(&objective, &optimum, &blocks, candidates[0].sample_ior),
        sigma_t_per_mm: sigma_t_interval,
        albedo: albedo_interval,
        g: g_interval,
        reduced_scattering_per_mm: reduced_scattering(&objective, optimum.x, v),
        absorption_per_mm: absorption(&objective, optimum.x, v),
        covariance: v.transpose().to_cols_array_2d(),
        correlation,
        valley: free[G] && correlation.abs() > VALLEY,
        resolved,
        measurement_noise: noise.measured_rms,
        dictionary_share: spread.dictionary_share,
        misfit: noise.misfit,
    }
}

fn is_resolved(sigma_t: &Interval, albedo: &Interval) -> bool {
    let bounded = |i: &Interval| !i.open_low && i.high <= RESOLVED_FACTOR * i.low;
    bounded(sigma_t) && !sigma_t.open_high && bounded(albedo) && albedo.high - albedo.low <= RESOLVED_ALBEDO
}

fn candidate(objective: &Objective, optimum: &Optimum, blocks: &[Block], sample_ior: f64) -> Candidate {
    let rms = |term: usize, gradient: bool| {
        let found = blocks.iter().find(|b| b.term == term && b.signs.is_some() == gradient);
        found.map_or(0.0, |b| b.rms)
    };
    let axis = objective.question.dictionary.grid().thickness_mm();
    let thickness = |(i, term): (usize, &Term)| ThicknessError {
        thickness_mm: axis[term.thickness],
        value_rms: rms(i, false),
        gradient_rms: rms(i, true),
        record: None,
    };
    Candidate {
        medium: objective.medium(optimum.x),
        sample_ior,
        error: optimum.error,
        thicknesses: objective.question.terms.iter().enumerate().map(thickness).collect(),
    }
}

/// The sources of noise as functionals of the residuals, before H⁻¹.
pub(super) struct Noise {
    hessian: DMat3,
    /// Covariances of Σ K δr, of each source.
    measurement: DMat3,
    dictionary: DMat3,
    systematic: DMat3,
    measured_rms: f64,
    misfit: f64,
}

/// Covariance of the optimum.
pub(super) struct Spread {
    pub total: DMat3,
    /// From noise: of the measurement's pixels and of the dictionary.
    pub random: DMat3,
    /// From the scale factor, and gain and zero of each profile.
    pub systematic: DMat3,
    pub inverse_hessian: DMat3,
    dictionary_share: f64,
}

impl Noise {
    fn new(objective: &Objective, x: Coordinates, blocks: &[Block]) -> Self {
        let settings = objective.question.options.settings();
        let mut noise = Self {
            hessian: DMat3::ZERO,
            measurement: DMat3::ZERO,
            dictionary: DMat3::ZERO,
            systematic: DMat3::ZERO,
            measured_rms: 0.0,
            misfit: 0.0,
        };
        let mut by_scale = DVec3::ZERO;
        let (mut squares, mut expected, mut measured, mut pixels) = (0.0, 0.0, 0.0, 0);
        for (i, term) in objective.question.terms.iter().enumerate() {
            let [gradients, values] = &blocks[2 * i..2 * i + 2] else { continue };
            let (k_values, k_gradients) = (kernel(values), kernel(gradients));
            for (block, k) in [(values, &k_values), (gradients, &k_gradients)] {
                noise.hessian += outer_sum(k, &block.jacobian);
            }
            let on_measured = combined(term, &k_values, &k_gradients, gradients, true);
            let std_errors = std_errors(term, &objective.predict(term, x).values, settings.mu);
            noise.measurement += measurement_noise(term, &on_measured, &std_errors, settings.mu);
            let on_model = combined(term, &k_values, &k_gradients, gradients, false);
            let covariance = objective.surrogate.noise(term.thickness, &term.view.pixels(), x, &on_model);
            noise.dictionary += DMat3::from_cols_array_2d(&covariance);
            let by_gain = DVec3::from_array(
                PARAMETERS.map(|c| dot(&k_values[c], &term.values) + dot(&k_gradients[c], &term.gradient)),
            );
            noise.systematic += outer(by_gain * settings.gain_std_error);
            let by_offset = DVec3::from_array(PARAMETERS.map(|c| k_values[c].iter().sum()));
            noise.systematic += outer(by_offset * settings.offset_std_error * settings.mu);
            by_scale += by_gain;
            squares += dot(&values.residual, &values.residual);
            expected += term.resampled.variances(&std_errors).iter().sum::<f64>() * settings.mu.powi(2);
            measured += dot(&std_errors, &std_errors) * settings.mu.powi(2);
            pixels += std_errors.len();
        }
        by_scale *= settings.mu_std_error / settings.mu;
        noise.systematic += outer(by_scale);
        noise.measured_rms = (measured / pixels as f64).sqrt();
        noise.misfit = (squares / expected.max(f64::MIN_POSITIVE)).sqrt();
        noise
    }

    /// The covariance of the coordinates that are free.
    pub(super) fn spread(&self, free: [bool; 3]) -> Spread {
        let ridge = DMat3::from_diagonal(DVec3::splat(1e-12));
        let inverse_hessian = invert(self.hessian + ridge, free).unwrap_or(DMat3::ZERO);
        let through = |source: DMat3| inverse_hessian * source * inverse_hessian.transpose();
        let dictionary = through(self.dictionary);
        let scaled_up = self.misfit.max(1.0).powi(2);
        let random = through(self.measurement) * scaled_up + dictionary;
        let systematic = through(self.systematic);
        let total = random + systematic;
        let (part, whole) = (dictionary.col(SIGMA_T)[SIGMA_T], total.col(SIGMA_T)[SIGMA_T]);
        let dictionary_share = if whole > 0.0 { part / whole } else { 0.0 };
        Spread { total, random, systematic, inverse_hessian, dictionary_share }
    }
}

/// K_b of the module's head, one row per coordinate.
fn kernel(block: &Block) -> [Vec<f64>; 3] {
    let rms = block.rms.max(1e-9);
    let n = block.residual.len() as f64;
    block.jacobian.each_ref().map(|j| {
        let along = dot(j, &block.residual) / (n * rms * rms);
        let part = |(j, r): (&f64, &f64)| block.weight / (n * rms) * (j - r * along);
        j.iter().zip(&block.residual).map(part).collect()
    })
}

fn outer_sum(a: &[Vec<f64>; 3], b: &[Vec<f64>; 3]) -> DMat3 {
    let mut sum = DMat3::ZERO;
    for i in PARAMETERS {
        for j in PARAMETERS {
            sum.col_mut(i)[j] = dot(&a[i], &b[j]);
        }
    }
    sum
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

/// Σ_b K_b as functionals of a profile's values: those of the gradients are brought back through the derivative, with
/// the signs of the measured profile or of the model.
fn combined(
    term: &Term,
    k_values: &[Vec<f64>; 3],
    k_gradients: &[Vec<f64>; 3],
    gradients: &Block,
    measured: bool,
) -> [Vec<f64>; 3] {
    let slope = term.view.slope();
    let scale = REFERENCE_PITCH_MM / slope.pitch_mm;
    let signs =
        gradients.signs.as_ref().map(|(of_measured, of_model)| if measured { of_measured } else { of_model });
    PARAMETERS.map(|c| {
        let mut k = k_gradients[c].clone();
        if let Some(signs) = signs {
            k.iter_mut().zip(signs).for_each(|(k, s)| *k *= s * scale);
        }
        let mut functional = derivative_adjoint(&k, slope.wavelet, slope.level);
        functional.iter_mut().zip(&k_values[c]).for_each(|(f, k)| *f += k);
        functional
    })
}

/// Standard errors of the measured pixels, as given, or from how the residuals scatter from pixel to pixel, on the dark
/// and on the light side by themselves.
fn std_errors(term: &Term, model: &[f64], mu: f64) -> Vec<f64> {
    let x = term.profile.x_mm();
    if let Some(given) = term.profile.std_errors()
        && given.iter().any(|e| *e > 0.0)
    {
        return given.to_vec();
    }
    let (first, pitch) = (term.view.pixels().start as f64, term.view.slope().pitch_mm);
    let half_width = 0.5 * pitch * term.view.all_pixels() as f64;
    let model_at = |x: f64| {
        let position = ((x + half_width) / pitch - 0.5 - first).clamp(0.0, (model.len() - 1) as f64);
        let below = (position as usize).min(model.len() - 2);
        model[below] + (position - below as f64) * (model[below + 1] - model[below])
    };
    let residuals: Vec<f64> =
        x.iter().zip(term.profile.values()).map(|(x, v)| v - model_at(*x) / mu).collect();
    let edge = x.partition_point(|x| *x < 0.0);
    if edge.min(x.len() - edge) < MIN_PIXELS {
        return vec![scatter(&residuals); x.len()];
    }
    let (dark, light) = (scatter(&residuals[..edge]), scatter(&residuals[edge..]));
    (0..x.len()).map(|i| if i < edge { dark } else { light }).collect()
}

/// Standard deviation of independent noise: second differences take off what is smooth, the median what is rare.
fn scatter(residuals: &[f64]) -> f64 {
    let mut bends: Vec<f64> = residuals.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs()).collect();
    bends.sort_by(f64::total_cmp);
    1.4826 * bends[bends.len() / 2] / 6.0_f64.sqrt()
}

fn measurement_noise(term: &Term, functionals: &[Vec<f64>; 3], std_errors: &[f64], mu: f64) -> DMat3 {
    let pulled = functionals.each_ref().map(|f| {
        let mut pulled = term.resampled.pull_back(f, std_errors.len());
        pulled.iter_mut().zip(std_errors).for_each(|(p, e)| *p *= mu * e);
        pulled
    });
    outer_sum(&pulled, &pulled)
}

/// An interval of exp(f) with f linear in the coordinates, kept within what the dictionary has.
fn log_interval(value: f64, slope: DVec3, covariance: DMat3, (least, greatest): (f64, f64)) -> Interval {
    let factor = (Z * slope.dot(covariance * slope).max(0.0).sqrt()).exp();
    let (low, high) = (value / factor, value * factor);
    Interval {
        low: low.max(least),
        high: high.min(greatest),
        open_low: low < least,
        open_high: high > greatest,
    }
}

/// σ_s (1 − g) = α σ_t (1 − g).
fn reduced_scattering(objective: &Objective, x: Coordinates, covariance: DMat3) -> Interval {
    let alpha = albedo(x[ALBEDO]);
    let value = alpha * sigma_t(x[SIGMA_T]) * x[G].exp();
    let slope = DVec3::new(1.0, -2.0 * x[ALBEDO] / alpha.max(1e-9), 1.0);
    let [s, a, g] = objective.surrogate.limits();
    let corner = |s: f64, a: f64, g: f64| albedo(a) * sigma_t(s) * g.exp();
    log_interval(value, slope, covariance, (corner(s.0, a.1, g.0), corner(s.1, a.0, g.1)))
}

/// σ_a = σ_t (1 − α), from its root u √σ_t, which may come down to zero.
fn absorption(objective: &Objective, x: Coordinates, covariance: DMat3) -> Interval {
    let (u, root) = (x[ALBEDO], (0.5 * x[SIGMA_T]).exp());
    let slope = DVec3::new(0.5 * u * root, root, 0.0);
    let half = Z * slope.dot(covariance * slope).max(0.0).sqrt();
    let [(_, s), (_, a), _] = objective.surrogate.limits();
    let greatest = a * (0.5 * s).exp();
    let (low, high) = ((u * root - half).max(0.0), u * root + half);
    Interval { low: low * low, high: high.min(greatest).powi(2), open_low: false, open_high: high > greatest }
}

/// The model's coordinates of a medium, for those who draw its profiles.
pub(super) fn coordinates_of(refined: &Refined) -> Coordinates {
    coordinates(&refined.best.medium)
}
