//! The measured media and their slabs.

use farm_tests::statistics::Normal;
use optics_model::Medium;

/// Nominal thicknesses of the slabs.
pub(super) const SLABS_MM: [f64; 2] = [0.5, 1.0];
/// Standard deviation of a slab's thickness about the nominal one, at the typical size.
const THICKNESS_MM: f64 = 0.005;

/// A medium, and the random thicknesses of its slabs.
#[derive(Debug, Clone)]
pub(super) struct Subject {
    pub number: u64,
    pub medium: Medium,
    /// Deviations of the slabs from their nominal thicknesses, in standard deviations.
    thickness_off: [f64; 2],
}

impl Subject {
    /// σ_t from 1.1 to 28 /mm and 1 − α from 0.001 to 0.7, both log-uniform, and g uniform in a range: all off the
    /// grid.
    pub(super) fn draw(number: u64, (g_min, g_max): (f64, f64)) -> Self {
        let mut random = Normal::new(410_000 + number);
        let mut log = |low: f64, high: f64| low * (high / low).powf(random.uniform());
        let (sigma_t, co_albedo) = (log(1.1, 28.0), log(1e-3, 0.7));
        let g = g_min + (g_max - g_min) * random.uniform();
        let thickness_off = [random.normal(), random.normal()];
        Self { number, medium: Medium::new(sigma_t, 1.0 - co_albedo, g).unwrap(), thickness_off }
    }

    /// True thickness of a slab, in mm, for deviations of a multiple of their typical size.
    pub(super) fn thickness_mm(&self, slab: usize, size: f64) -> f64 {
        SLABS_MM[slab] + size * THICKNESS_MM * self.thickness_off[slab]
    }
}
