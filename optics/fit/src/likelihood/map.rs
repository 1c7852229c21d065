//! Maps the likelihood over all media of the dictionary.

use optics_model::fit::{Candidate, DistanceMap, FitOptions, MapLayer};
use optics_model::{Invalid, Measurement, Medium};

use crate::dictionary::FitDictionary;
use crate::layers::of_layers;
use crate::likelihood::problem::ChannelData;
use crate::likelihood::problem::start::Scan;

/// One map per channel: the root of −2 ln L per pixel, in the basis of `problem/start`, and so accurate to a few per cent.
pub(crate) fn distance_map(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<Vec<DistanceMap>, Invalid> {
    let map = |name: &str| channel(&ChannelData::new(dictionary, measurement, 0, name, options)?);
    measurement.channels().into_iter().map(map).collect()
}

fn channel(data: &ChannelData) -> Result<DistanceMap, Invalid> {
    let settings = data.options.settings();
    let surrogates = data.surrogates();
    let scan = data.scan(&surrogates, settings.ln_mu_std_error())?;
    let costs = scan.costs(1.0);
    let best = scan.best(&costs, 1);
    let ior = best.first().map_or(0, |m| m[0]);
    let pixels = data.pixels() as f64;
    let error = |cost: f32| (f64::from(cost.max(0.0)) / pixels).sqrt();
    let layers = scan.region.admissible.g.clone().map(|g| layer(&scan, &costs, ior, g, &error)).collect();
    Ok(of_layers(data.dictionary.grid(), data.name, &scan.region.admissible, ior, layers))
}

fn layer(scan: &Scan, costs: &[f32], ior: usize, g: usize, error: &impl Fn(f32) -> f64) -> MapLayer {
    let (grid, admissible) = (scan.dictionary.grid(), &scan.region.admissible);
    let at = |s: usize, a: usize| error(costs[scan.number([ior, s, g, a])]);
    let row = |s: usize| admissible.albedo.clone().map(|a| at(s, a)).collect();
    let errors: Vec<Vec<f64>> = admissible.sigma_t.clone().map(row).collect();
    let places = admissible.sigma_t.clone().flat_map(|s| admissible.albedo.clone().map(move |a| (s, a)));
    let (s, a) = places
        .min_by(|x, y| at(x.0, x.1).total_cmp(&at(y.0, y.1)))
        .unwrap_or((admissible.sigma_t.start, admissible.albedo.start));
    let medium = Medium::new(grid.sigma_t_per_mm()[s], grid.albedo()[a], grid.g()[g]);
    let best = Candidate {
        medium: medium.expect("axes hold checked values"),
        sample_ior: grid.sample_ior()[ior],
        error: at(s, a),
        thicknesses: Vec::new(),
    };
    MapLayer { g: grid.g()[g], errors, best, similar: None }
}
