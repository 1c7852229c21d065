//! Reads the charts of ChromaPrint3D (github.com/Neroued/ChromaPrint3D, `data/dbs`): JSON with the layers of each stack,
//! and its colour in CIELAB under D65.

use anyhow::{Context, Result, bail};
use optics_chart::linear_srgb;
use serde::Deserialize;

use super::patch::{NamedPatch, check_colour};
use crate::slabs::NamedSlab;

#[derive(Debug, Deserialize)]
struct ColorDb {
    base_channel_idx: usize,
    base_layers: u32,
    layer_height_mm: f64,
    layer_order: String,
    palette: Vec<PaletteEntry>,
    entries: Vec<StackEntry>,
}

#[derive(Debug, Deserialize)]
struct PaletteEntry {
    color: String,
}

#[derive(Debug, Deserialize)]
struct StackEntry {
    lab: [f64; 3],
    recipe: Vec<usize>,
}

/// Whether a file is such a chart.
pub(super) fn is(text: &str) -> bool {
    text.starts_with('{') && text.contains("\"palette\"") && text.contains("\"recipe\"")
}

/// The patches, in linear sRGB.
pub(super) fn patches(text: &str) -> Result<Vec<NamedPatch>> {
    let chart: ColorDb = serde_json::from_str(text)?;
    // Heights are stored with the digits of a shorter number.
    let layer_mm = (chart.layer_height_mm * 1e6).round() / 1e6;
    let name = |material: usize| {
        let own = chart.palette.get(material)?;
        let alike = chart.palette.iter().filter(|other| other.color == own.color).count();
        let color = own.color.to_lowercase();
        Some(if alike > 1 { format!("{color} {}", material + 1) } else { color })
    };
    let slab = |material: usize, thickness_mm: f64| -> Result<NamedSlab> {
        let name = name(material).with_context(|| format!("filament {material} is unknown"))?;
        optics_model::medium::check_thickness(thickness_mm)?;
        Ok(NamedSlab { shares: vec![(name, 1.0)], thickness_mm })
    };
    let patch = |(number, entry): (usize, &StackEntry)| -> Result<NamedPatch> {
        let mut slabs = entry.recipe.iter().map(|m| slab(*m, layer_mm)).collect::<Result<Vec<_>>>()?;
        match chart.layer_order.as_str() {
            "Top2Bottom" => {}
            "Bottom2Top" => slabs.reverse(),
            other => bail!("layer_order = {other:?} is not valid: allowed are Top2Bottom and Bottom2Top"),
        }
        if chart.base_layers > 0 {
            let base_mm = (layer_mm * f64::from(chart.base_layers) * 1e6).round() / 1e6;
            slabs.push(slab(chart.base_channel_idx, base_mm)?);
        }
        check_colour(entry.lab)?;
        Ok(NamedPatch::new(format!("{}", number + 1), slabs, linear_srgb(entry.lab).to_vec()))
    };
    let named = |entry: (usize, &StackEntry)| patch(entry).with_context(|| format!("entry {}", entry.0 + 1));
    chart.entries.iter().enumerate().map(named).collect()
}
