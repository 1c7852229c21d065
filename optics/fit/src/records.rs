//! The values of all records of a dictionary in one channel.

use std::sync::Arc;

use optics_model::Grid;

/// Radiance factors as `[record][pixel]`.
#[derive(Debug)]
pub(super) struct Records {
    grid: Arc<Grid>,
    values: Vec<f32>,
}

impl Records {
    /// All values are 0 at first.
    pub(super) fn new(grid: Arc<Grid>) -> Self {
        let numbers = grid.record_count() * grid.scene().sensor().pixels();
        Self { grid, values: vec![0.0; numbers] }
    }

    pub(super) fn grid(&self) -> &Grid {
        &self.grid
    }

    pub(super) fn values(&self, record: usize) -> &[f32] {
        let pixels = self.pixels();
        &self.values[record * pixels..][..pixels]
    }

    pub(super) fn values_mut(&mut self, record: usize) -> &mut [f32] {
        let pixels = self.pixels();
        &mut self.values[record * pixels..][..pixels]
    }

    pub(super) fn pixels(&self) -> usize {
        self.grid.scene().sensor().pixels()
    }
}
