//! Measures a set of materials that were photographed in the same set-up: estimates the shared quantities from all of
//! them at once.
//!
//! A mesh over factors on μ and the dictionary's anisotropies finds the valley, in the basis of `problem/start`;
//! from its lowest point one descent over all unknowns of all channels finds the minimum. The mesh has the scene as it is
//! stated: where its phase function is uncertain, descents begin in all ranges of anisotropies, and the lowest minimum
//! counts. Intervals of a channel follow its own likelihood, with the others' likelihood as a quadratic in
//! the shared unknowns added (a Schur complement of their information). Where the pulls of channels on the shared
//! unknowns scatter by more than their noise, as they do if the photographs contain effects that the model lacks,
//! the others count less, by their χ² per degree of freedom (a Birge ratio).

mod minimum;
mod response;
mod shared;
#[cfg(test)]
mod tests;

use optics_model::fit::{
    ChannelFit, Common, FitOptions, GError, Interval, MaterialFit, MeasurePlan, Measured, MuRange, Refined,
};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
use crate::dictionary::axes::held;
use crate::likelihood::answer::Found;
use crate::likelihood::answer::nuisances::second_lobe;
use crate::likelihood::point::{LN_ONE_MINUS_G, LN_SCALE};
use crate::likelihood::problem::ChannelData;
use crate::likelihood::problem::assembly::{Assembly, Sharing, assemble};
use crate::likelihood::problem::start::{Scan, Start};
use crate::likelihood::system::COARSE;
use crate::likelihood::system::State;
use crate::likelihood::system::unknowns::inverse_over_free;
use crate::surrogate::{Surrogate, g};
use minimum::{Joint, SPREAD, common_slots};
use response::Response;
use shared::shared_errors;

/// Greatest distance of two scale factors of the mesh, in the logarithm.
const MESH_STEP: f64 = 0.05;
/// Maximum number of channels for which the mesh is computed.
const MESH_CHANNELS: usize = 16;

/// All channels of a set, ready to be searched.
struct Set<'a> {
    dictionary: &'a FitDictionary,
    materials: &'a [Measurement],
    channels: Vec<ChannelData<'a>>,
    surrogates: Vec<Vec<Surrogate<'a>>>,
    scans: Vec<Scan<'a>>,
    /// The factor μ that others are relative to.
    base: f64,
}

/// Range of anisotropies within which cells lie in one valley.
const FAR_G: f64 = 0.2;
/// Cost over that of the best approach, above which another one leads to no lower minimum, and most that are followed.
const NEAR_BEST: f64 = 1.3;
const SETTLED: usize = 3;

/// All channels near a common minimum.
struct Approached<'a> {
    assembly: Assembly<'a>,
    state: State,
    iors: Vec<usize>,
}

/// The lowest start of every channel at one scale and, if it is common, one anisotropy.
struct Cell {
    scale: f64,
    g: Option<f64>,
    starts: Vec<Start>,
    cost: f64,
}

pub(in crate::likelihood) fn all_channels<'a>(
    dictionary: &'a FitDictionary,
    materials: &'a [Measurement],
    options: &FitOptions,
) -> Result<Vec<ChannelData<'a>>, Invalid> {
    let mut channels = Vec::new();
    for (i, material) in materials.iter().enumerate() {
        for name in material.channels() {
            let data = ChannelData::new(dictionary, material, i, name, options);
            channels.push(data.map_err(|e| e.within(format_args!("materials[{i}]")))?);
        }
    }
    Ok(channels)
}

pub(crate) fn measure(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    options: &FitOptions,
    plan: &MeasurePlan,
) -> Result<Measured, Invalid> {
    let set = Set::new(dictionary, materials, options)?;
    let (cells, joint) = set.search(plan);
    if let Some(range) = &plan.search_mu {
        let (min, max, _) = range.parts();
        // Standard deviation of the logarithm of a factor that is only known to lie in the range.
        let unknown = libm::log(max / min) / 12.0_f64.sqrt();
        let deviation = joint.deviation(joint.assembly.system.slots[0][LN_SCALE]);
        if max > min && !(deviation > 0.0 && deviation <= unknown) {
            // The data do not determine the factor: the range is its prior.
            let mu = 1.0_f64.clamp(min, max);
            let options = options.with_mu(mu, (unknown * mu).min(1.0))?;
            let plan = MeasurePlan { search_mu: None, ..*plan };
            let set = Set::new(dictionary, materials, &options)?;
            let (cells, joint) = set.search(&plan);
            let mut measured = set.answer(&joint, &plan, &cells);
            measured.common.mu_interval = Interval { low: min, high: max, open_low: true, open_high: true };
            measured.common.mu_chosen = true;
            return Ok(measured);
        }
    }
    Ok(set.answer(&joint, plan, &cells))
}

