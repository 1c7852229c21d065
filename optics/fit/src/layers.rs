//! Puts the layers of a distance map together: one for each anisotropy, with the curve of media similar to the best.

use optics_model::Grid;
use optics_model::fit::{DistanceMap, MapLayer};

use crate::dictionary::axes::Admissible;
use crate::similarity::similar;

/// The map of a channel at one refractive index, given a layer for each admissible anisotropy.
pub(crate) fn of_layers(
    grid: &Grid,
    channel: &str,
    admissible: &Admissible,
    ior: usize,
    mut layers: Vec<MapLayer>,
) -> DistanceMap {
    let by_error =
        |(_, a): &(usize, &MapLayer), (_, b): &(usize, &MapLayer)| a.best.error.total_cmp(&b.best.error);
    let best_layer = layers.iter().enumerate().min_by(by_error).map_or(0, |(i, _)| i);
    let best = layers[best_layer].best.medium;
    for layer in &mut layers {
        layer.similar = similar(&best, layer.g).ok();
    }
    DistanceMap {
        channel: channel.to_owned(),
        sigma_t_per_mm: grid.sigma_t_per_mm()[admissible.sigma_t.clone()].to_vec(),
        albedo: grid.albedo()[admissible.albedo.clone()].to_vec(),
        sample_ior: grid.sample_ior()[ior],
        best_layer,
        layers,
    }
}
