//! Compares the estimates for a medium and for the set-up with the truth.

use optics_model::Medium;
use optics_model::fit::{Interval, MaterialFit, Measured};
use optics_model::scene::Scope;

use super::scenes::lab;

pub(super) const QUANTITIES: [&str; 5] = ["σ_t", "1 − α", "σ_s(1−g)", "σ_a", "1 − g"];

#[derive(Debug)]
pub(super) struct SetUpOutcome {
    truth: [f64; 5],
    found: [f64; 5],
    intervals: [Interval; 5],
    pub mu: f64,
    pub g: f64,
    pub probability: f64,
    pub scene: Vec<SceneOutcome>,
    /// Whether an estimate of the scene contradicts its prior or lies at the end of the responses.
    pub is_doubted: bool,
}

/// A quantity of the scene.
#[derive(Debug)]
pub(super) struct SceneOutcome {
    pub name: String,
    off: f64,
    std_error: f64,
    /// Standard error over that of the prior.
    pub share_of_prior: f64,
    pub at_end: bool,
}

impl SceneOutcome {
    pub(super) fn z(&self) -> f64 {
        self.off / self.std_error
    }

    pub(super) fn holds(&self) -> bool {
        self.z().abs() <= optics_model::fit::Z
    }
}

impl SetUpOutcome {
    /// `difference` is the truth of a quantity of the scene: by material, slab and prior.
    pub(super) fn of(
        material: usize,
        measured: &Measured,
        fit: &MaterialFit,
        truth: &Medium,
        difference: impl Fn(usize, Option<f64>, usize) -> Option<f64>,
    ) -> Self {
        let r = fit.channels[0].refined.as_ref().unwrap();
        let of = |m: &Medium| {
            let (s, a, g) = (m.sigma_t_per_mm(), m.albedo(), m.g());
            [s, 1.0 - a, s * a * (1.0 - g), s * (1.0 - a), 1.0 - g]
        };
        let complement = |i: &Interval| Interval {
            low: 1.0 - i.high,
            high: 1.0 - i.low,
            open_low: i.open_high,
            open_high: i.open_low,
        };
        let scene = lab();
        let named = |name: &str| scene.priors().iter().position(|p| scene.name_of(p) == name).unwrap();
        let estimates = r.likelihood.scene.iter();
        // Those of the session are the same for all materials.
        let own = estimates.filter(|e| material == 0 || e.scope != Scope::Session);
        let of_scene = own.filter_map(|e| {
            let difference = difference(material, e.slab_mm, named(&e.quantity))?;
            Some(SceneOutcome {
                name: e.quantity.clone(),
                off: e.value - e.prior - difference,
                std_error: e.std_error,
                share_of_prior: e.std_error / e.prior_std_error,
                at_end: e.at_end,
            })
        });
        Self {
            truth: of(truth),
            found: of(&r.best.medium),
            intervals: [
                r.sigma_t_per_mm,
                complement(&r.albedo),
                r.reduced_scattering_per_mm,
                r.absorption_per_mm,
                complement(&r.g),
            ],
            mu: measured.common.mu,
            g: r.best.medium.g(),
            probability: r.likelihood.probability,
            scene: of_scene.collect(),
            is_doubted: r.likelihood.scene.iter().any(|e| e.is_conflict() || e.at_end),
        }
    }

    pub(super) fn holds(&self, quantity: usize) -> bool {
        self.intervals[quantity].contains(self.truth[quantity])
    }

    /// Relative error.
    pub(super) fn error(&self, quantity: usize) -> f64 {
        self.found[quantity] / self.truth[quantity] - 1.0
    }

    /// Width of the interval over the truth.
    pub(super) fn width(&self, quantity: usize) -> f64 {
        (self.intervals[quantity].high - self.intervals[quantity].low) / self.truth[quantity]
    }
}
