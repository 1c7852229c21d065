//! Selects the records of an export: indices along each axis, or along those of the responses.

use anyhow::{Context, Result};
use optics_model::{Grid, Invalid};

use super::ExportArgs;

/// Indices along each axis that the lists select.
#[derive(Debug)]
pub(super) struct ChosenAxes {
    /// All variants of the responses and their baseline; empty for records of the axes.
    variants: Vec<Option<usize>>,
    iors: Vec<usize>,
    sigma_ts: Vec<usize>,
    gs: Vec<usize>,
    thicknesses: Vec<usize>,
    albedos: Vec<usize>,
}

impl ChosenAxes {
    pub(super) fn new(grid: &Grid, args: &ExportArgs) -> Result<Self> {
        let all = |axis: &[f64]| (0..axis.len()).collect::<Vec<usize>>();
        let [mut sigma_ts, mut gs] = [grid.sigma_t_per_mm(), grid.g()].map(all);
        let mut variants = Vec::new();
        if args.responses {
            let responses =
                grid.responses().context("the dictionary has no responses: its scene is exact")?;
            variants = responses.traced().collect();
            (sigma_ts, gs) = (responses.sigma_t().to_vec(), responses.g().to_vec());
        }
        Ok(Self {
            variants,
            iors: places("sample_ior", grid.sample_ior(), all(grid.sample_ior()), &args.sample_ior)?,
            sigma_ts: places("sigma_t", grid.sigma_t_per_mm(), sigma_ts, &args.sigma_t)?,
            gs: places("g", grid.g(), gs, &args.g)?,
            thicknesses: places("thickness", grid.thickness_mm(), all(grid.thickness_mm()), &args.thickness)?,
            albedos: places("albedo", grid.albedo(), all(grid.albedo()), &args.albedo)?,
        })
    }

    fn axes(&self) -> [&[usize]; 5] {
        [&self.iors, &self.sigma_ts, &self.gs, &self.thicknesses, &self.albedos]
    }

    /// Variants of the responses and their baseline; empty for records of the axes.
    pub(super) fn variants(&self) -> &[Option<usize>] {
        &self.variants
    }

    /// Lengths of the axes, beginning with the variants if there are any.
    pub(super) fn shape(&self) -> Vec<usize> {
        let variants = Some(self.variants.len()).filter(|n| *n > 0);
        variants.into_iter().chain(self.axes().map(<[usize]>::len)).collect()
    }

    pub(super) fn values(&self, grid: &Grid) -> [Vec<f64>; 5] {
        let all = [grid.sample_ior(), grid.sigma_t_per_mm(), grid.g(), grid.thickness_mm(), grid.albedo()];
        let mut axes = self.axes().into_iter().zip(all);
        std::array::from_fn(|_| {
            let (places, values) = axes.next().unwrap_or_default();
            places.iter().map(|place| values[*place]).collect()
        })
    }

    /// Numbers of the records, the albedo running fastest.
    pub(super) fn records(&self, grid: &Grid) -> Vec<u32> {
        let mut nominal = Vec::new();
        for &ior in &self.iors {
            for &sigma_t in &self.sigma_ts {
                for &g in &self.gs {
                    for &t in &self.thicknesses {
                        nominal.extend(self.albedos.iter().map(|&a| grid.record_at(ior, sigma_t, g, t, a)));
                    }
                }
            }
        }
        if self.variants.is_empty() {
            return nominal.into_iter().map(|record| record as u32).collect();
        }
        let albedos = grid.albedo().len();
        let job_record = |variant: Option<usize>, record: usize| {
            let job =
                grid.response_job(variant, record / albedos).expect("nodes of the responses are chosen");
            (grid.first_record(job) + record % albedos) as u32
        };
        let job_record = &job_record;
        self.variants.iter().flat_map(|v| nominal.iter().map(move |record| job_record(*v, *record))).collect()
    }
}

/// Numbers of the records that the lists select; empty for all records of the axes.
pub(super) fn selection(grid: &Grid, args: &ExportArgs) -> Result<Vec<u32>> {
    let lists = [&args.sigma_t, &args.albedo, &args.g, &args.thickness, &args.sample_ior];
    if !args.responses && lists.iter().all(|l| l.is_empty()) {
        return Ok(Vec::new());
    }
    Ok(ChosenAxes::new(grid, args)?.records(grid))
}

/// The indices in `among` whose values are in `wanted`; all if `wanted` is empty.
fn places(field: &str, axis: &[f64], among: Vec<usize>, wanted: &[f64]) -> Result<Vec<usize>, Invalid> {
    if wanted.is_empty() {
        return Ok(among);
    }
    let place = |value: &f64| {
        among.iter().copied().find(|place| axis[*place] == *value).ok_or_else(|| {
            let list = among.iter().map(|place| axis[*place].to_string()).collect::<Vec<_>>().join(", ");
            Invalid::new(field, value, format!("the dictionary has {list}"))
        })
    };
    let mut places = wanted.iter().map(place).collect::<Result<Vec<_>, _>>()?;
    places.sort_unstable();
    places.dedup();
    Ok(places)
}
