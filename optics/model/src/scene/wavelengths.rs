//! Scenes whose indices depend on the wavelength: what one of their channels differs by, and the scene of that channel.

use super::{Channel, Prior, Scene};
use crate::invalid::{Invalid, Result};

impl Scene {
    /// Whether an index depends on the wavelength.
    pub fn is_dispersive(&self) -> bool {
        self.priors().iter().any(|prior| prior.dispersion().is_some())
    }

    /// Difference of a quantity in a channel from its value at the D line: n(λ) − n_D of an index that depends on the
    /// wavelength, otherwise 0.
    ///
    /// It is an error if the channel's name is no wavelength, if the index is not known there, or if the response of the
    /// index does not reach as far.
    pub fn difference_in(&self, channel: &Channel, prior: &Prior) -> Result<f64> {
        let Some(dispersion) = prior.dispersion() else { return Ok(0.0) };
        let nm = channel.wavelength_nm().ok_or_else(|| {
            let allowed = format!(
                "the {} depends on the wavelength: give the channel its own, in nm",
                self.name_of(prior)
            );
            Invalid::new("name", channel.name(), allowed)
        })?;
        let difference = dispersion.difference(nm)?;
        let (low, high) = prior.range(self);
        if (low..=high).contains(&difference) {
            return Ok(difference);
        }
        let given = format!("{difference:+.4} at {nm} nm");
        let allowed = format!(
            "the response of the {} holds from {low:+} to {high:+}: a larger std_error has a wider one",
            self.name_of(prior)
        );
        Err(Invalid::new("dispersion", given, allowed))
    }

    /// Checks every channel by [`Self::difference_in`].
    pub(crate) fn check_dispersion(&self) -> Result<()> {
        for (i, channel) in self.channels().iter().enumerate() {
            let checked = |prior| self.difference_in(channel, prior).map(|_| ());
            self.priors()
                .iter()
                .try_for_each(checked)
                .map_err(|e| e.within(format_args!("channels[{i}]")))?;
        }
        Ok(())
    }

    /// The scene as it is in one channel: its indices are those of its wavelength, and no quantity is uncertain.
    pub fn of_channel(&self, channel: &Channel) -> Result<Self> {
        self.found_in(channel, &vec![0.0; self.priors().len()])
    }

    /// The same, with the quantities of the priors larger by these differences.
    pub fn found_in(&self, channel: &Channel, differences: &[f64]) -> Result<Self> {
        let alone = || vec![channel.clone()];
        let mut scene = self.clone().with_priors(Vec::new())?.with_channels(alone())?;
        for (prior, difference) in self.priors().iter().zip(differences) {
            let step = difference + self.difference_in(channel, prior)?;
            if step != 0.0 {
                scene = scene.varied(prior, step, alone())?;
            }
        }
        Ok(scene)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Dispersion, DispersionCurve, LayerMedium, PriorKind};

    /// The scene of a laboratory with gel and sample that have Cauchy's dispersion.
    fn dispersive(channels: [&str; 2]) -> Scene {
        let lab = Scene::lab();
        let with = |prior: &Prior| {
            let name = lab.name_of(prior);
            let b = if name == "gel index" { 0.003 } else { 0.004 };
            let curve = DispersionCurve { cauchy_b_um2: b, ..DispersionCurve::default() };
            if prior.kind() == PriorKind::Index && name != "coat index" {
                prior.clone().with_dispersion(Dispersion::new(curve).unwrap()).unwrap()
            } else {
                prior.clone()
            }
        };
        let priors = lab.priors().iter().map(with).collect();
        let channels = channels.map(|name| Channel::new(name, 0.9, 0.02).unwrap()).to_vec();
        lab.clone().with_channels(channels).unwrap().with_priors(priors).unwrap()
    }

    /// Indices of a channel's scene follow from its wavelength; nothing else changes.
    #[test]
    fn channels_have_their_own_indices() {
        let scene = dispersive(["400", "400 nm (white -1 %)"]);
        let off = |b: f64| b * (1.0 / 0.16 - 1.0 / (0.5893 * 0.5893));
        for channel in scene.channels() {
            let own = scene.of_channel(channel).unwrap();
            assert!((own.sample_ior_offset() - off(0.004)).abs() < 1e-12);
            for (layer, of_lab) in own.layers().iter().zip(scene.layers()) {
                let expected = |ior: f64| if layer.name() == "gel" { ior + off(0.003) } else { ior };
                if let (LayerMedium::Clear { ior, .. }, LayerMedium::Clear { ior: of_lab, .. }) =
                    (layer.medium(), of_lab.medium())
                {
                    assert!((ior - expected(of_lab)).abs() < 1e-12, "{}", layer.name());
                }
            }
            assert_eq!(
                (own.channels(), own.priors(), own.is_dispersive()),
                (&[channel.clone()][..], &[][..], false)
            );
        }
        let lab = Scene::lab();
        assert_eq!(lab.of_channel(&lab.channels()[0]).unwrap().layers(), lab.layers());
    }

    #[test]
    fn channels_without_index_are_refused() {
        assert!(dispersive(["400", "700"]).check_dispersion().is_ok());
        let message = |names| dispersive(names).check_dispersion().unwrap_err().to_string();
        assert_eq!(
            message(["400", "R"]),
            "channels[1].name = R is not valid: the gel index depends on the wavelength: give the channel its own, in nm"
        );
        assert_eq!(
            message(["250", "400"]),
            "channels[0].dispersion = +0.0525 at 250 nm is not valid: the response of the sample index holds from -0.05 to \
             +0.05: a larger std_error has a wider one"
        );
    }
}
