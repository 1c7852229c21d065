//! A set of materials that were photographed in the same set-up: what they share is found with all of them at once.
//!
//! A mesh over factors on μ and the dictionary's anisotropies finds the valley, in the basis of `start`; from its lowest
//! point one descent of all unknowns of all channels goes down to the bottom. Intervals of a channel follow its own
//! likelihood, with what the others say of the shared unknowns as a quadratic beside it (a Schur complement of their
//! information). Where channels pull on what they share by more than their noise, as they do if something in the
//! photographs is not in the model, the others' word counts less, by their χ² a degree of freedom (a Birge ratio).

use nalgebra::{Cholesky, DMatrix, DVector};
use optics_model::fit::{ChannelFit, Common, FitOptions, GError, Interval, MaterialFit};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

use super::answer::Found;
use super::channel::{leave_out_specks_by_neighbours, place_edges, settle};
use super::chi2::exceedance;
use super::outside;
use super::problem::{Assembly, ChannelData, Sharing, assemble};
use super::profile::{Profile, interval};
use super::start::{Scan, Start};
use super::system::{Coupling, Normal, Quantity, State, System, inverse_over_free, submatrix};
use super::{LN_ONE_MINUS_G, LN_SCALE, SHARED};
use crate::common::scales;
use crate::dictionary::FitDictionary;
use crate::measure::{MeasurePlan, Measured, mu_interval};
use crate::surrogate::{Surrogate, g};

/// Cost by which the first descent may miss its minimum.
const ROUGHLY: f64 = 1.0;
/// Cost by which the last descent of a channel may miss its minimum.
const WELL: f64 = 0.003;
/// Most channels that the mesh is computed for.
const MESH_CHANNELS: usize = 16;
/// Probability of the channels' pulls below which they are said to disagree.
const DISAGREE: f64 = 0.01;

/// All channels of a set, ready to be searched.
struct Set<'a> {
    dictionary: &'a FitDictionary,
    materials: &'a [Measurement],
    channels: Vec<ChannelData<'a>>,
    surrogates: Vec<Vec<Surrogate<'a>>>,
    scans: Vec<Scan<'a>>,
}

/// The lowest place with one anisotropy and one scale, of every channel.
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
    let base = options.settings().mu;
    let common_g = plan.common_g && !set.scans[0].region.held[2];
    let scales = scales(plan.search_mu.as_ref(), base);
    let limits = (scales[0], scales[scales.len() - 1]);
    let sharing = Sharing { g: common_g, scale: plan.search_mu.map(|_| limits) };
    let cells = set.mesh(&scales, common_g);
    let lowest = cells.iter().min_by(|a, b| a.cost.total_cmp(&b.cost)).expect("a mesh has a point");
    let joint = set.joint(lowest, sharing);
    if let Some(range) = &plan.search_mu {
        let (min, max, _) = range.parts();
        // The standard deviation of a factor of which nothing but the range is known, in the logarithm.
        let unknown = (max / min).ln() / 12.0_f64.sqrt();
        let deviation = joint.deviation(joint.assembly.system.slots[0][LN_SCALE]);
        if max > min && !(deviation > 0.0 && deviation <= unknown) {
            let mu = 1.0_f64.clamp(min, max);
            let options = options.with_mu(mu, (unknown * mu).min(1.0))?;
            let mut measured =
                measure(dictionary, materials, &options, &MeasurePlan { search_mu: None, ..*plan })?;
            measured.common.mu_interval = Interval { low: min, high: max, open_low: true, open_high: true };
            measured.common.mu_chosen = true;
            return Ok(measured);
        }
    }
    Ok(set.answer(&joint, plan, base, &cells))
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
        let deviation = settings.mu_std_error / settings.mu;
        let scans = channels
            .par_iter()
            .zip(&surrogates)
            .map(|(data, surrogates)| data.scan(surrogates, deviation))
            .collect::<Result<_, _>>()?;
        Ok(Self { dictionary, materials, channels, surrogates, scans })
    }

    /// Every scale, and with a common anisotropy every one of the dictionary's.
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
            let factor = (-scale).exp();
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

    /// Every channel at its own lowest place.
    fn cell(&self, scale: f64) -> Cell {
        let start = |(scan, surrogates): (&Scan, &Vec<Surrogate>)| {
            scan.starts(surrogates, (-scale).exp())
                .first()
                .copied()
                .expect("a dictionary has a lowest medium")
        };
        let starts: Vec<Start> = self.scans.par_iter().zip(&self.surrogates).map(start).collect();
        let cost = starts.iter().map(|s| s.cost).sum();
        Cell { scale, g: None, starts, cost }
    }

    /// The minimum of all channels together that lies below a cell of the mesh.
    fn joint(&self, cell: &Cell, sharing: Sharing) -> Joint<'_> {
        let starts: Vec<Start> = match cell.g {
            // The mesh may have left out some channels.
            Some(common) if cell.starts.len() < self.channels.len() => {
                let factor = (-cell.scale).exp();
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
        let (mut assembly, mut state) = assemble(&self.channels, &surrogates, &media, cell.scale, sharing);
        leave_out_specks_by_neighbours(&mut assembly.system);
        place_edges(&assembly.system, &mut state);
        let state = assembly.system.descend(state, None, ROUGHLY);
        let state = settle(&mut assembly.system, state);
        let linear = assembly.system.linear(&state.x, &state.own);
        let normal = assembly.system.normal(&state.x, &state.own, &linear);
        // Some materials may leave their own media open.
        let covariance = inverse_over_free(&assembly.system.unknowns, &normal.information, 1e-9);
        let iors = starts.iter().map(|s| s.ior).collect();
        let mut joint = Joint { assembly, state, normal, covariance, iors, disagreement: 1.0 };
        joint.disagreement = joint.disagreement(sharing);
        joint
    }

    fn answer(&self, joint: &Joint, plan: &MeasurePlan, base: f64, cells: &[Cell]) -> Measured {
        let system = &joint.assembly.system;
        let [.., g_slot, scale_slot, _, _] = system.slots[0];
        let found_g = cells[0].g.map(|_| g(joint.state.x[g_slot]));
        let g_interval = found_g.map(|_| joint.g_interval(g_slot));
        let grid = self.dictionary.grid();
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
                let refined = Some(found.refined());
                let scan = &self.scans[i];
                let factor = (-state.x[own.slots[0][LN_SCALE]]).exp();
                let nearest = scan.best(&scan.costs(factor), data.options.settings().top as usize);
                found.fit(refined, &nearest, outside(data, scan))
            })
            .collect();
        let mut fits = fits.into_iter();
        let materials = self.materials.iter().map(|m| MaterialFit {
            material: m.material().to_owned(),
            channels: fits.by_ref().take(m.channels().len()).collect(),
        });
        let mu = base * joint.state.x[scale_slot].exp();
        let mu_std_error = mu * joint.deviation(scale_slot);
        let by_g = by_g(cells, joint.state.x[scale_slot], base);
        Measured {
            scale: None,
            common: Common {
                mu,
                mu_std_error,
                mu_interval: mu_interval(mu, mu_std_error, plan.search_mu.as_ref()),
                mu_chosen: plan.search_mu.is_some(),
                g: found_g.or_else(|| self.only_g()),
                g_interval,
                by_g,
            },
            materials: materials.collect(),
        }
    }

    /// The anisotropy, if there is no choice.
    fn only_g(&self) -> Option<f64> {
        crate::refine::held(self.dictionary.grid(), &self.channels[0].options)[2]
    }
}

