//! Reports how noisy a dictionary's records are.
//!
//! The noise of a record is defined as in `[quality]`: the root mean square of a profile's standard errors over its
//! mean, in the channel where it is largest.

use anyhow::{Result, bail};
use farm_figures::{Picture, noise_figure};
use farm_proto::status::DictionaryStatus;
use optics_model::Grid;
use optics_model::fit::{Candidate, DistanceMap, MapLayer};
use optics_model::grid::Quality;
use serde::Serialize;

use crate::connection::Connection;
use crate::connection::records::RecordStream;
use crate::output::table;

/// Rows of the table by albedo.
const ROWS: usize = 9;

#[derive(Debug, Serialize)]
pub(super) struct Noise {
    /// Number of done records, which were read.
    records: usize,
    median: f64,
    worst: Worst,
    by_albedo: Vec<OfAlbedo>,
}

#[derive(Debug, Serialize)]
struct Worst {
    relative_std_error: f64,
    record: usize,
    sigma_t_per_mm: f64,
    albedo: f64,
    g: f64,
    thickness_mm: f64,
}

#[derive(Debug, Serialize)]
struct OfAlbedo {
    albedo: f64,
    median: f64,
    worst: f64,
}

/// Reads all done records of a dictionary: number and noise of each.
pub(super) async fn read(connection: &Connection, status: &DictionaryStatus) -> Result<Vec<(usize, f64)>> {
    let mut answers = RecordStream::ask(connection, status, Vec::new()).await?;
    let mut found = Vec::new();
    while let Some(record) = answers.next().await? {
        found.push((record.index, Quality::noise_of(std::slice::from_ref(&record))));
    }
    if found.is_empty() {
        bail!("none of the records whose noise is asked for is done yet");
    }
    Ok(found)
}

/// The noise over the grid: a cell shows the noisiest of its thicknesses and refractive indices.
pub(super) fn picture(name: &str, grid: &Grid, found: &[(usize, f64)]) -> Result<Picture> {
    noise_figure(name, &map(grid, found))
}

fn map(grid: &Grid, found: &[(usize, f64)]) -> DistanceMap {
    let mut of_record = vec![f64::NAN; grid.record_count()];
    for (record, noise) in found {
        of_record[*record] = *noise;
    }
    let (iors, thicknesses) = (grid.sample_ior().len(), grid.thickness_mm().len());
    let cell = |s: usize, g: usize, a: usize| {
        let slabs = (0..iors).flat_map(|i| (0..thicknesses).map(move |t| (i, t)));
        slabs.map(|(i, t)| of_record[grid.record_at(i, s, g, t, a)]).fold(f64::NAN, f64::max)
    };
    let layer = |g: usize| {
        let errors: Vec<Vec<f64>> = (0..grid.sigma_t_per_mm().len())
            .map(|s| (0..grid.albedo().len()).map(|a| cell(s, g, a)).collect())
            .collect();
        let cells = errors
            .iter()
            .enumerate()
            .flat_map(|(s, row)| row.iter().enumerate().map(move |(a, v)| (s, a, *v)));
        let there = cells.filter(|(_, _, noise)| noise.is_finite());
        let (s, a, error) = there.max_by(|x, y| x.2.total_cmp(&y.2)).unwrap_or((0, 0, f64::NAN));
        let (_, medium) = grid.parameters(grid.record_at(0, s, g, 0, a));
        let best = Candidate { medium, sample_ior: grid.sample_ior()[0], error, thicknesses: Vec::new() };
        MapLayer { g: grid.g()[g], errors, best, similar: None }
    };
    let layers: Vec<MapLayer> = (0..grid.g().len()).map(layer).collect();
    // A layer without a done record is the last choice.
    let noise =
        |layer: &MapLayer| if layer.best.error.is_finite() { layer.best.error } else { f64::NEG_INFINITY };
    let noisiest = layers.iter().enumerate().max_by(|a, b| noise(a.1).total_cmp(&noise(b.1)));
    DistanceMap {
        channel: String::new(),
        sigma_t_per_mm: grid.sigma_t_per_mm().to_vec(),
        albedo: grid.albedo().to_vec(),
        sample_ior: grid.sample_ior()[0],
        best_layer: noisiest.map_or(0, |(g, _)| g),
        layers,
    }
}

