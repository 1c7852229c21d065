//! Compares plans of a measurement, slabs and numbers of photographs, by their Cramér–Rao bounds.
//!
//! At a guess of the medium the profiles of a set of slabs are predicted from the dictionary, with their derivatives by
//! the medium and by all uncertain quantities of a set-up. The inverse of the Fisher information, F = Σ over pixels of
//! (∂y/∂θ)(∂y/∂θ)ᵀ/σ² + the priors' 1/σ², is the least covariance of an unbiased estimate. So no fit of these photographs
//! is more accurate, and one by the likelihood is hardly less accurate.

use optics_model::fit::{
    Design, DesignQuestion, DesignSettings, FitOptions, FitSettings, HalfWidths, Improvement, Limitation,
    PixelRow, SlabSet,
};
use optics_model::{Grid, Invalid, Medium};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
use crate::dictionary::axes::find_channel;
use crate::dictionary::axes::held;
use crate::likelihood::{DesignPlan, KnownErrors, Precision};
use crate::surrogate::place::{axes, check_medium, check_thickness, own_pixels, sample_ior};
use crate::surrogate::{G, Surrogate, coordinates};

#[cfg(test)]
mod tests;

/// Maximum number of sets of slabs that are combined from the dictionary's thicknesses.
const MOST_SETS: usize = 25;

/// Limitations that may be reduced, apart from those of the scene.
const LIMITATIONS: [Limitation; 9] = [
    Limitation::Noise,
    Limitation::Thickness,
    Limitation::Origin,
    Limitation::Blur,
    Limitation::Gain,
    Limitation::Zero,
    Limitation::Slope,
    Limitation::Wedge,
    Limitation::Scale,
];

/// Compares sets of slabs by how well they would determine a medium.
pub fn design(dictionary: &FitDictionary, question: &DesignQuestion) -> Result<Design, Invalid> {
    let (settings, grid) = (question.settings(), dictionary.grid());
    let channels = grid.scene().channels();
    let channel = settings.channel.as_ref().map_or(Ok(0), |name| find_channel(grid, name))?;
    let ior = sample_ior(grid, settings.sample_ior)?;
    check_guess(grid, &settings.medium)?;
    let pixels = pixels(grid, settings.pixels)?;
    let surrogate = Surrogate::new(dictionary, channel, ior);
    let slab_sets = slab_sets(&surrogate, settings)?;
    let planner = Planner { surrogate: &surrogate, settings, pixels };
    let tried: Vec<(Vec<f64>, u32)> =
        slab_sets.iter().flat_map(|slabs| settings.shots.iter().map(|n| (slabs.clone(), *n))).collect();
    let mut sets: Vec<SlabSet> =
        tried.into_par_iter().map(|(slabs, shots)| planner.set(slabs, shots)).collect();
    mark_best(&mut sets, &settings.medium);
    Ok(Design {
        channel: channels[channel].name().to_owned(),
        medium: settings.medium,
        sample_ior: grid.sample_ior()[ior],
        pixels,
        sets,
    })
}

/// Checks that the guess lies between media of the dictionary, from which its derivatives are taken.
fn check_guess(grid: &Grid, medium: &Medium) -> Result<(), Invalid> {
    check_medium(grid, medium)?;
    let axes = axes(grid, medium);
    if axes.iter().all(|(.., axis)| axis.len() == 1) {
        let given = format!("{} of one medium", axes[0].0);
        return Err(Invalid::new("dictionary", given, "where there is one medium only nothing is measured"));
    }
    Ok(())
}

/// The given pixels if the dictionary covers them; its own pixels if none are given.
fn pixels(grid: &Grid, given: Option<PixelRow>) -> Result<PixelRow, Invalid> {
    let half = 0.5 * grid.scene().sensor().width_mm();
    let Some(row) = given else { return own_pixels(grid) };
    if row.from_mm() < -half - 1e-9 || row.to_mm() > half + 1e-9 {
        let given = format!("{} to {}", row.from_mm(), row.to_mm());
        return Err(Invalid::new("pixels", given, format!("the dictionary covers {} to {half} mm", -half)));
    }
    Ok(row)
}

