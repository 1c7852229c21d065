//! Computes the scale factor, Eq. 3: argmin over μ of (1/μ) Σ_materials Σ_channels min_v Σ_t d(μ F_A, F_S(v)).
//!
//! The distance is closed form in μ: ‖μa − s‖² = μ² ‖a‖² − 2μ a·s + ‖s‖², and |∇(μF)| = μ |∇F|, so three inner products
//! per profile and record give the whole curve. They are in double precision; the difference loses some ten digits of
//! sixteen where the fit is perfect, and none that matter elsewhere. Media that are the best at no μ are left out
//! (`pruning`).

mod pruning;

use std::borrow::Cow;
use std::sync::Arc;

use optics_model::fit::{FitOptions, GError, MuRange, ScaleCurve, ScalePoint};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
use crate::dictionary::sum::{mean_product, mean_square};
use crate::dictionary::view::View;
use crate::dictionary::wide::wide;
use crate::paper::question::{ComparedProfile, GridPlace, Question, check_ranges, questions};

/// Searches the scale factor that is common to all materials, within the bounds of the options; their μ is not used.
pub fn scale(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    options: &FitOptions,
    range: &MuRange,
) -> Result<ScaleCurve, Invalid> {
    let unscaled = options.with_mu(1.0, 0.0)?;
    check_ranges(dictionary, materials)?;
    let mut all: Vec<Question> = Vec::new();
    for (i, material) in materials.iter().enumerate() {
        let asked = questions(dictionary, material, &unscaled);
        all.extend(asked.map_err(|e| e.within(format_args!("materials[{i}]")))?);
    }
    if all.is_empty() {
        return Err(Invalid::new("materials", "none", "at least one is needed"));
    }
    let mu = range.values();
    let least = least_errors(&all, &mu);
    Ok(summary(dictionary, &all, &mu, &least))
}

/// Least error of every question, for every anisotropy and scale factor: `[question][g][μ]`.
#[derive(Debug, Clone)]
struct LeastErrors {
    anisotropies: usize,
    scales: usize,
    errors: Vec<f64>,
}

impl LeastErrors {
    fn new(questions: usize, anisotropies: usize, scales: usize) -> Self {
        Self { anisotropies, scales, errors: vec![f64::INFINITY; questions * anisotropies * scales] }
    }

    fn row(&self, question: usize, g: usize) -> &[f64] {
        &self.errors[(question * self.anisotropies + g) * self.scales..][..self.scales]
    }

    fn row_mut(&mut self, question: usize, g: usize) -> &mut [f64] {
        &mut self.errors[(question * self.anisotropies + g) * self.scales..][..self.scales]
    }

    fn merge(mut self, other: &Self) -> Self {
        lower(&mut self.errors, &other.errors);
        self
    }

    /// The least over all anisotropies.
    fn free(&self, question: usize) -> Vec<f64> {
        let mut least = vec![f64::INFINITY; self.scales];
        (0..self.anisotropies).for_each(|g| lower(&mut least, self.row(question, g)));
        least
    }
}

fn lower(least: &mut [f64], errors: &[f64]) {
    for (least, error) in least.iter_mut().zip(errors) {
        *least = least.min(*error);
    }
}

