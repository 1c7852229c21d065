//! Reports the estimates of the set-up's nuisances, each with its prior.

use nalgebra::{DMatrix, DVector};
use optics_model::fit::{Nuisance, NuisanceEstimate, SceneEstimate};
use optics_model::phase::{MOST_G, MOST_SECOND_WEIGHT, SecondLobe};
use optics_model::scene::{PriorKind, Scene, Scope};

use crate::likelihood::answer::Found;
use crate::likelihood::point::{BLUR, LN_ONE_MINUS_G, LN_SCALE, LN_THICKNESS};
use crate::likelihood::system::unknowns::{SceneUnknown, submatrix};
use crate::likelihood::system::{State, System};
use crate::likelihood::term::blur;
use crate::likelihood::term::reduced::Reduced;
use crate::likelihood::term::{Own, OwnPrior};
use crate::surrogate::g;

/// Thickness of a layer as a share of its prior's standard deviation, below which there is none.
const NEAR_0: f64 = 0.3;
/// Standard errors by which data must pull a quantity beyond its range: true values near an end scatter less.
const BEYOND: f64 = 2.0;

impl Found<'_, '_> {
    /// The uncertain quantities of the scene, in its order. `step` leads from the state to the minimum of the quadratic.
    pub(crate) fn scene_estimates(
        &self,
        covariance: &DMatrix<f64>,
        step: &DVector<f64>,
    ) -> Vec<SceneEstimate> {
        let scene = self.data.dictionary.grid().scene();
        let estimate = |unknown: &SceneUnknown| {
            let (slot, prior) = (unknown.slot, &scene.priors()[unknown.prior]);
            let (u, limits) = (self.state.x[slot], self.system.unknowns[slot].limits);
            let (mean, sd) = (scene.value_of(prior).unwrap_or(self.sample_ior), prior.std_error());
            // No weight, no spread and no gel are ends of the quantities, not of the responses.
            let ends_at_0 = match prior.kind() {
                PriorKind::SecondLobeWeight | PriorKind::BaseSpread => true,
                PriorKind::Thickness => mean + sd * limits.0 < NEAR_0 * sd,
                _ => false,
            };
            let std_error = std_error(covariance, slot);
            let is_low = u <= limits.0 && !ends_at_0 && step[slot] < -BEYOND * std_error;
            let is_high = u >= limits.1 && step[slot] > BEYOND * std_error;
            let (of_prior, of_prior_sd) = match self.system.unknowns[slot].prior {
                Some((of_prior, of_prior_sd)) if unknown.is_measured => (of_prior, of_prior_sd),
                _ => (0.0, 1.0),
            };
            SceneEstimate {
                quantity: scene.name_of(prior),
                unit: prior.kind().unit().to_owned(),
                scope: if unknown.channel.is_some() { Scope::Channel } else { prior.scope() },
                slab_mm: unknown.slab_mm,
                value: mean + sd * u,
                std_error: sd * std_error,
                prior: mean + sd * of_prior,
                prior_std_error: sd * of_prior_sd,
                at_end: is_low || is_high || self.is_beyond(prior.kind(), mean + sd * u),
            }
        };
        let free = |unknown: &&SceneUnknown| self.is_free(unknown.slot);
        let mut all: Vec<&SceneUnknown> = self.system.of_scene.iter().filter(free).collect();
        all.sort_by_key(|unknown| unknown.prior);
        all.into_iter().map(estimate).collect()
    }

    /// Whether a second lobe of this weight is too heavy for the medium's anisotropy.
    fn is_beyond(&self, kind: PriorKind, weight: f64) -> bool {
        let of_scene = self.data.dictionary.grid().scene().phase().second_lobe();
        let of_second = of_scene.filter(|_| kind == PriorKind::SecondLobeWeight).map(SecondLobe::g);
        let lobe = of_second.and_then(|of_second| SecondLobe::new(weight.max(0.0), of_second).ok());
        lobe.is_some_and(|lobe| lobe.limited_to(g(self.x(LN_ONE_MINUS_G))) != lobe)
    }

    /// All nuisances in the order of the answer: common ones first, then by profile.
    pub(crate) fn nuisances(&self, covariance: &DMatrix<f64>, reduced: &[Reduced]) -> Vec<NuisanceEstimate> {
        let profile_estimates = |i: usize| {
            let own = self.own_estimates(i, covariance, &reduced[i]);
            self.blur_estimate(i, covariance)
                .into_iter()
                .chain(self.thickness_estimate(i, covariance))
                .chain(own)
        };
        let profiles = (0..self.system.terms.len()).flat_map(profile_estimates);
        self.scale_estimate(covariance).into_iter().chain(profiles).collect()
    }

    fn is_free(&self, slot: usize) -> bool {
        !self.system.unknowns[slot].held
    }

    fn scale_estimate(&self, covariance: &DMatrix<f64>) -> Option<NuisanceEstimate> {
        let (settings, slot) = (self.data.options.settings(), self.slots()[LN_SCALE]);
        let (prior, relative) = (1.0 / settings.mu, settings.ln_mu_std_error());
        let value = libm::exp(-self.x(LN_SCALE)) / settings.mu;
        self.is_free(slot).then(|| NuisanceEstimate {
            nuisance: Nuisance::Scale,
            profile_mm: None,
            value,
            std_error: std_error(covariance, slot) * value,
            prior,
            prior_std_error: if relative > 0.0 { prior * relative } else { f64::INFINITY },
        })
    }

