//! A chart to print: wedges of each material alone, pairs, mixed stacks, and repeats that show light and noise, in places
//! that have nothing to do with their colours.

use anyhow::{Result, bail};
use optics_chart::scattered;

use super::notes::is_multiple;
use super::patch::merged;
use crate::slabs::NamedSlab;

/// Layers of the wedges of each material.
const WEDGE: [usize; 5] = [1, 2, 4, 8, 16];
/// Layers of mixed stacks.
const MIXED: usize = 5;
/// Equal patches over the plate.
const REPEATS: usize = 10;
const MOST_PATCHES: usize = 2000;

/// The materials and layers of a chart to print.
#[derive(Debug, Clone)]
pub struct ChartDesign {
    pub materials: Vec<String>,
    /// Heights of layers in mm, one for each plate.
    pub layers_mm: Vec<f64>,
    /// Patches on each plate.
    pub patches: usize,
    /// The slab under all patches.
    pub base: NamedSlab,
}

/// A patch on its plate.
#[derive(Debug, Clone, PartialEq)]
pub struct PrintedPatch {
    pub row: usize,
    pub column: usize,
    /// Material of each layer, from the top.
    pub layers: Vec<usize>,
}

impl ChartDesign {
    /// The patches of each plate.
    ///
    /// # Errors
    /// If there are too few materials or patches, or too many.
    pub fn plates(&self) -> Result<Vec<Vec<PrintedPatch>>> {
        let materials = self.materials.len();
        if !(2..=12).contains(&materials) {
            bail!("a chart of {materials} materials is not valid: allowed are 2 to 12");
        }
        if let Some(twice) = (1..materials).find(|i| self.materials[..*i].contains(&self.materials[*i])) {
            bail!("material {:?} may be given once", self.materials[twice]);
        }
        let signs = [',', '|', ':', '=', '"', ';', '\t', '\n'];
        if let Some(name) = self.materials.iter().find(|name| name.trim().is_empty() || name.contains(signs))
        {
            bail!(
                "material {name:?} is not valid: a name is not empty, and has none of , | : = ; and quotes"
            );
        }
        for (i, mm) in self.layers_mm.iter().enumerate() {
            if self.layers_mm[..i].contains(mm) {
                bail!("--layer {mm} may be given once");
            }
            if !is_multiple(self.base.thickness_mm, *mm) {
                bail!(
                    "--base {}: its {} mm are no whole number of layers of {mm} mm",
                    self.base.text(),
                    self.base.thickness_mm
                );
            }
        }
        let least = REPEATS + WEDGE.len() * materials;
        if !(least..=MOST_PATCHES).contains(&self.patches) {
            bail!(
                "--patches {} is not valid: {materials} materials need {least} to {MOST_PATCHES}",
                self.patches
            );
        }
        let mut random = Shuffle(0);
        Ok(self.layers_mm.iter().map(|_| self.plate(&mut random)).collect())
    }

    fn plate(&self, random: &mut Shuffle) -> Vec<PrintedPatch> {
        let count = self.materials.len();
        let wedges = (0..count).flat_map(|m| WEDGE.map(|layers| vec![m; layers]));
        let mut stacks: Vec<Vec<usize>> = wedges.collect();
        let mut pairs: Vec<Vec<usize>> = (0..count * count)
            .map(|i| (i / count, i % count))
            .filter(|(top, below)| top != below)
            .map(|(top, below)| vec![top, top, below, below, below])
            .collect();
        random.shuffle(&mut pairs);
        let repeated = pairs.pop().unwrap_or_else(|| vec![0; MIXED]);
        let free = self.patches - REPEATS - stacks.len();
        // Half of what is left is for pairs, at most.
        stacks.extend(pairs.into_iter().take(free.div_ceil(2)));
        while stacks.len() < self.patches - REPEATS {
            let mixed: Vec<usize> = (0..MIXED).map(|_| random.below(count)).collect();
            // Few materials have few stacks.
            if !stacks.contains(&mixed) || stacks.len() > count.pow(MIXED as u32) / 2 {
                stacks.push(mixed);
            }
        }
        random.shuffle(&mut stacks);
        let columns = (self.patches as f64).sqrt().ceil() as usize;
        let rows = self.patches.div_ceil(columns);
        let (last, right) = (rows - 1, columns - 1);
        // The last row may not be full.
        let full = if self.patches == rows * columns { last } else { last - 1 };
        let mut held = vec![
            (0, 0),
            (0, right),
            (full, 0),
            (full, right),
            (0, right / 2),
            (full, right / 2),
            (full / 2, 0),
            (full / 2, right),
            (full / 2, right / 2),
            (full / 2 + 1, right / 2 + 1),
        ];
        held.dedup();
        let places = (0..self.patches).map(|i| (i / columns, i % columns));
        places
            .map(|(row, column)| {
                let own = if held.contains(&(row, column)) { None } else { stacks.pop() };
                PrintedPatch { row, column, layers: own.unwrap_or_else(|| repeated.clone()) }
            })
            .collect()
    }