impl<'a> Set<'a> {
    fn new(
        dictionary: &'a FitDictionary,
        materials: &'a [Measurement],
        options: &FitOptions,
    ) -> Result<Self, Invalid> {
        let channels = all_channels(dictionary, materials, options)?;
        let surrogates: Vec<Vec<Surrogate>> = channels.iter().map(ChannelData::surrogates).collect();
        let settings = options.settings();
        let deviation = settings.ln_mu_std_error();
        let scans = channels
            .par_iter()
            .zip(&surrogates)
            .map(|(data, surrogates)| data.scan(surrogates, deviation))
            .collect::<Result<_, _>>()?;
        Ok(Self { dictionary, materials, channels, surrogates, scans, base: settings.mu })
    }

    /// The mesh of a plan, and the common minimum below its lowest cell.
    fn search(&self, plan: &MeasurePlan) -> (Vec<Cell>, Joint<'_>) {
        let common_g = plan.common_g && !self.scans[0].region.held[2];
        let scales = scales(plan.search_mu.as_ref(), self.base);
        let limits = (scales[0], scales[scales.len() - 1]);
        let sharing = Sharing {
            g: common_g,
            g_spread: plan.g_spread.unwrap_or(SPREAD),
            g_change: plan.g_change,
            scale: plan.search_mu.map(|_| limits),
        };
        let cells = self.mesh(&scales, common_g);
        let mut joint = self.lowest_minimum(&self.beginnings(&cells), sharing);
        if let Some(spread) = joint.g_spread().filter(|_| plan.g_spread.is_none()) {
            let Joint { mut assembly, state, iors, .. } = joint;
            assembly.set_g_spread(spread);
            joint = Self::settle(Approached { assembly, state, iors }, sharing);
        }
        (cells, joint)
    }

