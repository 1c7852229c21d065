//! Fits measured profiles to the records of a dictionary. Numerics over plain slices: no SQL, no gRPC.
//!
//! Contains Eqs. 1 to 6 of Elek, Sumin et al. 2017 (supplement, Secs. 5.5 and 6.1), and a likelihood, which interpolates
//! between the records of the dictionary and gives confidence intervals. The public functions are the questions that a
//! dictionary answers.
//!
//! `docs/glossary.md` explains the terms.

mod bases;
mod design;
mod dictionary;
mod layers;
mod likelihood;
mod paper;
mod profile;
mod similarity;
mod stop;
mod surrogate;
#[cfg(test)]
mod testing;

use optics_model::fit::{DistanceMap, FitOptions, MaterialFit, Mixtures, Objective, Unmixed};
use optics_model::{Invalid, Measurement};

pub use design::design;
pub use dictionary::axes::channels_called;
pub use dictionary::gradient::{derivative, shown_derivative};
pub use dictionary::{DictionaryBuilder, FitChannel, FitDictionary};
pub use optics_model::fit::{MeasurePlan, Measured};
pub use paper::scale::scale;
pub use profile::profile;
pub use similarity::similar;
pub use stop::{Stop, Stopped};
pub use surrogate::predicts_thickness;

/// Fits every channel of a measurement on its own, jointly over its thicknesses.
pub fn fit(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<MaterialFit, Invalid> {
    match options.objective() {
        Objective::Paper => paper::fit(dictionary, measurement, options),
        Objective::Likelihood => likelihood::fit(dictionary, measurement, options),
    }
}

/// One map per channel of a measurement, over every admissible medium: the error of Eq. 1, or for the likelihood the root
/// mean square of the residuals over their noise, with the nuisances of the set-up at their most likely values.
pub fn distance_map(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<Vec<DistanceMap>, Invalid> {
    match options.objective() {
        Objective::Paper => paper::map::distance_map(dictionary, measurement, options),
        Objective::Likelihood => likelihood::distance_map(dictionary, measurement, options),
    }
}

/// Measures a set of materials that were photographed in the same set-up: the quantities that they share, and every
/// channel.
pub fn measure(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    options: &FitOptions,
    plan: &MeasurePlan,
) -> Result<Measured, Invalid> {
    match options.objective() {
        Objective::Paper => paper::measure(dictionary, materials, options, plan),
        Objective::Likelihood => likelihood::measure(dictionary, materials, options, plan),
    }
}

/// Estimates inks jointly from their own slabs and those of their mixtures, after all were measured one by one. Maximises
/// the likelihood, whatever the objective of those measurements.
pub fn unmix(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    mixtures: &Mixtures,
    measured: &Measured,
    options: &FitOptions,
    plan: &MeasurePlan,
) -> Result<Unmixed, Invalid> {
    likelihood::unmix(dictionary, materials, mixtures, measured, options, plan)
}
