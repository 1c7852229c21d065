//! The light over the board, and how that of a shot differs from it: values that correct radiance factors.

use crate::estimate::Estimate;

/// Light of a shot in one column, against that of the bare board b: (factor + slope · place) b + offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightChange {
    pub factor: Estimate,
    /// As a radiance factor: of a black level that drifts, and of stray light.
    pub offset: Estimate,
    /// Relative, per 10 mm across the edge and along it.
    pub slope: [Estimate; 2],
}

impl LightChange {
    /// The greater slope.
    pub(crate) fn steepest(&self) -> Estimate {
        let [across, along] = self.slope;
        if across.value.abs() > along.value.abs() { across } else { along }
    }
}

impl Default for LightChange {
    /// Unchanged light.
    fn default() -> Self {
        let none = Estimate::default();
        Self { factor: Estimate::new(1.0, 0.0), offset: none, slope: [none; 2] }
    }
}

/// Light over the board relative to that at the crop's middle, in one column: 1 + s · p + p Q p at a place p in units of
/// 10 mm, across the edge and along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LightField {
    /// The factors of p₀, p₁, p₀², p₀ p₁ and p₁².
    pub coefficients: [f64; FIELD_TERMS],
    /// Standard error of the slope across the edge, per 10 mm.
    pub slope_std_error: f64,
}

pub(crate) const FIELD_TERMS: usize = 5;

impl Default for LightField {
    /// Even light, of unknown slope.
    fn default() -> Self {
        Self { coefficients: [0.0; FIELD_TERMS], slope_std_error: f64::INFINITY }
    }
}

impl LightField {
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
        self.coefficients == [0.0; FIELD_TERMS]
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

/// The plane of the board: a linear map of pixels to places in units of 10 mm, across the edge and along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BoardPlane {
    pub origin_px: [f64; 2],
    pub per_px: [[f64; 2]; 2],
}

impl BoardPlane {
    pub fn place(&self, px: [f64; 2]) -> [f64; 2] {
        let [x, y] = [px[0] - self.origin_px[0], px[1] - self.origin_px[1]];
        self.per_px.map(|row| row[0] * x + row[1] * y)
    }
}
