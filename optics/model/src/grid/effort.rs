//! Sets the number of walks that the transport points of a grid begin with: a given number, or as many as a level of
//! noise needs.

use super::{BATCH_WALKS, Walks};
use crate::invalid::{Invalid, Result};
use crate::medium::TransportPoint;

/// Level of the noise of the walks of records, of which exact levels remove a part.
///
/// The paper's own level is the noise of its path tracer with 250,000 samples per pixel. The variance of such a sample is
/// known exactly, see `docs/design/estimator.md`: at an albedo α and reflectances ρ it is F(α², ρ²)/Δ − F(α, ρ)², F being
/// the profile and Δ the ring's measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoiseLevel {
    /// A tenth of the walks: errors three times as large.
    Draft,
    Paper,
    /// Ten times the walks: errors a third as large.
    Fine,
}

impl NoiseLevel {
    pub const ALL: [Self; 3] = [Self::Draft, Self::Paper, Self::Fine];

    pub fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Paper => "paper",
            Self::Fine => "fine",
        }
    }

    pub fn from_name(name: &str) -> Result<Self> {
        let level = Self::ALL.into_iter().find(|level| level.name() == name);
        level.ok_or_else(|| Invalid::new("quality", name, "allowed are draft, paper and fine"))
    }

    /// Walks that the noisiest record of a point needs, which is the brightest.
    ///
    /// Found by tracing: in units of the paper's variance, the variance of a walk depends practically on the optical
    /// thickness alone, as (τ + 1.3)/(τ + 3). Exact levels remove more in thick samples, but fewer walks there make shapes
    /// too noisy for anisotropies.
    pub fn walks(self, point: &TransportPoint) -> Walks {
        // Part of the physics version: the walks of a level are not in a grid's digest.
        const OF_THICK: f64 = 53_000.0;
        let share = match self {
            Self::Draft => 0.1,
            Self::Paper => 1.0,
            Self::Fine => 10.0,
        };
        // In single precision, in which points that share their walks have the same value.
        let tau = f64::from(point.walked_slab().optical_thickness);
        let walks = share * OF_THICK * (tau + 1.3) / (tau + 3.0);
        let batches = (walks / BATCH_WALKS as f64).ceil() as u64;
        Walks::new(batches * BATCH_WALKS).expect("whole batches, and enough of them")
    }
}

/// The effort for the points of a grid, or their initial effort if there is a target for their error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effort {
    /// An equal number for all points.
    Walks(Walks),
    Noise(NoiseLevel),
}

impl Effort {
    pub fn walks(self, point: &TransportPoint) -> Walks {
        match self {
            Self::Walks(walks) => walks,
            Self::Noise(level) => level.walks(point),
        }
    }
}

impl From<Walks> for Effort {
    fn from(walks: Walks) -> Self {
        Self::Walks(walks)
    }
}

impl From<NoiseLevel> for Effort {
    fn from(level: NoiseLevel) -> Self {
        Self::Noise(level)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walks(level: NoiseLevel, sigma_t: f64) -> u64 {
        level.walks(&TransportPoint::new(sigma_t, 0.4, 1.0, 1.53).unwrap()).get()
    }

    /// Thick samples need more walks than thin ones for the same noise.
    #[test]
    fn thick_samples_need_more_walks() {
        assert_eq!([0.5, 2.0, 30.0].map(|tau| walks(NoiseLevel::Paper, tau)), [27_500, 35_000, 50_500]);
        assert_eq!(walks(NoiseLevel::Draft, 2.0), 3_500);
        assert_eq!(walks(NoiseLevel::Fine, 2.0), 350_000);
        // A very thin and a very thick sample.
        assert_eq!([1e-4, 1e4].map(|tau| walks(NoiseLevel::Draft, tau)), [2_500, 5_500]);
    }

    #[test]
    fn levels_are_found_by_their_names() {
        for level in NoiseLevel::ALL {
            assert_eq!(NoiseLevel::from_name(level.name()), Ok(level));
        }
        let error = NoiseLevel::from_name("best").unwrap_err().to_string();
        assert_eq!(error, "quality = best is not valid: allowed are draft, paper and fine");
    }
}
