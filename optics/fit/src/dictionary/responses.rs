//! What the uncertain quantities of a scene do to the records of a dictionary in one channel: differences of profiles
//! that were traced in varied scenes and in the scene itself, with the same random walks.

use std::sync::Arc;

use optics_model::Grid;

use crate::dictionary::records::Records;

/// Bytes that a grid's responses take in one channel.
pub(crate) fn bytes_of(grid: &Grid) -> usize {
    let records = grid.stored_records() - grid.record_count();
    records.saturating_mul(grid.scene().sensor().pixels() * size_of::<f32>())
}

/// Differences as `[record beyond those of the axes][pixel]`.
#[derive(Debug)]
pub(crate) struct ResponseRecords {
    grid: Arc<Grid>,
    differences: Vec<f32>,
}

impl ResponseRecords {
    /// All values are 0 at first.
    pub(crate) fn new(grid: Arc<Grid>) -> Self {
        let numbers = bytes_of(&grid) / size_of::<f32>();
        Self { grid, differences: vec![0.0; numbers] }
    }

    /// Takes in the values of a record beyond those of the axes.
    pub(crate) fn set(&mut self, record: usize, values: impl Iterator<Item = f32>) {
        let (pixels, first) = (self.pixels(), self.grid.record_count());
        let row = &mut self.differences[(record - first) * pixels..][..pixels];
        row.iter_mut().zip(values).for_each(|(v, new)| *v = new);
    }

    /// Subtracts the records of the scene itself, once all are there.
    pub(crate) fn subtract(mut self, records: &Records) -> Self {
        let (pixels, albedos) = (self.pixels(), self.grid.albedo().len());
        for (i, row) in self.differences.chunks_exact_mut(pixels).enumerate() {
            let job = self.grid.nominal_jobs() + i / albedos;
            let place = self.grid.response_of(job).expect("a job beyond those of the axes is of a response");
            let nominal = self.grid.first_record(place.nominal_job) + i % albedos;
            let values = records.values(nominal, 0..pixels);
            row.iter_mut().zip(values.iter()).for_each(|(v, nominal)| *v -= nominal);
        }
        self
    }

    /// The difference that a variant makes to a record of the axes; None where it is not traced.
    pub(crate) fn difference(&self, variant: usize, record: usize) -> Option<&[f32]> {
        let (pixels, albedos) = (self.pixels(), self.grid.albedo().len());
        let job = self.grid.response_job(variant, record / albedos)?;
        let row = (job - self.grid.nominal_jobs()) * albedos + record % albedos;
        Some(&self.differences[row * pixels..][..pixels])
    }

    fn pixels(&self) -> usize {
        self.grid.scene().sensor().pixels()
    }
}