    /// The table that `measure` reads, once colours are filled in.
    pub fn table(&self, plates: &[Vec<PrintedPatch>]) -> String {
        let mut text = "patch,photo,row,column,slabs,L,a,b\n".to_owned();
        for (plate, patches) in plates.iter().enumerate() {
            for patch in patches {
                let layer = |material: &usize| NamedSlab {
                    shares: vec![(self.materials[*material].clone(), 1.0)],
                    thickness_mm: self.layers_mm[plate],
                };
                let printed: Vec<NamedSlab> = patch.layers.iter().map(layer).collect();
                let (photo, row, column) = (plate + 1, patch.row + 1, patch.column + 1);
                let has_blanks = self.materials.iter().any(|name| name.contains(char::is_whitespace));
                let between = if has_blanks { "|" } else { " " };
                let slabs =
                    merged(&printed).iter().chain([&self.base]).map(NamedSlab::text).collect::<Vec<_>>();
                let slabs = slabs.join(between);
                text += &format!("{photo}-{row}-{column},{photo},{row},{column},{slabs},,,\n");
            }
        }
        text
    }
}

/// Numbers in an order that is the same everywhere: how many were taken.
struct Shuffle(u64);

impl Shuffle {
    fn below(&mut self, end: usize) -> usize {
        self.0 += 1;
        (scattered(self.0) % end as u64) as usize
    }

    fn shuffle<T>(&mut self, all: &mut [T]) {
        for i in (1..all.len()).rev() {
            all.swap(i, self.below(i + 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn design(patches: usize) -> ChartDesign {
        let base = NamedSlab { shares: vec![("white".to_owned(), 1.0)], thickness_mm: 0.8 };
        let materials = ["white", "cyan", "magenta", "yellow"].map(str::to_owned).to_vec();
        ChartDesign { materials, layers_mm: vec![0.08, 0.2], patches, base }
    }

    /// Every plate has all wedges, ten repeats with the corners among them, and its patches in all places.
    #[test]
    fn charts_have_wedges_and_repeats() {
        for patches in [30, 60, 97, 100, 250] {
            let design = design(patches);
            for plate in design.plates().unwrap() {
                assert_eq!(plate.len(), patches);
                let count = |layers: &[usize]| plate.iter().filter(|patch| patch.layers == layers).count();
                assert!((0..4).all(|m| WEDGE.iter().all(|n| count(&vec![m; *n]) >= 1)), "{patches}");
                let most = plate.iter().max_by_key(|patch| count(&patch.layers)).unwrap();
                assert!(count(&most.layers) >= REPEATS && plate[0].layers == most.layers, "{patches}");
            }
            let table = design.table(&design.plates().unwrap());
            assert!(
                table.lines().count() == 2 * patches + 1 && table.contains("white:3.2 white:0.8,,,"),
                "{table}"
            );
        }
        assert!(design(29).plates().unwrap_err().to_string().contains("4 materials need 30 to 2000"));
    }
}
