//! What is likely wrong where noise does not explain what a fit leaves.
//!
//! Each cause is tried alone: those that change profiles a little as one more column beside the medium's, in least
//! squares weighted by the noise; those that change them much by fitting the changed profiles anew. The one that leaves
//! least is told, if it takes away most of what noise leaves unexplained.

use optics_model::fit::{Cause, MISFIT, Suspicion};

use crate::dictionary::sum::dot;
use crate::paper::noise::{add_direction, pixel_variances};
use crate::paper::question::Question;
use crate::paper::refine::{Block, Objective, Unknowns};
use crate::paper::search;

/// Share of the unexplained χ² that a cause must take away, …
const CONVINCING: f64 = 0.6;
/// … and the misfit that it may leave, or that share of the whole: what still does not fit explains nothing.
const LEFT: (f64, f64) = (1.5 * MISFIT, 1.0 / 8.0);
/// By this factor a cause must leave more than the removal of pixels to be thought less likely: whatever is wrong
/// somewhere goes away with the pixels.
const PIXELS_COST: f64 = 1.25;
/// Standard deviations from which on a pixel lies apart.
const APART: f64 = 5.0;
/// Greatest share of pixels that can lie apart from the others.
const FEW: f64 = 0.15;

/// The likeliest cause of a misfit; none if there is no misfit.
pub(crate) fn suspicion(
    objective: &Objective,
    x: Unknowns,
    blocks: &[Block],
    misfit: f64,
) -> Option<Suspicion> {
    if misfit <= MISFIT || misfit.is_nan() {
        return None;
    }
    let residuals = Residuals::new(objective, x, blocks);
    let mut tried = small_causes(&residuals);
    tried.push(residuals.outliers());
    tried.extend(large_causes(objective.question));
    let unknown = Suspicion { cause: Cause::Unknown, thickness_mm: None, amount: 0.0, misfit_left: misfit };
    let explained = |s: &Suspicion| misfit.powi(2) - s.misfit_left.powi(2);
    let convincing = |s: &Suspicion| {
        explained(s) >= CONVINCING * (misfit.powi(2) - 1.0) && s.misfit_left <= LEFT.0.max(LEFT.1 * misfit)
    };
    let cost = |s: &Suspicion| if s.cause == Cause::Outliers { PIXELS_COST } else { 1.0 } * s.misfit_left;
    let least = tried.into_iter().filter(convincing).min_by(|a, b| cost(a).total_cmp(&cost(b)));
    Some(least.unwrap_or(unknown))
}

/// What a fit leaves, over its noise, one profile after the other.
struct Residuals<'a> {
    objective: &'a Objective<'a>,
    /// Where each term's pixels begin, and the end.
    starts: Vec<usize>,
    /// One over the noise of each pixel.
    weights: Vec<f64>,
    predicted: Vec<f64>,
    /// In units of the noise, like the derivatives.
    residual: Vec<f64>,
    /// Derivatives by the free coordinates.
    jacobian: Vec<Vec<f64>>,
}

impl<'a> Residuals<'a> {
    fn new(objective: &'a Objective<'a>, x: Unknowns, blocks: &[Block]) -> Self {
        let free = objective.free();
        let mut all = Self {
            objective,
            starts: vec![0],
            weights: Vec::new(),
            predicted: Vec::new(),
            residual: Vec::new(),
            jacobian: vec![Vec::new(); free.iter().filter(|f| **f).count()],
        };
        for (i, term) in objective.question.terms.iter().enumerate() {
            let values = &blocks[2 * i + 1];
            let variances = pixel_variances(objective, i, x, values);
            let weights: Vec<f64> =
                variances.iter().map(|v| v.max(f64::MIN_POSITIVE).sqrt().recip()).collect();
            all.predicted.extend(objective.predict(term, x).values);
            all.residual.extend(values.residual.iter().zip(&weights).map(|(r, w)| r * w));
            let free = values.jacobian.iter().zip(free).filter(|(_, free)| *free);
            for (column, (by, _)) in all.jacobian.iter_mut().zip(free) {
                column.extend(by.iter().zip(&weights).map(|(j, w)| j * w));
            }
            all.weights.extend(weights);
            all.starts.push(all.residual.len());
        }
        all
    }