/// The requested sets; without any, those of up to three of the dictionary's thicknesses, or of fewer if these are too
/// many.
fn slab_sets(surrogate: &Surrogate, settings: &DesignSettings) -> Result<Vec<Vec<f64>>, Invalid> {
    let asked = !settings.slab_sets.is_empty();
    let check = |slab: f64| check_thickness(surrogate, &settings.medium, slab);
    if asked {
        for (i, slabs) in settings.slab_sets.iter().enumerate() {
            for (k, slab) in slabs.iter().enumerate() {
                check(*slab).map_err(|e| match e.field() {
                    "thickness_mm" => e.renamed(format!("slab_sets[{i}][{k}]")),
                    _ => e,
                })?;
            }
        }
        return Ok(settings.slab_sets.clone());
    }
    let axis = surrogate.grid().thickness_mm();
    let up_to = |most: usize| -> Vec<Vec<f64>> { (1..=most).flat_map(|n| choices(axis, n)).collect() };
    let few = [3, 2, 1].map(up_to).into_iter().find(|sets| sets.len() <= MOST_SETS);
    Ok(few.unwrap_or_else(|| up_to(1)))
}

/// All combinations of `count` of these values.
fn choices(values: &[f64], count: usize) -> Vec<Vec<f64>> {
    if count == 0 {
        return vec![Vec::new()];
    }
    let starting_at = |i: usize| {
        choices(&values[i + 1..], count - 1).into_iter().map(move |rest| [vec![values[i]], rest].concat())
    };
    (0..values.len()).flat_map(starting_at).collect()
}

struct Planner<'a> {
    surrogate: &'a Surrogate<'a>,
    settings: &'a DesignSettings,
    pixels: PixelRow,
}

/// A limitation that may be reduced, with the index of its prior if it is one of the scene.
#[derive(Debug, Clone, Copy)]
struct Better {
    limitation: Limitation,
    prior: usize,
}

impl Planner<'_> {
    fn limitations(&self) -> Vec<Better> {
        let grid = self.surrogate.grid();
        let priors = if grid.responses().is_some() { grid.scene().priors().len() } else { 0 };
        let of_scene = (0..priors).map(|prior| Better { limitation: Limitation::Scene, prior });
        LIMITATIONS.map(|limitation| Better { limitation, prior: 0 }).into_iter().chain(of_scene).collect()
    }

    fn set(&self, slabs_mm: Vec<f64>, shots: u32) -> SlabSet {
        let known = self.known(shots);
        let free_g = self.surrogate.grid().g().len() > 1;
        let held = self.plan(true).precision(&slabs_mm, &known);
        let free = free_g.then(|| self.plan(false).precision(&slabs_mm, &known)).flatten();
        let improvement = |better| {
            let improvement = self.improvement(&slabs_mm, &known, better)?;
            let estimated = |precision: &Option<Precision>| self.estimated(precision.as_ref()?, better);
            Some(Improvement {
                estimated: estimated(&held),
                estimated_g_free: estimated(&free),
                ..improvement
            })
        };
        let widths = |of: &Option<Precision>| of.as_ref().map_or(HalfWidths::UNKNOWN, |p| p.medium);
        SlabSet {
            shots,
            g_held: widths(&held),
            g_free: free_g.then(|| widths(&free)),
            best_of_its_effort: false,
            best: false,
            improvements: self.limitations().into_iter().filter_map(improvement).collect(),
            slabs_mm,
        }
    }

    /// Standard errors with this number of photographs: the noise is that of their mean, errors of the set-up are common
    /// to all of them.
    fn known(&self, shots: u32) -> KnownErrors {
        let (settings, set_up) = (self.settings, *self.settings.set_up.settings());
        let photographs = f64::from(shots).sqrt();
        KnownErrors {
            noise: settings.noise / photographs,
            // The model describes measured values times μ.
            noise_floor: settings.noise_floor * set_up.mu / photographs,
            set_up,
            mu_free: settings.mu_free,
            scene: vec![1.0; self.surrogate.grid().scene().priors().len()],
        }
    }

    /// Standard error of a quantity of the scene after the measurement.
    fn estimated(&self, precision: &Precision, better: Better) -> Option<f64> {
        let prior = self.surrogate.grid().scene().priors().get(better.prior)?;
        (better.limitation == Limitation::Scene).then(|| prior.std_error() * precision.scene[better.prior])
    }

    fn plan(&self, hold_g: bool) -> DesignPlan<'_> {
        let mut held = held(self.surrogate.grid(), &FitOptions::default()).map(|h| h.is_some());
        held[G] |= hold_g;
        let medium = coordinates(&self.settings.medium);
        DesignPlan { surrogate: self.surrogate, medium, held, pixels: self.pixels }
    }

    /// None if the limited quantity is known exactly already.
    fn improvement(&self, slabs_mm: &[f64], known: &KnownErrors, better: Better) -> Option<Improvement> {
        let scene = self.surrogate.grid().scene();
        let prior = scene.priors().get(better.prior).filter(|_| better.limitation == Limitation::Scene);
        let std_error =
            prior.map_or_else(|| self.std_error(better.limitation), |prior| Some(prior.std_error()));
        let is_noise = better.limitation == Limitation::Noise;
        if std_error == Some(0.0) && !is_noise {
            return None;
        }
        let with = |factor: f64| self.plan(true).half_widths(slabs_mm, &times(known, better, factor));
        Some(Improvement {
            limitation: better.limitation,
            quantity: prior.map(|prior| scene.name_of(prior)),
            unit: prior.map(|prior| prior.kind().unit().to_owned()),
            std_error,
            halved: std_error.map(|_| with(0.5)),
            removed: (!is_noise).then(|| with(0.0)),
            estimated: None,
            estimated_g_free: None,
        })
    }

    fn std_error(&self, limitation: Limitation) -> Option<f64> {
        match limitation {
            Limitation::Noise => Some(self.settings.noise),
            Limitation::Scale if self.settings.mu_free => None,
            _ => std_error(&mut self.settings.set_up.settings().clone(), limitation).copied(),
        }
    }
}

