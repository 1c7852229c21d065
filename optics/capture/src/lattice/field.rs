//! Measures how the light over the board differs from that of the flat shots, by the board's light squares, and corrects it.

use super::light::{LightChange, PatchRadiance};
use crate::least_squares::{FittedParameters, robust_fit};

/// Light over the board relative to that at the crop's middle, in one column: 1 + s · p + p Q p at a place p in units of
/// 10 mm, across the edge and along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LightField {
    /// Of p₀, p₁, p₀², p₀ p₁ and p₁².
    coefficients: [f64; TERMS],
    /// Standard error of the slope across the edge, per 10 mm.
    pub slope_std_error: f64,
}

const TERMS: usize = 5;

/// Standard deviation of the reflectance of a printed board: its slope per 10 mm.
pub(crate) const BOARD_SLOPE: f64 = 0.001;

/// Fewest light patches, and the largest standard error of the slope, with which a field counts as seen.
const PATCHES: usize = 12;
const SEEN: f64 = 0.002;

/// Standard errors, with the board's own slope, beyond which the field is corrected.
const CERTAIN: f64 = 3.0;

impl Default for LightField {
    /// Even light, of unknown slope.
    fn default() -> Self {
        Self { coefficients: [0.0; TERMS], slope_std_error: f64::INFINITY }
    }
}

impl LightField {
    /// The field of each column by the patches of a bare shot.
    pub fn measured(patches: &[PatchRadiance]) -> Vec<Self> {
        let columns = patches.first().map_or(0, |patch| patch.means.len());
        (0..columns).map(|c| Self::column(patches, c).unwrap_or_default()).collect()
    }

    fn column(patches: &[PatchRadiance], c: usize) -> Option<Self> {
        let light = patches.iter().filter(|p| p.is_light && p.means[c].value > 0.0);
        let point = |p: &PatchRadiance| {
            let [x, y] = p.place;
            ([1.0, x, y, x * x, x * y, y * y], libm::log(p.means[c].value))
        };
        let points: Vec<_> = light.map(point).collect();
        if points.len() < PATCHES {
            return None;
        }
        let bent = robust_fit(&points, 8);
        let straight: Vec<_> = points.iter().map(|(row, value)| ([row[0], row[1], row[2]], *value)).collect();
        let straight = robust_fit(&straight, 8);
        // Patches on few lines do not determine a bend.
        let errors = |fit: &(FittedParameters, f64)| fit.0.std_error(1) * fit.1;
        let (found, sigma) =
            bent.filter(|fit| errors(fit) < SEEN).or(straight.filter(|fit| errors(fit) < SEEN))?;
        let value = |i: usize| if i < found.x.len() { found.x[i] } else { 0.0 };
        let error = |i: usize| libm::hypot(sigma * found.std_error(i), BOARD_SLOPE);
        let is_certain = (1..found.x.len()).any(|i| value(i).abs() > CERTAIN * error(i));
        let coefficients = std::array::from_fn(|i| if is_certain { value(i + 1) } else { 0.0 });
        let lost = if is_certain { 0.0 } else { value(1) };
        Some(Self { coefficients, slope_std_error: libm::hypot(error(1), lost) })
    }

    /// The mean of each column over several shots.
    pub fn mean(shots: &[Vec<Self>]) -> Vec<Self> {
        let n = shots.len() as f64;
        let mean = |c: usize| Self {
            coefficients: std::array::from_fn(|i| {
                shots.iter().map(|s| s[c].coefficients[i]).sum::<f64>() / n
            }),
            slope_std_error: shots.iter().map(|s| s[c].slope_std_error).fold(0.0, f64::max),
        };
        (0..shots.first().map_or(0, Vec::len)).map(mean).collect()
    }

    /// This field in a shot whose light has another slope.
    pub fn under(mut self, light: &LightChange) -> Self {
        self.coefficients[0] += light.slope[0].value;
        self.coefficients[1] += light.slope[1].value;
        self
    }

    pub fn is_even(&self) -> bool {
        self.coefficients == [0.0; TERMS]
    }

    /// The greater slope at the crop's middle, per 10 mm across the edge or along it.
    pub fn steepest(&self) -> f64 {
        let [across, along] = [self.coefficients[0], self.coefficients[1]];
        if across.abs() > along.abs() { across } else { along }
    }

    pub fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let terms = [x, y, x * x, x * y, y * y];
        1.0 + self.coefficients.iter().zip(terms).map(|(c, t)| c * t).sum::<f64>()
    }
}
