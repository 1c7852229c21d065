//! A chart as its file has it: stacks of named materials, with the values of each patch.

use std::path::Path;

use anyhow::{Context, Result, bail};
use optics_chart::linear_srgb;

use super::patch::{CAMERA, NamedPatch};
use super::settings::ChartSettings;
use super::{color_db, table};
use crate::bounded_file;
use crate::measurement_file::cgats::{self, CgatsStacks};
use crate::measurement_file::{Note, plain};
use crate::slabs;

/// Largest file that is read, in bytes.
const LARGEST: u64 = 64 << 20;
const MOST_PATCHES: usize = 20_000;
const MOST_SLABS: usize = 500;
const MOST_MATERIALS: usize = 24;
const MOST_CHANNELS: usize = 80;

/// A chart.
#[derive(Debug, Clone)]
pub struct ChartFile {
    pub settings: ChartSettings,
    pub patches: Vec<NamedPatch>,
    pub channels: Vec<String>,
    /// Whether the values are linear sRGB of a camera.
    pub is_colour: bool,
    pub notes: Vec<Note>,
}

/// Whether a file is a chart of stacks: a table of them, or the settings of one.
pub fn is_chart(path: &Path) -> bool {
    let text = path.is_file().then(|| bounded_file::read(path, LARGEST).ok()).flatten();
    text.and_then(|bytes| plain(&bytes).ok()).is_some_and(|text| is_settings(&text) || is_patches(&text))
}

fn is_patches(text: &str) -> bool {
    color_db::is(text) || cgats::has_stacks(text) || table::is(text)
}

fn is_settings(text: &str) -> bool {
    // Tables of a million rows need not be parsed for it.
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines.next().is_some_and(|line| line.contains('=') || line.starts_with('['))
        && text.parse::<toml::Table>().is_ok_and(|table| table.contains_key("values"))
}

impl ChartFile {
    /// Reads a chart, or its settings and the chart that they name.
    pub fn read(path: &Path) -> Result<Self> {
        let text = text_of(path)?;
        if !is_settings(&text) {
            return Self::parsed(&text, ChartSettings::default())
                .with_context(|| format!("chart {}", path.display()));
        }
        let settings = ChartSettings::parsed(&text, path)?;
        let values = settings.place(&settings.values);
        let text = text_of(&values)?;
        Self::parsed(&text, settings).with_context(|| format!("chart {}", values.display()))
    }

    pub(super) fn parsed(text: &str, settings: ChartSettings) -> Result<Self> {
        let (patches, channels, is_colour) = match () {
            () if color_db::is(text) => (color_db::patches(text)?, CAMERA.map(str::to_owned).to_vec(), true),
            () if cgats::has_stacks(text) => cgats_patches(text)?,
            () if table::is(text) => table::patches(text)?,
            () => bail!(
                "it has no stacks: a table with the columns slabs, L, a and b, or slabs, channel and value is needed"
            ),
        };
        // The channels of a camera are its colours, whose matrix is unknown.
        let has_rgb = channels.len() == 3 && CAMERA.iter().all(|name| channels.iter().any(|c| c == name));
        let is_colour = is_colour || has_rgb && settings.matrix != "none";
        let mut file = Self { settings, patches, channels, is_colour, notes: Vec::new() };
        file.check()?;
        file.order_channels();
        file.leave_out_clipped()?;
        Ok(file)
    }

