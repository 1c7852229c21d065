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
    let range = match plan.search_mu {
        Some(range) => range,
        None => MuRange::new(settings.mu, settings.mu, 1.0)?,
    };
    let searched = scale(dictionary, materials, options, &range)?;
    let (mu, mu_std_error) = match plan.search_mu {
        Some(_) => (searched.best.mu, searched.std_error.unwrap_or(0.0)),
        None => (settings.mu, settings.mu_std_error),
    };
    let g =
        if settings.g.is_fixed() { Some(settings.g.min()) } else { plan.common_g.then_some(searched.best_g) };
    let options = FitOptions::new(FitSettings { mu, mu_std_error, refine: true, ..settings })?;
    let options = if let Some(g) = g { options.with_g(g)? } else { options };
    let fit = |material: &Measurement| super::fit(dictionary, material, &options);
    let fits = materials.iter().map(fit).collect::<Result<_, _>>()?;
    Ok(Measured { scale: plan.search_mu.is_some().then_some(searched), mu, mu_std_error, g, materials: fits })
}
