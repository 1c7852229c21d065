//! A dictionary in memory, laid out for comparison: values and gradient magnitudes of every record.

use farm_proto::{Grid, Record};
use rayon::prelude::*;

use super::distance::gradient_magnitude;

/// Collects records, which may come in any order.
#[derive(Debug)]
pub struct DictionaryBuilder {
    grid: Grid,
    values: Vec<f32>,
    present: usize,
}

impl DictionaryBuilder {
    pub fn new(grid: Grid) -> Self {
        let numbers = grid.record_count() * grid.scene().channels().len() * grid.scene().sensor().pixels();
        Self { grid, values: vec![0.0; numbers], present: 0 }
    }

    /// # Panics
    /// If the record is not of the grid's shape or number.
    pub fn add(&mut self, record: &Record) {
        let pixels = self.grid.scene().sensor().pixels();
        let channels = self.grid.scene().channels().len();
        assert_eq!(record.profiles.len(), channels, "one profile per channel");
        let rows = self.values[record.index * channels * pixels..].chunks_exact_mut(pixels);
        for (row, profile) in rows.zip(&record.profiles) {
            row.copy_from_slice(profile.radiance_factor.values());
        }
        self.present += 1;
    }

    /// Computes the gradients.
    ///
    /// # Panics
    /// If records are missing.
    pub fn build(self) -> FitDictionary {
        assert_eq!(self.present, self.grid.record_count(), "every record once");
        let sensor = self.grid.scene().sensor();
        let mut gradients = vec![0.0; self.values.len()];
        gradients
            .par_chunks_exact_mut(sensor.pixels())
            .zip(self.values.par_chunks_exact(sensor.pixels()))
            .for_each(|(gradient, values)| write_gradient(values, sensor.pitch_mm(), gradient));
        FitDictionary { grid: self.grid, values: self.values, gradients }
    }
}

fn write_gradient(values: &[f32], pitch_mm: f64, gradient: &mut [f32]) {
    if values.len() < 2 {
        return;
    }
    let values: Vec<f64> = values.iter().copied().map(f64::from).collect();
    for (out, magnitude) in gradient.iter_mut().zip(gradient_magnitude(&values, pitch_mm)) {
        *out = magnitude as f32;
    }
}

/// Values and gradient magnitudes of all records, `[record][channel][pixel]`.
#[derive(Debug)]
pub struct FitDictionary {
    grid: Grid,
    values: Vec<f32>,
    gradients: Vec<f32>,
}

impl FitDictionary {
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    pub(super) fn values(&self, record: usize, channel: usize) -> &[f32] {
        self.row(&self.values, record, channel)
    }

    pub(super) fn gradient(&self, record: usize, channel: usize) -> &[f32] {
        self.row(&self.gradients, record, channel)
    }

    /// Gradient magnitudes over a part of the pixels. The derivative takes off the chord between the ends, so that of
    /// a part is not a part of that of the whole.
    pub(super) fn gradient_of_part(
        &self,
        record: usize,
        channel: usize,
        pixels: std::ops::Range<usize>,
        out: &mut Vec<f32>,
    ) {
        out.resize(pixels.len(), 0.0);
        let values = &self.values(record, channel)[pixels];
        write_gradient(values, self.grid.scene().sensor().pitch_mm(), out);
    }

    fn row<'a>(&self, numbers: &'a [f32], record: usize, channel: usize) -> &'a [f32] {
        let pixels = self.grid.scene().sensor().pixels();
        let start = (record * self.grid.scene().channels().len() + channel) * pixels;
        &numbers[start..start + pixels]
    }
}
