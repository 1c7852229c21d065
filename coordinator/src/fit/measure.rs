//! The whole job of the paper: scale factor, common anisotropy, fits, refinement, certainty.

use farm_proto::fit::{FitOptions, FitSettings, MaterialFit, MuRange, ScaleCurve};
use farm_proto::{Invalid, Measurement};

use super::dictionary::FitDictionary;
use super::scale::scale;

/// What was found for a set of materials.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The search of the scale factor; none if it was given.
    pub scale: Option<ScaleCurve>,
    pub mu: f64,
    pub mu_std_error: f64,
    /// The anisotropy common to all materials; none if each channel has its own.
    pub g: Option<f64>,
    pub materials: Vec<MaterialFit>,
}

/// How the scale factor and the anisotropy are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasurePlan {
    /// Scale factors to search; none to take that of the options.
    pub search_mu: Option<MuRange>,
    /// Hold all materials at the anisotropy that explains them best together.
    pub common_g: bool,
}

/// Measures a set of materials that were photographed in the same set-up.
pub fn measure(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    options: &FitOptions,
    plan: &MeasurePlan,
) -> Result<Measured, Invalid> {
    let settings = *options.settings();
    let held_g = settings.g.is_fixed().then_some(settings.g.min());
    // One value of μ is enough to compare anisotropies.
    let range = plan.search_mu.map_or_else(|| MuRange::new(settings.mu, settings.mu, 1.0), Ok)?;
    let wants_g = plan.common_g && held_g.is_none();
    let searched = if plan.search_mu.is_some() || wants_g {
        Some(scale(dictionary, materials, options, &range)?)
    } else {
        None
    };
    let common_g = searched.as_ref().filter(|_| wants_g).map(|s| s.best_g);
    let found_mu = searched.filter(|_| plan.search_mu.is_some());
    let (mu, mu_std_error) = match &found_mu {
        Some(scale) => (scale.best.mu, scale.std_error.unwrap_or(0.0)),
        None => (settings.mu, settings.mu_std_error),
    };
    let g = held_g.or(common_g);
    let options = FitOptions::new(FitSettings { mu, mu_std_error, refine: true, ..settings })?;
    let options = if let Some(g) = g { options.with_g(g)? } else { options };
    let fit = |material: &Measurement| super::fit(dictionary, material, &options);
    let fits = materials.iter().map(fit).collect::<Result<_, _>>()?;
    Ok(Measured { scale: found_mu, mu, mu_std_error, g, materials: fits })
}
