//! Gives spectra of media one anisotropy: renderers take one for a medium.

use optics_model::Medium;
use optics_model::measurement::wavelength_nm;

use super::RenderedChannel;

/// A note on media whose g differs between wavelengths.
pub(super) const SIMILAR: &str = "g differs between wavelengths and a medium takes one: sigma_s is scaled so that sigma_s (1 - g) is as measured.";

/// The mean anisotropy, weighted by σ_s.
pub(super) fn mean_g(channels: &[RenderedChannel]) -> f64 {
    let sigma_s = |c: &RenderedChannel| c.medium.sigma_t_per_mm() * c.medium.albedo();
    let sum: f64 = channels.iter().map(|c| sigma_s(c) * c.medium.g()).sum();
    sum / channels.iter().map(sigma_s).sum::<f64>().max(f64::MIN_POSITIVE)
}

/// Channels of wavelengths with one anisotropy, similar to theirs: σ_s (1 − g) and σ_a are the same. None for other
/// channels, and where second lobes differ.
pub(super) fn with_common_g<'a>(channels: &[RenderedChannel<'a>]) -> Option<Vec<RenderedChannel<'a>>> {
    let (g, second_lobe) = (mean_g(channels), channels.first()?.second_lobe);
    let similar = |c: &RenderedChannel<'a>| {
        let same = wavelength_nm(c.name).is_some() && c.second_lobe == second_lobe;
        let (sigma_t, albedo) = (c.medium.sigma_t_per_mm(), c.medium.albedo());
        let sigma_s = sigma_t * albedo * (1.0 - c.medium.g()) / (1.0 - g);
        let sigma_t = sigma_s + sigma_t * (1.0 - albedo);
        let medium = Medium::new(sigma_t, sigma_s / sigma_t, g).ok().filter(|_| same)?;
        Some(RenderedChannel { medium, ..*c })
    };
    channels.iter().map(similar).collect()
}
