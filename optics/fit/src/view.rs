//! Gradients and descriptions of all records of a channel over some of the pixels.
//!
//! The wavelet derivative takes off the chord between the ends, so the gradients of a part are not a part of the
//! whole's: every range of pixels needs its own.

use std::borrow::Cow;
use std::ops::Range;

use optics_model::Grid;
use optics_model::fit::Wavelet;
use rayon::prelude::*;

use super::gradient::derivative;
use super::records::Records;
use super::sketch::{Basis, Description, Sketch};

/// Pixel pitch that gradients are told per, in mm: 360 pixels over 10 mm.
pub(super) const REFERENCE_PITCH_MM: f64 = 10.0 / 360.0;

/// Profiles that a basis is made from.
const SAMPLES: usize = 2000;
/// Largest dictionary, by the values of all channels, of which gradients are kept, in bytes. Of larger ones they are taken
/// anew whenever a record is compared: most never are.
const GRADIENTS_KEPT: usize = 512 << 20;

/// Bytes of the values of a grid's records in one channel.
fn bytes_of_values(grid: &Grid) -> usize {
    grid.record_count().saturating_mul(grid.scene().sensor().pixels() * size_of::<f32>())
}

fn keeps_gradients(grid: &Grid) -> bool {
    bytes_of_values(grid).saturating_mul(grid.scene().seen_channels().count()) <= GRADIENTS_KEPT
}

/// Bytes that the view of a channel over all pixels takes.
pub(super) fn bytes_of(grid: &Grid) -> usize {
    let sketches = grid.record_count().saturating_mul(2 * Sketch::BYTES);
    sketches + if keeps_gradients(grid) { bytes_of_values(grid) } else { 0 }
}

/// How gradients are taken: per sample of the reference pitch, whatever the pixels'.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slope {
    pub wavelet: Wavelet,
    pub level: u32,
    pub pitch_mm: f64,
}

impl Slope {
    /// ∇f, signed.
    pub(super) fn of(self, f: &[f64]) -> Vec<f64> {
        let scale = REFERENCE_PITCH_MM / self.pitch_mm;
        let mut slope = derivative(f, self.wavelet, self.level);
        for d in &mut slope {
            *d *= scale;
        }
        slope
    }

    /// |∇f|.
    pub(super) fn magnitude(self, f: &[f64]) -> Vec<f64> {
        let mut slope = self.of(f);
        for d in &mut slope {
            *d = d.abs();
        }
        slope
    }
}

/// Which pixels are compared, and how their gradients are taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ViewKey {
    pub pixels: Range<usize>,
    pub wavelet: Wavelet,
    pub level: u32,
}

#[derive(Debug)]
pub(super) struct View {
    key: ViewKey,
    slope: Slope,
    all_pixels: usize,
    /// `[record][pixel of the view]`, if they are kept.
    gradients: Option<Vec<f32>>,
    value_basis: Basis,
    gradient_basis: Basis,
    /// By thickness.
    sketches: Vec<PairSketch>,
}

/// Descriptions of the values and gradients of all media at one thickness.
#[derive(Debug)]
pub(super) struct PairSketch {
    values: Sketch,
    gradients: Sketch,
    /// Least and greatest mean value of a record.
    pub levels: (f64, f64),
}

/// A measured profile in the bases of a view.
#[derive(Debug)]
pub(super) struct PairDescription {
    values: Description,
    gradient: Description,
}

impl PairSketch {
    /// Coefficients of the values of all media in the view's basis.
    pub(super) fn value_coefficients(&self) -> &Sketch {
        &self.values
    }

    /// Adds lower bounds of d(target, medium) for the media from `first` on.
    #[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
    #[inline(always)]
    pub(super) fn add_bounds(&self, target: &PairDescription, lambda: f64, first: usize, bounds: &mut [f32]) {
        self.values.add_bounds(&target.values, 1.0, first, bounds);
        self.gradients.add_bounds(&target.gradient, lambda as f32, first, bounds);
    }
}

