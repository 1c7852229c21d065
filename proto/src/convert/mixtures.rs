//! Converts mixtures, and the inks found from them.

use super::mirror::{list, mirror, number, optional, required};
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
    descent: number,
});
mirror!(MixtureFit { material, channel, parts: list, medium: required, agreement: optional, left_out });
mirror!(Agreement { chi2, pixels, misfit, pull });

#[cfg(test)]
mod tests {
    use super::*;

    /// A missing field of a result for mixtures is refused. That the others are the same is what `mirror!` guarantees.
    #[test]
    fn missing_field_of_an_ink_is_named() {
        let inks = vec![wire::InkFit { channels: vec![wire::InkChannel::default()], ..Default::default() }];
        let common =
            Some(wire::Common { mu_interval: Some(wire::Interval::default()), ..Default::default() });
        let refused = Unmixed::try_from(wire::Unmixed { common, inks, ..Default::default() }).unwrap_err();
        assert_eq!(refused.field(), "inks[0].channels[0].medium");
    }

    /// Mixtures and their parts are unchanged after conversion, and invalid ones are refused.
    #[test]
    fn mixtures_round_trip_and_are_checked() {
        let part = |ink: &str| (ink.to_owned(), 0.5);
        let there =
            Mixtures::new(vec![Mixture::new("grey", [part("white"), part("black")]).unwrap()]).unwrap();
        let sent: Vec<wire::Mixture> = there.all().iter().map(Into::into).collect();
        assert_eq!(mixtures(sent.clone()).unwrap(), Some(there));
        assert_eq!(mixtures(Vec::new()).unwrap(), None);
        let white = MixturePart::new("white", 0.5);
        assert_eq!(MixturePart::try_from(sent[0].parts[0].clone()).unwrap(), white);
        let mut bad = sent;
        bad[0].parts[0].volume_fraction = f64::NAN;
        assert_eq!(mixtures(bad).unwrap_err().field(), "mixtures[0].parts of grey");
    }
}