fn least_errors(questions: &[Question], mu: &[f64]) -> LeastErrors {
    let grid = questions[0].dictionary.grid();
    let admissible = &questions[0].admissible;
    let (sigmas, gs) = (admissible.sigma_t.len(), admissible.g.len());
    let rows = grid.sample_ior().len() * sigmas * gs;
    let none = || LeastErrors::new(questions.len(), gs, mu.len());
    let lambda = questions[0].options.settings().lambda;
    let terms: Vec<Vec<Scalable>> =
        questions.iter().map(|q| q.terms.iter().map(Scalable::new).collect()).collect();
    // By all threads together, channel by channel: materials that have the same channel would each describe its records.
    questions.iter().flat_map(|q| &q.terms).for_each(|term| _ = term.description());
    let possible: Vec<Vec<bool>> = questions
        .par_iter()
        .zip(&terms)
        .map(|(question, terms)| pruning::possible(question, terms, mu))
        .collect();
    (0..rows)
        .into_par_iter()
        .fold(none, |mut least, row| {
            let (rest, g) = (row / gs, row % gs);
            let (ior, sigma_t) = (rest / sigmas, rest % sigmas);
            let mut errors = vec![0.0; mu.len()];
            for albedo in admissible.albedo.clone() {
                let (sigma_t, g) = (admissible.sigma_t.start + sigma_t, admissible.g.start + g);
                // Gradients that are not stored are computed once for all materials.
                let mut seen: Vec<Seen> = Vec::new();
                let place = GridPlace { ior, sigma_t, g, albedo };
                for (n, question) in questions.iter().enumerate() {
                    if !possible[n][question.medium_number(place)] {
                        continue;
                    }
                    errors.fill(0.0);
                    for scalable in &terms[n] {
                        let record = question.record(scalable.term, place);
                        let known = seen.iter().position(|s| s.is(question, scalable.term, record));
                        let known = known.unwrap_or_else(|| {
                            seen.push(Seen::new(question, scalable.term, record));
                            seen.len() - 1
                        });
                        let Seen { values, gradient, .. } = &seen[known];
                        wide(
                            #[inline(always)]
                            || scalable.add_distances(values, gradient, lambda, mu, &mut errors),
                        );
                    }
                    lower(least.row_mut(n, g - admissible.g.start), &errors);
                }
            }
            least
        })
        .reduce(none, |a, b| a.merge(&b))
}

/// A record's values and gradient on the pixels of a view.
struct Seen<'a> {
    channel: usize,
    record: usize,
    view: &'a View,
    values: Cow<'a, [f32]>,
    gradient: Cow<'a, [f32]>,
}

impl<'a> Seen<'a> {
    fn new(question: &Question<'a>, term: &'a ComparedProfile, record: usize) -> Self {
        let (values, gradient) = term.view.profile(record);
        Self { channel: question.channel, record, view: &term.view, values, gradient }
    }

    fn is(&self, question: &Question, term: &ComparedProfile, record: usize) -> bool {
        self.channel == question.channel
            && self.record == record
            && std::ptr::eq(self.view, Arc::as_ptr(&term.view))
    }
}

/// A measured profile and its gradient, with their mean squares.
struct Scalable<'a> {
    term: &'a ComparedProfile,
    value_square: f64,
    gradient_square: f64,
}

impl<'a> Scalable<'a> {
    fn new(term: &'a ComparedProfile) -> Self {
        Self { term, value_square: mean_square(&term.values), gradient_square: mean_square(&term.gradient) }
    }

    /// Adds d(μ F_A, F_S) of one record for every μ.
    #[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
    #[inline(always)]
    fn add_distances(&self, values: &[f32], gradient: &[f32], lambda: f64, mu: &[f64], errors: &mut [f64]) {
        let (values_both, values_square) = (mean_product(&self.term.values, values), mean_square(values));
        let (gradients_both, gradients_square) =
            (mean_product(&self.term.gradient, gradient), mean_square(gradient));
        for (error, mu) in errors.iter_mut().zip(mu) {
            let values = mu * mu * self.value_square - 2.0 * mu * values_both + values_square;
            let gradients = mu * mu * self.gradient_square - 2.0 * mu * gradients_both + gradients_square;
            *error += values.max(0.0).sqrt() + lambda * gradients.max(0.0).sqrt();
        }
    }
}