/// The least cost with each anisotropy, at the scale of the mesh next to the one found, and at its own best.
fn by_g(cells: &[Cell], scale: f64, base: f64) -> Vec<GError> {
    let mut nodes: Vec<f64> = cells.iter().filter_map(|c| c.g).collect();
    nodes.sort_by(f64::total_cmp);
    nodes.dedup();
    let error = |g: f64| {
        let with = || cells.iter().filter(move |c| c.g == Some(g));
        let near = with().min_by(|a, b| (a.scale - scale).abs().total_cmp(&(b.scale - scale).abs()));
        let best = with().min_by(|a, b| a.cost.total_cmp(&b.cost));
        let (near, best) = (near?, best?);
        Some(GError { g, error: near.cost, best_mu: base * best.scale.exp(), best_mu_error: best.cost })
    };
    nodes.into_iter().filter_map(error).collect()
}

/// All channels at their common minimum.
struct Joint<'a> {
    assembly: Assembly<'a>,
    state: State,
    normal: Normal,
    covariance: Option<DMatrix<f64>>,
    iors: Vec<usize>,
    /// χ² of the channels' pulls on what they share, a degree of freedom, but at least 1.
    disagreement: f64,
}

impl<'a> Joint<'a> {
    fn deviation(&self, slot: usize) -> f64 {
        let variance = self.covariance.as_ref().map_or(f64::INFINITY, |c| c[(slot, slot)]);
        (variance * self.disagreement).max(0.0).sqrt()
    }

    fn g_interval(&self, slot: usize) -> Interval {
        let limits = self.assembly.system.unknowns[slot].limits;
        let Some(covariance) = &self.covariance else {
            return Interval { low: g(limits.1), high: g(limits.0), open_low: true, open_high: true };
        };
        let profile = Profile {
            system: &self.assembly.system,
            optimum: &self.state,
            normal: &self.normal,
            covariance,
            inflation: self.disagreement,
        };
        interval(profile.ends(Quantity::Unknown(slot), limits), g, true)
    }

