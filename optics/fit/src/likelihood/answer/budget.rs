//! Computes the error budget of a channel's medium: the part of each source of error in an estimate's variance.
//!
//! Near the minimum an estimate is linear in the pixels and in the means of the priors, with the response C a, where C is
//! the covariance and a the gradient of the quantity. Errors of pixels and priors are independent of each other, so that
//! aᵀCa = Σ over them of (response × standard error)²: the parts are positive and add up to the variance. With g held
//! these are the parts of all sources but g; the increase of the variance with g free is the part of g.

use nalgebra::{DMatrix, DVector};
use optics_model::fit::{ErrorSource, SourceShare};

use crate::dictionary::sum::dot;
use crate::likelihood::answer::Found;
use crate::likelihood::point::{BLUR, LN_ONE_MINUS_G, LN_SCALE, LN_THICKNESS, SLAB_FLAWS};
use crate::likelihood::system::Normal;
use crate::likelihood::system::quantity::Quantity;
use crate::likelihood::system::unknowns::inverse_over;
use crate::likelihood::term::{Linear, Own};

/// Sources in the order in which shares are listed; those of the quantities of the scene follow.
const SOURCES: [ErrorSource; 12] = [
    ErrorSource::Noise,
    ErrorSource::Dictionary,
    ErrorSource::Thickness,
    ErrorSource::Origin,
    ErrorSource::Blur,
    ErrorSource::Gain,
    ErrorSource::Zero,
    ErrorSource::Slope,
    ErrorSource::Wedge,
    ErrorSource::Scale,
    ErrorSource::OtherChannels,
    ErrorSource::G,
];

/// Variance of one quantity by source, in the order of the shares.
type Parts = Vec<f64>;

impl Found<'_, '_> {
    /// Shares of the sources that contribute to any of the variances. Empty if the information is singular.
    pub(crate) fn budget(
        &self,
        linear: &[Linear],
        normal: &Normal,
        covariance: Option<&DMatrix<f64>>,
    ) -> Vec<SourceShare> {
        let g = self.slots()[LN_ONE_MINUS_G];
        let free: Vec<usize> = self.system.free().into_iter().filter(|i| *i != g).collect();
        let held = inverse_over(&free, &normal.information, 0.0);
        let (Some(covariance), Some(held)) = (covariance, held) else { return Vec::new() };
        let [sigma_t, albedo, _, reduced, absorption] = Quantity::all(self.slots()).map(|quantity| {
            let gradient = quantity.gradient(&self.state.x);
            let variance = |c: &DMatrix<f64>| gradient.dot(&(c * &gradient));
            let mut parts = self.parts(linear, normal, &(&held * &gradient));
            let whole = variance(covariance);
            add(&mut parts, ErrorSource::G, (whole - variance(&held)).max(0.0));
            parts.iter().map(|part| if whole > 0.0 { part / whole } else { 0.0 }).collect::<Parts>()
        });
        let scene = self.data.dictionary.grid().scene();
        let named = SOURCES.into_iter().map(|source| (source, None));
        let of_scene = scene.priors().iter().map(|prior| (ErrorSource::Scene, Some(scene.name_of(prior))));
        let share = |(i, (source, quantity))| SourceShare {
            source,
            quantity,
            sigma_t: sigma_t[i],
            albedo: albedo[i],
            reduced_scattering: reduced[i],
            absorption: absorption[i],
        };
        let all = named.chain(of_scene).enumerate().map(share);
        all.filter(|s| s.sigma_t + s.albedo + s.reduced_scattering + s.absorption > 0.0).collect()
    }

    /// The parts of a quantity's variance by source, where `response` is that of the unknowns to its gradient.
    fn parts(&self, linear: &[Linear], normal: &Normal, response: &DVector<f64>) -> Parts {
        let system = self.system;
        let mut parts = vec![0.0; SOURCES.len() + self.data.dictionary.grid().scene().priors().len()];
        for (i, unknown) in system.unknowns.iter().enumerate() {
            if let Some((_, std_error)) = unknown.prior.filter(|_| !unknown.held) {
                let about = unknown.about.map_or(0.0, |mean| response[mean]);
                let part = ((response[i] - about) / std_error).powi(2);
                match system.of_scene(i) {
                    Some(unknown) => parts[SOURCES.len() + unknown.prior] += part,
                    None => add(&mut parts, self.source(i), part),
                }
            }
        }
        if let Some(coupling) = &system.coupling {
            let others = response.dot(&(&coupling.information * response));
            add(&mut parts, ErrorSource::OtherChannels, others.max(0.0));
        }
        for (i, (term, linear)) in system.terms.iter().zip(linear).enumerate() {
            let shared = DVector::from_iterator(
                system.slots[i].len(),
                system.slots[i].iter().map(|slot| response[*slot]),
            );
            let own = normal.reduced[i].own_response(&shared);
            for (k, response) in own.iter().enumerate() {
                let source = match term.priors.get(k).map(|prior| prior.own) {
                    Some(Own::Origin) => ErrorSource::Origin,
                    Some(Own::Gain) => ErrorSource::Gain,
                    Some(Own::Zero) => ErrorSource::Zero,
                    Some(Own::Slope) => ErrorSource::Slope,
                    Some(Own::Wedge) => ErrorSource::Wedge,
                    None => ErrorSource::Dictionary,
                };
                add(&mut parts, source, response * response);
            }
            let all: Vec<f64> = shared.iter().chain(own.iter()).copied().collect();
            for (pixel, weight) in term.weights(linear).into_iter().enumerate() {
                let column: Vec<f64> = linear.columns.iter().map(|c| c[pixel]).collect();
                add(&mut parts, ErrorSource::Noise, weight * dot(&column, &all).powi(2));
            }
        }
        parts
    }

    /// The source of error of an unknown with a prior.
    fn source(&self, unknown: usize) -> ErrorSource {
        let is = |which: usize| self.system.slots.iter().any(|slots| slots[which] == unknown);
        if is(LN_SCALE) {
            ErrorSource::Scale
        } else if let Some(flaw) = SLAB_FLAWS.into_iter().position(is) {
            [ErrorSource::Gain, ErrorSource::Zero, ErrorSource::Slope, ErrorSource::Wedge][flaw]
        } else if is(BLUR) {
            ErrorSource::Blur
        } else if is(LN_THICKNESS) {
            ErrorSource::Thickness
        } else {
            // The anisotropies of a curve have priors, also those of other wavelengths.
            ErrorSource::G
        }
    }
}

fn add(parts: &mut [f64], source: ErrorSource, variance: f64) {
    let i = SOURCES.iter().position(|s| *s == source).expect("all sources are listed");
    parts[i] += variance;
}
