//! Finds the part of a dictionary's axes that a question covers, and the channels that it needs.

use std::ops::Range;

use optics_model::fit::{Bounds, FitOptions, Outside};
use optics_model::measurement::colour;
use optics_model::scene::Channel;
use optics_model::{Grid, Invalid};

use super::FitDictionary;

/// Two parameters are the same if they differ by less than this share: decimals in files are rounded.
pub(crate) const SAME: f64 = 1e-6;

/// Share by which a profile's mean must lie beyond those of all records to count as outside: more than noise explains.
const OUTSIDE: f64 = 0.01;

/// Media that a search covers, as ranges of the grid's axes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Admissible {
    pub sigma_t: Range<usize>,
    pub g: Range<usize>,
    pub albedo: Range<usize>,
}

impl Admissible {
    pub(crate) fn new(dictionary: &FitDictionary, options: &FitOptions) -> Result<Self, Invalid> {
        let (grid, settings) = (dictionary.grid(), options.settings());
        Ok(Self {
            sigma_t: within("sigma_t_per_mm", grid.sigma_t_per_mm(), settings.sigma_t_per_mm)?,
            g: within("g", grid.g(), settings.g)?,
            albedo: within("albedo", grid.albedo(), settings.albedo)?,
        })
    }
}

/// The values of parameters that are held: by the bounds, or since the dictionary has one value only.
pub(crate) fn held(grid: &Grid, options: &FitOptions) -> [Option<f64>; 3] {
    let settings = options.settings();
    let held = |axis: &[f64], bounds: Bounds| match axis {
        [one] => Some(*one),
        _ => bounds.is_fixed().then_some(bounds.min()),
    };
    [
        held(grid.sigma_t_per_mm(), settings.sigma_t_per_mm),
        held(grid.albedo(), settings.albedo),
        held(grid.g(), settings.g),
    ]
}

/// Nodes within the bounds; if the bounds lie between two nodes, these two.
fn within(field: &str, axis: &[f64], bounds: Bounds) -> Result<Range<usize>, Invalid> {
    let slack = |v: f64| if v.is_finite() { SAME * v.abs().max(1e-3) } else { 0.0 };
    let (min, max) = (bounds.min() - slack(bounds.min()), bounds.max() + slack(bounds.max()));
    let first = axis.partition_point(|v| *v < min);
    let end = axis.partition_point(|v| *v <= max);
    if first < end {
        return Ok(first..end);
    }
    if first == 0 || first == axis.len() {
        let given = if bounds.is_fixed() {
            bounds.min().to_string()
        } else {
            format!("{} to {}", bounds.min(), bounds.max())
        };
        let allowed = format!("the dictionary has {}", span(axis));
        return Err(Invalid::new(field, given, allowed));
    }
    Ok(first - 1..first + 1)
}

fn span(axis: &[f64]) -> String {
    match axis {
        [one] => format!("{one} alone"),
        [first, .., last] => format!("{first} to {last}"),
        [] => "none".to_owned(),
    }
}

pub(crate) fn list(axis: &[f64]) -> String {
    axis.iter().map(f64::to_string).collect::<Vec<_>>().join(", ")
}

/// The error for a thickness that the dictionary lacks, with the grid to submit.
pub(crate) fn unknown_thickness(grid: &Grid, thickness_mm: f64) -> Invalid {
    let axis = grid.thickness_mm();
    let mut wanted = [axis, &[thickness_mm]].concat();
    wanted.sort_by(f64::total_cmp);
    let allowed = format!(
        "the dictionary has {}; `farmctl submit GRID.toml` computes one with all of them if the grid file says \
         thickness_mm = [{}], and takes over what is there. With --objective likelihood, thicknesses near the dictionary's \
         need none",
        list(axis),
        list(&wanted)
    );
    Invalid::new("thickness_mm", thickness_mm, allowed)
}

/// Index of a channel among the scene's.
pub(crate) fn find_channel(grid: &Grid, name: &str) -> Result<usize, Invalid> {
    let channels = grid.scene().channels();
    let called = |c: &Channel| c.name() == name;
    // A colour may have another spelling here than in the measurement.
    let alike = |c: &Channel| colour(name).is_some() && colour(c.name()) == colour(name);
    let found = channels.iter().position(called).or_else(|| channels.iter().position(alike));
    found.ok_or_else(|| {
        let names: Vec<_> = channels.iter().map(Channel::name).collect();
        Invalid::new("channel", name, format!("the dictionary has {}", names.join(", ")))
    })
}

/// Indices of the channels that a question about these names needs, in ascending order; the first channel if there are no
/// names. Unknown names are left out: the question itself refuses them.
pub fn channels_called<'a>(grid: &Grid, names: impl IntoIterator<Item = &'a str>) -> Vec<usize> {
    let mut names = names.into_iter().peekable();
    let mut indices = match names.peek() {
        None => vec![0],
        Some(_) => names.filter_map(|name| find_channel(grid, name).ok()).collect(),
    };
    let darker: Vec<usize> = indices.iter().filter_map(|i| grid.scene().under_darker_white(*i)).collect();
    indices.extend(darker);
    indices.sort_unstable();
    indices.dedup();
    indices
}

/// Whether a profile of this mean is brighter or darker than records of these least and greatest means.
pub(crate) fn outside(mean: f64, (least, greatest): (f64, f64)) -> Option<Outside> {
    if mean > greatest * (1.0 + OUTSIDE) {
        Some(Outside::Brighter)
    } else if mean < least * (1.0 - OUTSIDE) {
        Some(Outside::Darker)
    } else {
        None
    }
}
