//! The likelihood of a measurement, with the errors of the set-up estimated together with the medium.
//!
//! −2 ln L of all pixels and priors is minimised over the medium, and over the quantities of the set-up that are not known
//! exactly: a common factor, the camera's blur, the thickness of every slab, and of every profile its origin, gain, zero
//! and slope (`term`). Dust is left out (`robust`). The noise of the dictionary's records, which is alike in neighbouring
//! pixels, is modes with a prior of their own (`records_noise`). The optimum is global over the dictionary (`start`).
//! Intervals follow the least −2 ln L with one quantity held, up to a rise of 1.96² (`profile_likelihood`).

mod answer;
mod blend;
mod blur;
mod bound;
mod budget;
mod camera;
mod channel;
mod chi2;
mod descent;
mod design;
mod form;
mod joint;
mod map;
mod mixtures;
mod nuisances;
mod part;
mod problem;
mod profile_likelihood;
mod quantity;
mod records_noise;
mod residuals;
mod robust;
mod scatter;
mod settle;
mod start;
mod suspicion;
mod system;
mod term;
#[cfg(test)]
mod tests;
mod unknowns;

use optics_model::fit::{ChannelFit, FitOptions, MaterialFit, Outside};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
use answer::Found;
use problem::ChannelData;

pub(super) use design::{DesignPlan, KnownErrors};
pub(super) use joint::measure;
pub(super) use map::distance_map;
pub(super) use mixtures::unmix;

/// Numbers by pixel.
pub(super) type Line = Vec<f64>;

/// Unknowns that a profile may share with others, in this order.
pub(super) const LN_SIGMA_T: usize = 0;
pub(super) const ROOT_CO_ALBEDO: usize = 1;
pub(super) const LN_ONE_MINUS_G: usize = 2;
/// Logarithm of a factor on μ.
pub(super) const LN_SCALE: usize = 3;
/// The camera's blur (`blur`).
pub(super) const BLUR: usize = 4;
pub(super) const LN_THICKNESS: usize = 5;
/// The uncertain quantities of the scene follow, in its order, each by its difference from the scene's value in units of
/// its prior's standard deviation.
pub(super) const SHARED: usize = 6;

/// Values of the shared unknowns of one profile.
#[derive(Debug, Clone)]
pub(super) struct Point(pub Line);

impl Point {
    fn medium(&self) -> [f64; 3] {
        [self.0[LN_SIGMA_T], self.0[ROOT_CO_ALBEDO], self.0[LN_ONE_MINUS_G]]
    }

    fn ln_scale(&self) -> f64 {
        self.0[LN_SCALE]
    }

    fn scale(&self) -> f64 {
        (-self.0[LN_SCALE]).exp()
    }

    /// Coordinate of the blur.
    fn blur(&self) -> f64 {
        self.0[BLUR]
    }

    fn thickness_mm(&self) -> f64 {
        self.0[LN_THICKNESS].exp()
    }

    /// The uncertain quantities of the scene.
    fn scene(&self) -> &[f64] {
        &self.0[SHARED..]
    }
}

/// Fits every channel of a measurement on its own, jointly over its thicknesses.
pub(crate) fn fit(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<MaterialFit, Invalid> {
    let channel = |name: &&str| fit_channel(&ChannelData::new(dictionary, measurement, 0, name, options)?);
    let names = measurement.channels();
    let channels = match names.as_slice() {
        // Not worth waking other threads for.
        [one] => vec![channel(one)?],
        several => several.par_iter().map(channel).collect::<Result<_, _>>()?,
    };
    Ok(MaterialFit { material: measurement.material().to_owned(), channels })
}

fn fit_channel(data: &ChannelData) -> Result<ChannelFit, Invalid> {
    let settings = data.options.settings();
    let surrogates = data.surrogates();
    let scan = data.scan(&surrogates, settings.mu_std_error / settings.mu)?;
    let (assembly, state, ior) = channel::minimum(data, &surrogates, &scan);
    let sample_ior = data.dictionary.grid().sample_ior()[ior];
    let found = Found { data, system: &assembly.system, state: &state, sample_ior, common_g: None };
    let refined = settings.refine.then(|| found.refined());
    let nearest = scan.best(&scan.costs(1.0), settings.top as usize);
    Ok(found.fit(refined, &nearest, outside(data, &scan)))
}

/// Whether a profile is brighter or darker than all records, in the mean.
fn outside(data: &ChannelData, scan: &start::Scan) -> Option<Outside> {
    let thicknesses = scan.terms.iter().map(start::Compressed::thickness);
    data.profiles.iter().zip(thicknesses).find_map(|(profile, thickness)| {
        let levels = scan.view.value_sketch(thickness).levels;
        profile.outside(levels, data.options.settings().mu)
    })
}
