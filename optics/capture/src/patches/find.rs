//! Finds a row of grey patches in a photograph: even rectangles of one size, at equal distances, with brightnesses in
//! proportion to their ρ. Patches without contrast to their surroundings are placed by the others.

use super::{LEAST_PX, Neutral};
use crate::frame::Area;
use crate::refusal::Refusal;
use crate::tiles::{EVEN, EvenRegion, Tiles, alike};
use crate::view::PhotoView;

/// Tolerance of a patch's brightness: relative to its ρ, and as a share of a white one, for stray light.
const LEVEL: (f64, f64) = (0.12, 0.012);
/// Part of a patch's sides that is read.
const INNER: f64 = 0.6;

/// Patches in a row.
#[derive(Debug, Clone, Copy)]
struct PatchRow {
    first: [f64; 2],
    step: [f64; 2],
    size: [f64; 2],
    /// Regions that are its patches.
    seen: usize,
    /// Sum of squared deviations from ρ.
    off: f64,
}

/// The patches' areas, in the order of ρ.
pub(super) fn find(view: PhotoView<'_>, neutral: &Neutral) -> Result<Vec<Area>, Refusal> {
    let tiles = Tiles::of(view);
    let regions = tiles.regions();
    let none = |seen: String| Refusal::NoPatches { label: view.photo.label.clone(), seen };
    let rho = &neutral.rho;
    let mut rows: Vec<PatchRow> = Vec::new();
    for a in &regions {
        for b in regions.iter().filter(|b| a.middle != b.middle && alike(a.size, b.size)) {
            let places = (0..rho.len()).flat_map(|i| (i + 1..rho.len()).map(move |j| (i, j)));
            rows.extend(places.filter_map(|(i, j)| tiles.row(&regions, rho, (a, i), (b, j))));
        }
    }
    let better = |a: &&PatchRow, b: &&PatchRow| a.seen.cmp(&b.seen).then(b.off.total_cmp(&a.off));
    let Some(best) = rows.iter().max_by(better) else {
        let count = regions.len();
        let seen = format!("of {count} even rectangles, no row of {} has the brightnesses of rho", rho.len());
        return Err(none(seen));
    };
    let far = |row: &&PatchRow| {
        let apart = [0, 1].map(|k| (row.first[k] - best.first[k]).abs() / best.size[k]);
        row.seen == best.seen && apart.iter().any(|d| *d > 0.5)
    };
    if let Some(other) = rows.iter().find(far) {
        let [at, also] = [best, other].map(|row| row.first.map(|v| (v * tiles.side_px as f64).round()));
        return Err(none(format!("two rows fit, beginning at {at:?} and {also:?} px")));
    }
    let row = best.through(&regions, rho.len());
    let areas: Vec<Area> = (0..rho.len()).map(|i| row.area(i, tiles.side_px)).collect();
    if areas.iter().any(|area| area.width.min(area.height) < LEAST_PX) {
        return Err(none(format!("those found are smaller than {LEAST_PX} × {LEAST_PX} pixels")));
    }
    Ok(areas)
}

impl Tiles {
    /// The row in which these regions are patches i and j, if all patches agree with it.
    fn row(
        &self,
        regions: &[EvenRegion],
        rho: &[Vec<f64>],
        (a, i): (&EvenRegion, usize),
        (b, j): (&EvenRegion, usize),
    ) -> Option<PatchRow> {
        let green = |patch: usize| rho[patch][rho[patch].len() / 2];
        // Numbers per ρ, from the brighter one, where stray light matters less.
        let (bright, of) = if green(i) > green(j) { (a, i) } else { (b, j) };
        if bright.light.iter().any(|light| *light <= self.floor) {
            return None;
        }
        let per_rho: Vec<f64> = bright.light.iter().zip(&rho[of]).map(|(light, rho)| light / rho).collect();
        let deviation = |light: &[f64], patch: usize| -> Option<f64> {
            let mut sum = 0.0;
            for ((light, per_rho), expected) in light.iter().zip(&per_rho).zip(&rho[patch]) {
                let off = (light / per_rho - expected) / (LEVEL.0 * expected + LEVEL.1);
                if off.abs() > 1.0 {
                    return None;
                }
                sum += off * off;
            }
            Some(sum)
        };
        deviation(&a.light, i)?;
        deviation(&b.light, j)?;
        let step = [0, 1].map(|k| (b.middle[k] - a.middle[k]) / (j - i) as f64);
        let size = [0, 1].map(|k| 0.5 * (a.size[k] + b.size[k]));
        if !(0..2).any(|k| step[k].abs() > 0.9 * size[k]) {
            return None;
        }
        let first = [0, 1].map(|k| a.middle[k] - i as f64 * step[k]);
        let mut row = PatchRow { first, step, size, seen: 0, off: 0.0 };
        for patch in 0..rho.len() {
            row.off += deviation(&self.even(&row, patch)?, patch)?;
            row.seen += usize::from(row.region(regions, patch).is_some());
        }
        // One patch may be as bright as its surroundings.
        (row.seen + 1 >= rho.len()).then_some(row)
    }

