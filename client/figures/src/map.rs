//! Draws Fig. 9: maps over co-albedo and extinction, one for each g: of the distance to a measurement, or of records'
//! noise.

mod nodes;
mod overlay;
mod plan;

use anyhow::ensure;
use optics_model::fit::DistanceMap;

use crate::drawing::canvas::Canvas;
use crate::drawing::head::{Head, MARGIN};
use crate::drawing::picture::Picture;
use overlay::keys;
use plan::MapPlan;

/// The meaning of a map's cells and marks.
#[derive(Debug)]
struct MapLabels {
    title: String,
    value: &'static str,
    /// Labels of the marks of the best node over all maps, and of the best in each map.
    mark_of_all: &'static str,
    mark: &'static str,
    /// Whether small values are bright.
    is_low_bright: bool,
}

pub fn map_figure(material: &str, map: &DistanceMap) -> anyhow::Result<Picture> {
    let words = MapLabels {
        title: format!("{material}, channel {}: distance to every medium", map.channel),
        value: "distance",
        mark_of_all: "best fit",
        mark: "best fit for this g",
        is_low_bright: true,
    };
    figure(&words, map)
}

/// A map of the noise of a dictionary's records instead of distances; the marks show the noisiest record instead of the
/// best.
pub fn noise_figure(dictionary: &str, map: &DistanceMap) -> anyhow::Result<Picture> {
    let words = MapLabels {
        title: format!("Dictionary {dictionary}: noise of its records"),
        value: "relative standard error",
        mark_of_all: "noisiest",
        mark: "noisiest for this g",
        is_low_bright: false,
    };
    figure(&words, map)
}

fn figure(words: &MapLabels, map: &DistanceMap) -> anyhow::Result<Picture> {
    let cells = map.sigma_t_per_mm.len() * map.albedo.len();
    for layer in &map.layers {
        let n: usize = layer.errors.iter().map(Vec::len).sum();
        ensure!(n == cells, "map for g = {}: {n} distances for {cells} cells", layer.g);
    }
    let plan = MapPlan::new(map, words.is_low_bright)?;
    let keys = keys(words, map, &plan.frame(0, 0.0));
    let head = Head::new(&words.title, &keys, plan.width - 2.0 * MARGIN);
    let top = head.height().ceil();
    let mut canvas = Canvas::new(plan.width, top + plan.height() + MARGIN);
    head.draw(&mut canvas);
    for i in 0..map.layers.len() {
        plan.draw_panel(&mut canvas, map, i, top)?;
    }
    plan.draw_bar(&mut canvas, words.value, top)?;
    Ok(canvas.finish())
}

#[cfg(test)]
mod tests {
    use base64::Engine as _;
    use optics_model::Medium;
    use optics_model::fit::{Candidate, MapLayer};
    use tiny_skia::Pixmap;

    use super::plan::FINENESS;
    use super::*;
    use crate::checks::{assert_shows, texts};
    use crate::drawing::rgb::Rgb;
    use crate::testing;

    fn figure(gs: usize) -> DistanceMap {
        let sigma_t_per_mm = vec![1.0, 2.0, 4.0, 10.0, 30.0];
        let albedo = vec![0.05, 0.5, 0.9, 0.99, 0.999, 0.99999];
        let distance = |s: f64, a: f64| 0.01 + libm::log(s / 4.0).abs() + 5.0 * (a - 0.99_f64).abs();
        let row = |s: &f64| albedo.iter().map(|a| distance(*s, *a)).collect();
        let layer = |i: usize| MapLayer {
            g: 0.1 * i as f64,
            errors: sigma_t_per_mm.iter().map(row).collect(),
            best: best(4.0, 0.99),
            similar: Some(best(if i == 1 { 80.0 } else { 5.0 }, 0.995).medium),
        };
        DistanceMap {
            channel: "R".into(),
            sample_ior: 1.53,
            best_layer: 0,
            layers: (0..gs).map(layer).collect(),
            sigma_t_per_mm: sigma_t_per_mm.clone(),
            albedo: albedo.clone(),
        }
    }

    fn best(sigma_t_per_mm: f64, albedo: f64) -> Candidate {
        let medium = Medium::new(sigma_t_per_mm, albedo, 0.0).unwrap();
        Candidate { medium, ..testing::candidate(sigma_t_per_mm) }
    }

    fn draw(map: &DistanceMap) -> anyhow::Result<Picture> {
        map_figure("Vero White", map)
    }

    fn images(picture: &Picture) -> Vec<Pixmap> {
        let svg = picture.svg();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let images = document.descendants().filter_map(|node| node.attribute("href"));
        let decode = |href: &str| {
            let data = href.strip_prefix("data:image/png;base64,").unwrap();
            let png = base64::engine::general_purpose::STANDARD.decode(data).unwrap();
            Pixmap::decode_png(&png).unwrap()
        };
        images.map(decode).collect()
    }