    fn check(&self) -> Result<()> {
        let slabs = self.patches.iter().map(|patch| patch.slabs.len()).max().unwrap_or(0);
        for (what, found, most) in [
            ("patches", self.patches.len(), MOST_PATCHES),
            ("slabs in a stack", slabs, MOST_SLABS),
            ("materials", self.materials().len(), MOST_MATERIALS),
            ("channels", self.channels.len(), MOST_CHANNELS),
        ] {
            if found == 0 || found > most {
                bail!("it has {found} {what}: allowed are 1 to {most}");
            }
        }
        let is_empty =
            |patch: &&NamedPatch| patch.slabs.is_empty() || !patch.values.iter().all(|v| v.is_finite());
        if let Some(patch) = self.patches.iter().find(is_empty) {
            bail!("patch {}: it needs slabs and a value", patch.name);
        }
        let mixed = self.patches.iter().find(|patch| patch.slabs.iter().any(|slab| slab.shares.len() > 1));
        if let Some(patch) = mixed {
            bail!("patch {}: slabs of a chart are of one material each", patch.name);
        }
        Ok(())
    }

    /// Cameras' channels in their usual order.
    fn order_channels(&mut self) {
        if !self.is_colour {
            return;
        }
        let order = CAMERA.map(|name| self.channels.iter().position(|c| c == name).unwrap_or(0));
        for patch in &mut self.patches {
            patch.values = order.iter().map(|i| patch.values[*i]).collect();
            patch.std_errors = order.iter().map(|i| patch.std_errors[*i]).collect();
        }
        self.channels = CAMERA.map(str::to_owned).to_vec();
    }

    /// Leaves out patches at the ends of a picture's values, which only bound what was there, and values without a
    /// logarithm.
    fn leave_out_clipped(&mut self) -> Result<()> {
        let is_colour = self.is_colour;
        let is_end = |v: &f64| {
            if is_colour { v.abs() < 1e-6 || (v - 1.0).abs() < 1e-6 } else { *v <= 0.0 }
        };
        let all = self.patches.len();
        let clipped: Vec<String> = self
            .patches
            .iter()
            .filter(|patch| patch.values.iter().any(is_end))
            .map(|patch| patch.name.clone())
            .collect();
        if clipped.is_empty() {
            return Ok(());
        }
        if clipped.len() == all {
            bail!("all {all} patches are at the ends of the values, so that they show nothing");
        }
        self.patches.retain(|patch| !patch.values.iter().any(is_end));
        let names = clipped.iter().take(5).cloned().collect::<Vec<_>>().join(", ");
        let more = if clipped.len() > 5 { ", …" } else { "" };
        self.notes.push(Note::new(
            "CLIPPED_PATCHES",
            format!(
                "{} of {all} patches are left out: a channel of them is {} ({names}{more})",
                clipped.len(),
                if is_colour { "exactly 0 or 1, so the photograph is clipped there" } else { "not above 0" }
            ),
        ));
        Ok(())
    }

    /// Names of the materials, in the order in which they occur.
    pub fn materials(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for (name, _) in self.patches.iter().flat_map(|p| &p.slabs).flat_map(|slab| &slab.shares) {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        names
    }
}

/// The patches of a CGATS table, with their channels; whether they are colours.
fn cgats_patches(text: &str) -> Result<(Vec<NamedPatch>, Vec<String>, bool)> {
    let CgatsStacks { channels, rows } = cgats::stacks(text)?;
    let is_colour = channels.is_empty();
    let patch = |(number, (words, values, std_error)): (usize, &(String, Vec<f64>, f64))| {
        let slabs = slabs::stack(words).with_context(|| format!("set {}", number + 1))?;
        let values =
            if is_colour { linear_srgb([values[0], values[1], values[2]]).to_vec() } else { values.clone() };
        let std_errors = vec![*std_error; values.len()];
        Ok(NamedPatch { std_errors, ..NamedPatch::new((number + 1).to_string(), slabs, values) })
    };
    let patches = rows.iter().enumerate().map(patch).collect::<Result<_>>()?;
    Ok((patches, if is_colour { CAMERA.map(str::to_owned).to_vec() } else { channels }, is_colour))
}

fn text_of(path: &Path) -> Result<String> {
    let place = || format!("chart {}", path.display());
    let bytes = bounded_file::read(path, LARGEST).with_context(place)?;
    plain(&bytes).with_context(place)
}