    /// Brightness of the inner part of a patch; None if it is uneven or outside the frame.
    fn even(&self, row: &PatchRow, patch: usize) -> Option<Vec<f64>> {
        let area = row.area(patch, 1);
        let inside = area.x >= 0.0 && area.y >= 0.0;
        if !inside || area.x + area.width > self.columns as f64 || area.y + area.height > self.rows as f64 {
            return None;
        }
        let span =
            |from: f64, length: f64| from as usize..((from + length).ceil() as usize).max(from as usize + 1);
        let columns = span(area.x, area.width);
        let tiles: Vec<usize> = span(area.y, area.height)
            .flat_map(|y| columns.clone().map(move |x| (x, y)))
            .filter(|(x, y)| *x < self.columns && *y < self.rows)
            .map(|(x, y)| y * self.columns + x)
            .collect();
        let light = self.mean(&tiles);
        // Dust may lie on some tiles.
        let green = light[light.len() / 2];
        let odd = |t: &&usize| (self.green()[**t] - green).abs() > 2.0 * EVEN.0 * green + self.floor;
        (tiles.iter().filter(odd).count() * 10 <= tiles.len()).then_some(light)
    }
}

impl PatchRow {
    fn middle(&self, patch: usize) -> [f64; 2] {
        [0, 1].map(|k| self.first[k] + patch as f64 * self.step[k])
    }

    /// The region that is this patch.
    fn region<'a>(&self, regions: &'a [EvenRegion], patch: usize) -> Option<&'a EvenRegion> {
        let middle = self.middle(patch);
        regions.iter().find(|r| {
            let near = |k: usize| (r.middle[k] - middle[k]).abs() < 0.25 * self.size[k];
            (0..2).all(near) && alike(self.size, r.size)
        })
    }

    /// The row fitted to the middles of all its regions, by least squares.
    fn through(&self, regions: &[EvenRegion], patches: usize) -> Self {
        let seen: Vec<(f64, [f64; 2])> = (0..patches)
            .filter_map(|i| self.region(regions, i).map(|region| (i as f64, region.middle)))
            .collect();
        let n = seen.len() as f64;
        let mean_i = seen.iter().map(|s| s.0).sum::<f64>() / n;
        let square = seen.iter().map(|s| (s.0 - mean_i).powi(2)).sum::<f64>();
        let mut row = *self;
        for k in 0..2 {
            let mean = seen.iter().map(|s| s.1[k]).sum::<f64>() / n;
            row.step[k] = seen.iter().map(|s| (s.0 - mean_i) * (s.1[k] - mean)).sum::<f64>() / square;
            row.first[k] = mean - mean_i * row.step[k];
        }
        row
    }

    /// The area of a patch that is read.
    fn area(&self, patch: usize, side_px: usize) -> Area {
        let (middle, px) = (self.middle(patch), side_px as f64);
        let [width, height] = self.size.map(|v| INNER * v);
        Area {
            x: (middle[0] - 0.5 * width) * px,
            y: (middle[1] - 0.5 * height) * px,
            width: width * px,
            height: height * px,
        }
    }
}