impl Noise {
    /// Summarises the noise of records, given with their numbers.
    pub(super) fn of(grid: &Grid, found: &[(usize, f64)]) -> Self {
        let albedos = grid.albedo();
        let by_albedo = |(i, albedo): (usize, &f64)| {
            let of_albedo = found.iter().filter(|(record, _)| record % albedos.len() == i);
            let (median, worst) = median_and_worst(of_albedo.map(|(_, noise)| *noise).collect())?;
            Some(OfAlbedo { albedo: *albedo, median, worst })
        };
        let by_albedo = albedos.iter().enumerate().filter_map(by_albedo).collect();
        let median = median_and_worst(found.iter().map(|(_, noise)| *noise).collect()).map_or(0.0, |m| m.0);
        let (record, relative_std_error) =
            found.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or_default();
        let (point, medium) = grid.parameters(record);
        let worst = Worst {
            relative_std_error,
            record,
            sigma_t_per_mm: medium.sigma_t_per_mm(),
            albedo: medium.albedo(),
            g: medium.g(),
            thickness_mm: point.thickness_mm(),
        };
        Self { records: found.len(), median, worst, by_albedo }
    }

    pub(super) fn text(&self) -> String {
        let w = &self.worst;
        let mut text = format!(
            "{:<15} median {}, worst {} (record {}: sigma_t {} /mm, albedo {}, g {}, {} mm)\n\n",
            "noise",
            percent(self.median),
            percent(w.relative_std_error),
            w.record,
            w.sigma_t_per_mm,
            w.albedo,
            w.g,
            w.thickness_mm
        );
        let count = self.by_albedo.len();
        let rows = count.min(ROWS);
        let chosen = (0..rows).map(|i| &self.by_albedo[i * (count - 1) / (rows - 1).max(1)]);
        let row = |of: &OfAlbedo| vec![of.albedo.to_string(), percent(of.median), percent(of.worst)];
        text += &table(">albedo | >median noise | >worst", chosen.map(row));
        text
    }
}

fn median_and_worst(mut noise: Vec<f64>) -> Option<(f64, f64)> {
    noise.sort_by(f64::total_cmp);
    Some((noise.get(noise.len() / 2).copied()?, *noise.last()?))
}

fn percent(share: f64) -> String {
    format!("{:.2} %", 100.0 * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cell has the noise of its noisiest slab.
    #[test]
    fn cell_has_its_noisiest_slab() {
        let grid = Grid::paper();
        let [thin, thick] = [0, 1].map(|t| grid.record_at(0, 3, 2, t, 40));
        let map = map(&grid, &[(thin, 0.01), (thick, 0.03), (grid.record_at(0, 5, 4, 0, 7), 0.02)]);
        assert_eq!((map.layers[2].errors[3][40], map.layers[4].errors[5][7]), (0.03, 0.02));
        let there = map.layers.iter().flat_map(|l| l.errors.iter().flatten()).filter(|v| v.is_finite());
        assert_eq!((there.count(), map.best_layer), (2, 2));
        let noisiest = map.layers[2].best.medium;
        assert_eq!(
            (noisiest.sigma_t_per_mm(), noisiest.albedo()),
            (grid.sigma_t_per_mm()[3], grid.albedo()[40])
        );
        picture("paper", &grid, &[(thin, 0.01)]).unwrap();
    }

    /// The medians and the worst noise are listed with their media.
    #[test]
    fn medians_and_worst_name_their_media() {
        let grid = Grid::paper();
        let albedos = grid.albedo().len();
        // Increases with the albedo's index, except for one record with the largest noise.
        let noise = |record: usize| if record == 17 { 0.5 } else { 0.001 * (record % albedos + 1) as f64 };
        let found: Vec<(usize, f64)> = (0..3 * albedos).map(|record| (record, noise(record))).collect();
        let noise = Noise::of(&grid, &found);
        assert_eq!((noise.records, noise.worst.record), (3 * albedos, 17));
        assert_eq!(noise.worst.albedo, grid.albedo()[17]);
        assert!((noise.median - 0.021).abs() < 1e-12, "{noise:?}");
        let row = &noise.by_albedo[17];
        assert!((row.median - 0.018).abs() < 1e-12 && row.worst == 0.5, "{row:?}");
        let text = noise.text();
        assert!(
            text.contains("median 2.10 %, worst 50.00 % (record 17: sigma_t 1 /mm, albedo 0.875"),
            "{text}"
        );
        assert_eq!(text.lines().count(), 2 + 4 + ROWS, "{text}");
    }
}
