//! Converts mixtures, and the inks found from them.

use super::mirror::{list, mirror, optional, required};
use crate::wire;
use optics_model::fit::{Agreement, InkChannel, InkFit, Mixture, MixtureFit, MixturePart, Mixtures, Unmixed};
use optics_model::invalid::{Invalid, Result, each};

impl From<MixturePart> for wire::MixturePart {
    fn from(part: MixturePart) -> Self {
        Self { ink: part.ink().to_owned(), volume_fraction: part.volume_fraction() }
    }
}

impl TryFrom<wire::MixturePart> for MixturePart {
    type Error = Invalid;

    fn try_from(part: wire::MixturePart) -> Result<Self> {
        Ok(Self::new(part.ink, part.volume_fraction))
    }
}

impl From<&Mixture> for wire::Mixture {
    fn from(mixture: &Mixture) -> Self {
        let parts = mixture.parts().iter().cloned().map(Into::into).collect();
        Self { material: mixture.material().to_owned(), parts }
    }
}

/// Converts mixtures; None if there are none.
pub fn mixtures(all: Vec<wire::Mixture>) -> Result<Option<Mixtures>> {
    if all.is_empty() {
        return Ok(None);
    }
    let mixture = |m: wire::Mixture| {
        Mixture::new(m.material, m.parts.into_iter().map(|part| (part.ink, part.volume_fraction)))
    };
    Ok(Some(Mixtures::new(each("mixtures", all, mixture)?)?))
}

mirror!(Unmixed { common: required, inks: list, mixtures: list });
mirror!(InkFit { material, channels: list });
mirror!(InkChannel {
    channel,
    medium: required,
    sigma_t_per_mm: required,
    albedo: required,
    g: required,
    reduced_scattering_per_mm: required,
    absorption_per_mm: required,
    resolved,
    from_mixtures,
});
mirror!(MixtureFit { material, channel, parts: list, medium: required, agreement: optional, left_out });
mirror!(Agreement { chi2, pixels, misfit, pull });

#[cfg(test)]
mod tests {
    use super::*;
    use optics_model::Medium;
    use optics_model::fit::{Common, Interval};

    fn interval(low: f64) -> Interval {
        Interval { low, high: 2.0 * low, open_low: low < 1.0, open_high: low > 3.0 }
    }

    fn unmixed() -> Unmixed {
        let medium = Medium::new(9.0, 0.05, 0.4).unwrap();
        let channel = InkChannel {
            channel: "R".into(),
            medium,
            sigma_t_per_mm: interval(8.5),
            albedo: interval(0.04),
            g: interval(0.35),
            reduced_scattering_per_mm: interval(0.2),
            absorption_per_mm: interval(8.0),
            resolved: true,
            from_mixtures: true,
        };
        let mixture = |agreement, left_out: Option<&str>| MixtureFit {
            material: "white+cyan".into(),
            channel: "R".into(),
            parts: vec![MixturePart::new("white", 0.5), MixturePart::new("cyan", 0.5)],
            medium,
            agreement,
            left_out: left_out.map(str::to_owned),
        };
        let agreement = Agreement { chi2: 700.0, pixels: 720.0, misfit: 0.98, pull: 1.2 };
        Unmixed {
            common: Common {
                mu: 0.91,
                mu_std_error: 0.01,
                mu_interval: interval(0.89),
                mu_chosen: true,
                g: Some(0.4),
                g_change: None,
                g_interval: Some(interval(0.38)),
                by_g: Vec::new(),
            },
            inks: vec![InkFit { material: "cyan".into(), channels: vec![channel] }],
            mixtures: vec![mixture(Some(agreement), None), mixture(None, Some("outside"))],
        }
    }

    /// The result for mixtures is unchanged after conversion, and a missing field is refused.
    #[test]
    fn unmixed_result_round_trips() {
        let there = unmixed();
        assert_eq!(Unmixed::try_from(wire::Unmixed::from(there.clone())).unwrap(), there);
        let mut lacking = wire::Unmixed::from(there);
        lacking.inks[0].channels[0].medium = None;
        let refused = Unmixed::try_from(lacking).unwrap_err();
        assert_eq!(refused.field(), "inks[0].channels[0].medium");
    }

    /// Mixtures are unchanged after conversion, and invalid ones are refused.
    #[test]
    fn mixtures_round_trip_and_are_checked() {
        let part = |ink: &str| (ink.to_owned(), 0.5);
        let there =
            Mixtures::new(vec![Mixture::new("grey", [part("white"), part("black")]).unwrap()]).unwrap();
        let sent: Vec<wire::Mixture> = there.all().iter().map(Into::into).collect();
        assert_eq!(mixtures(sent.clone()).unwrap(), Some(there));
        assert_eq!(mixtures(Vec::new()).unwrap(), None);
        let mut bad = sent;
        bad[0].parts[0].volume_fraction = f64::NAN;
        let refused = mixtures(bad).unwrap_err();
        assert_eq!(refused.field(), "mixtures[0].parts of grey");
    }
}
