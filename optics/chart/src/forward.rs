//! The radiance factors of all patches, and their slopes in the numbers of the media, of bases, and in the index.

use nalgebra::DVector;
use optics_layers::{OverBase, Print, PrintLayer, StackLevels, Stacks};
use optics_model::Medium;
use optics_model::phase::PhaseShape;
use rayon::prelude::*;

use crate::unknowns::{ChartUnknowns, coefficients};
use crate::{Chart, ChartView};

/// Step of a number of a medium, and of the index.
const STEP: f64 = 1e-3;
const INDEX_STEP: f64 = 0.01;
/// Extinctions in 1/mm to which media are limited.
const EXTINCTIONS: [f64; 2] = [1e-6, 1e4];

/// Radiance factors by patch and channel.
pub type PatchValues = Vec<Vec<f64>>;

/// The slopes of a radiance factor, each with the place of its number.
pub(crate) type PatchSlopes = Vec<(usize, f64)>;

/// Patches of one view, and its layers.
#[derive(Debug)]
pub struct PatchLook {
    /// Numbers of its patches.
    patches: Vec<usize>,
    stacks: Stacks,
    print: Print,
    /// With a greater index.
    other: Option<Print>,
    transmitted: bool,
}

/// Views of the patches that are asked for.
pub(crate) fn looks(chart: &Chart, patches: &[usize], is_coarse: bool) -> Vec<PatchLook> {
    let print = |view: &ChartView, ior: f64| {
        if is_coarse {
            Print::coarse(&view.scene, ior)
        } else {
            Print::new(&view.scene, ior, chart.narrowest_peak())
        }
    };
    let look = |(number, view): (usize, &ChartView)| {
        let patches: Vec<usize> =
            patches.iter().copied().filter(|patch| chart.patches[*patch].view == number).collect();
        let stacks = Stacks::new(patches.iter().map(|patch| &chart.patches[*patch].slabs[..]));
        let other = is_coarse && chart.ior[1] > 0.0 && !patches.is_empty();
        PatchLook {
            patches,
            stacks,
            print: print(view, chart.ior[0]),
            other: other.then(|| print(view, chart.ior[0] + INDEX_STEP)),
            transmitted: view.transmitted,
        }
    };
    chart.views.iter().enumerate().map(look).collect()
}

/// One channel of one view.
struct SeenChannel<'a> {
    chart: &'a Chart,
    unknowns: &'a ChartUnknowns,
    at: &'a DVector<f64>,
    channel: usize,
    look: &'a PatchLook,
}

