//! Predicts profiles of any medium and thickness within a dictionary, for display.

use optics_model::fit::{FitSettings, PredictedChannel, PredictedProfiles, ProfileQuestion};
use optics_model::{Grid, Invalid, Medium};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
use crate::dictionary::axes::find_channel;
use crate::dictionary::gradient::shown_derivative;
use crate::surrogate::place::{axes, check_medium, check_thickness, own_pixels, sample_ior};
use crate::surrogate::{Surrogate, coordinates};

/// Least effective number of independent records for a standard error: fewer determine it too poorly.
const LEAST_DEGREES: f64 = 4.0;

/// Relative difference below which a parameter equals that of a record: decimals are rounded.
const SAME: f64 = 1e-6;

/// Predicts the profiles of a slab by the model between the records (`surrogate`), with standard errors from the noise of
/// the neighbouring records.
pub fn profile(dictionary: &FitDictionary, question: &ProfileQuestion) -> Result<PredictedProfiles, Invalid> {
    let (grid, medium) = (dictionary.grid(), *question.medium());
    let ior = sample_ior(grid, question.sample_ior())?;
    check_medium(grid, &medium)?;
    let channels: Vec<usize> = if question.channels().is_empty() {
        vec![0]
    } else {
        question.channels().iter().map(|name| find_channel(grid, name)).collect::<Result<_, _>>()?
    };
    let surrogates: Vec<_> =
        channels.iter().map(|channel| Surrogate::new(dictionary, *channel, ior)).collect();
    let thickness_mm = question.thickness_mm();
    for surrogate in &surrogates {
        check_thickness(surrogate, &medium, thickness_mm)?;
    }
    let predicted = |(surrogate, channel): (&Surrogate, &usize)| PredictedChannel {
        channel: grid.scene().channels()[*channel].name().to_owned(),
        ..of_channel(surrogate, &medium, thickness_mm)
    };
    Ok(PredictedProfiles {
        medium,
        thickness_mm,
        sample_ior: grid.sample_ior()[ior],
        recorded: is_recorded(grid, &medium, thickness_mm),
        pixels: own_pixels(grid)?,
        channels: surrogates.par_iter().zip(&channels).map(predicted).collect(),
    })
}

/// Leaves the channel's name empty: the caller sets it.
fn of_channel(surrogate: &Surrogate, medium: &Medium, thickness_mm: f64) -> PredictedChannel {
    let x = coordinates(medium);
    let values = surrogate.predict_at(thickness_mm, x).values;
    let noise = surrogate.noise_factors_at(thickness_mm, x);
    let at = |pixel: usize| noise.factors.iter().map(|f| f[pixel] * f[pixel]).sum::<f64>().sqrt();
    let known = noise.degrees >= LEAST_DEGREES;
    let FitSettings { wavelet, level, .. } = FitSettings::default();
    let per_mm = surrogate.grid().scene().sensor().pitch_mm().recip();
    let gradient = shown_derivative(&values, wavelet, level).into_iter().map(|d| d * per_mm).collect();
    PredictedChannel {
        channel: String::new(),
        std_errors: known.then(|| (0..values.len()).map(at).collect()),
        gradient,
        values,
    }
}

fn is_recorded(grid: &Grid, medium: &Medium, thickness_mm: f64) -> bool {
    let has = |axis: &[f64], value: f64| axis.iter().any(|v| (v - value).abs() <= SAME * v.abs().max(1e-3));
    has(grid.thickness_mm(), thickness_mm)
        && axes(grid, medium).into_iter().all(|(_, value, axis)| has(axis, value))
}

#[cfg(test)]
mod tests;
