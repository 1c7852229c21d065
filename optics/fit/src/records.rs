//! The values of all records of a dictionary.

use optics_model::Grid;

/// Radiance factors as `[channel][record][pixel]`.
#[derive(Debug)]
pub(super) struct Records {
    grid: Grid,
    values: Vec<f32>,
}

impl Records {
    /// All values are 0 at first.
    pub(super) fn new(grid: Grid) -> Self {
        let scene = grid.scene();
        let numbers = grid.record_count() * scene.channels().len() * scene.sensor().pixels();
        Self { grid, values: vec![0.0; numbers] }
    }

    pub(super) fn grid(&self) -> &Grid {
        &self.grid
    }

    pub(super) fn values(&self, record: usize, channel: usize) -> &[f32] {
        let start = self.start(record, channel);
        &self.values[start..start + self.pixels()]
    }

    pub(super) fn values_mut(&mut self, record: usize, channel: usize) -> &mut [f32] {
        let (start, pixels) = (self.start(record, channel), self.pixels());
        &mut self.values[start..start + pixels]
    }

    fn start(&self, record: usize, channel: usize) -> usize {
        (channel * self.grid.record_count() + record) * self.pixels()
    }

    fn pixels(&self) -> usize {
        self.grid.scene().sensor().pixels()
    }
}
