//! What noise does to the optimum of Eq. 1.
//!
//! The optimum x is a function of the data: with H the second derivative of Eq. 1 at the optimum, a change δr of the
//! residuals moves it by δx = H⁻¹ Σ_b K_b δr_b, K_b = c_b/(n ρ_b) Jᵀ(1 − r rᵀ/(n ρ_b²)), ρ_b being the root mean square
//! of r_b. So every source of noise gives a covariance of x: the measurement's pixels, the records about, the scale
//! factor, and the gain and the zero of each profile. Noise of the measurement that is smaller than the residuals is
//! scaled up to them.

use glam::{DMat4, DVec4};
use optics_model::measurement::MIN_PIXELS;

use crate::dictionary::gradient::derivative_adjoint;
use crate::dictionary::sum::dot;
use crate::dictionary::view::REFERENCE_PITCH_MM;
use crate::paper::question::Term;
use crate::paper::refine::{Block, Objective, PARAMETERS, UNKNOWNS, Unknowns, invert};
use crate::surrogate::SIGMA_T;

/// The sources of noise as functionals of the residuals, before H⁻¹.
#[derive(Debug)]
pub(crate) struct Noise {
    /// Second derivative of Eq. 1.
    pub hessian: DMat4,
    /// Covariances of Σ K δr, of each source.
    measurement: DMat4,
    dictionary: DMat4,
    /// Gain and zero of each profile.
    profiles: DMat4,
    /// What one standard error of μ does, which is the same for all channels that share it.
    pub by_scale: DVec4,
    /// Standard error of one measured value (times μ): root mean square over pixels.
    pub measured_rms: f64,
    /// Root mean square of the residuals over that of the noise, of the measurement and of the records.
    pub misfit: f64,
}

/// Covariance of the optimum.
#[derive(Debug)]
pub(crate) struct Spread {
    pub total: DMat4,
    /// From noise: of the measurement's pixels and of the dictionary.
    pub random: DMat4,
    /// From the scale factor, and gain and zero of each profile.
    pub systematic: DMat4,
    pub inverse_hessian: DMat4,
    /// Share of the variance of ln σ_t that comes from the dictionary.
    pub dictionary_share: f64,
}

impl Noise {
    pub(crate) fn new(objective: &Objective, x: Unknowns, blocks: &[Block]) -> Self {
        let settings = objective.question.options.settings();
        let mut noise = Self {
            hessian: DMat4::ZERO,
            measurement: DMat4::ZERO,
            dictionary: DMat4::ZERO,
            profiles: DMat4::ZERO,
            by_scale: DVec4::ZERO,
            measured_rms: 0.0,
            misfit: 0.0,
        };
        let mut by_scale = DVec4::ZERO;
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
            let medium = PARAMETERS.map(|c| x[c]);
            let covariance =
                objective.surrogate.noise(term.thickness, &term.view.pixels(), medium, &on_model);
            noise.dictionary += DMat4::from_cols_array_2d(&covariance);
            let by_gain = DVec4::from_array(
                UNKNOWNS.map(|c| dot(&k_values[c], &term.values) + dot(&k_gradients[c], &term.gradient)),
            );
            noise.profiles += outer(by_gain * settings.gain_std_error);
            let by_offset = DVec4::from_array(UNKNOWNS.map(|c| k_values[c].iter().sum()));
            noise.profiles += outer(by_offset * settings.offset_std_error * settings.mu);
            by_scale += by_gain;
            squares += dot(&values.residual, &values.residual);
            expected += pixel_variances(objective, i, x, values).iter().sum::<f64>();
            measured += dot(&std_errors, &std_errors) * settings.mu.powi(2);
            pixels += std_errors.len();
        }
        noise.by_scale = by_scale * (settings.mu_std_error / settings.mu);
        noise.measured_rms = (measured / pixels as f64).sqrt();
        noise.misfit = (squares / expected.max(f64::MIN_POSITIVE)).sqrt();
        noise
    }

    /// With these second derivatives, this noise of the pixels, and this effect of the scale factor.
    #[cfg(test)]
    pub(crate) fn for_test(hessian: DMat4, measurement: DMat4, by_scale: DVec4) -> Self {
        let zero = DMat4::ZERO;
        Self {
            hessian,
            measurement,
            dictionary: zero,
            profiles: zero,
            by_scale,
            measured_rms: 0.0,
            misfit: 1.0,
        }
    }

    /// Covariance of Σ K δr from noise: noise of the measurement that is smaller than the residuals is scaled up to them.
    pub(crate) fn random(&self) -> DMat4 {
        self.measurement * self.misfit.max(1.0).powi(2) + self.dictionary
    }

    /// Covariance of Σ K δr from all that is this channel's own: noise, and the gains and zeros of its profiles.
    pub(crate) fn own(&self) -> DMat4 {
        self.random() + self.profiles
    }

    /// H⁻¹ over the unknowns that are free.
    pub(crate) fn inverse_hessian(&self, free: [bool; 4]) -> DMat4 {
        let ridge = DMat4::from_diagonal(DVec4::splat(1e-12));
        invert(self.hessian + ridge, free).unwrap_or(DMat4::ZERO)
    }

    /// The covariance of the unknowns that are free.
    pub(crate) fn spread(&self, free: [bool; 4]) -> Spread {
        let inverse_hessian = self.inverse_hessian(free);
        let through = |source: DMat4| inverse_hessian * source * inverse_hessian.transpose();
        let dictionary = through(self.dictionary);
        let random = through(self.random());
        let systematic = through(self.profiles + outer(self.by_scale));
        let total = random + systematic;
        let (part, whole) = (dictionary.col(SIGMA_T)[SIGMA_T], total.col(SIGMA_T)[SIGMA_T]);
        let dictionary_share = if whole > 0.0 { part / whole } else { 0.0 };
        Spread { total, random, systematic, inverse_hessian, dictionary_share }
    }
}

