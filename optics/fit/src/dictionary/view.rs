//! Describes all records of a channel, and their gradients, over a range of pixels.
//!
//! The wavelet derivative subtracts the chord between the ends, so the gradients of a part are not a part of the whole's:
//! every range of pixels needs its own. Only the paper's distance uses gradients, so they are computed and described at
//! the first question with that distance.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use optics_model::Grid;
use optics_model::fit::Wavelet;
use rayon::prelude::*;

use crate::dictionary::gradient::{derivative, shown_derivative};
use crate::dictionary::records::{self, Records};
use crate::dictionary::sketch::{Basis, Description, Sketch};

/// Pixel pitch to which gradients refer, in mm: 360 pixels over 10 mm.
pub(crate) const REFERENCE_PITCH_MM: f64 = 10.0 / 360.0;

/// Maximum number of profiles from which a basis is made.
const SAMPLES: usize = 2000;
/// Number of records whose gradients are computed together.
const BLOCK: usize = 256;

/// Maximum bytes of the view of a channel over all pixels.
pub(crate) fn bytes_of(grid: &Grid) -> usize {
    let sketches = grid.record_count().saturating_mul(2 * Sketch::BYTES);
    sketches + if records::is_small(grid) { records::bytes_of(grid) } else { 0 }
}

/// How gradients are computed: per sample of the reference pitch, whatever the pixels' own pitch.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slope {
    pub wavelet: Wavelet,
    pub level: u32,
    pub pitch_mm: f64,
}

impl Slope {
    /// ∇f, signed.
    pub(crate) fn of(self, f: &[f64]) -> Vec<f64> {
        let scale = REFERENCE_PITCH_MM / self.pitch_mm;
        let mut slope = derivative(f, self.wavelet, self.level);
        for d in &mut slope {
            *d *= scale;
        }
        slope
    }

    /// |∇f|.
    pub(crate) fn magnitude(self, f: &[f64]) -> Vec<f64> {
        let mut slope = self.of(f);
        for d in &mut slope {
            *d = d.abs();
        }
        slope
    }

    /// |∇f| for display.
    pub(crate) fn shown(self, f: &[f64]) -> Vec<f64> {
        let scale = REFERENCE_PITCH_MM / self.pitch_mm;
        shown_derivative(f, self.wavelet, self.level).into_iter().map(|d| (scale * d).abs()).collect()
    }
}

/// The compared pixels, and how their gradients are computed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ViewKey {
    pub pixels: Range<usize>,
    pub wavelet: Wavelet,
    pub level: u32,
}

#[derive(Debug)]
pub(crate) struct View {
    records: Arc<Records>,
    key: ViewKey,
    slope: Slope,
    values: Described,
    /// Gradients of a small dictionary, by blocks of records: `[record][pixel of the view]`. A block is computed when one
    /// of its records is first compared.
    gradients: Vec<OnceLock<Vec<f32>>>,
    gradients_described: OnceLock<Described>,
}

/// All records, described in a common basis.
#[derive(Debug)]
struct Described {
    basis: Basis,
    /// Sketches of all media, by thickness.
    sketches: Vec<Sketch>,
}

/// Descriptions of the values and gradients of all media at one thickness.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PairSketch<'a> {
    values: &'a Sketch,
    gradients: &'a Sketch,
}

/// A measured profile in the bases of a view.
#[derive(Debug)]
pub(crate) struct PairDescription {
    values: Description,
    gradient: Description,
}

impl PairSketch<'_> {
    /// Adds lower bounds of d(target, medium) for the media from `first` on.
    #[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
    #[inline(always)]
    pub(crate) fn add_bounds(&self, target: &PairDescription, lambda: f64, first: usize, bounds: &mut [f32]) {
        self.values.add_bounds(&target.values, 1.0, first, bounds);
        self.gradients.add_bounds(&target.gradient, lambda as f32, first, bounds);
    }
}

impl Described {
    /// Describes the records of a grid, given a profile of each.
    fn new<'a>(grid: &Grid, profile: impl Fn(usize) -> Cow<'a, [f32]> + Sync) -> Self {
        let records = grid.record_count();
        let sampled: Vec<Cow<[f32]>> =
            (0..records).into_par_iter().step_by(records.div_ceil(SAMPLES)).map(&profile).collect();
        let basis = Basis::of(&sampled.iter().map(|profile| &**profile).collect::<Vec<_>>());
        let (thicknesses, albedos) = (grid.thickness_mm().len(), grid.albedo().len());
        let media = records / thicknesses;
        let record = |medium: usize, thickness| {
            (medium / albedos * thicknesses + thickness) * albedos + medium % albedos
        };
        let sketch = |thickness| Sketch::new(&basis, media, |medium| profile(record(medium, thickness)));
        let sketches = (0..thicknesses).map(sketch).collect();
        Self { basis, sketches }
    }
}