    /// The lowest of the minima below these cells. Descents that end far above the best lead to none of them.
    fn lowest_minimum(&self, beginnings: &[&Cell], sharing: Sharing) -> Joint<'_> {
        let mut approached: Vec<Approached> =
            beginnings.par_iter().map(|cell| self.approach(cell, sharing)).collect();
        approached.sort_by(|a, b| a.state.cost.total_cmp(&b.state.cost));
        let bound = NEAR_BEST * approached.first().expect("a mesh has a point").state.cost;
        approached.retain(|near| near.state.cost <= bound);
        approached.truncate(SETTLED);
        let minima = approached.into_iter().map(|near| Self::settle(near, sharing));
        minima.min_by(|a, b| a.state.cost.total_cmp(&b.state.cost)).expect("the best is kept")
    }

    /// The lowest cell; if the phase function is uncertain, the lowest in every range of anisotropies. The mesh has the
    /// scene as it is stated: with errors of the set-up its costs say little.
    fn beginnings<'c>(&self, cells: &'c [Cell]) -> Vec<&'c Cell> {
        let lowest = |among: &dyn Fn(&Cell) -> bool| {
            cells.iter().filter(|cell| among(cell)).min_by(|a, b| a.cost.total_cmp(&b.cost))
        };
        let range = |cell: &Cell| cell.g.map(|g| (g / FAR_G).round() as i64);
        let Some(first) = lowest(&|_| true) else { return Vec::new() };
        if range(first).is_none() || !self.channels[0].has_free_phase() {
            return vec![first];
        }
        let mut ranges: Vec<i64> = cells.iter().filter_map(range).collect();
        ranges.sort_unstable();
        ranges.dedup();
        ranges.into_iter().filter_map(|one| lowest(&|cell| range(cell) == Some(one))).collect()
    }

    /// Cells at every scale and, with a common anisotropy, at every one of the dictionary's.
    fn mesh(&self, scales: &[f64], common_g: bool) -> Vec<Cell> {
        if scales.len() == 1 && !common_g {
            return vec![self.cell(scales[0])];
        }
        let stride = self.channels.len().div_ceil(MESH_CHANNELS);
        let mut cells = Vec::new();
        for scale in scales {
            if !common_g {
                cells.push(self.cell(*scale));
                continue;
            }
            let factor = libm::exp(-scale);
            let by_channel: Vec<Vec<Start>> = self
                .scans
                .par_iter()
                .zip(&self.surrogates)
                .enumerate()
                .map(|(i, (scan, surrogates))| {
                    if i % stride != 0 {
                        return Vec::new();
                    }
                    scan.by_anisotropy(surrogates, &scan.costs(factor), factor)
                })
                .collect();
            let nodes = self.scans[0].region.admissible.g.clone();
            for (k, node) in nodes.enumerate() {
                let starts: Vec<Start> = by_channel.iter().filter_map(|s| s.get(k).copied()).collect();
                let cost = starts.iter().map(|s| s.cost).sum();
                cells.push(Cell { scale: *scale, g: Some(self.dictionary.grid().g()[node]), starts, cost });
            }
        }
        cells
    }

    /// Every channel at its own lowest start.
    fn cell(&self, scale: f64) -> Cell {
        let start = |(scan, surrogates): (&Scan, &Vec<Surrogate>)| {
            scan.starts(surrogates, libm::exp(-scale))
                .first()
                .copied()
                .expect("a dictionary has a lowest medium")
        };
        let starts: Vec<Start> = self.scans.par_iter().zip(&self.surrogates).map(start).collect();
        let cost = starts.iter().map(|s| s.cost).sum();
        Cell { scale, g: None, starts, cost }
    }

    /// All channels near a common minimum, by a descent from a cell of the mesh.
    fn approach(&self, cell: &Cell, sharing: Sharing) -> Approached<'_> {
        let starts: Vec<Start> = match cell.g {
            // The mesh may have left out some channels.
            Some(common) if cell.starts.len() < self.channels.len() => {
                let factor = libm::exp(-cell.scale);
                let start = |(scan, surrogates): (&Scan, &Vec<Surrogate>)| {
                    let all = scan.by_anisotropy(surrogates, &scan.costs(factor), factor);
                    let off = |s: &Start| (g(s.medium[2]) - common).abs();
                    all.into_iter()
                        .min_by(|a, b| off(a).total_cmp(&off(b)))
                        .expect("every anisotropy has a medium")
                };
                self.scans.par_iter().zip(&self.surrogates).map(start).collect()
            }
            _ => cell.starts.clone(),
        };
        let surrogates: Vec<&Surrogate> =
            self.surrogates.iter().zip(&starts).map(|(s, start)| &s[start.ior]).collect();
        let media: Vec<[f64; 3]> = starts.iter().map(|s| s.medium).collect();
        let (mut assembly, state) = assemble(&self.channels, &surrogates, &media, cell.scale, sharing);
        let state = assembly.system.approach(state, COARSE);
        Approached { assembly, state, iors: starts.iter().map(|s| s.ior).collect() }
    }

    /// All channels at their common minimum.
    fn settle(near: Approached<'_>, sharing: Sharing) -> Joint<'_> {
        let Approached { mut assembly, state, iors } = near;
        let state = assembly.system.settle(state);
        let (_, normal) = assembly.system.look(&state);
        // Some materials may not determine their own media.
        let covariance = inverse_over_free(&assembly.system.unknowns, &normal.information, 1e-9);
        let common = common_slots(&assembly.system, sharing);
        Joint { assembly, state, normal, covariance, iors, disagreement: 1.0, common }.with_disagreement()
    }

    fn answer(&self, joint: &Joint, plan: &MeasurePlan, cells: &[Cell]) -> Measured {
        let system = &joint.assembly.system;
        let (g_slot, scale_slot) = (system.slots[0][LN_ONE_MINUS_G], system.slots[0][LN_SCALE]);
        let common_g = joint.is_common(g_slot);
        let g_interval = common_g.then(|| joint.g_interval(g_slot));
        let is_curve = joint.assembly.is_g_curve;
        let g_mean = joint.assembly.g_of_materials.as_ref().filter(|_| !is_curve).map(|(mean, _)| *mean);
        let grid = self.dictionary.grid();
        let response = Response::find(joint, plan.search_mu.is_some());
        let fits: Vec<ChannelFit> = (0..self.channels.len())
            .into_par_iter()
            .map(|i| {
                let data = &self.channels[i];
                let (own, state) = joint.channel(i);
                let found = Found {
                    data,
                    system: &own,
                    state: &state,
                    sample_ior: grid.sample_ior()[joint.iors[i]],
                    common_g: g_interval,
                };
                let mut refined = found.refined();
                // The estimate of all channels together: what a material shares is the same for its channels.
                let first = joint.assembly.terms[i].start;
                refined.second_lobe = second_lobe(grid.scene(), system, &joint.state, first);
                let absorbed = response.as_ref().map(|r| r.suspicion(i));
                refined.suspicion = absorbed.or(refined.suspicion);
                let scan = &self.scans[i];
                let factor = libm::exp(-state.x[own.slots[0][LN_SCALE]]);
                let nearest = scan.best(&scan.costs(factor), data.options.settings().top as usize);
                found.fit(Some(refined), &nearest, data.outside(scan))
            })
            .collect();
        let refined: Vec<&Refined> = fits.iter().filter_map(|fit| fit.refined.as_ref()).collect();
        let shared_errors = shared_errors(joint, grid.scene().priors(), &refined);
        let best_g = |fit: &ChannelFit| fit.refined.as_ref().map(|r| r.best.medium.g());
        let found_g = fits.first().filter(|_| common_g).and_then(best_g);
        let mut fits = fits.into_iter();
        let materials = self.materials.iter().map(|m| MaterialFit {
            material: m.material().to_owned(),
            channels: fits.by_ref().take(m.channels().len()).collect(),
        });
        let mu = self.base * libm::exp(joint.state.x[scale_slot]);
        let mu_std_error = mu * joint.deviation(scale_slot);
        let by_g = by_g(cells, joint.state.x[scale_slot], self.base);
        Measured {
            scale: None,
            common: Common {
                mu,
                mu_std_error,
                mu_interval: plan.mu_interval(mu, mu_std_error),
                mu_chosen: plan.search_mu.is_some(),
                g: found_g.or_else(|| g_mean.map(|slot| g(joint.state.x[slot]))).or_else(|| self.only_g()),
                g_spread: joint.assembly.g_spread(),
                g_equal_probability: joint.g_equal_probability(),
                g_change: is_curve.then_some(plan.g_change),
                g_interval: g_interval.or_else(|| g_mean.map(|slot| joint.g_interval(slot))),
                by_g,
            },
            materials: materials.collect(),
            shared_errors,
        }
    }

    /// The anisotropy, if it is held.
    fn only_g(&self) -> Option<f64> {
        held(self.dictionary.grid(), &self.channels[0].options)[2]
    }
}

