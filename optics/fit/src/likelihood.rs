//! Maximises the likelihood of a measurement, with the errors of the set-up estimated together with the medium.
//!
//! −2 ln L of all pixels and priors is minimised over the medium, and over the quantities of the set-up that are not
//! known exactly: a common factor, the camera's blur, the thickness of every slab, and of every profile its origin, gain,
//! zero and slope (`term`). Dust is left out (`term/robust`). The noise of the dictionary's records, which is correlated
//! between neighbouring pixels, is modelled by modes with priors (`term/records_noise`). The optimum is global over the
//! dictionary (`problem/start`). Intervals follow the profile likelihood, the least −2 ln L with one quantity held, up to
//! a rise of 1.96² (`interval/profile_likelihood`).

mod answer;
mod design;
mod interval;
mod joint;
mod map;
mod mixtures;
mod point;
mod problem;
mod system;
mod term;
#[cfg(test)]
mod tests;

use optics_model::fit::{ChannelFit, FitOptions, MaterialFit};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
use answer::Found;
use problem::ChannelData;
use problem::channel::{self, ChannelMinimum};

pub(super) use design::{DesignPlan, KnownErrors, Precision};
pub(super) use joint::measure;
pub(super) use map::distance_map;
pub(super) use mixtures::unmix;

/// Fits every channel of a measurement on its own, jointly over its thicknesses.
pub(crate) fn fit(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<MaterialFit, Invalid> {
    let channel = |name: &&str| fit_channel(&ChannelData::new(dictionary, measurement, 0, name, options)?);
    let names = measurement.channels();
    let channels = match names.as_slice() {
        // A single channel is not worth waking other threads for.
        [one] => vec![channel(one)?],
        several => several.par_iter().map(channel).collect::<Result<_, _>>()?,
    };
    Ok(MaterialFit { material: measurement.material().to_owned(), channels })
}

fn fit_channel(data: &ChannelData) -> Result<ChannelFit, Invalid> {
    let settings = data.options.settings();
    let surrogates = data.surrogates();
    let scan = data.scan(&surrogates, settings.ln_mu_std_error())?;
    let ChannelMinimum { system, state, sample_ior } = channel::minimum(data, &surrogates, &scan);
    let found = Found { data, system: &system, state: &state, sample_ior, common_g: None };
    let refined = settings.refine.then(|| found.refined());
    let nearest = scan.best(&scan.costs(1.0), settings.top as usize);
    Ok(found.fit(refined, &nearest, data.outside(&scan)))
}
