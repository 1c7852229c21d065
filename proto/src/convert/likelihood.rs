//! What the likelihood tells of a fit.

use super::required;
use crate::wire;
use optics_model::fit::{
    Bound, Ends, ErrorSource, Likelihood, Nuisance, NuisanceEstimate, OutlierPixel, SourceShare, Stretch,
};
use optics_model::invalid::{Invalid, Result};

impl From<Likelihood> for wire::Likelihood {
    fn from(l: Likelihood) -> Self {
        Self {
            chi2: l.chi2,
            degrees_of_freedom: l.degrees_of_freedom,
            probability: l.probability,
            nuisances: l.nuisances.into_iter().map(Into::into).collect(),
            outliers: l.outliers.into_iter().map(Into::into).collect(),
            stretches: l.stretches.into_iter().map(Into::into).collect(),
            bound: Some(l.bound.into()),
            budget: l.budget.into_iter().map(Into::into).collect(),
        }
    }
}

impl TryFrom<wire::Likelihood> for Likelihood {
    type Error = Invalid;

    fn try_from(l: wire::Likelihood) -> Result<Self> {
        Ok(Self {
            chi2: l.chi2,
            degrees_of_freedom: l.degrees_of_freedom,
            probability: l.probability,
            nuisances: l.nuisances.into_iter().filter_map(nuisance_estimate).collect(),
            outliers: l.outliers.into_iter().map(Into::into).collect(),
            stretches: l.stretches.into_iter().map(Into::into).collect(),
            bound: required("bound", l.bound)?.try_into()?,
            budget: l.budget.into_iter().map(Into::into).collect(),
        })
    }
}

const NUISANCES: [(Nuisance, wire::Nuisance); 7] = [
    (Nuisance::Scale, wire::Nuisance::Scale),
    (Nuisance::BlurVariance, wire::Nuisance::BlurVariance),
    (Nuisance::Thickness, wire::Nuisance::Thickness),
    (Nuisance::Origin, wire::Nuisance::Origin),
    (Nuisance::Gain, wire::Nuisance::Gain),
    (Nuisance::Zero, wire::Nuisance::Zero),
    (Nuisance::Slope, wire::Nuisance::Slope),
];

impl From<NuisanceEstimate> for wire::NuisanceEstimate {
    fn from(n: NuisanceEstimate) -> Self {
        let nuisance = NUISANCES.into_iter().find(|(nuisance, _)| *nuisance == n.nuisance);
        Self {
            nuisance: nuisance.map_or(wire::Nuisance::Unspecified, |(_, wire)| wire).into(),
            profile_mm: n.profile_mm,
            value: n.value,
            std_error: n.std_error,
            prior: n.prior,
            prior_std_error: n.prior_std_error,
        }
    }
}

/// None for a nuisance that only a newer coordinator knows: without its name and unit its numbers say nothing.
fn nuisance_estimate(n: wire::NuisanceEstimate) -> Option<NuisanceEstimate> {
    let (nuisance, _) = NUISANCES.into_iter().find(|(_, wire)| i32::from(*wire) == n.nuisance)?;
    Some(NuisanceEstimate {
        nuisance,
        profile_mm: n.profile_mm,
        value: n.value,
        std_error: n.std_error,
        prior: n.prior,
        prior_std_error: n.prior_std_error,
    })
}

impl From<OutlierPixel> for wire::OutlierPixel {
    fn from(o: OutlierPixel) -> Self {
        Self { profile_mm: o.profile_mm, x_mm: o.x_mm, deviation: o.deviation }
    }
}

impl From<wire::OutlierPixel> for OutlierPixel {
    fn from(o: wire::OutlierPixel) -> Self {
        Self { profile_mm: o.profile_mm, x_mm: o.x_mm, deviation: o.deviation }
    }
}

impl From<Stretch> for wire::Stretch {
    fn from(s: Stretch) -> Self {
        Self { profile_mm: s.profile_mm, from_mm: s.from_mm, to_mm: s.to_mm, deviation: s.deviation }
    }
}

impl From<wire::Stretch> for Stretch {
    fn from(s: wire::Stretch) -> Self {
        Self { profile_mm: s.profile_mm, from_mm: s.from_mm, to_mm: s.to_mm, deviation: s.deviation }
    }
}

impl From<Bound> for wire::Bound {
    fn from(b: Bound) -> Self {
        let ends = |e: Ends| Some(wire::Ends { low: e.low, high: e.high });
        Self {
            sigma_t_per_mm: ends(b.sigma_t_per_mm),
            albedo: ends(b.albedo),
            g: ends(b.g),
            reduced_scattering_per_mm: ends(b.reduced_scattering_per_mm),
            absorption_per_mm: ends(b.absorption_per_mm),
        }
    }
}

