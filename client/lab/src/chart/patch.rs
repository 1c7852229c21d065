//! Patches of a chart, whose stacks have materials by name.

use anyhow::{Result, bail};

use super::settings::PatchGeometry;
use crate::slabs::NamedSlab;

/// Channels of a camera's colours.
pub(super) const CAMERA: [&str; 3] = ["R", "G", "B"];
/// The base of patches that name none.
pub const REST: &str = "base";

/// Refuses what is no colour.
pub(super) fn check_colour([l, a, b]: [f64; 3]) -> Result<()> {
    if !(-5.0..=150.0).contains(&l) || ![a, b].iter().all(|v| (-300.0..=300.0).contains(v)) {
        bail!("L = {l}, a = {a}, b = {b} is no colour in CIELAB");
    }
    Ok(())
}

/// A patch.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedPatch {
    pub name: String,
    /// From the top to the base.
    pub slabs: Vec<NamedSlab>,
    /// One for each channel.
    pub values: Vec<f64>,
    pub std_errors: Vec<f64>,
    /// Name of its base, or its reflectance.
    pub base: String,
    pub geometry: Option<PatchGeometry>,
    pub place: Option<PatchPlace>,
}

/// A place in a photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchPlace {
    pub photo: String,
    pub column: f64,
    pub row: f64,
}

impl NamedPatch {
    pub(super) fn new(name: String, slabs: Vec<NamedSlab>, values: Vec<f64>) -> Self {
        let std_errors = vec![0.0; values.len()];
        Self { name, slabs, values, std_errors, base: REST.to_owned(), geometry: None, place: None }
    }
}

/// The words of a stack, whose layers of one material are one slab: `white:0.16 yellow:0.08`.
pub fn stack_text(slabs: &[NamedSlab]) -> String {
    merged(slabs).iter().map(NamedSlab::text).collect::<Vec<_>>().join(" ")
}

/// A stack whose layers of one material are one slab.
pub(super) fn merged(slabs: &[NamedSlab]) -> Vec<NamedSlab> {
    let mut merged: Vec<NamedSlab> = Vec::new();
    for slab in slabs {
        match merged.last_mut().filter(|last| last.shares == slab.shares) {
            // Sums without the digits of rounding.
            Some(last) => last.thickness_mm = (1e6 * (last.thickness_mm + slab.thickness_mm)).round() / 1e6,
            None => merged.push(slab.clone()),
        }
    }
    merged
}