fn summary(
    dictionary: &FitDictionary,
    questions: &[Question],
    mu: &[f64],
    least: &LeastErrors,
) -> ScaleCurve {
    let free: Vec<Vec<f64>> = (0..questions.len()).map(|n| least.free(n)).collect();
    let total = sum_over_mu(mu, free.iter().map(Vec::as_slice));
    let best = argmin(&total);
    let admissible = &questions[0].admissible;
    let by_g: Vec<GError> = admissible
        .g
        .clone()
        .enumerate()
        .map(|(i, g)| {
            let total = sum_over_mu(mu, (0..questions.len()).map(|n| least.row(n, i)));
            let own = argmin(&total);
            let g = dictionary.grid().g()[g];
            GError { g, error: total[best], best_mu: mu[own], best_mu_error: total[own] }
        })
        .collect();
    let best_g = by_g.iter().min_by(|a, b| a.error.total_cmp(&b.error)).map_or(0.0, |e| e.g);
    ScaleCurve {
        points: mu.iter().zip(&total).map(|(mu, error)| ScalePoint { mu: *mu, error: *error }).collect(),
        best: ScalePoint { mu: mu[best], error: total[best] },
        std_error: jackknife(mu, &free),
        curvature: curvature(mu, &total, best),
        at_end: mu.len() > 1 && (best == 0 || best + 1 == mu.len()),
        by_g,
        best_g,
    }
}

/// (1/μ) Σ of the rows.
fn sum_over_mu<'a>(mu: &[f64], rows: impl Iterator<Item = &'a [f64]>) -> Vec<f64> {
    let mut total = vec![0.0; mu.len()];
    for row in rows {
        for (total, error) in total.iter_mut().zip(row) {
            *total += error;
        }
    }
    total.iter().zip(mu).map(|(total, mu)| total / mu).collect()
}

/// Index of the first of the least values.
fn argmin(values: &[f64]) -> usize {
    values.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(i, _)| i)
}

/// The vertex of the parabola through the least value and its neighbours.
fn vertex(mu: &[f64], values: &[f64]) -> f64 {
    let i = argmin(values);
    if i == 0 || i + 1 == mu.len() {
        return mu[i];
    }
    let (below, above) = (values[i - 1] - values[i], values[i + 1] - values[i]);
    let step = 0.5 * (mu[i + 1] - mu[i - 1]);
    if below + above > 0.0 { mu[i] + 0.5 * step * (below - above) / (below + above) } else { mu[i] }
}

/// Standard error of μ*: the search is done without each channel of each material in turn.
fn jackknife(mu: &[f64], errors: &[Vec<f64>]) -> Option<f64> {
    let n = errors.len();
    if n < 2 || mu.len() < 3 {
        return None;
    }
    let without = |left_out: usize| {
        let rest = errors.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, e)| e.as_slice());
        vertex(mu, &sum_over_mu(mu, rest))
    };
    let found: Vec<f64> = (0..n).map(without).collect();
    let mean = found.iter().sum::<f64>() / n as f64;
    let scatter: f64 = found.iter().map(|v| (v - mean).powi(2)).sum();
    Some((scatter * (n - 1) as f64 / n as f64).sqrt())
}

