//! Finds specks and scratches in the residuals of a crop: groups of neighbouring cells far above the noise.
//!
//! The robust fit rejects single samples, but larger specks leave a rim in it or make the thirds of the crop disagree.
//! A feature broader than dust, such as a bubble or uneven light, is not masked.

use crate::least_squares::spread;

/// A sample's deviation from the profile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Residual {
    pub x: u32,
    pub y: u32,
    /// In standard deviations.
    pub z: f64,
    /// As a share of the profile.
    pub share: f64,
}

/// Pixels of a cell's side: it holds at least four samples of each colour of a mosaic.
const CELL: usize = 4;

/// Residuals are clipped at this, so that one hot pixel is no blemish.
const CLIP: f64 = 5.0;

/// Standard deviations of a cell that begin a blemish, and down to which it extends.
const FOUND: f64 = 6.0;
const REACHES: f64 = 3.0;

/// Share of the profile that counts as at least one standard deviation: uneven light and rough boards cause such
/// deviations everywhere, which are left to the comparison of thirds.
const UNEVEN: f64 = 0.001;

/// Half the breadth above which a feature is not a blemish, in mm.
const BROAD_MM: f64 = 0.8;

/// The masked cells, and the blemishes that they belong to.
#[derive(Debug, Clone, Default)]
pub(crate) struct BlemishMask {
    columns: usize,
    rows: usize,
    masked: Vec<bool>,
    pub blemishes: Vec<Blemish>,
}

/// A speck or a scratch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Blemish {
    /// Its middle.
    pub at_px: [f64; 2],
    pub area_mm2: f64,
}

impl BlemishMask {
    pub fn holds(&self, x: u32, y: u32) -> bool {
        let (column, row) = (x as usize / CELL, y as usize / CELL);
        column < self.columns && row < self.rows && self.masked[row * self.columns + column]
    }

    /// Blemishes in the residuals of all colours.
    pub fn find(colours: &[Vec<Residual>], mm_per_px: f64) -> Self {
        let end = |of: fn(&Residual) -> u32| {
            colours.iter().flatten().map(of).max().map_or(0, |v| v as usize / CELL + 1)
        };
        let mut mask = Self { columns: end(|r| r.x), rows: end(|r| r.y), ..Self::default() };
        let height = mask.heights(colours);
        let mut seen = vec![false; height.len()];
        let mut grown = vec![false; height.len()];
        for first in 0..height.len() {
            if seen[first] || height[first] < FOUND {
                continue;
            }
            let group = mask.group(first, &height, &mut seen);
            if mask.is_broad(&group, BROAD_MM / mm_per_px / CELL as f64) {
                continue;
            }
            let area_mm2 = group.len() as f64 * (CELL as f64 * mm_per_px).powi(2);
            mask.blemishes.push(Blemish { at_px: mask.middle(&group), area_mm2 });
            for k in group {
                grown[k] = true;
                mask.around(k).for_each(|near| grown[near] = true);
            }
        }
        mask.masked = grown;
        mask
    }

    /// Largest deviation of each cell among the colours, in standard deviations of all cells.
    fn heights(&self, colours: &[Vec<Residual>]) -> Vec<f64> {
        let mut height = vec![0.0_f64; self.columns * self.rows];
        for residuals in colours {
            let mut sums = vec![[0.0; 3]; height.len()];
            for r in residuals {
                let sum = &mut sums[r.y as usize / CELL * self.columns + r.x as usize / CELL];
                *sum = [sum[0] + r.z.clamp(-CLIP, CLIP), sum[1] + 1.0, sum[2] + r.share];
            }
            let z = |[sum, count, _]: &[f64; 3]| if *count > 0.0 { sum / count.sqrt() } else { 0.0 };
            let uneven = |[_, count, share]: &[f64; 3]| (share / count.max(1.0) / UNEVEN).abs();
            let filled: Vec<f64> = sums.iter().filter(|s| s[1] > 0.0).map(z).collect();
            let scale = if filled.is_empty() { 1.0 } else { spread(&filled).max(1.0) };
            for (height, sum) in height.iter_mut().zip(&sums) {
                *height = height.max((z(sum).abs() / scale).min(uneven(sum)));
            }
        }
        height
    }

