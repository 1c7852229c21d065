//! Finds the most likely cause where neither noise nor the priors of the set-up explain a channel.
//!
//! sRGB-coded values and exchanged thicknesses are tested by fitting the corrected profiles. Otherwise the part of the
//! set-up is reported whose estimate lies farthest from its prior.

use optics_model::fit::{Cause, FitOptions, MISFIT, Nuisance, NuisanceEstimate, Suspicion};
use optics_model::{Invalid, MeasuredProfile, Measurement};

use crate::likelihood::answer::{Found, Goodness};
use crate::likelihood::point::LN_SCALE;
use crate::likelihood::problem::ChannelData;
use crate::likelihood::problem::channel::{ChannelMinimum, minimum};

/// Share of the unexplained χ² that a cause must explain, …
const CONVINCING: f64 = 0.6;
/// … and the greatest misfit that it may leave: this number, or this share of the whole misfit. A poor fit explains
/// nothing.
const LEFT: (f64, f64) = (1.5 * MISFIT, 1.0 / 8.0);
/// Standard deviations of its prior from which on an estimate is suspicious, however well the data are explained.
const PULLED: f64 = 4.0;

impl Found<'_, '_> {
    /// The most likely cause; none if the residuals are noise.
    pub(crate) fn suspicion(&self, goodness: &Goodness, nuisances: &[NuisanceEstimate]) -> Option<Suspicion> {
        let misfit = goodness.misfit();
        if misfit > MISFIT
            && let Some(corrected) = self.corrected(misfit)
        {
            return Some(corrected);
        }
        let unknown =
            Suspicion { cause: Cause::Unknown, thickness_mm: None, amount: 0.0, misfit_left: misfit };
        let pulled = self.pulled(goodness, nuisances);
        let pulled = pulled.filter(|s| misfit <= MISFIT || is_convincing(s, misfit));
        pulled.or((misfit > MISFIT).then_some(unknown))
    }

    /// The correction of the profiles that leaves the least misfit, if it is convincing.
    fn corrected(&self, misfit: f64) -> Option<Suspicion> {
        let options = self.as_found().ok()?;
        let attempt = |(cause, profiles): (Cause, Vec<MeasuredProfile>)| {
            let misfit_left = self.misfit_of(profiles, &options).ok()?;
            Some(Suspicion { cause, thickness_mm: None, amount: 0.0, misfit_left })
        };
        let profiles: Vec<&MeasuredProfile> = self.data.profiles.iter().map(|p| p.profile).collect();
        let decoded = decoded(&profiles).map(|profiles| (Cause::GammaCoded, profiles));
        let swapped = swapped(&profiles).map(|profiles| (Cause::ThicknessesSwapped, profiles));
        let tried = [decoded, swapped].into_iter().flatten().filter_map(attempt);
        tried.filter(|s| is_convincing(s, misfit)).min_by(|a, b| a.misfit_left.total_cmp(&b.misfit_left))
    }

    /// The options with the common factor and the anisotropy at their estimates.
    fn as_found(&self) -> Result<FitOptions, Invalid> {
        let settings = self.data.options.settings();
        let options =
            self.data.options.with_mu(settings.mu * libm::exp(self.x(LN_SCALE)), settings.mu_std_error)?;
        if self.common_g.is_some() { options.with_g(self.medium(self.state).g()) } else { Ok(options) }
    }

    fn misfit_of(&self, profiles: Vec<MeasuredProfile>, options: &FitOptions) -> Result<f64, Invalid> {
        let changed = Measurement::new(self.data.measurement.material(), profiles)?;
        let data = ChannelData::new(self.data.dictionary, &changed, 0, self.data.name, options)?;
        let surrogates = data.surrogates();
        let scan = data.scan(&surrogates, options.settings().ln_mu_std_error())?;
        let ChannelMinimum { system, state, sample_ior } = minimum(&data, &surrogates, &scan);
        let found = Found { data: &data, system: &system, state: &state, sample_ior, common_g: None };
        Ok(found.goodness(&system.linear(&state.x, &state.own)).misfit())
    }

    /// The part of the set-up whose estimates lie farthest from their priors.
    fn pulled(&self, goodness: &Goodness, nuisances: &[NuisanceEstimate]) -> Option<Suspicion> {
        let pull = |n: &NuisanceEstimate| (n.value - n.prior) / n.prior_std_error;
        let suspicion = |(cause, nuisance): (Cause, Nuisance)| {
            let far = nuisances.iter().filter(|n| n.nuisance == nuisance && pull(n).abs() > PULLED);
            let far: Vec<&NuisanceEstimate> = far.collect();
            let squares: f64 = far.iter().map(|n| pull(n).powi(2)).sum();
            let mean = far.iter().map(|n| n.value).sum::<f64>() / far.len() as f64;
            let amount = if cause == Cause::Blur { mean.max(0.0).sqrt() } else { mean };
            let one = (far.len() == 1 && self.data.profiles.len() > 1).then(|| far[0].profile_mm);
            let left = (goodness.chi2 - squares).max(0.0) / goodness.degrees_of_freedom.max(1.0);
            let misfit_left = left.sqrt();
            (!far.is_empty())
                .then_some((squares, Suspicion { cause, thickness_mm: one.flatten(), amount, misfit_left }))
        };
        let causes = [
            (Cause::EdgeOffset, Nuisance::Origin),
            (Cause::Gain, Nuisance::Gain),
            (Cause::Zero, Nuisance::Zero),
            (Cause::Slope, Nuisance::Slope),
            (Cause::Wedge, Nuisance::Wedge),
            (Cause::Blur, Nuisance::BlurVariance),
            (Cause::Thickness, Nuisance::Thickness),
        ];
        let found = causes.into_iter().filter_map(suspicion);
        found.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, suspicion)| suspicion)
    }
}

