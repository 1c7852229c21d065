//! Gradients and descriptions of all records over some of the pixels.
//!
//! The wavelet derivative takes off the chord between the ends, so the gradients of a part are not a part of the
//! whole's: every range of pixels needs its own.

use std::ops::Range;

use optics_model::fit::Wavelet;
use rayon::prelude::*;

use super::gradient::derivative;
use super::records::Records;
use super::sketch::{Basis, Description, Sketch};

/// Pixel pitch that gradients are told per, in mm: 360 pixels over 10 mm.
pub(super) const REFERENCE_PITCH_MM: f64 = 10.0 / 360.0;

/// Profiles that a basis is made from.
const SAMPLES: usize = 2000;

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
    records: usize,
    all_pixels: usize,
    /// `[channel][record][pixel of the view]`.
    gradients: Vec<f32>,
    value_basis: Basis,
    gradient_basis: Basis,
    /// `[channel][thickness]`.
    sketches: Vec<Vec<PairSketch>>,
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
    pub(super) fn add_bounds(&self, target: &PairDescription, lambda: f64, first: usize, bounds: &mut [f32]) {
        self.values.add_bounds(&target.values, 1.0, first, bounds);
        self.gradients.add_bounds(&target.gradient, lambda as f32, first, bounds);
    }
}

impl View {
    pub(super) fn new(all: &Records, key: ViewKey) -> Self {
        let scene = all.grid().scene();
        let slope = Slope { wavelet: key.wavelet, level: key.level, pitch_mm: scene.sensor().pitch_mm() };
        let (records, pixels) = (all.grid().record_count(), key.pixels.len());
        let (channels, all_pixels) = (scene.channels().len(), scene.sensor().pixels());
        let mut gradients = vec![0.0_f32; channels * records * pixels];
        gradients.par_chunks_exact_mut(pixels).enumerate().for_each(|(row, out)| {
            let values = &all.values(row % records, row / records)[key.pixels.clone()];
            let values: Vec<f64> = values.iter().copied().map(f64::from).collect();
            for (out, d) in out.iter_mut().zip(slope.magnitude(&values)) {
                *out = d as f32;
            }
        });
        let step = (channels * records).div_ceil(SAMPLES);
        let sampled = || (0..channels * records).step_by(step);
        let values: Vec<&[f32]> =
            sampled().map(|row| &all.values(row % records, row / records)[key.pixels.clone()]).collect();
        let slopes: Vec<&[f32]> = sampled().map(|row| &gradients[row * pixels..][..pixels]).collect();
        let (value_basis, gradient_basis) = rayon::join(|| Basis::of(&values), || Basis::of(&slopes));
        let mut view = Self {
            key,
            slope,
            records,
            all_pixels,
            gradients,
            value_basis,
            gradient_basis,
            sketches: Vec::new(),
        };
        view.sketches = (0..channels).map(|channel| view.sketch_channel(all, channel)).collect();
        view
    }

    fn sketch_channel(&self, all: &Records, channel: usize) -> Vec<PairSketch> {
        let grid = all.grid();
        let (thicknesses, albedos) = (grid.thickness_mm().len(), grid.albedo().len());
        let media = self.records / thicknesses;
        let sketch = |thickness: usize| {
            let described: Vec<(Description, Description, f64)> = (0..media)
                .into_par_iter()
                .map(|medium| {
                    let record = (medium / albedos * thicknesses + thickness) * albedos + medium % albedos;
                    let values = &all.values(record, channel)[self.key.pixels.clone()];
                    let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64;
                    let gradient = self.gradient(record, channel);
                    (
                        self.value_basis.describe_record(values),
                        self.gradient_basis.describe_record(gradient),
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
        };
        (0..thicknesses).map(sketch).collect()
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

    pub(super) fn gradient(&self, record: usize, channel: usize) -> &[f32] {
        let pixels = self.key.pixels.len();
        &self.gradients[(channel * self.records + record) * pixels..][..pixels]
    }

    pub(super) fn sketch(&self, channel: usize, thickness: usize) -> &PairSketch {
        &self.sketches[channel][thickness]
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
