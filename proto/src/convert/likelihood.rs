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
mirror_enum!(Nuisance { Scale, BlurVariance, Thickness, Origin, Gain, Zero, Slope });
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
    Noise, Dictionary, Thickness, Origin, Blur, Gain, Zero, Slope, Scale, OtherChannels, G, Scene,
} or Unknown);

#[cfg(test)]
mod tests {
    use optics_model::scene::Scope;

    use super::*;
    use crate::convert::mirror::Numbered;
    use crate::wire;

    fn likelihood() -> Likelihood {
        let estimate = |number: i32| {
            let n = f64::from(number);
            NuisanceEstimate {
                nuisance: Nuisance::of_number(number).unwrap(),
                profile_mm: (number > 2).then_some(0.5),
                value: n + 0.1,
                std_error: n + 0.2,
                prior: n + 0.3,
                prior_std_error: n + 0.4,
            }
        };
        let ends = |low| Ends { low, high: 2.0 * low };
        let share = |number: i32| {
            let n = f64::from(number);
            SourceShare {
                source: ErrorSource::of_number(number).unwrap(),
                quantity: (number == 12).then(|| "gel thickness".to_owned()),
                sigma_t: n + 0.1,
                albedo: n + 0.2,
                reduced_scattering: n + 0.3,
                absorption: n + 0.4,
            }
        };
        Likelihood {
            chi2: 712.5,
            degrees_of_freedom: 716.0,
            probability: 0.53,
            nuisances: (1..=7).map(estimate).collect(),
            outliers: vec![OutlierPixel { profile_mm: 1.0, x_mm: -1.23, deviation: 8.5 }],
            stretches: vec![Stretch { profile_mm: 0.5, from_mm: 1.2, to_mm: 1.6, deviation: -4.1 }],
            bound: Bound {
                sigma_t_per_mm: Ends { low: f64::NEG_INFINITY, high: f64::INFINITY },
                albedo: ends(0.4),
                g: ends(0.3),
                reduced_scattering_per_mm: ends(2.0),
                absorption_per_mm: ends(0.01),
            },
            budget: (0..=12).map(share).collect(),
            scene: vec![SceneEstimate {
                quantity: "gel thickness".to_owned(),
                unit: "mm".to_owned(),
                scope: Scope::Slab,
                slab_mm: Some(0.5),
                value: 0.031,
                std_error: 0.004,
                prior: 0.02,
                prior_std_error: 0.02,
                at_end: true,
            }],
        }
    }

    /// A likelihood is unchanged after conversion, with all its nuisances.
    #[test]
    fn likelihood_round_trips_with_nuisances() {
        let there = likelihood();
        assert_eq!(Likelihood::try_from(wire::Likelihood::from(there.clone())).unwrap(), there);
    }

    /// A newer coordinator may send more nuisances. A missing bound is refused.
    #[test]
    fn unknown_nuisances_are_ignored() {
        let mut message = wire::Likelihood::from(likelihood());
        message.nuisances[2].nuisance = 99;
        message.nuisances[3].nuisance = 0;
        assert_eq!(Likelihood::try_from(message.clone()).unwrap().nuisances.len(), 5);
        message.bound.as_mut().unwrap().g = None;
        assert_eq!(Likelihood::try_from(message.clone()).unwrap_err().field(), "g");
        message.bound = None;
        assert_eq!(Likelihood::try_from(message).unwrap_err().field(), "bound");
    }
}