/// Pixels at which the records' noise is looked at.
const SAMPLED: usize = 12;

/// Variances that noise explains, of the measured pixels and of the records, on the pixels that are compared.
pub(crate) fn pixel_variances(objective: &Objective, i: usize, x: Unknowns, values: &Block) -> Vec<f64> {
    let (term, mu) = (&objective.question.terms[i], objective.question.options.settings().mu);
    let std_errors = std_errors(term, &objective.predict(term, x).values, mu);
    let records = records_variance(objective, term, x, values);
    term.resampled.variances(&std_errors).iter().map(|v| v * mu * mu + records).collect()
}

/// Mean variance of the model's pixels from the records' noise, without what the fit takes up.
fn records_variance(objective: &Objective, term: &Term, x: Unknowns, values: &Block) -> f64 {
    let n = values.residual.len();
    let free = objective.free();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for c in UNKNOWNS.into_iter().filter(|c| free[*c]) {
        add_direction(&mut basis, values.jacobian[c].clone());
    }
    let functionals: [Vec<f64>; SAMPLED] = std::array::from_fn(|k| {
        let pixel = (2 * k + 1) * n / (2 * SAMPLED);
        let mut impulse = vec![0.0; n];
        impulse[pixel] = 1.0;
        for direction in &basis {
            let along = direction[pixel];
            impulse.iter_mut().zip(direction).for_each(|(f, d)| *f -= along * d);
        }
        impulse
    });
    let medium = PARAMETERS.map(|c| x[c]);
    let covariance = objective.surrogate.noise(term.thickness, &term.view.pixels(), medium, &functionals);
    (0..SAMPLED).map(|k| covariance[k][k]).sum::<f64>() / SAMPLED as f64
}

/// Adds what a vector has beyond the orthonormal ones, if that is anything, and tells its length.
pub(crate) fn add_direction(basis: &mut Vec<Vec<f64>>, mut vector: Vec<f64>) -> f64 {
    let whole = dot(&vector, &vector).sqrt();
    for direction in basis.iter() {
        let along = dot(direction, &vector);
        vector.iter_mut().zip(direction).for_each(|(v, d)| *v -= along * d);
    }
    let length = dot(&vector, &vector).sqrt();
    if length > 1e-6 * whole {
        for v in &mut vector {
            *v /= length;
        }
        basis.push(vector);
        return length;
    }
    0.0
}

/// K_b, one row per unknown.
fn kernel(block: &Block) -> [Vec<f64>; 4] {
    let rms = block.rms.max(1e-9);
    let n = block.residual.len() as f64;
    block.jacobian.each_ref().map(|j| {
        let along = dot(j, &block.residual) / (n * rms * rms);
        let part = |(j, r): (&f64, &f64)| block.weight / (n * rms) * (j - r * along);
        j.iter().zip(&block.residual).map(part).collect()
    })
}

fn outer_sum(a: &[Vec<f64>; 4], b: &[Vec<f64>; 4]) -> DMat4 {
    let mut sum = DMat4::ZERO;
    for i in UNKNOWNS {
        for j in UNKNOWNS {
            sum.col_mut(i)[j] = dot(&a[i], &b[j]);
        }
    }
    sum
}

pub(crate) fn outer(v: DVec4) -> DMat4 {
    DMat4::from_cols(v * v.x, v * v.y, v * v.z, v * v.w)
}

/// Σ_b K_b as functionals of a profile's values: those of the gradients are brought back through the derivative, with
/// the signs of the measured profile or of the model.
fn combined(
    term: &Term,
    k_values: &[Vec<f64>; 4],
    k_gradients: &[Vec<f64>; 4],
    gradients: &Block,
    measured: bool,
) -> [Vec<f64>; 4] {
    let slope = term.view.slope();
    let scale = REFERENCE_PITCH_MM / slope.pitch_mm;
    let signs =
        gradients.signs.as_ref().map(|(of_measured, of_model)| if measured { of_measured } else { of_model });
    UNKNOWNS.map(|c| {
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
    scatter_by_side(x, &residuals)
}

/// Standard errors of a profile that does not tell them: from how its values scatter from pixel to pixel, on the dark and
/// on the light side by themselves.
pub(crate) fn scatter_by_side(x_mm: &[f64], values: &[f64]) -> Vec<f64> {
    let edge = x_mm.partition_point(|x| *x < 0.0);
    if edge.min(x_mm.len() - edge) < MIN_PIXELS {
        return vec![scatter(values); x_mm.len()];
    }
    let (dark, light) = (scatter(&values[..edge]), scatter(&values[edge..]));
    (0..x_mm.len()).map(|i| if i < edge { dark } else { light }).collect()
}

/// Standard deviation of independent noise: second differences take off what is smooth, the median what is rare.
fn scatter(residuals: &[f64]) -> f64 {
    let mut bends: Vec<f64> = residuals.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs()).collect();
    bends.sort_by(f64::total_cmp);
    1.4826 * bends[bends.len() / 2] / 6.0_f64.sqrt()
}

fn measurement_noise(term: &Term, functionals: &[Vec<f64>; 4], std_errors: &[f64], mu: f64) -> DMat4 {
    let pulled = functionals.each_ref().map(|f| {
        let mut pulled = term.resampled.pull_back(f, std_errors.len());
        pulled.iter_mut().zip(std_errors).for_each(|(p, e)| *p *= mu * e);
        pulled
    });
    outer_sum(&pulled, &pulled)
}