/// Second derivative of ln error by μ, from a parabola fitted to the values within 0.01 of the minimum.
fn curvature(mu: &[f64], total: &[f64], best: usize) -> Option<f64> {
    const REACH: f64 = 0.01 + 1e-9;
    let near = || {
        mu.iter().zip(total).map(|(m, e)| (m - mu[best], e / total[best])).filter(|(d, _)| d.abs() <= REACH)
    };
    let count = near().count();
    if count < 3 || total[best] <= 0.0 {
        return None;
    }
    // Least squares of c₀ + c₁ d + c₂ d² in units of the reach.
    let mut normal = glam::DMat3::ZERO;
    let mut right = glam::DVec3::ZERO;
    for (d, e) in near() {
        let p = glam::DVec3::new(1.0, d / REACH, (d / REACH).powi(2));
        normal += glam::DMat3::from_cols(p * p.x, p * p.y, p * p.z);
        right += p * e;
    }
    let c = normal.inverse() * right;
    c.is_finite().then_some(2.0 * c.z / (REACH * REACH))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{changed, dense, noisy_measurement, remade};
    use optics_model::fit::{Bounds, FitSettings, Objective};
    use optics_model::{MeasuredProfile, Measurement};

    /// The measurement as with a wrong exposure: all values divided by μ.
    fn divided(measurement: &Measurement, mu: f64) -> Measurement {
        remade(measurement, |p| changed(p, |_, v, _| (v / mu, None)))
    }

    fn materials(mu: f64) -> Vec<Measurement> {
        let media = [(2.117, 0.99, 0.3), (1.5, 0.97, 0.4), (4.17, 0.2, 0.1), (3.0, 0.6, 0.0)];
        media.iter().zip(0..).map(|(m, seed)| divided(&noisy_measurement(*m, seed, false), mu)).collect()
    }

    /// The curve over the scale factor has the values of separate fits.
    #[test]
    fn scale_curve_matches_separate_fits() {
        let dictionary = dense(360, 0.0);
        let materials = materials(0.93);
        let range = MuRange::new(0.85, 1.0, 0.05).unwrap();
        let within = FitSettings {
            albedo: Bounds::new("albedo", Some(0.3), None).unwrap(),
            lambda: 7.0,
            objective: Some(Objective::Paper),
            ..FitSettings::default()
        };
        let options = FitOptions::new(within).unwrap();
        let curve = scale(dictionary, &materials, &options, &range).unwrap();
        let error = |options: &FitOptions| -> f64 {
            let best = |m| crate::fit(dictionary, m, options).unwrap().channels[0].candidates[0].error;
            materials.iter().map(best).sum()
        };
        for point in &curve.points {
            let sum = error(&options.with_mu(point.mu, 0.0).unwrap());
            assert!((sum / point.mu - point.error).abs() < 1e-9, "{point:?} {}", sum / point.mu);
        }
        for e in &curve.by_g {
            let sum = error(&options.with_mu(curve.best.mu, 0.0).unwrap().with_g(e.g).unwrap());
            assert!((sum / curve.best.mu - e.error).abs() < 1e-9, "{e:?}");
            assert!(e.best_mu_error <= e.error);
        }
    }

    /// Some of the media lie at the ends of the albedos, so that no other factor is as good.
    #[test]
    fn hidden_factor_is_found_within_its_error() {
        let dictionary = dense(360, 0.0);
        for hidden in [0.87, 0.913, 0.98] {
            let curve =
                scale(dictionary, &materials(hidden), &FitOptions::default(), &MuRange::default()).unwrap();
            assert!((curve.best.mu - hidden).abs() <= 0.005, "{hidden}: {:?}", curve.best);
            assert!(!curve.at_end && curve.curvature.unwrap() > 0.0 && curve.std_error.unwrap() < 0.02);
        }
        let beyond = MuRange::new(0.95, 1.0, 0.001).unwrap();
        let curve = scale(dictionary, &materials(0.9), &FitOptions::default(), &beyond).unwrap();
        assert!(curve.at_end && curve.best.mu == 0.95);
    }

    /// A single channel has no jackknife error, and errors name the material.
    #[test]
    fn one_channel_has_no_jackknife() {
        let dictionary = dense(90, 0.0);
        let one = &materials(1.0)[..1];
        let curve = scale(dictionary, one, &FitOptions::default(), &MuRange::default()).unwrap();
        assert_eq!((curve.std_error, curve.points.len()), (None, 301));
        let mut two = materials(1.0)[..2].to_vec();
        let p = &two[1].profiles()[0];
        let other = MeasuredProfile::new("X", 0.5, p.x_mm().to_vec(), p.values().to_vec(), None).unwrap();
        two[1] = Measurement::new("x", vec![other]).unwrap();
        let error = scale(dictionary, &two, &FitOptions::default(), &MuRange::default()).unwrap_err();
        assert_eq!(error.field(), "materials[1].channel");
    }
}
