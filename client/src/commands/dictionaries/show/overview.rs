//! Draws Fig. 5: an overview of a part of a dictionary.

use std::collections::HashMap;

use anyhow::Result;
use optics_model::{Grid, Record};

use farm_figures::{OverviewFigure, Picture, overview_figure};

/// Indices of the shown values on the axes of σ_t, albedo and g.
#[derive(Debug)]
pub(super) struct OverviewAxes {
    sigma_t: Vec<usize>,
    albedo: Vec<usize>,
    g: Vec<usize>,
}

/// At most six σ_t, six albedos and four g, evenly over the axes: 288 records of the paper's grid, as in its figure.
pub(super) fn chosen_axes(grid: &Grid) -> OverviewAxes {
    let spread = |n: usize, most: usize| -> Vec<usize> {
        let count = n.min(most);
        (0..count).map(|i| if count == 1 { 0 } else { i * (n - 1) / (count - 1) }).collect()
    };
    OverviewAxes {
        sigma_t: spread(grid.sigma_t_per_mm().len(), 6),
        albedo: spread(grid.albedo().len(), 6),
        g: spread(grid.g().len(), 4),
    }
}

impl OverviewAxes {
    /// The records shown, in the order of the figure: thickness, σ_t, albedo, g.
    pub(super) fn records(&self, grid: &Grid) -> Vec<u32> {
        let mut records = Vec::new();
        for t in 0..grid.thickness_mm().len() {
            for &s in &self.sigma_t {
                for &a in &self.albedo {
                    records.extend(self.g.iter().map(|&g| grid.record_at(0, s, g, t, a) as u32));
                }
            }
        }
        records
    }
}

/// Draws the first channel of the given records.
pub(super) fn picture(name: &str, grid: &Grid, axes: &OverviewAxes, records: &[Record]) -> Result<Picture> {
    let by_index: HashMap<usize, &Record> = records.iter().map(|r| (r.index, r)).collect();
    let profile = |index: &u32| {
        by_index.get(&(*index as usize)).map_or_else(Vec::new, |r| {
            r.profiles[0].radiance_factor.values().iter().copied().map(f64::from).collect()
        })
    };
    let pick = |axis: &[f64], chosen: &[usize]| chosen.iter().map(|&i| axis[i]).collect();
    let sensor = grid.scene().sensor();
    overview_figure(&OverviewFigure {
        title: format!("Dictionary {name}"),
        channel: grid.scene().channels()[0].name().to_owned(),
        thickness_mm: grid.thickness_mm().to_vec(),
        sigma_t_per_mm: pick(grid.sigma_t_per_mm(), &axes.sigma_t),
        albedo: pick(grid.albedo(), &axes.albedo),
        g: pick(grid.g(), &axes.g),
        x_mm: (0..sensor.pixels()).map(|i| sensor.centre_mm(i)).collect(),
        profiles: axes.records(grid).iter().map(profile).collect(),
    })
}