    /// The blur of a profile; None if it is held, or if it is shared with the first profile, which reports it.
    fn blur_estimate(&self, profile: usize, covariance: &DMatrix<f64>) -> Option<NuisanceEstimate> {
        let slot = self.system.slots[profile][BLUR];
        if !self.is_free(slot) || (profile > 0 && self.system.slots[0][BLUR] == slot) {
            return None;
        }
        let (value, std_error) = variance_mm2((self.state.x[slot], std_error(covariance, slot)));
        let (prior, prior_std_error) = variance_mm2(blur::prior(&self.data.profiles[profile].set_up));
        let profile_mm = (profile > 0).then_some(self.system.terms[profile].thickness_mm);
        Some(NuisanceEstimate {
            nuisance: Nuisance::BlurVariance,
            profile_mm,
            value,
            std_error,
            prior,
            prior_std_error,
        })
    }

    fn thickness_estimate(&self, profile: usize, covariance: &DMatrix<f64>) -> Option<NuisanceEstimate> {
        let (slot, stated_mm) =
            (self.system.slots[profile][LN_THICKNESS], self.system.terms[profile].thickness_mm);
        let value = libm::exp(self.state.x[slot]);
        self.is_free(slot).then(|| NuisanceEstimate {
            nuisance: Nuisance::Thickness,
            profile_mm: Some(stated_mm),
            value,
            std_error: std_error(covariance, slot) * value,
            prior: stated_mm,
            prior_std_error: self.data.profiles[profile].set_up.thickness_std_error_mm,
        })
    }

    /// Origin, gain, zero and slope of a profile, each the sum of its own part and the slab's.
    fn own_estimates(
        &self,
        profile: usize,
        covariance: &DMatrix<f64>,
        reduced: &Reduced,
    ) -> Vec<NuisanceEstimate> {
        let term = &self.system.terms[profile];
        let slots = &self.system.slots[profile];
        let shared = submatrix(covariance, slots);
        let own = reduced.own_covariance(&shared);
        // Value of the slab's part, its variance, and its covariance with the own part.
        let slab_part = |k: usize, slab: usize| {
            let with_own = reduced.own_response(&shared.column(slab).into_owned())[k];
            [self.state.x[slots[slab]], shared[(slab, slab)], with_own]
        };
        let estimate = |(k, of): (usize, &OwnPrior)| {
            let (nuisance, prior) = match of.own {
                Own::Origin => (Nuisance::Origin, term.origin_mm),
                Own::Gain => (Nuisance::Gain, 0.0),
                Own::Zero => (Nuisance::Zero, 0.0),
                Own::Slope => (Nuisance::Slope, 0.0),
                Own::Wedge => (Nuisance::Wedge, 0.0),
            };
            let [slab, slab_variance, with_own] =
                of.own.of_slab().map_or([0.0; 3], |slab| slab_part(k, slab));
            let (sd, slab_sd) = (of.std_error, of.slab_std_error);
            let variance = sd * sd * own[(k, k)] + slab_sd * (slab_sd * slab_variance + 2.0 * sd * with_own);
            NuisanceEstimate {
                nuisance,
                profile_mm: Some(term.thickness_mm),
                value: prior + sd * self.state.own[profile][k] + slab_sd * slab,
                std_error: variance.max(0.0).sqrt(),
                prior,
                prior_std_error: libm::hypot(sd, slab_sd),
            }
        };
        term.priors.iter().enumerate().map(estimate).collect()
    }
}

/// The second lobe of the phase function of a profile, at a state of its system.
pub(crate) fn second_lobe(
    scene: &Scene,
    system: &System,
    state: &State,
    profile: usize,
) -> Option<SecondLobe> {
    let of_scene = scene.phase().second_lobe()?;
    let slots = &system.slots[profile];
    let estimate = |kind: PriorKind, of_scene: f64| {
        let has_kind = |u: &&SceneUnknown| scene.priors()[u.prior].kind() == kind;
        let own = system.of_scene.iter().find(|u| has_kind(u) && slots.contains(&u.slot));
        own.map_or(of_scene, |u| of_scene + scene.priors()[u.prior].std_error() * state.x[u.slot])
    };
    let weight = estimate(PriorKind::SecondLobeWeight, of_scene.weight());
    let of_second = estimate(PriorKind::SecondLobeG, of_scene.g()).clamp(-MOST_G, MOST_G);
    let lobe = SecondLobe::new(weight.clamp(0.0, MOST_SECOND_WEIGHT), of_second).ok()?;
    Some(lobe.limited_to(g(state.x[slots[LN_ONE_MINUS_G]]))).filter(|lobe| lobe.weight() > 0.0)
}

fn std_error(covariance: &DMatrix<f64>, i: usize) -> f64 {
    covariance[(i, i)].max(0.0).sqrt()
}

/// The blur's variance in mm² and its standard error, from those of its coordinate.
fn variance_mm2((u, deviation): (f64, f64)) -> (f64, f64) {
    let variance = blur::variance_mm2(u);
    (variance, blur::variance_mm2(u + deviation) - variance)
}