impl SeenChannel<'_> {
    /// A slab, after a change of one number of the media.
    fn layer(&self, changed: Option<(usize, usize)>) -> impl Fn(usize, f64) -> PrintLayer + Sync {
        let layer = |material: usize| {
            let place = self.unknowns.medium(self.channel, material);
            let mut numbers = [self.at[place], self.at[place + 1]];
            if let Some((_, number)) = changed.filter(|(of, _)| *of == material) {
                numbers[number] += STEP;
            }
            // A thicker slab is one of a denser medium.
            let factor = libm::exp(self.at[self.unknowns.thickness()]);
            medium(coefficients(numbers).map(|v| factor * v), self.chart.g[material])
        };
        let media: Vec<Medium> = (0..self.chart.materials).map(layer).collect();
        move |material, thickness_mm| PrintLayer {
            medium: media[material],
            phase: PhaseShape::default(),
            thickness_mm,
        }
    }

    /// Change of a number of a medium by that of the logarithm of its coefficient.
    fn by_logarithm(&self, place: usize) -> f64 {
        // Places of σ_s(1 − g) are even.
        if place.is_multiple_of(2) { 1.0 } else { libm::tanh(self.at[place]) }
    }

    fn rho(&self, patch: usize) -> f64 {
        let base = self.chart.patches[patch].base;
        let place = self.unknowns.base(base, self.channel);
        place.map_or_else(|| self.chart.bases[base][self.channel].unwrap_or(0.0), |place| self.at[place])
    }

    fn values(&self, seen: &[OverBase]) -> Vec<f64> {
        self.look.patches.iter().zip(seen).map(|(patch, seen)| seen.at(self.rho(*patch))).collect()
    }

    /// Without a base each stack is computed by itself: few are measured so.
    fn transmittances(&self, print: &Print, changed: Option<(usize, usize)>) -> Vec<f64> {
        let layer = self.layer(changed);
        let one = |patch: &usize| {
            let slabs = &self.chart.patches[*patch].slabs;
            let slabs: Vec<PrintLayer> = slabs.iter().map(|(m, mm)| layer(*m, *mm)).collect();
            print.transmittance(&slabs)
        };
        self.look.patches.par_iter().map(one).collect()
    }

    fn all(&self, print: &Print) -> (Vec<f64>, Option<StackLevels>) {
        if self.look.transmitted {
            return (self.transmittances(print, None), None);
        }
        let levels = self.look.stacks.levels(print, self.layer(None));
        (self.values(&levels.seen), Some(levels))
    }

    /// Values of the patches, and their slopes.
    fn with_slopes(&self) -> (Vec<f64>, Vec<PatchSlopes>) {
        let PatchLook { stacks, print, patches, .. } = self.look;
        let (values, levels) = self.all(print);
        let mut slopes: Vec<PatchSlopes> = vec![Vec::new(); patches.len()];
        let numbers = (0..self.chart.materials).flat_map(|material| [(material, 0), (material, 1)]);
        let moved = |changed: (usize, usize)| match &levels {
            Some(levels) => self.values(&stacks.changed(levels, changed.0, print, self.layer(Some(changed)))),
            None => self.transmittances(print, Some(changed)),
        };
        let numbers: Vec<(usize, usize)> = numbers.collect();
        let ends: Vec<Vec<f64>> = numbers.par_iter().map(|changed| moved(*changed)).collect();
        for ((material, number), ends) in numbers.iter().zip(&ends) {
            let place = self.unknowns.medium(self.channel, *material) + number;
            for ((slopes, end), value) in slopes.iter_mut().zip(ends).zip(&values) {
                if end != value {
                    slopes.push((place, (end - value) / STEP));
                }
            }
        }
        for slopes in &mut slopes {
            let by_thickness = slopes.iter().map(|(place, slope)| slope * self.by_logarithm(*place)).sum();
            slopes.push((self.unknowns.thickness(), by_thickness));
        }
        if let Some(levels) = &levels {
            for ((slopes, patch), seen) in slopes.iter_mut().zip(patches).zip(&levels.seen) {
                let place = self.unknowns.base(self.chart.patches[*patch].base, self.channel);
                slopes.extend(place.map(|place| (place, seen.slope(self.at[place]))));
            }
        }
        if let Some(other) = &self.look.other {
            // The number of the index counts its standard error.
            let by = self.chart.ior[1] / INDEX_STEP;
            for ((slopes, end), value) in slopes.iter_mut().zip(self.all(other).0).zip(&values) {
                slopes.push((self.unknowns.ior, by * (end - value)));
            }
        }
        (values, slopes)
    }
}

fn medium([reduced_scattering, absorption]: [f64; 2], g: f64) -> Medium {
    let scattering = reduced_scattering / (1.0 - g);
    let extinction = (scattering + absorption).clamp(EXTINCTIONS[0], EXTINCTIONS[1]);
    let albedo = scattering / (scattering + absorption);
    Medium::new(extinction, albedo, g).expect("within limits")
}

/// Radiance factors of the patches of these views by patch and channel; those of others are empty.
pub(crate) fn values(
    chart: &Chart,
    unknowns: &ChartUnknowns,
    looks: &[PatchLook],
    at: &DVector<f64>,
) -> PatchValues {
    each(chart, unknowns, looks, at, false).0
}

/// Radiance factors with their slopes.
pub(crate) fn with_slopes(
    chart: &Chart,
    unknowns: &ChartUnknowns,
    looks: &[PatchLook],
    at: &DVector<f64>,
) -> (PatchValues, Vec<Vec<PatchSlopes>>) {
    each(chart, unknowns, looks, at, true)
}

fn each(
    chart: &Chart,
    unknowns: &ChartUnknowns,
    looks: &[PatchLook],
    at: &DVector<f64>,
    has_slopes: bool,
) -> (PatchValues, Vec<Vec<PatchSlopes>>) {
    let (mut values, mut slopes) =
        (vec![Vec::new(); chart.patches.len()], vec![Vec::new(); chart.patches.len()]);
    for look in looks.iter().filter(|look| !look.patches.is_empty()) {
        let channels = (0..chart.channels).into_par_iter();
        let one = |channel: usize| {
            let seen = SeenChannel { chart, unknowns, at, channel, look };
            if has_slopes {
                return seen.with_slopes();
            }
            let (values, _) = seen.all(&look.print);
            let none = vec![Vec::new(); values.len()];
            (values, none)
        };
        let found: Vec<_> = channels.map(one).collect();
        for (of_channel, slopes_of_channel) in found {
            for ((patch, value), own) in look.patches.iter().zip(of_channel).zip(slopes_of_channel) {
                values[*patch].push(value);
                slopes[*patch].push(own);
            }
        }
    }
    (values, slopes)
}
