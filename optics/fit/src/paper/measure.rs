//! Measures a set of materials as the paper does: scale factor and common anisotropy by Eq. 3, then the best records.

use optics_model::fit::{Common, FitOptions, MeasurePlan, Measured, MuRange, SharedErrors};
use optics_model::{Invalid, Measurement};

use super::scale::scale;
use crate::dictionary::FitDictionary;
use crate::dictionary::axes::held;

pub(crate) fn measure(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    options: &FitOptions,
    plan: &MeasurePlan,
) -> Result<Measured, Invalid> {
    let settings = options.settings();
    let only_g = held(dictionary.grid(), options)[2];
    let common_g = plan.common_g && only_g.is_none();
    let range = match plan.search_mu {
        None if common_g => Some(MuRange::new(settings.mu, settings.mu, 1.0)?),
        searched => searched,
    };
    let curve = range.map(|range| scale(dictionary, materials, options, &range)).transpose()?;
    let scale = curve.as_ref().filter(|_| plan.search_mu.is_some());
    let given = (settings.mu, settings.mu_std_error);
    let (mu, mu_std_error) = scale.map_or(given, |s| (s.best.mu, s.std_error.map_or(0.0, |e| e.min(1.0))));
    let by_records = curve.as_ref().filter(|_| common_g);
    let mut options = options.with_mu(mu, mu_std_error)?;
    if let Some(curve) = by_records {
        options = options.with_g(curve.best_g)?;
    }
    let fits = materials.iter().enumerate().map(|(i, material)| {
        super::fit(dictionary, material, &options).map_err(|e| e.within(format_args!("materials[{i}]")))
    });
    let materials = fits.collect::<Result<_, _>>()?;
    let common = Common {
        mu,
        mu_std_error,
        mu_interval: plan.mu_interval(mu, mu_std_error),
        mu_chosen: scale.is_some(),
        g: by_records.map(|curve| curve.best_g).or(only_g),
        g_spread: None,
        g_equal_probability: None,
        g_change: None,
        g_interval: None,
        by_g: by_records.map_or_else(Vec::new, |curve| curve.by_g.clone()),
    };
    Ok(Measured { scale: scale.cloned(), common, materials, shared_errors: SharedErrors::default() })
}
