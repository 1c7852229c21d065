//! Converts the answers of a fit by the likelihood: nuisances, intervals, budget.

use super::mirror::{known_ones, list, mirror, mirror_enum, number, required};
use optics_model::fit::{
    Bound, Ends, ErrorSource, Likelihood, Nuisance, NuisanceEstimate, OutlierPixel, SceneEstimate,
    SourceShare, Stretch,
};

mirror!(Likelihood {
    chi2,
    degrees_of_freedom,
    probability,
    nuisances: known_ones,
    outliers: list,
    stretches: list,
    bound: required,
    budget: list,
    scene: list,
});
mirror!(SceneEstimate {
    quantity,
    unit,
    scope: number,
    slab_mm,
    value,
    std_error,
    prior,
    prior_std_error,
    at_end,
});
mirror!(NuisanceEstimate { nuisance: number, profile_mm, value, std_error, prior, prior_std_error });
mirror_enum!(Nuisance { Scale, BlurVariance, Thickness, Origin, Gain, Zero, Slope, Wedge });
mirror!(OutlierPixel { profile_mm, x_mm, deviation });
mirror!(Stretch { profile_mm, from_mm, to_mm, deviation });
mirror!(Bound {
    sigma_t_per_mm: required,
    albedo: required,
    g: required,
    reduced_scattering_per_mm: required,
    absorption_per_mm: required,
});
mirror!(Ends { low, high });
// A source of a newer version is kept without its name: the shares still add up to 1.
mirror!(SourceShare { source: number, quantity, sigma_t, albedo, reduced_scattering, absorption });
mirror_enum!(ErrorSource {
    Noise, Dictionary, Thickness, Origin, Blur, Gain, Zero, Slope, Scale, OtherChannels, G, Scene, Wedge,
} or Unknown);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convert::mirror::Numbered;
    use crate::wire;

    /// A newer coordinator may send more nuisances, which are left out, and sources, which keep their shares. A missing
    /// bound is refused. That the fields are the same is what `mirror!` guarantees.
    #[test]
    fn unknown_nuisances_are_ignored() {
        let ends = Some(wire::Ends { low: f64::NEG_INFINITY, high: 1.0 });
        let bound = wire::Bound {
            sigma_t_per_mm: ends,
            albedo: ends,
            g: ends,
            reduced_scattering_per_mm: ends,
            absorption_per_mm: ends,
        };
        let estimate = |nuisance| wire::NuisanceEstimate { nuisance, ..Default::default() };
        let share = |source| wire::SourceShare { source, sigma_t: 0.1, ..Default::default() };
        let message = wire::Likelihood {
            nuisances: (0..=9).map(estimate).collect(),
            budget: (0..=14).map(share).collect(),
            bound: Some(bound),
            ..Default::default()
        };
        let likelihood = Likelihood::try_from(message.clone()).unwrap();
        assert!(likelihood.nuisances.iter().map(|n| n.nuisance.number()).eq(1..=8));
        let sources = likelihood.budget.iter().map(|share| share.source.number());
        assert!(sources.eq((0..=13).chain([0])));
        for (bound, field) in [(Some(wire::Bound { g: None, ..bound }), "g"), (None, "bound")] {
            let lacking = wire::Likelihood { bound, ..message.clone() };
            assert_eq!(Likelihood::try_from(lacking).unwrap_err().field(), field);
        }
    }
}
