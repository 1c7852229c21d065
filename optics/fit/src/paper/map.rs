//! Computes maps of the distance over all media, Fig. 9 of the paper.

use optics_model::fit::{DistanceMap, FitOptions, MapLayer};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
use crate::layers::of_layers;
use crate::paper::question::{GridPlace, Question, questions};

/// The error of Eq. 1 over every admissible medium, by channel.
pub(crate) fn distance_map(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<Vec<DistanceMap>, Invalid> {
    Ok(questions(dictionary, measurement, options)?.iter().map(map).collect())
}

fn map(question: &Question) -> DistanceMap {
    let grid = question.dictionary.grid();
    // A map covers one refractive index, that of the best record.
    let ior = best_ior(question);
    let layers = question.admissible.g.clone().map(|g| layer(question, ior, g)).collect();
    of_layers(grid, question.name, &question.admissible, ior, layers)
}

fn best_ior(question: &Question) -> usize {
    let iors = question.dictionary.grid().sample_ior();
    let best = crate::paper::search::best(question, 1);
    iors.iter().position(|v| *v == best[0].sample_ior).unwrap_or(0)
}

fn layer(question: &Question, ior: usize, g: usize) -> MapLayer {
    let admissible = &question.admissible;
    let albedos = admissible.albedo.len();
    let place = |n: usize| GridPlace {
        ior,
        sigma_t: admissible.sigma_t.start + n / albedos,
        g,
        albedo: admissible.albedo.start + n % albedos,
    };
    let errors: Vec<f64> =
        (0..admissible.sigma_t.len() * albedos).into_par_iter().map(|n| question.error(place(n))).collect();
    let best = errors.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(n, _)| n);
    MapLayer {
        g: question.dictionary.grid().g()[g],
        best: question.candidate(place(best)),
        errors: errors.chunks(albedos).map(<[f64]>::to_vec).collect(),
        similar: None,
    }
}