/// The setting that is the standard error of a limitation; none for noise and the scene.
fn std_error(set_up: &mut FitSettings, limitation: Limitation) -> Option<&mut f64> {
    Some(match limitation {
        Limitation::Thickness => &mut set_up.thickness_std_error_mm,
        Limitation::Origin => &mut set_up.origin_std_error_mm,
        Limitation::Blur => &mut set_up.blur_std_error_mm,
        Limitation::Gain => &mut set_up.gain_std_error,
        Limitation::Zero => &mut set_up.offset_std_error,
        Limitation::Slope => &mut set_up.slope_std_error,
        Limitation::Wedge => &mut set_up.wedge_std_error,
        Limitation::Scale => &mut set_up.mu_std_error,
        Limitation::Noise | Limitation::Scene => return None,
    })
}

/// The errors with one of them multiplied by a factor. A factor of 0 also makes a free scale exact.
fn times(known: &KnownErrors, better: Better, factor: f64) -> KnownErrors {
    let mut known = known.clone();
    match better.limitation {
        Limitation::Noise => {
            known.noise *= factor;
            known.noise_floor *= factor;
        }
        Limitation::Scene => known.scene[better.prior] *= factor,
        Limitation::Scale if factor == 0.0 => (known.mu_free, known.set_up.mu_std_error) = (false, 0.0),
        of_set_up => std_error(&mut known.set_up, of_set_up).into_iter().for_each(|error| *error *= factor),
    }
    known
}

/// Size of the region that remains: the product of the half-widths of σ_t (relative) and α, without those that are 0.
fn region(set: &SlabSet, medium: &Medium) -> f64 {
    let widths = [set.g_held.of_sigma_t(medium), set.g_held.albedo];
    widths.into_iter().filter(|w| *w > 0.0).product()
}

fn mark_best(sets: &mut [SlabSet], medium: &Medium) {
    let regions: Vec<f64> = sets.iter().map(|set| region(set, medium)).collect();
    let efforts: Vec<u64> = sets.iter().map(SlabSet::photographs).collect();
    let least = |effort: u64| -> Option<usize> {
        let within = (0..regions.len()).filter(|i| efforts[*i] <= effort && regions[*i].is_finite());
        within.min_by(|a, b| regions[*a].total_cmp(&regions[*b]).then(efforts[*a].cmp(&efforts[*b])))
    };
    let best = least(u64::MAX);
    for (i, set) in sets.iter_mut().enumerate() {
        set.best = best == Some(i);
        set.best_of_its_effort = least(efforts[i]) == Some(i);
    }
}