    /// One map or many are well laid out.
    #[test]
    fn maps_are_well_laid_out() {
        for gs in [1, 2, 3, 4, 5, 11] {
            let picture = draw(&figure(gs)).unwrap();
            let title = "Vero White, channel R: distance to every medium";
            let labels = [title, "1 − α", "σt [1/mm]", "distance", "best fit", "similarity theory"];
            let texts = assert_shows(&picture, &labels);
            assert_eq!(texts.iter().filter(|text| text.starts_with("g = ")).count(), gs);
            let outside = texts.iter().any(|text| text == "similarity theory, outside the grid");
            assert_eq!(outside, gs > 1);
        }
    }

    /// A map of noise has its own labels.
    #[test]
    fn noise_map_has_its_own_labels() {
        let mut map = figure(4);
        map.layers.iter_mut().for_each(|layer| layer.similar = None);
        let picture = noise_figure("paper", &map).unwrap();
        let title = "Dictionary paper: noise of its records";
        let texts = assert_shows(&picture, &[title, "relative standard error", "noisiest for this g"]);
        assert!(
            !texts.iter().any(|text| text.contains("distance") || text.contains("similarity")),
            "{texts:?}"
        );
    }

    /// Each cell has the colour of its node's distance.
    #[test]
    fn map_cells_end_at_geometric_midpoints() {
        let figure = figure(1);
        let plan = MapPlan::new(&figure, true).unwrap();
        let frame = plan.frame(0, 0.0);
        let pixels = images(&draw(&figure).unwrap()).remove(0);
        let colour = |sigma_t: f64, co_albedo: f64| {
            let place = [frame.across(co_albedo) - frame.area.left, frame.up(sigma_t) - frame.area.top];
            let [x, y] = place.map(|length| (FINENESS * length) as u32);
            let pixel = pixels.pixel(x, y).unwrap();
            Rgb(pixel.red(), pixel.green(), pixel.blue())
        };
        assert_eq!(colour(4.0, 0.01), Rgb::viridis(1.0), "the smallest distance");
        assert_eq!(colour(30.0, 0.95), Rgb::viridis(0.0), "the largest distance");
        // The edges next to the node are at √(2 · 4) and √(4 · 10), at √(0.001 · 0.01) and √(0.01 · 0.1).
        for (sigma_t, co_albedo) in [(2.86, 0.01), (6.29, 0.01), (4.0, 0.0032), (4.0, 0.0314)] {
            assert_eq!(colour(sigma_t, co_albedo), colour(4.0, 0.01));
        }
        for (sigma_t, co_albedo) in [(2.80, 0.01), (6.37, 0.01), (4.0, 0.0031), (4.0, 0.0319)] {
            assert_ne!(colour(sigma_t, co_albedo), colour(4.0, 0.01));
        }
    }

    /// The PNG shows the maps, and is the same every time.
    #[test]
    fn png_shows_the_maps_reproducibly() {
        let figure = figure(2);
        let png = || draw(&figure).unwrap().png(None, 192.0).unwrap();
        let bytes = png();
        assert!(bytes == png());
        let drawn = Pixmap::decode_png(&bytes).unwrap();
        let map = &images(&draw(&figure).unwrap())[1];
        let first_cell = map.pixel(0, map.height() - 1).unwrap();
        let same = drawn.pixels().iter().filter(|pixel| **pixel == first_cell).count();
        assert!(same > 100, "{same} pixels have the colour of the first cell");
    }

    /// Missing distances are grey, and the legend names them.
    #[test]
    fn missing_distances_are_grey() {
        let mut figure = figure(2);
        figure.layers[1].errors.iter_mut().for_each(|row| row.fill(f64::NAN));
        let picture = draw(&figure).unwrap();
        assert!(images(&picture)[1].pixels().iter().all(|p| [p.red(), p.green(), p.blue()] == [0xdd; 3]));
        assert!(texts(&picture).iter().any(|text| text == "no record"));
    }

    /// Unusual grids are drawn, and wrong data are refused.
    #[test]
    fn odd_grids_are_drawn_wrong_data_refused() {
        let layer = MapLayer { g: -0.25, errors: vec![vec![0.0, 0.0]], best: best(3.0, 0.9), similar: None };
        let mut figure = DistanceMap {
            channel: String::new(),
            sigma_t_per_mm: vec![3.0],
            albedo: vec![1.0, 0.9],
            sample_ior: 1.53,
            best_layer: 0,
            layers: vec![layer],
        };
        let picture = draw(&figure).unwrap();
        assert_shows(&picture, &["α = 1 has no place", "g = −0.25"]);
        figure.layers[0].errors[0].pop();
        assert_eq!(draw(&figure).unwrap_err().to_string(), "map for g = -0.25: 1 distances for 2 cells");
        figure.layers[0].errors = vec![vec![f64::NAN; 2]];
        assert_eq!(draw(&figure).unwrap_err().to_string(), "no distances to draw");
        figure.albedo.pop();
        figure.layers[0].errors[0].pop();
        assert_eq!(draw(&figure).unwrap_err().to_string(), "albedos");
        figure.layers.clear();
        assert_eq!(draw(&figure).unwrap_err().to_string(), "no maps to draw");
    }
}