impl View {
    pub(crate) fn new(records: &Arc<Records>, key: ViewKey) -> Self {
        let grid = records.grid();
        let slope =
            Slope { wavelet: key.wavelet, level: key.level, pitch_mm: grid.scene().sensor().pitch_mm() };
        let values = Described::new(grid, |record| records.values(record, key.pixels.clone()));
        let blocks = if records.are_exact() { grid.record_count().div_ceil(BLOCK) } else { 0 };
        let gradients = std::iter::repeat_with(OnceLock::new).take(blocks).collect();
        Self { records: records.clone(), key, slope, values, gradients, gradients_described: OnceLock::new() }
    }

    fn values(&self, record: usize) -> Cow<'_, [f32]> {
        self.records.values(record, self.key.pixels.clone())
    }

    /// The gradient magnitudes of a record, given its values.
    fn gradient(&self, record: usize, values: &[f32]) -> Cow<'_, [f32]> {
        let Some(block) = self.gradients.get(record / BLOCK) else {
            return Cow::Owned(gradient_of(self.slope, values));
        };
        // One thread computes a whole block and takes up no other work meanwhile, so other threads may wait for it.
        let kept = block.get_or_init(|| {
            let first = record / BLOCK * BLOCK;
            let records = first..(first + BLOCK).min(self.records.grid().record_count());
            records.flat_map(|record| gradient_of(self.slope, &self.values(record))).collect()
        });
        let pixels = self.key.pixels.len();
        Cow::Borrowed(&kept[record % BLOCK * pixels..][..pixels])
    }

    fn gradients_described(&self) -> &Described {
        made_once(&self.gradients_described, || {
            Described::new(self.records.grid(), |record| self.gradient(record, &self.values(record)))
        })
    }

    pub(crate) fn slope(&self) -> Slope {
        self.slope
    }

    pub(crate) fn pixels(&self) -> Range<usize> {
        self.key.pixels.clone()
    }

    /// The values and gradient magnitudes of a record on the view's pixels.
    pub(crate) fn profile(&self, record: usize) -> (Cow<'_, [f32]>, Cow<'_, [f32]>) {
        let values = self.values(record);
        let gradient = self.gradient(record, &values);
        (values, gradient)
    }

    /// The sketches that bound the distances of all media at a thickness from below.
    pub(crate) fn sketch(&self, thickness: usize) -> PairSketch<'_> {
        PairSketch {
            values: &self.values.sketches[thickness],
            gradients: &self.gradients_described().sketches[thickness],
        }
    }

    /// The values of all media at a thickness in the view's basis.
    pub(crate) fn value_sketch(&self, thickness: usize) -> &Sketch {
        &self.values.sketches[thickness]
    }

    pub(crate) fn value_basis(&self) -> &Basis {
        &self.values.basis
    }

    /// Factor from the coefficients of sketches to those of profiles.
    pub(crate) fn sketch_scale(&self) -> f64 {
        (self.key.pixels.len() as f64).sqrt()
    }

    pub(crate) fn describe(&self, values: &[f64], gradient: &[f64]) -> PairDescription {
        PairDescription {
            values: self.values.basis.describe(values),
            gradient: self.gradients_described().basis.describe(gradient),
        }
    }
}

/// Makes the value at its first use, outside the cell's lock: a thread that waits for parts of the value may begin
/// another question that needs the same value, and would wait for itself. At worst all concurrent callers make it.
pub(crate) fn made_once<T>(cell: &OnceLock<T>, make: impl FnOnce() -> T) -> &T {
    if let Some(made) = cell.get() {
        return made;
    }
    let made = make();
    cell.get_or_init(|| made)
}

/// |∇f| in single precision, as records are compared.
fn gradient_of(slope: Slope, values: &[f32]) -> Vec<f32> {
    let values: Vec<f64> = values.iter().copied().map(f64::from).collect();
    slope.magnitude(&values).into_iter().map(|d| d as f32).collect()
}