/// The least cost with each anisotropy, at the scale of the mesh that is nearest to the estimate, and at the anisotropy's
/// own best scale.
fn by_g(cells: &[Cell], scale: f64, base: f64) -> Vec<GError> {
    let mut nodes: Vec<f64> = cells.iter().filter_map(|c| c.g).collect();
    nodes.sort_by(f64::total_cmp);
    nodes.dedup();
    let error = |g: f64| {
        let with = || cells.iter().filter(move |c| c.g == Some(g));
        let near = with().min_by(|a, b| (a.scale - scale).abs().total_cmp(&(b.scale - scale).abs()));
        let best = with().min_by(|a, b| a.cost.total_cmp(&b.cost));
        let (near, best) = (near?, best?);
        Some(GError { g, error: near.cost, best_mu: base * libm::exp(best.scale), best_mu_error: best.cost })
    };
    nodes.into_iter().filter_map(error).collect()
}

/// Logarithms of factors on μ, evenly over the range.
pub(in crate::likelihood) fn scales(range: Option<&MuRange>, base: f64) -> Vec<f64> {
    let Some(range) = range else { return vec![0.0] };
    let (min, max, _) = range.parts();
    let (low, high) = (libm::log(min / base), libm::log(max / base));
    let steps = ((high - low) / MESH_STEP).ceil().max(1.0);
    (0..=steps as usize).map(|i| low + (high - low) * i as f64 / steps).collect()
}