impl View {
    pub(super) fn new(all: &Records, key: ViewKey) -> Self {
        let grid = all.grid();
        let sensor = grid.scene().sensor();
        let slope = Slope { wavelet: key.wavelet, level: key.level, pitch_mm: sensor.pitch_mm() };
        let (records, pixels) = (grid.record_count(), key.pixels.len());
        let values = |record: usize| &all.values(record)[key.pixels.clone()];
        let gradients = keeps_gradients(grid).then(|| {
            let mut gradients = vec![0.0_f32; records * pixels];
            let rows = gradients.par_chunks_exact_mut(pixels).enumerate();
            rows.for_each(|(record, out)| out.copy_from_slice(&gradient_of(slope, values(record))));
            gradients
        });
        let sampled: Vec<&[f32]> = (0..records).step_by(records.div_ceil(SAMPLES)).map(values).collect();
        let slopes: Vec<Vec<f32>> = sampled.par_iter().map(|values| gradient_of(slope, values)).collect();
        let slopes: Vec<&[f32]> = slopes.iter().map(Vec::as_slice).collect();
        let (value_basis, gradient_basis) = rayon::join(|| Basis::of(&sampled), || Basis::of(&slopes));
        let all_pixels = sensor.pixels();
        let mut view =
            Self { key, slope, all_pixels, gradients, value_basis, gradient_basis, sketches: Vec::new() };
        view.sketches =
            (0..grid.thickness_mm().len()).map(|thickness| view.sketch_of(all, thickness)).collect();
        view
    }

    fn sketch_of(&self, all: &Records, thickness: usize) -> PairSketch {
        let grid = all.grid();
        let (thicknesses, albedos) = (grid.thickness_mm().len(), grid.albedo().len());
        let media = grid.record_count() / thicknesses;
        let described: Vec<(Description, Description, f64)> = (0..media)
            .into_par_iter()
            .map(|medium| {
                let record = (medium / albedos * thicknesses + thickness) * albedos + medium % albedos;
                let values = &all.values(record)[self.key.pixels.clone()];
                let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64;
                let gradient = self.gradient(record, values);
                (
                    self.value_basis.describe_record(values),
                    self.gradient_basis.describe_record(&gradient),
                    mean,
                )
            })
            .collect();
        let mut levels = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut values, mut gradients) = (Vec::new(), Vec::new());
        for (value, gradient, mean) in described {
            levels = (levels.0.min(mean), levels.1.max(mean));
            values.push(value);
            gradients.push(gradient);
        }
        PairSketch { values: Sketch::of(&values), gradients: Sketch::of(&gradients), levels }
    }

    pub(super) fn slope(&self) -> Slope {
        self.slope
    }

    /// Pixels of a whole profile of the dictionary.
    pub(super) fn all_pixels(&self) -> usize {
        self.all_pixels
    }

    pub(super) fn pixels(&self) -> std::ops::Range<usize> {
        self.key.pixels.clone()
    }

    /// The gradient magnitudes of a record, whose values on the view's pixels are given.
    pub(super) fn gradient(&self, record: usize, values: &[f32]) -> Cow<'_, [f32]> {
        let pixels = self.key.pixels.len();
        match &self.gradients {
            Some(kept) => Cow::Borrowed(&kept[record * pixels..][..pixels]),
            None => Cow::Owned(gradient_of(self.slope, values)),
        }
    }

    pub(super) fn sketch(&self, thickness: usize) -> &PairSketch {
        &self.sketches[thickness]
    }

    pub(super) fn value_basis(&self) -> &Basis {
        &self.value_basis
    }

    /// Factor from the coefficients of sketches to those of profiles.
    pub(super) fn sketch_scale(&self) -> f64 {
        (self.key.pixels.len() as f64).sqrt()
    }

    pub(super) fn describe(&self, values: &[f64], gradient: &[f64]) -> PairDescription {
        PairDescription {
            values: self.value_basis.describe_target(values),
            gradient: self.gradient_basis.describe_target(gradient),
        }
    }
}

/// |∇f| in single precision, as records are compared.
fn gradient_of(slope: Slope, values: &[f32]) -> Vec<f32> {
    let values: Vec<f64> = values.iter().copied().map(f64::from).collect();
    slope.magnitude(&values).into_iter().map(|d| d as f32).collect()
}
