//! Estimates of the set-up's nuisances, each with its prior.

use nalgebra::DMatrix;
use optics_model::fit::{Nuisance, NuisanceEstimate, SceneEstimate};

use super::answer::Found;
use super::term::{Own, Reduced};
use super::unknowns::{SceneUnknown, submatrix};
use super::{BLUR, LN_SCALE, LN_THICKNESS, blur};

impl Found<'_, '_> {
    /// The uncertain quantities of the scene, in its order.
    pub(super) fn scene_estimates(&self, covariance: &DMatrix<f64>) -> Vec<SceneEstimate> {
        let scene = self.data.dictionary.grid().scene();
        let estimate = |unknown: &SceneUnknown| {
            let (slot, prior) = (unknown.slot, &scene.priors()[unknown.prior]);
            let (u, limits) = (self.state.x[slot], self.system.unknowns[slot].limits);
            let (mean, sd) = (scene.value_of(prior).unwrap_or(self.sample_ior), prior.std_error());
            SceneEstimate {
                quantity: scene.name_of(prior),
                unit: prior.kind().unit().to_owned(),
                scope: prior.scope(),
                slab_mm: unknown.slab_mm,
                value: mean + sd * u,
                std_error: sd * covariance[(slot, slot)].max(0.0).sqrt(),
                prior: mean,
                prior_std_error: sd,
                at_end: u <= limits.0 || u >= limits.1,
            }
        };
        let mut all: Vec<&SceneUnknown> = self.system.of_scene.iter().collect();
        all.sort_by_key(|unknown| unknown.prior);
        all.into_iter().map(estimate).collect()
    }

    /// In the order of the answer: common ones first, then by profile.
    pub(super) fn nuisances(&self, covariance: &DMatrix<f64>, reduced: &[Reduced]) -> Vec<NuisanceEstimate> {
        let settings = self.data.options.settings();
        let mut all = Vec::new();
        let mut add = |nuisance, profile_mm, value, variance: f64, prior_value: f64, prior_std_error: f64| {
            let std_error = variance.max(0.0).sqrt();
            all.push(NuisanceEstimate {
                nuisance,
                profile_mm,
                value,
                std_error,
                prior: prior_value,
                prior_std_error,
            });
        };
        let slots = self.slots();
        let free = |slot: usize| !self.system.unknowns[slot].held;
        if free(slots[LN_SCALE]) {
            let (x, slot) = (self.x(LN_SCALE), slots[LN_SCALE]);
            let (prior_value, factor) = (1.0 / settings.mu, (-x).exp() / settings.mu);
            let relative = settings.mu_std_error / settings.mu;
            let prior_std_error = if relative > 0.0 { prior_value * relative } else { f64::INFINITY };
            add(
                Nuisance::Scale,
                None,
                factor,
                covariance[(slot, slot)] * factor * factor,
                prior_value,
                prior_std_error,
            );
        }
        for (i, (term, profile)) in self.system.terms.iter().zip(&self.data.profiles).enumerate() {
            let (slots, at) = (&self.system.slots[i], Some(term.thickness_mm));
            let (blur, thickness) = (slots[BLUR], slots[LN_THICKNESS]);
            if free(blur) && (i == 0 || self.system.slots[0][BLUR] != blur) {
                let profile_mm = at.filter(|_| i > 0);
                let deviation = covariance[(blur, blur)].max(0.0).sqrt();
                let (value, std_error) = variance_mm2((self.state.x[blur], deviation));
                let (prior_value, prior_std_error) = variance_mm2(profile.blur);
                add(
                    Nuisance::BlurVariance,
                    profile_mm,
                    value,
                    std_error.powi(2),
                    prior_value,
                    prior_std_error,
                );
            }
            if free(thickness) {
                let t = self.state.x[thickness].exp();
                let variance = covariance[(thickness, thickness)] * t * t;
                add(Nuisance::Thickness, at, t, variance, term.thickness_mm, profile.thickness_std_error_mm);
            }
            let shared = submatrix(covariance, slots);
            let own = reduced[i].own_covariance(&shared);
            for (k, prior) in term.priors.iter().enumerate() {
                let (nuisance, prior_value) = match prior.own {
                    Own::Origin => (Nuisance::Origin, term.origin_mm),
                    Own::Gain => (Nuisance::Gain, 0.0),
                    Own::Zero => (Nuisance::Zero, 0.0),
                    Own::Slope => (Nuisance::Slope, 0.0),
                };
                let sd = prior.std_error;
                add(
                    nuisance,
                    at,
                    prior_value + sd * self.state.own[i][k],
                    own[(k, k)] * sd * sd,
                    prior_value,
                    sd,
                );
            }
        }
        all
    }
}

/// The blur's variance in mm² and its standard error, from those of its coordinate.
fn variance_mm2((u, deviation): (f64, f64)) -> (f64, f64) {
    let variance = blur::variance_mm2(u);
    (variance, blur::variance_mm2(u + deviation) - variance)
}
