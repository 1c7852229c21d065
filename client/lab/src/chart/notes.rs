//! Notes on a chart: what its answer lacks, and what is probably wrong with it.

use anyhow::Result;
use farm_figures::numbers::significant;
use optics_chart::fit;

use super::data::ChartJson;
use super::file::ChartFile;
use super::judged::judged;
use super::patch::NamedPatch;
use super::problem::{NamedChart, upwards};
use crate::measurement_file::Note;

/// Fewest patches for each material.
const FEWEST_PATCHES: usize = 15;
/// Greatest range of a photograph's light.
const FIELD: f64 = 0.1;
/// Share of the variance of lightness that places explain, from which on the light cannot be separated from the stacks.
const SORTED: f64 = 0.5;
/// Median difference from which on stacks are tried upside down, and share of the difference that is better.
const POOR: [f64; 2] = [3.0, 0.15];
const BETTER: f64 = 0.7;

/// Remarks on what is wrong with a chart, or makes its answer worse than it could be.
pub(super) fn notes(
    file: &ChartFile,
    named: &NamedChart,
    data: &ChartJson,
    misfit: f64,
) -> Result<Vec<Note>> {
    let mut notes = Vec::new();
    let mut add = |code: &'static str, text: String| notes.push(Note::new(code, text));
    let (patches, materials) = (file.patches.len(), named.materials.len());
    if !data.descent.is_minimum() {
        add("NOT_CONVERGED", "the fit has not converged: neither media nor intervals hold".to_owned());
    }
    if let Some(held_out) = &data.held_out {
        let poor = POOR[usize::from(!file.is_colour)];
        if held_out.median > poor {
            let turned = fit(&NamedChart::new(file, upwards)?.chart);
            let other = turned.and_then(|fit| judged(&file.patches, &fit.held_out, file.is_colour));
            match other.filter(|other| other.median < BETTER * held_out.median) {
                Some(other) => add(
                    "UPSIDE_DOWN",
                    format!(
                        "the stacks are probably upside down: with their layers in the other order the median difference \
                         is {} instead of {}; a stack is written from the top",
                        significant(other.median, 2),
                        significant(held_out.median, 2)
                    ),
                ),
                None => add(
                    "POOR_PREDICTION",
                    format!(
                        "stacks that were held out differ by {} in the median: are the rows of stacks and colours in one \
                         order, and are the materials, layers and base those of the print?",
                        significant(held_out.median, 2)
                    ),
                ),
            }
        }
        if patches < FEWEST_PATCHES * materials {
            let wanted = FEWEST_PATCHES * materials;
            add("FEW_PATCHES", format!("{patches} patches of {materials} materials: print {wanted} or more"));
        }
    } else if misfit > 1.5 {
        add(
            "MISFIT",
            format!(
                "residuals are {} times as large as the errors of the values: intervals are widened by as much",
                significant(misfit, 2)
            ),
        );
    }
    let layers = layers_mm(file);
    // Slabs by themselves are no layers.
    if layers.len() == 1 && file.patches.iter().any(|patch| patch.slabs.len() > 2) {
        add(
            "ONE_LAYER_HEIGHT",
            format!(
                "all layers are of {} mm: predictions of other layers may differ twice as much; print thin and thick ones",
                layers[0]
            ),
        );
    }
    let lacking: Vec<&str> =
        named.materials.iter().filter(|name| !has_wedge(file, name)).map(String::as_str).collect();
    if !lacking.is_empty() {
        add(
            "NO_WEDGE",
            format!(
                "no stacks of one material alone in several thicknesses: {}; they contain the most information",
                lacking.join(", ")
            ),
        );
    }
    let open: Vec<String> = data
        .materials
        .iter()
        .flat_map(|m| m.channels.iter().map(move |c| (&m.material, c)))
        .filter(|(_, c)| c.refined.as_ref().is_some_and(|r| !r.resolved_at_g))
        .map(|(material, c)| format!("{material} {}", c.channel))
        .collect();
    if !open.is_empty() {
        add("UNRESOLVED", format!("not determined, as one layer is opaque or clear: {}", open.join(", ")));
    }
    if let Some(photo) = data.light.iter().find(|light| light.range > FIELD) {
        add(
            "UNEVEN_LIGHT",
            format!(
                "the light of photograph {} varies by {} %: photograph a white card as well and divide by it",
                photo.photo,
                significant(100.0 * photo.range, 2)
            ),
        );
    }
    if named.chart.light && sorted_share(named) > SORTED {
        add(
            "SORTED_PLACES",
            "patches are sorted by lightness: their light cannot be separated from their stacks; print them in random places"
                .to_owned(),
        );
    }
    Ok(notes)
}

/// Whether stacks of a material alone, on any base, have several thicknesses.
fn has_wedge(file: &ChartFile, name: &str) -> bool {
    let alone = |patch: &&NamedPatch| {
        let all = patch.slabs.len();
        let printed = if all > 1 { all - 1 } else { 1 };
        patch.slabs[..printed].iter().all(|slab| slab.shares[0].0 == name)
    };
    let total = |patch: &NamedPatch| {
        let own = patch.slabs.iter().take_while(|slab| slab.shares[0].0 == name);
        (own.map(|slab| slab.thickness_mm).sum::<f64>() * 1e4).round() as i64
    };
    let mut totals: Vec<i64> = file.patches.iter().filter(alone).map(total).collect();
    totals.sort_unstable();
    totals.dedup();
    totals.len() > 1
}

/// Share of the variance of the patches' second channel that a plane over the places explains.
fn sorted_share(named: &NamedChart) -> f64 {
    let points: Vec<([f64; 3], f64)> = named
        .chart
        .patches
        .iter()
        .filter_map(|p| p.place.map(|(_, [x, y])| ([1.0, x, y], libm::cbrt(p.values[p.values.len() / 2]))))
        .collect();
    let n = points.len();
    let design = nalgebra::DMatrix::from_fn(n, 3, |i, j| points[i].0[j]);
    let values = nalgebra::DVector::from_fn(n, |i, _| points[i].1);
    let mean = values.mean();
    let Some(root) = design.tr_mul(&design).cholesky() else { return 0.0 };
    let rest = &values - &design * root.solve(&design.tr_mul(&values));
    1.0 - rest.norm_squared() / values.map(|v| (v - mean).powi(2)).sum().max(1e-12)
}

/// Heights of layers on bases, each once: slabs of several layers are multiples of them.
pub(super) fn layers_mm(file: &ChartFile) -> Vec<f64> {
    let printed = |patch: &NamedPatch| {
        let all = patch.slabs.len();
        patch
            .slabs
            .iter()
            .take(if all > 1 { all - 1 } else { 1 })
            .map(|slab| slab.thickness_mm)
            .collect::<Vec<_>>()
    };
    let mut all: Vec<f64> = file.patches.iter().flat_map(printed).collect();
    all.sort_by(f64::total_cmp);
    let mut heights: Vec<f64> = Vec::new();
    for thickness in all {
        if !heights.iter().any(|height| is_multiple(thickness, *height)) {
            heights.push(thickness);
        }
    }
    heights
}

/// Whether a slab can have been printed in layers of this height.
pub fn is_multiple(thickness_mm: f64, layer_mm: f64) -> bool {
    let layers = thickness_mm / layer_mm;
    layers > 0.5 && (layers - layers.round()).abs() < 1e-3 * layers
}
