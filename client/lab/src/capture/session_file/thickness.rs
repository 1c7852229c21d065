//! Reads the thickness of a slab: a number, or readings at several places, of which mean and standard error are taken.

use serde::Deserialize;

/// The thickness of a slab: a number, or readings at several places.
#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "a number is needed, or a list of readings")]
pub(super) enum Thickness {
    One(f64),
    Readings(Vec<f64>),
}

impl Thickness {
    pub(super) fn readings(&self) -> &[f64] {
        match self {
            Self::One(mm) => std::slice::from_ref(mm),
            Self::Readings(readings) => readings,
        }
    }

    /// The number as it stands, or the mean of readings to 0.1 µm.
    pub(super) fn mean_mm(&self) -> f64 {
        match self {
            Self::One(mm) => *mm,
            Self::Readings(readings) => {
                (1e4 * readings.iter().sum::<f64>() / readings.len() as f64).round() / 1e4
            }
        }
    }

    /// Standard error of the mean by the scatter of the readings.
    pub(super) fn scatter_mm(&self) -> f64 {
        let (readings, mean) = (self.readings(), self.mean_mm());
        let n = readings.len() as f64;
        let squares: f64 = readings.iter().map(|t| (t - mean).powi(2)).sum();
        if readings.len() < 2 { 0.0 } else { (squares / (n * (n - 1.0))).sqrt() }
    }

    /// Difference of the largest from the least, as a share of the mean.
    pub(super) fn range(&self) -> f64 {
        let ends = self.readings().iter().fold((f64::INFINITY, 0.0_f64), |(l, h), t| (l.min(*t), h.max(*t)));
        (ends.1 - ends.0) / self.mean_mm()
    }
}