    /// Predicted values of a term.
    fn predicted(&self, term: usize) -> &[f64] {
        &self.predicted[self.starts[term]..self.starts[term + 1]]
    }

    fn terms(&self) -> usize {
        self.starts.len() - 1
    }

    /// A column for the pixels of one term, or of all.
    fn column(&self, only: Option<usize>, of: impl Fn(usize) -> Vec<f64>) -> Vec<f64> {
        let mut column = vec![0.0; self.residual.len()];
        for term in (0..self.terms()).filter(|t| only.is_none_or(|o| o == *t)) {
            let start = self.starts[term];
            for (k, v) in of(term).into_iter().enumerate() {
                column[start + k] = v * self.weights[start + k];
            }
        }
        column
    }

    /// The misfit that is left beside a column, and its factor.
    fn without(&self, column: Vec<f64>) -> (f64, f64) {
        let mut basis = Vec::new();
        for j in &self.jacobian {
            add_direction(&mut basis, j.clone());
        }
        let length = add_direction(&mut basis, column);
        let mut left = self.residual.clone();
        let mut along = 0.0;
        for direction in &basis {
            along = dot(direction, &left);
            left.iter_mut().zip(direction).for_each(|(l, d)| *l -= along * d);
        }
        let misfit = (dot(&left, &left) / left.len() as f64).sqrt();
        (misfit, if length > 0.0 { along / length } else { 0.0 })
    }

    /// The misfit without the pixels that lie apart, and their number.
    fn outliers(&self) -> Suspicion {
        let n = self.residual.len();
        let mut kept = vec![true; n];
        let mut left = self.residual.clone();
        for _ in 0..4 {
            let only_kept = |v: &[f64]| v.iter().zip(&kept).map(|(v, k)| if *k { *v } else { 0.0 }).collect();
            let mut basis = Vec::new();
            for j in &self.jacobian {
                add_direction(&mut basis, only_kept(j));
            }
            left = only_kept(&self.residual);
            for direction in &basis {
                let along = dot(direction, &left);
                left.iter_mut().zip(direction).for_each(|(l, d)| *l -= along * d);
            }
            let mut sizes: Vec<f64> =
                left.iter().zip(&kept).filter(|(_, k)| **k).map(|(l, _)| l.abs()).collect();
            sizes.sort_by(f64::total_cmp);
            let Some(median) = sizes.get(sizes.len() / 2) else { break };
            let most = APART * (1.4826 * median).max(1.0);
            kept.iter_mut().zip(&left).for_each(|(kept, l)| *kept &= l.abs() <= most);
        }
        let count = kept.iter().filter(|k| !**k).count();
        let few = count > 0 && count as f64 <= FEW * n as f64;
        let kept_square: f64 = left.iter().zip(&kept).filter(|(_, k)| **k).map(|(l, _)| l * l).sum();
        let misfit_left = if few { (kept_square / (n - count) as f64).sqrt() } else { f64::INFINITY };
        Suspicion { cause: Cause::Outliers, thickness_mm: None, amount: count as f64, misfit_left }
    }
}

/// Derivative of a profile by x.
fn slope(values: &[f64], pitch_mm: f64) -> Vec<f64> {
    let last = values.len() - 1;
    let at = |i: usize| {
        let (below, above) = (i.saturating_sub(1), (i + 1).min(last));
        (values[above] - values[below]) / ((above - below) as f64 * pitch_mm)
    };
    (0..values.len()).map(at).collect()
}