    fn group(&self, first: usize, height: &[f64], seen: &mut [bool]) -> Vec<usize> {
        let (mut group, mut open) = (Vec::new(), vec![first]);
        seen[first] = true;
        while let Some(k) = open.pop() {
            group.push(k);
            for near in self.around(k) {
                if !seen[near] && height[near] >= REACHES {
                    seen[near] = true;
                    open.push(near);
                }
            }
        }
        group
    }

    fn around(&self, k: usize) -> impl Iterator<Item = usize> + use<> {
        let (columns, rows) = (self.columns, self.rows);
        let (column, row) = (k % columns, k / columns);
        let near = |v: usize, end: usize| v.saturating_sub(1)..(v + 2).min(end);
        near(row, rows)
            .flat_map(move |r| near(column, columns).map(move |c| r * columns + c))
            .filter(move |n| *n != k)
    }

    /// Whether a disc of this radius, in cells, fits into a group.
    fn is_broad(&self, group: &[usize], radius: f64) -> bool {
        let mut inside = vec![false; self.columns * self.rows];
        for k in group {
            inside[*k] = true;
        }
        let reach = radius as i64;
        let disc: Vec<[i64; 2]> = (-reach..=reach)
            .flat_map(|dy| (-reach..=reach).map(move |dx| [dx, dy]))
            .filter(|[dx, dy]| ((dx * dx + dy * dy) as f64) <= radius * radius)
            .collect();
        group.iter().any(|k| {
            let (x, y) = ((k % self.columns) as i64, (k / self.columns) as i64);
            disc.iter().all(|[dx, dy]| {
                let (x, y) = (x + dx, y + dy);
                let within = (0..self.columns as i64).contains(&x) && (0..self.rows as i64).contains(&y);
                within && inside[y as usize * self.columns + x as usize]
            })
        })
    }

    fn middle(&self, group: &[usize]) -> [f64; 2] {
        let mean = |f: &dyn Fn(usize) -> usize| {
            CELL as f64 * (group.iter().map(|k| f(*k) as f64 + 0.5).sum::<f64>() / group.len().max(1) as f64)
        };
        [mean(&|k| k % self.columns), mean(&|k| k / self.columns)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: u32 = 240;
    const MM_PER_PX: f64 = 0.03;

    /// Residuals that alternate by one standard deviation, plus `more`.
    fn residuals(more: impl Fn(f64, f64) -> f64) -> [Vec<Residual>; 3] {
        let pixel = |i: u32| {
            let (x, y) = (i % SIDE, i / SIDE);
            let noise = if (x + y).is_multiple_of(2) { 1.0 } else { -1.0 };
            let z = noise + more(f64::from(x), f64::from(y));
            Residual { x, y, z, share: 2e-3 * z }
        };
        let all: Vec<Residual> = (0..SIDE * SIDE).map(pixel).collect();
        [all.clone(), all.clone(), all]
    }

    fn share(mask: &BlemishMask) -> f64 {
        let masked = (0..SIDE * SIDE).filter(|i| mask.holds(i % SIDE, i / SIDE)).count();
        masked as f64 / f64::from(SIDE * SIDE)
    }

    /// Deviations of a quarter of a per cent, however small the noise.
    #[test]
    fn uneven_light_is_no_blemish() {
        let uneven = residuals(|x, _| if (100.0..110.0).contains(&x) { 20.0 } else { 0.0 });
        let faint: [Vec<Residual>; 3] =
            uneven.map(|all| all.into_iter().map(|r| Residual { share: 1.25e-4 * r.z, ..r }).collect());
        assert!(BlemishMask::find(&faint, MM_PER_PX).blemishes.is_empty());
    }

    /// A hot pixel and a bubble are not blemishes.
    #[test]
    fn hot_pixels_and_bubbles_are_not_masked() {
        let hot = |x: f64, y: f64| if (x, y) == (50.0, 50.0) { 300.0 } else { 0.0 };
        let bubble = |x: f64, y: f64| if libm::hypot(x - 120.0, y - 120.0) < 42.0 { -15.0 } else { 0.0 };
        let mask = BlemishMask::find(&residuals(|x, y| hot(x, y) + bubble(x, y)), MM_PER_PX);
        assert!(mask.blemishes.is_empty() && share(&mask) == 0.0, "{:?}", mask.blemishes);
    }
}
