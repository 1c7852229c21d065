//! How sure a refined fit is.
//!
//! Intervals are not ±1.96 standard deviations (see `noise`) but follow Eq. 1 as it is: a value belongs to the interval
//! if the error with all else optimised rises no further than it would at ±1.96 standard deviations if profiles were
//! linear in the coordinates. They are therefore lopsided or open where the data are. What a channel shares with others
//! – a scale factor, an anisotropy – is added in quadrature, in the linear theory of `shared`.

use glam::{DMat4, DVec4};
use optics_model::fit::{Candidate, Interval, Refined, ThicknessError};

use crate::paper::intervals::{Intervals, Z};
use crate::paper::noise::{Noise, Spread};
use crate::paper::question::{Question, Term};
use crate::paper::refine::{Block, Descent, Objective, Optimum, Unknowns};
use crate::paper::shared::{Part, Shared};
use crate::paper::suspicion::suspicion;
use crate::surrogate::{ALBEDO, G, SIGMA_T, albedo, sigma_t};

/// A channel is resolved if its intervals of σ_t and of the albedo span at most this factor …
const RESOLVED_FACTOR: f64 = 2.0;
/// … and that of the albedo at most this.
const RESOLVED_ALBEDO: f64 = 0.2;
/// Correlation of ln σ_t with ln(1 − g) from which on they are said to trade off.
pub(crate) const VALLEY: f64 = 0.9;

/// A channel's continuous optimum and what noise does to it.
#[derive(Debug)]
pub(crate) struct Analysis<'a> {
    pub objective: Objective<'a>,
    optimum: Optimum,
    blocks: Vec<Block>,
    /// Where the error falls at the optimum, by all unknowns.
    downhill: DVec4,
    pub noise: Noise,
}

/// What a channel has in common with others.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Company<'a> {
    /// The channel's place among them.
    pub channel: usize,
    pub shared: &'a Shared,
    /// The same with the anisotropy held at its value.
    pub at_g: &'a Shared,
    /// The interval of the anisotropy, if it was chosen for all together.
    pub g: Option<Interval>,
}

impl<'a> Analysis<'a> {
    /// Of the optimum that is reached from the best record.
    pub(crate) fn new(question: &'a Question<'a>, best: &Candidate) -> Self {
        let objective = Objective::new(question, best);
        let optimum = objective.descend(objective.start(&best.medium), objective.free());
        let blocks = objective.blocks(optimum.x);
        let noise = Noise::new(&objective, optimum.x, &blocks);
        let downhill = Descent::new(&blocks).downhill;
        Self { objective, optimum, blocks, downhill, noise }
    }