/// Causes that change profiles a little, in one profile or in all alike.
fn small_causes(residuals: &Residuals) -> Vec<Suspicion> {
    let question = residuals.objective.question;
    let sensor = question.dictionary.grid().scene().sensor();
    let pitch = sensor.pitch_mm();
    let predicted = |term: usize| residuals.predicted(term);
    let half_width_mm = 5.0;
    let lit = |term: usize| {
        let pixels = question.terms[term].view.pixels();
        let lit = pixels.zip(predicted(term)).map(|(p, v)| v * 0.5 * sensor.centre_mm(p) / half_width_mm);
        lit.collect::<Vec<f64>>()
    };
    let negative = |v: Vec<f64>| v.into_iter().map(|v| -v).collect::<Vec<f64>>();
    let column = |cause: Cause, term: usize| match cause {
        Cause::EdgeOffset => negative(slope(predicted(term), pitch)),
        Cause::Gain => predicted(term).to_vec(),
        Cause::Zero => vec![1.0; predicted(term).len()],
        Cause::Slope => lit(term),
        _ => slope(&slope(predicted(term), pitch), pitch).into_iter().map(|v| 0.5 * v).collect(),
    };
    let mut tried = Vec::new();
    for cause in [Cause::EdgeOffset, Cause::Gain, Cause::Zero, Cause::Slope, Cause::Blur] {
        let each = (0..residuals.terms()).map(Some);
        let all = (residuals.terms() > 1).then_some(None);
        for only in each.chain(all) {
            let (misfit_left, factor) = residuals.without(residuals.column(only, |t| column(cause, t)));
            if cause == Cause::Blur && factor <= 0.0 {
                continue;
            }
            let amount = if cause == Cause::Blur { factor.sqrt() } else { factor };
            let thickness = |t: usize| question.terms[t].profile.thickness_mm();
            let thickness_mm = only.filter(|_| residuals.terms() > 1).map(thickness);
            tried.push(Suspicion { cause, thickness_mm, amount, misfit_left });
        }
    }
    tried
}

/// Causes that change profiles much: the changed ones are fitted anew.
fn large_causes(question: &Question) -> Vec<Suspicion> {
    let mut tried = vec![edge_offset(question)];
    let mut attempt = |cause: Cause, changed: &Question| {
        let (misfit_left, _) = fitted_anew(changed);
        tried.push(Suspicion { cause, thickness_mm: None, amount: 0.0, misfit_left });
    };
    let mu = question.options.settings().mu;
    let in_range = |v: &f64| (0.0..=mu).contains(v);
    if question.terms.iter().all(|t| t.values.iter().all(in_range)) {
        let decoded = |values: &[f64]| values.iter().map(|v| mu * linear(v / mu)).collect();
        attempt(Cause::GammaCoded, &question.changed(decoded));
    }
    if question.terms.len() == 2 {
        attempt(Cause::ThicknessesSwapped, &question.swapped());
    }
    tried
}

/// The misfit of a question's best fit, and the shift of all its profiles that would still help.
fn fitted_anew(question: &Question) -> (f64, f64) {
    let best = &search::best(question, 1)[0];
    let objective = Objective::new(question, best);
    let optimum = objective.descend(objective.start(&best.medium), objective.free());
    let residuals = Residuals::new(&objective, optimum.x, &objective.blocks(optimum.x));
    let (misfit, _) = residuals.without(vec![0.0; residuals.residual.len()]);
    let pitch = question.dictionary.grid().scene().sensor().pitch_mm();
    let shifts =
        residuals.column(None, |t| slope(residuals.predicted(t), pitch).iter().map(|v| -v).collect());
    (misfit, residuals.without(shifts).1)
}

/// A shift of all profiles, which is not small beside an edge: found in a few steps.
fn edge_offset(question: &Question) -> Suspicion {
    const STEPS: usize = 3;
    let pitch = question.dictionary.grid().scene().sensor().pitch_mm();
    let (mut misfit_left, mut more) = fitted_anew(question);
    let mut amount = 0.0;
    for _ in 0..STEPS {
        amount += more;
        (misfit_left, more) = fitted_anew(&question.changed(|values| shifted(values, amount / pitch)));
    }
    Suspicion { cause: Cause::EdgeOffset, thickness_mm: None, amount, misfit_left }
}

/// The profile read so many pixels further on.
fn shifted(values: &[f64], pixels: f64) -> Vec<f64> {
    let last = values.len() - 1;
    let at = |i: usize| {
        let place = (i as f64 + pixels).clamp(0.0, last as f64);
        let below = (place as usize).min(last - 1);
        values[below] + (place - below as f64) * (values[below + 1] - values[below])
    };
    (0..values.len()).map(at).collect()
}

/// The linear value of an sRGB-coded one (IEC 61966-2-1).
fn linear(v: f64) -> f64 {
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}
