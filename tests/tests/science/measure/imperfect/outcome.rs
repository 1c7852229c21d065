//! The result of a fit, compared with the true medium.

use optics_fit::{FitDictionary, fit};
use optics_model::fit::{Bound, Ends, FitOptions, Interval, MISFIT, Refined};
use optics_model::{Measurement, Medium};

use super::media::Subject;
use super::rows::Row;

/// Names of the quantities, in the order of all arrays below.
pub(super) const QUANTITIES: [&str; 5] = ["σ_t", "α", "g", "σ_s(1−g)", "σ_a"];
const SIGMA_T: usize = 0;
const ALBEDO: usize = 1;

/// Quantities whose coverage is counted with g held and with g free.
pub(super) const COVERED: [usize; 4] = [SIGMA_T, ALBEDO, 3, 4];

/// A way to fit a measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Way {
    /// Whether g is held at the truth.
    pub g_held: bool,
}

impl Way {
    pub(super) const ALL: [Self; 2] = [Self { g_held: true }, Self { g_held: false }];

    pub(super) fn g_name(self) -> &'static str {
        if self.g_held { "held" } else { "free" }
    }
}

/// A fit of a medium's measurement.
#[derive(Debug, Clone)]
pub(super) struct Outcome {
    pub row: usize,
    pub way: Way,
    pub subject: u64,
    pub truth: [f64; 5],
    pub found: [f64; 5],
    pub intervals: [Interval; 5],
    /// The Cramér–Rao bound.
    pub bound: [Ends; 5],
    pub resolved: bool,
    pub misfit: f64,
    /// Probability that noise alone makes χ² as large.
    pub probability: f64,
    pub outliers: usize,
}

impl Outcome {
    pub(super) fn of(
        dictionary: &FitDictionary,
        subject: &Subject,
        measurement: &Measurement,
        (number, row): (usize, &Row),
        way: Way,
    ) -> Self {
        let g = way.g_held.then(|| subject.medium.g());
        let options = FitOptions::new(row.settings(g)).unwrap();
        let answer = fit(dictionary, measurement, &options).unwrap();
        let r = answer.channels[0].refined.as_ref().unwrap();
        let likelihood = &r.likelihood;
        Self {
            row: number,
            way,
            subject: subject.number,
            truth: quantities(&subject.medium),
            found: quantities(&r.best.medium),
            intervals: intervals(r),
            bound: ends(&likelihood.bound),
            resolved: r.resolved_at_g,
            misfit: r.misfit,
            probability: likelihood.probability,
            outliers: likelihood.outliers.len(),
        }
    }

    /// Relative errors of σ_t and of 1 − α, with their signs.
    pub(super) fn errors(&self) -> [f64; 2] {
        let (found, truth) = (&self.found, &self.truth);
        let co_albedo = (1.0 - found[ALBEDO]) / (1.0 - truth[ALBEDO]);
        [found[SIGMA_T] / truth[SIGMA_T] - 1.0, co_albedo - 1.0]
    }

    pub(super) fn holds(&self, quantity: usize) -> bool {
        self.intervals[quantity].contains(self.truth[quantity])
    }

    pub(super) fn is_misfit(&self) -> bool {
        self.misfit > MISFIT
    }

    /// Ratio of the width of an interval to that of a bound; None if one of them is open.
    pub(super) fn over_bound(&self, quantity: usize, bound: &[Ends; 5]) -> Option<f64> {
        let (found, least) = (&self.intervals[quantity], &bound[quantity]);
        let ratio = (found.high - found.low) / (least.high - least.low);
        (!found.open_low && !found.open_high && ratio.is_finite()).then_some(ratio)
    }
}

fn quantities(m: &Medium) -> [f64; 5] {
    [m.sigma_t_per_mm(), m.albedo(), m.g(), m.reduced_scattering_per_mm(), m.absorption_per_mm()]
}

fn intervals(r: &Refined) -> [Interval; 5] {
    [r.sigma_t_per_mm, r.albedo, r.g, r.reduced_scattering_per_mm, r.absorption_per_mm]
}

fn ends(b: &Bound) -> [Ends; 5] {
    [b.sigma_t_per_mm, b.albedo, b.g, b.reduced_scattering_per_mm, b.absorption_per_mm]
}