/// Whether a cause explains most of the misfit.
fn is_convincing(suspicion: &Suspicion, misfit: f64) -> bool {
    let left = suspicion.misfit_left;
    misfit.powi(2) - left.powi(2) >= CONVINCING * (misfit.powi(2) - 1.0)
        && left <= LEFT.0.max(LEFT.1 * misfit)
}

/// The profiles with linear values, if the measured values lie between 0 and 1 and may be sRGB-coded.
fn decoded(profiles: &[&MeasuredProfile]) -> Option<Vec<MeasuredProfile>> {
    let decode = |p: &&MeasuredProfile| {
        let values: Vec<(f64, f64)> = p.values().iter().map(|v| linear(*v)).collect();
        let errors = p.std_errors().map(|e| e.iter().zip(&values).map(|(e, (_, slope))| e * slope).collect());
        let values = values.into_iter().map(|(value, _)| value).collect();
        changed(p, p.thickness_mm(), values, errors)
    };
    let in_range = profiles.iter().all(|p| p.values().iter().all(|v| (0.0..=1.0).contains(v)));
    if in_range { profiles.iter().map(decode).collect() } else { None }
}

/// Two profiles, each at the thickness of the other.
fn swapped(profiles: &[&MeasuredProfile]) -> Option<Vec<MeasuredProfile>> {
    let [a, b] = profiles else { return None };
    let at = |p: &MeasuredProfile, thickness_mm: f64| {
        changed(p, thickness_mm, p.values().to_vec(), p.std_errors().map(<[f64]>::to_vec))
    };
    Some(vec![at(a, b.thickness_mm())?, at(b, a.thickness_mm())?])
}

fn changed(
    p: &MeasuredProfile,
    thickness_mm: f64,
    values: Vec<f64>,
    std_errors: Option<Vec<f64>>,
) -> Option<MeasuredProfile> {
    let profile = MeasuredProfile::new(p.channel(), thickness_mm, p.x_mm().to_vec(), values, std_errors);
    profile.and_then(|profile| profile.with_setup(*p.setup())).ok()
}

/// The linear value of an sRGB-coded one (IEC 61966-2-1), and its derivative.
fn linear(v: f64) -> (f64, f64) {
    let root = (v + 0.055) / 1.055;
    if v <= 0.040_45 {
        (v / 12.92, 1.0 / 12.92)
    } else {
        (libm::pow(root, 2.4), 2.4 / 1.055 * libm::pow(root, 1.4))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cause explains three fifths of the χ² that noise does not, and leaves a misfit of 3 or an eighth at most.
    #[test]
    fn convincing_causes_leave_little() {
        let convinces = |misfit: f64, misfit_left: f64| {
            let cause = Cause::Gain;
            is_convincing(&Suspicion { cause, thickness_mm: None, amount: 0.0, misfit_left }, misfit)
        };
        for (misfit, most) in [(2.4, 1.7041), (10.0, 3.0), (40.0, 5.0)] {
            assert!(convinces(misfit, most - 1e-3) && !convinces(misfit, most + 1e-3), "{misfit}");
        }
    }

    /// The first pixel is black.
    fn profile(thickness_mm: f64, value: f64) -> MeasuredProfile {
        let x: Vec<f64> = (0..10).map(|i| f64::from(i) - 4.5).collect();
        let values = (0..10).map(|i| if i == 0 { 0.0 } else { value }).collect();
        MeasuredProfile::new("G", thickness_mm, x, values, Some(vec![0.01; 10])).unwrap()
    }

    /// Standard errors are decoded with the slope, and values outside 0 to 1 are not taken as coded.
    #[test]
    fn decoded_profiles_have_linear_errors() {
        let profiles = decoded(&[&profile(0.5, 0.5)]).unwrap();
        let (value, slope) = linear(0.5);
        assert_eq!(profiles[0].values()[..2], [0.0, value]);
        assert_eq!(profiles[0].std_errors().unwrap()[..2], [0.01 * linear(0.0).1, 0.01 * slope]);
        assert!(decoded(&[&profile(0.5, 0.5), &profile(1.0, 1.01)]).is_none());
    }

    /// Thicknesses are exchanged between two profiles.
    #[test]
    fn swapped_profiles_exchange_thicknesses() {
        let [a, b] = [(0.5, 0.3), (1.0, 0.4)].map(|(thickness_mm, value)| profile(thickness_mm, value));
        let found = swapped(&[&a, &b]).unwrap();
        let places = found.iter().map(|p| (p.thickness_mm(), p.values()[1]));
        assert_eq!(places.collect::<Vec<_>>(), [(1.0, 0.3), (0.5, 0.4)]);
        assert!(swapped(&[&a, &b, &a]).is_none());
    }

    /// sRGB by the standard: half of the code is 21.4 % of the light, and the slopes of both branches meet within 3 %.
    #[test]
    fn srgb_is_decoded_by_the_standard() {
        assert!((linear(0.5).0 - 0.214_041).abs() < 1e-6, "{:?}", linear(0.5));
        assert!((linear(1.0).0 - 1.0).abs() < 1e-12);
        assert!((linear(0.04).0 - 0.04 / 12.92).abs() < 1e-12);
        for v in [0.02, 0.3, 0.9] {
            let difference = (linear(v + 1e-6).0 - linear(v - 1e-6).0) / 2e-6;
            assert!((linear(v).1 - difference).abs() < 1e-6, "{v}: {:?} {difference}", linear(v));
        }
        let [below, above] = [0.040_449, 0.040_451].map(linear);
        assert!((below.0 - above.0).abs() < 1e-6 && (below.1 / above.1 - 1.0).abs() < 0.03);
    }
}
