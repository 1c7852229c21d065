use optics_model::grid::Axes;
use optics_model::scene::{Scene, Sensor};
use optics_model::{Grid, Medium, Walks};

use super::*;
use crate::FitDictionary;
use crate::testing::{dictionary_of, exact_record};

/// Reflectances of the base's halves, reduced by the losses on the way.
const BASE: [f64; 2] = [0.02, 0.8];

/// Light that leaves a slab vertically if it is scattered at most once, on its way down or up: the sum of that from the
/// sample and that from the base.
fn scattered_once(medium: &Medium, thickness_mm: f64, base: f64) -> f64 {
    let (s, a, g) = (medium.sigma_t_per_mm(), medium.albedo(), medium.g());
    let (cosine_in, cosine) = (0.887_f64, -0.887);
    let both_ways = 1.0 + 1.0 / cosine_in;
    let through = libm::exp(-s * thickness_mm * both_ways);
    let phase = (1.0 - g * g) / libm::pow(1.0 + g * g - 2.0 * g * cosine, 1.5);
    a * phase / (4.0 * both_ways) * (1.0 - through) + base * through
}

/// Exact records of dark media, at the paper's σ_t and g.
fn dark_media() -> FitDictionary {
    let paper = Grid::paper().axes().clone();
    let axes = Axes { albedo: vec![0.05, 0.1, 0.15, 0.2, 0.25, 0.3], ..paper };
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, 2, 0.0).unwrap());
    let channels = scene.channels().len();
    let grid = Grid::new(scene, axes, Walks::PAPER, 1, false).unwrap();
    let value = |x: f64, m: &Medium, mm: f64, _| scattered_once(m, mm, BASE[usize::from(x > 0.0)]);
    dictionary_of(&grid, |index| exact_record(&grid, index, channels, value))
}

/// Media between the nodes.
fn media_between() -> impl Iterator<Item = Medium> {
    [1.1, 1.6, 2.9, 3.6, 5.1, 7.3, 9.2, 13.3, 19.4, 26.0].into_iter().flat_map(|sigma_t| {
        [0.03, 0.13, 0.25, 0.4, 0.52, 0.65, 0.75].map(|g| Medium::new(sigma_t, 0.12, g).unwrap())
    })
}

/// The records are exact, so the error of a prediction is that of the model between them.
#[test]
fn dark_media_are_predicted_between_the_records() {
    let dictionary = dark_media();
    let surrogate = Surrogate::new(&dictionary, 0, 0);
    for medium in media_between() {
        for (thickness, thickness_mm) in [0.5, 1.0].into_iter().enumerate() {
            let found = surrogate.predict(thickness, coordinates(&medium)).values;
            for (found, base) in found.iter().zip(BASE) {
                let off = found / scattered_once(&medium, thickness_mm, base) - 1.0;
                assert!(off.abs() < 0.01, "{medium:?}, {thickness_mm} mm, base {base}: {off}");
            }
        }
    }
}

/// A sum of the values of one pixel over the media near by is its prediction, with its derivatives.
#[test]
fn sums_over_media_are_predictions() {
    const THICKNESS_MM: f64 = 0.5;
    let dictionary = dark_media();
    let (surrogate, grid) = (Surrogate::new(&dictionary, 0, 0), dictionary.grid());
    let mut of_media = Vec::new();
    for sigma_t in grid.sigma_t_per_mm() {
        for g in grid.g() {
            let value =
                |a: &f64| scattered_once(&Medium::new(*sigma_t, *a, *g).unwrap(), THICKNESS_MM, BASE[1]);
            of_media.extend(grid.albedo().iter().map(|a| value(a) as f32));
        }
    }
    for medium in media_between() {
        let x = coordinates(&medium);
        let [value, slopes @ ..] = surrogate.sums(&surrogate.neighbours(x), &of_media);
        let predicted = surrogate.predict(0, x);
        assert!((value / predicted.values[1] - 1.0).abs() < 1e-5, "{medium:?}: {value} {predicted:?}");
        for (slope, predicted) in slopes.iter().zip(&predicted.slopes) {
            let off = (slope - predicted[1]).abs();
            assert!(off < 1e-4 * (value + slope.abs()), "{medium:?}: {slope} {predicted:?}");
        }
    }
}