    /// What a channel's own profiles say, over all unknowns.
    fn contribution(&self, channel: usize) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.state.x.len();
        let (mut information, mut downhill) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for term in self.assembly.terms[channel].clone() {
            let (slots, reduced) = (&self.assembly.system.slots[term], &self.normal.reduced[term]);
            for i in 0..SHARED {
                downhill[slots[i]] += reduced.downhill[i];
                for k in 0..SHARED {
                    information[(slots[i], slots[k])] += reduced.information[(i, k)];
                }
            }
        }
        (information, downhill)
    }

    fn used_by(&self, channel: usize) -> Vec<usize> {
        let terms = self.assembly.terms[channel].clone();
        let mut used: Vec<usize> = terms.flat_map(|t| self.assembly.system.slots[t]).collect();
        used.sort_unstable();
        used.dedup();
        used
    }

    /// A channel as a system of its own, with what the others say beside it.
    fn channel(&self, channel: usize) -> (System<'a>, State) {
        let whole = &self.assembly.system;
        let used = self.used_by(channel);
        let (own, own_downhill) = self.contribution(channel);
        let (mut rest, mut downhill) = (&self.normal.information - own, &self.normal.downhill - own_downhill);
        for slot in &used {
            if let Some((mean, sd)) = whole.unknowns[*slot].prior.filter(|_| !whole.unknowns[*slot].held) {
                rest[(*slot, *slot)] -= 1.0 / (sd * sd);
                downhill[*slot] += (self.state.x[*slot] - mean) / (sd * sd);
            }
        }
        let others: Vec<usize> = whole.free().into_iter().filter(|i| !used.contains(i)).collect();
        let (information, downhill) = eliminate(&rest, &downhill, &used, &others);
        let share = 1.0 / self.disagreement;
        let centre = DVector::from_iterator(used.len(), used.iter().map(|i| self.state.x[*i]));
        let coupling =
            Coupling { centre: centre.clone(), information: information * share, downhill: downhill * share };
        let place = |slot: &usize| used.iter().position(|u| u == slot).unwrap_or(0);
        let terms = self.assembly.terms[channel].clone();
        let mut system = System {
            terms: whole.terms[terms.clone()].to_vec(),
            surrogates: whole.surrogates[terms.clone()].to_vec(),
            slots: whole.slots[terms.clone()].iter().map(|slots| slots.each_ref().map(place)).collect(),
            unknowns: used.iter().map(|i| whole.unknowns[*i]).collect(),
            coupling: Some(coupling),
        };
        // For its own medium, noise that others share counts once.
        let mut own = self.state.own[terms].to_vec();
        system.terms.iter_mut().zip(&mut own).for_each(|(term, own)| term.count_alike(own, 1.0));
        let state = system.descend(State { x: centre, own, cost: f64::INFINITY }, None, WELL);
        (system, state)
    }

    fn disagreement(&self, sharing: Sharing) -> f64 {
        let slots = self.assembly.system.slots[0];
        let unknowns = &self.assembly.system.unknowns;
        let shared: Vec<usize> = [(LN_ONE_MINUS_G, sharing.g), (LN_SCALE, sharing.scale.is_some())]
            .into_iter()
            .filter(|(i, shared)| *shared && !unknowns[slots[*i]].held)
            .map(|(i, _)| slots[i])
            .collect();
        let channels = self.assembly.terms.len();
        let freedom = (shared.len() * channels.saturating_sub(1)) as f64;
        if freedom == 0.0 {
            return 1.0;
        }
        let pull = |channel: usize| -> f64 {
            let (mut information, downhill) = self.contribution(channel);
            let others: Vec<usize> = self
                .used_by(channel)
                .into_iter()
                .filter(|i| !unknowns[*i].held && !shared.contains(i))
                .collect();
            for i in &others {
                information[(*i, *i)] += unknowns[*i].prior.map_or(0.0, |(_, sd)| 1.0 / (sd * sd));
            }
            let (information, pull) = eliminate(&information, &downhill, &shared, &others);
            let ridge = DMatrix::identity(shared.len(), shared.len()) * 1e-9;
            Cholesky::new(information + ridge).map_or(0.0, |c| pull.dot(&c.solve(&pull)))
        };
        let chi2: f64 = (0..channels).map(pull).sum();
        if exceedance(chi2, freedom) < DISAGREE { (chi2 / freedom).max(1.0) } else { 1.0 }
    }
}

/// A quadratic over some unknowns that is left when others follow.
fn eliminate(
    information: &DMatrix<f64>,
    downhill: &DVector<f64>,
    kept: &[usize],
    others: &[usize],
) -> (DMatrix<f64>, DVector<f64>) {
    let inner = submatrix(information, kept);
    let part =
        |indices: &[usize]| DVector::from_iterator(indices.len(), indices.iter().map(|i| downhill[*i]));
    let mixed = DMatrix::from_fn(others.len(), kept.len(), |i, k| information[(others[i], kept[k])]);
    let ridge = DMatrix::identity(others.len(), others.len()) * 1e-9;
    match Cholesky::new(submatrix(information, others) + ridge) {
        Some(root) if !others.is_empty() => (
            inner - mixed.transpose() * root.solve(&mixed),
            part(kept) - mixed.transpose() * root.solve(&part(others)),
        ),
        _ => (inner, part(kept)),
    }
}