impl TryFrom<wire::Bound> for Bound {
    type Error = Invalid;

    fn try_from(b: wire::Bound) -> Result<Self> {
        let ends = |field, ends| required(field, ends).map(|e: wire::Ends| Ends { low: e.low, high: e.high });
        Ok(Self {
            sigma_t_per_mm: ends("sigma_t_per_mm", b.sigma_t_per_mm)?,
            albedo: ends("albedo", b.albedo)?,
            g: ends("g", b.g)?,
            reduced_scattering_per_mm: ends("reduced_scattering_per_mm", b.reduced_scattering_per_mm)?,
            absorption_per_mm: ends("absorption_per_mm", b.absorption_per_mm)?,
        })
    }
}

const SOURCES: [(ErrorSource, wire::ErrorSource); 12] = [
    (ErrorSource::Unknown, wire::ErrorSource::Unspecified),
    (ErrorSource::Noise, wire::ErrorSource::Noise),
    (ErrorSource::Dictionary, wire::ErrorSource::Dictionary),
    (ErrorSource::Thickness, wire::ErrorSource::Thickness),
    (ErrorSource::Origin, wire::ErrorSource::Origin),
    (ErrorSource::Blur, wire::ErrorSource::Blur),
    (ErrorSource::Gain, wire::ErrorSource::Gain),
    (ErrorSource::Zero, wire::ErrorSource::Zero),
    (ErrorSource::Slope, wire::ErrorSource::Slope),
    (ErrorSource::Scale, wire::ErrorSource::Scale),
    (ErrorSource::OtherChannels, wire::ErrorSource::OtherChannels),
    (ErrorSource::G, wire::ErrorSource::G),
];

impl From<SourceShare> for wire::SourceShare {
    fn from(s: SourceShare) -> Self {
        let source = SOURCES.into_iter().find(|(source, _)| *source == s.source);
        Self {
            source: source.map_or(wire::ErrorSource::Unspecified, |(_, wire)| wire).into(),
            sigma_t: s.sigma_t,
            albedo: s.albedo,
            reduced_scattering: s.reduced_scattering,
            absorption: s.absorption,
        }
    }
}

/// A source that only a newer coordinator has stays, without its name: the shares still add up to 1.
impl From<wire::SourceShare> for SourceShare {
    fn from(s: wire::SourceShare) -> Self {
        let source = SOURCES.into_iter().find(|(_, wire)| *wire == s.source());
        Self {
            source: source.map_or(ErrorSource::Unknown, |(source, _)| source),
            sigma_t: s.sigma_t,
            albedo: s.albedo,
            reduced_scattering: s.reduced_scattering,
            absorption: s.absorption,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn likelihood() -> Likelihood {
        let estimate = |(i, (nuisance, _)): (usize, (Nuisance, wire::Nuisance))| {
            let n = i as f64;
            NuisanceEstimate {
                nuisance,
                profile_mm: (i > 1).then_some(0.5),
                value: n + 0.1,
                std_error: n + 0.2,
                prior: n + 0.3,
                prior_std_error: n + 0.4,
            }
        };
        let ends = |low| Ends { low, high: 2.0 * low };
        let share = |(i, (source, _)): (usize, (ErrorSource, wire::ErrorSource))| {
            let n = i as f64;
            SourceShare {
                source,
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
            nuisances: NUISANCES.into_iter().enumerate().map(estimate).collect(),
            outliers: vec![OutlierPixel { profile_mm: 1.0, x_mm: -1.23, deviation: 8.5 }],
            stretches: vec![Stretch { profile_mm: 0.5, from_mm: 1.2, to_mm: 1.6, deviation: -4.1 }],
            bound: Bound {
                sigma_t_per_mm: Ends { low: f64::NEG_INFINITY, high: f64::INFINITY },
                albedo: ends(0.4),
                g: ends(0.3),
                reduced_scattering_per_mm: ends(2.0),
                absorption_per_mm: ends(0.01),
            },
            budget: SOURCES.into_iter().enumerate().map(share).collect(),
        }
    }

    #[test]
    fn a_likelihood_comes_through_with_all_its_nuisances() {
        let there = likelihood();
        assert_eq!(Likelihood::try_from(wire::Likelihood::from(there.clone())).unwrap(), there);
    }

    /// A newer coordinator may have more of them. A missing bound is refused.
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