    pub(crate) fn part(&self) -> Part<'_> {
        self.part_with(self.objective.free())
    }

    fn part_with(&self, own: [bool; 4]) -> Part<'_> {
        Part { noise: &self.noise, own, downhill: self.downhill }
    }

    /// The refined fit of a channel on its own, or in company.
    pub(crate) fn refined(&self, company: Option<&Company>) -> Refined {
        let free = self.objective.free();
        let spread = self.noise.spread(free);
        let total = company.map_or(spread.total, |c| c.shared.of(c.channel, &self.part()));
        let [sigma_t, albedo, g] = self.intervals(&spread, free, company.map(|c| (c.shared, c.channel)));
        let (x, chosen_g) = (self.optimum.x, company.and_then(|c| c.g));
        let resolved = is_resolved(&sigma_t, &albedo);
        let at_its_g = || {
            let free = [free[SIGMA_T], free[ALBEDO], false, false];
            let at_g = company.map(|c| (c.at_g, c.channel));
            let [sigma_t, albedo, _] = self.intervals(&self.noise.spread(free), free, at_g);
            is_resolved(&sigma_t, &albedo)
        };
        let resolved_at_g = resolved || ((free[G] || chosen_g.is_some()) && at_its_g());
        let deviation = |i: usize| total.col(i)[i].max(0.0).sqrt();
        let both = deviation(SIGMA_T) * deviation(G);
        let correlation = if both > 0.0 { total.col(SIGMA_T)[G] / both } else { 0.0 };
        Refined {
            best: self.candidate(),
            sigma_t_per_mm: sigma_t,
            albedo,
            g: chosen_g.unwrap_or(g),
            reduced_scattering_per_mm: reduced_scattering(&self.objective, x, total),
            absorption_per_mm: absorption(&self.objective, x, total),
            covariance: [SIGMA_T, ALBEDO, G].map(|i| [SIGMA_T, ALBEDO, G].map(|j| total.col(j)[i])),
            correlation,
            valley: (free[G] || chosen_g.is_some()) && correlation.abs() > VALLEY,
            resolved,
            resolved_at_g,
            measurement_noise: self.noise.measured_rms,
            dictionary_share: spread.dictionary_share,
            misfit: self.noise.misfit,
            suspicion: suspicion(&self.objective, x, &self.blocks, self.noise.misfit),
            likelihood: None,
            from_mixtures: false,
        }
    }

    fn intervals(
        &self,
        spread: &Spread,
        free: [bool; 4],
        company: Option<(&Shared, usize)>,
    ) -> [Interval; 3] {
        // Beside the channel's own noise; where the data do not bound σ_t, at any one σ_t.
        let systematic = |free: [bool; 4]| match company {
            None => self.noise.spread(free).systematic,
            Some((shared, channel)) => {
                shared.of(channel, &self.part_with(free)) - self.noise.spread(free).random
            }
        };
        let intervals = Intervals {
            objective: &self.objective,
            optimum: &self.optimum,
            blocks: &self.blocks,
            spread,
            systematic: systematic(free),
            free,
        };
        intervals.all(|| systematic([false, free[ALBEDO], free[G], false]))
    }

    fn candidate(&self) -> Candidate {
        let rms = |term: usize, gradient: bool| {
            let found = self.blocks.iter().find(|b| b.term == term && b.signs.is_some() == gradient);
            found.map_or(0.0, |b| b.rms)
        };
        let question = self.objective.question;
        let axis = question.dictionary.grid().thickness_mm();
        let thickness = |(i, term): (usize, &Term)| ThicknessError {
            thickness_mm: axis[term.thickness],
            value_rms: rms(i, false),
            gradient_rms: rms(i, true),
            record: None,
        };
        Candidate {
            medium: self.objective.medium(self.optimum.x),
            sample_ior: self.objective.sample_ior(),
            error: self.optimum.error,
            thicknesses: question.terms.iter().enumerate().map(thickness).collect(),
        }
    }
}

pub(crate) fn is_resolved(sigma_t: &Interval, albedo: &Interval) -> bool {
    let bounded = |i: &Interval| !i.open_low && i.high <= RESOLVED_FACTOR * i.low;
    bounded(sigma_t) && !sigma_t.open_high && bounded(albedo) && albedo.high - albedo.low <= RESOLVED_ALBEDO
}

/// An interval of exp(f) with f linear in the coordinates, kept within what the dictionary has.
fn log_interval(value: f64, slope: DVec4, covariance: DMat4, (least, greatest): (f64, f64)) -> Interval {
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
fn reduced_scattering(objective: &Objective, x: Unknowns, covariance: DMat4) -> Interval {
    let alpha = albedo(x[ALBEDO]);
    let value = alpha * sigma_t(x[SIGMA_T]) * x[G].exp();
    let slope = DVec4::new(1.0, -2.0 * x[ALBEDO] / alpha.max(1e-9), 1.0, 0.0);
    let [s, a, g] = objective.surrogate.limits();
    let corner = |s: f64, a: f64, g: f64| albedo(a) * sigma_t(s) * g.exp();
    log_interval(value, slope, covariance, (corner(s.0, a.1, g.0), corner(s.1, a.0, g.1)))
}

/// σ_a = σ_t (1 − α), from its root u √σ_t, which may come down to zero if the dictionary does.
fn absorption(objective: &Objective, x: Unknowns, covariance: DMat4) -> Interval {
    let (u, root) = (x[ALBEDO], (0.5 * x[SIGMA_T]).exp());
    let slope = DVec4::new(0.5 * u * root, root, 0.0, 0.0);
    let half = Z * slope.dot(covariance * slope).max(0.0).sqrt();
    let [(least_s, s), (least_a, a), _] = objective.surrogate.limits();
    let (least, greatest) = (least_a * (0.5 * least_s).exp(), a * (0.5 * s).exp());
    let (low, high) = (u * root - half, u * root + half);
    // At the dictionary's greatest albedo less absorption is not excluded, unless that is 1.
    let open_low = least_a > 0.0 && (low < least || u <= least_a);
    Interval {
        low: low.max(least).powi(2),
        high: high.min(greatest).powi(2),
        open_low,
        open_high: high > greatest,
    }
}
