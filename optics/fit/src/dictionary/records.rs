//! Stores the values of all records of a dictionary in one channel.
//!
//! Values of a large dictionary are rounded to two bytes each, as roots: a value v of a record with the maximum m is
//! stored as √(v/m) to 1/65,535, so its error is about √(v m)/65,535 at most. That is 1.5·10⁻⁵ of the value where the
//! record is bright, and 1.5·10⁻⁴ where it is a hundred times as dark. With roots the rounding error is distributed like
//! the noise of walks: at the paper's quality it is 0.2 % of a pixel's standard error in the median, and 1.6 % at most.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use optics_model::Grid;

use crate::dictionary::wide::wide;

/// Greatest size of a dictionary whose values are stored exactly and whose gradients are stored: bytes of the values of
/// all seen channels. In larger ones gradients are computed at every comparison of a record: most records are never
/// compared.
const SMALL: usize = 512 << 20;

/// Number of steps from 0 to the root of a record's maximum.
const STEPS: f32 = u16::MAX as f32;

/// Whether a dictionary is so small that its values are stored exactly, and its gradients as well.
pub(crate) fn is_small(grid: &Grid) -> bool {
    let exact = grid.record_count().saturating_mul(grid.scene().sensor().pixels() * size_of::<f32>());
    exact.saturating_mul(grid.scene().seen_channels().count()) <= SMALL
}

/// Bytes of the values of a grid's records in one channel.
pub(crate) fn bytes_of(grid: &Grid) -> usize {
    let pixels = grid.scene().sensor().pixels();
    let of_record =
        if is_small(grid) { pixels * size_of::<f32>() } else { pixels * size_of::<u16>() + size_of::<f32>() };
    grid.record_count().saturating_mul(of_record)
}

/// Radiance factors of all records.
#[derive(Debug)]
pub(crate) struct Records {
    grid: Arc<Grid>,
    stored: Stored,
}

#[derive(Debug)]
enum Stored {
    Exact(Exact),
    Rounded(Rounded),
}

/// Values as `[record][pixel]`.
#[derive(Debug)]
struct Exact {
    values: Vec<f32>,
}

/// Roots in steps as `[record][pixel]`, and the square of a step by record.
#[derive(Debug)]
struct Rounded {
    roots: Vec<u16>,
    units: Vec<f32>,
}

#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn square(root: u16, unit: f32) -> f32 {
    f32::from(root) * f32::from(root) * unit
}

impl Records {
    /// Records whose values are all 0.
    pub(crate) fn new(grid: Arc<Grid>) -> Self {
        let exactly = is_small(&grid);
        Self::kept(grid, exactly)
    }

    /// Records whose values are all 0, stored exactly or rounded, whatever their number.
    pub(crate) fn kept(grid: Arc<Grid>, exactly: bool) -> Self {
        let (records, pixels) = (grid.record_count(), grid.scene().sensor().pixels());
        let stored = if exactly {
            Stored::Exact(Exact { values: vec![0.0; records * pixels] })
        } else {
            Stored::Rounded(Rounded { roots: vec![0; records * pixels], units: vec![0.0; records] })
        };
        Self { grid, stored }
    }

    pub(crate) fn grid(&self) -> &Grid {
        &self.grid
    }

    pub(crate) fn are_exact(&self) -> bool {
        matches!(self.stored, Stored::Exact(_))
    }

    /// The values of a record on some of the pixels.
    pub(crate) fn values(&self, record: usize, pixels: Range<usize>) -> Cow<'_, [f32]> {
        match &self.stored {
            Stored::Exact(Exact { values }) => Cow::Borrowed(&values[record * self.pixels()..][pixels]),
            Stored::Rounded(Rounded { roots, units }) => {
                let (roots, unit) = (&roots[record * self.pixels()..][pixels], units[record]);
                let mut values = vec![0.0; roots.len()];
                wide(
                    #[inline(always)]
                    || values.iter_mut().zip(roots).for_each(|(value, root)| *value = square(*root, unit)),
                );
                Cow::Owned(values)
            }
        }
    }

    /// Sets the values of a record, which must not be negative.
    pub(crate) fn set(&mut self, record: usize, new: impl ExactSizeIterator<Item = f32>) {
        let pixels = self.pixels();
        let numbers = record * pixels..(record + 1) * pixels;
        match &mut self.stored {
            Stored::Exact(Exact { values }) => {
                values[numbers].iter_mut().zip(new).for_each(|(value, new)| *value = new);
            }
            Stored::Rounded(Rounded { roots, units }) => {
                let new: Vec<f32> = new.collect();
                debug_assert!(new.iter().all(|value| *value >= 0.0), "radiance factors are not negative");
                units[record] = round(&new, &mut roots[numbers]);
            }
        }
    }

    pub(crate) fn pixels(&self) -> usize {
        self.grid.scene().sensor().pixels()
    }
}

/// Writes roots in steps, and returns the square of a step.
fn round(values: &[f32], roots: &mut [u16]) -> f32 {
    let greatest = values.iter().copied().fold(0.0, f32::max);
    let unit = greatest / (STEPS * STEPS);
    if unit > 0.0 {
        wide(
            #[inline(always)]
            || {
                for (root, value) in roots.iter_mut().zip(values) {
                    *root = ((value.max(0.0) / unit).sqrt() + 0.5).min(STEPS) as u16;
                }
            },
        );
    }
    unit
}

#[cfg(test)]
mod tests {
    use optics_model::Walks;
    use optics_model::scene::{Scene, Sensor};

    use super::*;
    use crate::testing::coarse_axes;

    /// A profile from very dark to bright, over more than twice eight pixels.
    fn profile(scale: f32) -> Vec<f32> {
        (0..20).map(|i| scale * 1e-5 * 1.8_f32.powi(i)).chain([0.0]).collect()
    }

    /// The rounding of stored values stays within the bound that is stated for it.
    #[test]
    fn rounding_stays_within_its_stated_bound() {
        let scene = Scene::paper().with_sensor(Sensor::new(10.0, 21, 0.0).unwrap());
        let grid = Arc::new(Grid::new(scene, coarse_axes(), Walks::PAPER, 1, false).unwrap());
        let mut records = Records::kept(grid, false);
        for (record, scale) in [1.0, 1e-3, 0.0].into_iter().enumerate() {
            let given = profile(scale);
            records.set(record, given.iter().copied());
            let greatest = given.iter().copied().fold(0.0, f32::max);
            let found = records.values(record, 0..21);
            for (found, given) in found.iter().zip(&given) {
                // Half a step of the root, its square, and the rounding of single precision.
                let half = 0.5 / STEPS;
                let most = 2.0 * (given * greatest).sqrt() * half + greatest * half * half + 1e-6 * given;
                assert!((found - given).abs() <= most, "{found} {given} {most}");
            }
            assert_eq!(*records.values(record, 3..9), found[3..9]);
        }
    }
}
