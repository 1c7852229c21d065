//! The phase function of the sample: its parameters, density and azimuthal mean, each written once for all users.
//!
//! The tracer samples it and scores with the azimuthal mean; the fit's surrogate takes the shapes of its interpolation from
//! the density.

mod table;

use std::f64::consts::PI;
use std::sync::Arc;

use serde::Serialize;

use crate::invalid::{Invalid, Result, check};
pub use table::PhaseTable;

/// Largest |g| of a lobe.
pub const MOST_G: f64 = 0.999;
/// Largest weight of a second lobe.
pub const MOST_SECOND_WEIGHT: f64 = 0.5;
/// Weights of lobes are multiples of this in walks, whose cosines are drawn from as many numbers.
const WALK_WEIGHT: f64 = 1.0 / 65_536.0;

/// Refuses a value that is not a usable anisotropy.
pub fn check_g(value: f64) -> Result<f64> {
    check("g", value, |v| v.abs() <= MOST_G, "allowed are -0.999 to 0.999")
}

/// The second lobe of a two-term Henyey–Greenstein phase function: its weight b, and the anisotropy g₂ of the lobe.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct SecondLobe {
    weight: f64,
    g: f64,
}

impl SecondLobe {
    pub fn new(weight: f64, g: f64) -> Result<Self> {
        Ok(Self {
            weight: check(
                "second_lobe_weight",
                weight,
                |v| (0.0..=MOST_SECOND_WEIGHT).contains(&v),
                "allowed are 0 to 0.5",
            )?,
            g: check_g(g).map_err(|e| e.renamed("second_lobe_g"))?,
        })
    }

    /// b.
    pub fn weight(self) -> f64 {
        self.weight
    }

    /// g₂.
    pub fn g(self) -> f64 {
        self.g
    }

    /// This lobe, with the largest weight that a mean cosine g allows if its own is larger.
    #[must_use]
    pub fn limited_to(self, g: f64) -> Self {
        let end = MOST_G.copysign(self.first(g));
        if self.first(g).abs() <= MOST_G { self } else { Self { weight: (end - g) / (end - self.g), ..self } }
    }

    /// The anisotropy of the first lobe with which the mean cosine is g: g₁ = (g − b g₂)/(1 − b).
    pub fn first(self, g: f64) -> f64 {
        (g - self.weight * self.g) / (1.0 - self.weight)
    }
}

/// The shape of a phase function: all that its mean cosine leaves open.
#[derive(Debug, Clone, PartialEq)]
pub enum PhaseShape {
    /// Two-term Henyey–Greenstein; with a weight of 0, plain Henyey–Greenstein.
    Lobes(SecondLobe),
    /// A tabulated function, whose mean cosine is its own.
    Table(Arc<PhaseTable>),
}

impl Default for PhaseShape {
    fn default() -> Self {
        Self::Lobes(SecondLobe::default())
    }
}

impl PhaseShape {
    /// The phase function with the mean cosine g.
    pub fn function(&self, g: f64) -> Result<PhaseFunction> {
        match self {
            Self::Lobes(second) => {
                check_g(g)?;
                if second.first(g).abs() > MOST_G {
                    let (b, g2) = (second.weight, second.g);
                    let [low, high] = [-MOST_G, MOST_G].map(|first| (1.0 - b) * first + b * g2);
                    let allowed = format!(
                        "with a second lobe of weight {b} and anisotropy {g2}, allowed are {low:.3} to {high:.3}; without it -0.999 to 0.999"
                    );
                    return Err(Invalid::new("g", g, allowed));
                }
                Ok(PhaseFunction::lobes(g, *second))
            }
            Self::Table(table) => {
                // Grids and jobs carry the mean cosine in decimals.
                let own = table.mean_cosine();
                let allowed = format!("the tabulated phase function has a mean cosine of {own}");
                check("g", g, |g| (g - own).abs() < 1e-9, &allowed)?;
                Ok(PhaseFunction::Table(Arc::clone(table)))
            }
        }
    }

    /// The phase function with the mean cosine g, or with the nearest that the shape allows.
    #[must_use]
    pub fn function_near(&self, g: f64) -> PhaseFunction {
        match self {
            Self::Lobes(second) => {
                let first = second.first(g).clamp(-MOST_G, MOST_G);
                PhaseFunction::Lobes { first, second: *second }
            }
            Self::Table(table) => PhaseFunction::Table(Arc::clone(table)),
        }
    }

    /// The second lobe; None for a table.
    pub fn second_lobe(&self) -> Option<SecondLobe> {
        match self {
            Self::Lobes(second) => Some(*second),
            Self::Table(_) => None,
        }
    }

    pub fn table(&self) -> Option<&PhaseTable> {
        match self {
            Self::Lobes(_) => None,
            Self::Table(table) => Some(table),
        }
    }
}

/// A phase function, in 1/sr.
#[derive(Debug, Clone, PartialEq)]
pub enum PhaseFunction {
    /// (1 − b) HG(g₁) + b HG(g₂), with the Henyey–Greenstein function of anisotropy g,
    /// HG(cos θ) = (1 − g²) / (4π (1 + g² − 2 g cos θ)^{3/2}).
    Lobes {
        /// g₁.
        first: f64,
        second: SecondLobe,
    },
    Table(Arc<PhaseTable>),
}

impl PhaseFunction {
    fn lobes(g: f64, second: SecondLobe) -> Self {
        Self::Lobes { first: if second.weight == 0.0 { g } else { second.first(g) }, second }
    }

    /// Plain Henyey–Greenstein.
    pub fn henyey_greenstein(g: f64) -> Result<Self> {
        PhaseShape::default().function(g)
    }

    /// This phase function with a weight that walks can have; the mean cosine stays the same.
    #[must_use]
    pub fn with_walk_weight(&self) -> Self {
        match self {
            Self::Lobes { second, .. } if second.weight > 0.0 => {
                let weight = (second.weight / WALK_WEIGHT).round() * WALK_WEIGHT;
                Self::lobes(self.mean_cosine(), SecondLobe { weight, ..*second })
            }
            _ => self.clone(),
        }
    }

    /// This phase function with anisotropies in single precision.
    #[must_use]
    pub fn in_single_precision(&self) -> Self {
        let single = |v: f64| f64::from(v as f32);
        match self {
            Self::Lobes { first, second } => {
                let second = SecondLobe { g: single(second.g), ..*second };
                Self::Lobes { first: single(*first), second }
            }
            Self::Table(table) => Self::Table(Arc::clone(table)),
        }
    }

    /// Whether it is plain Henyey–Greenstein.
    pub fn is_single_lobe(&self) -> bool {
        matches!(self, Self::Lobes { second, .. } if second.weight == 0.0)
    }

    /// The mean cosine of the scattering angle.
    pub fn mean_cosine(&self) -> f64 {
        match self {
            Self::Lobes { first, second } => (1.0 - second.weight) * first + second.weight * second.g,
            Self::Table(table) => table.mean_cosine(),
        }
    }

    /// The angle in radians over which the narrowest peak of the density falls to a third: about 1 − |g| for a lobe.
    pub fn peak_width(&self) -> f64 {
        match self {
            Self::Lobes { first, .. } if self.is_single_lobe() => 1.0 - first.abs(),
            Self::Lobes { first, second } => 1.0 - first.abs().max(second.g.abs()),
            Self::Table(table) => table.peak_width(),
        }
    }

    /// 4π p(cos θ): the density as a multiple of isotropic scattering's.
    pub fn over_isotropic(&self, cosine: f64) -> f64 {
        let lobe = |g: f64| {
            let square = 1.0 + g * g - 2.0 * g * cosine;
            [(1.0 - g * g) / (square * square.sqrt())]
        };
        match self {
            Self::Lobes { first, second } => {
                let [density] = mixed(*first, *second, lobe);
                density
            }
            Self::Table(table) => table.over_isotropic(cosine),
        }
    }

    /// The density per steradian.
    pub fn density(&self, cosine: f64) -> f64 {
        self.over_isotropic(cosine) / (4.0 * PI)
    }

    /// The density for light that goes down with the cosine μ and a walk that arrives with the cosine u, averaged over
    /// the azimuth between them, in 1/sr. With the cosine of the angle uμ + √((1 − u²)(1 − μ²)) cos φ it is, for a lobe,
    ///
    /// (1 − g²)/(4π) · (2/π) E(m)/((a − b) √(a + b)), a = 1 + g² − 2guμ, b = 2|g| √((1 − u²)(1 − μ²)), m = 2b/(a + b),
    ///
    /// E being the complete elliptic integral (Gradshteyn and Ryzhik 2.575).
    pub fn azimuthal_mean(&self, u: f64, mu: f64) -> f64 {
        let [mean] = self.azimuthal_means([u], mu);
        mean
    }

    /// [`Self::azimuthal_mean`] for several cosines of walks at a time, with the same bits. The compiler can compute them
    /// in the lanes of a vector.
    #[expect(
        clippy::inline_always,
        reason = "it is compiled for the instructions of the function that calls it"
    )]
    #[inline(always)]
    pub fn azimuthal_means<const N: usize>(&self, u: [f64; N], mu: f64) -> [f64; N] {
        let across = u.map(|u| ((1.0 - u * u).max(0.0) * (1.0 - mu * mu).max(0.0)).sqrt());
        match self {
            Self::Lobes { first, second } => mixed(
                *first,
                *second,
                #[inline(always)]
                |g| of_lobe(g, u, mu, across),
            ),
            Self::Table(table) => std::array::from_fn(|i| table.azimuthal_mean(u[i] * mu, across[i])),
        }
    }
}

/// The azimuthal mean of a lobe.
#[expect(clippy::inline_always, reason = "it is compiled for the instructions of the function that calls it")]
#[inline(always)]
fn of_lobe<const N: usize>(g: f64, u: [f64; N], mu: f64, across: [f64; N]) -> [f64; N] {
    let a = u.map(|u| 1.0 + g * g - 2.0 * g * u * mu);
    let b = across.map(|across| 2.0 * g.abs() * across);
    let e = elliptic::<N>(std::array::from_fn(|i| 2.0 * b[i] / (a[i] + b[i])));
    std::array::from_fn(|i| (1.0 - g * g) / (4.0 * PI) * e[i] / ((a[i] - b[i]) * (a[i] + b[i]).sqrt()))
}

/// (1 − b) f(g₁) + b f(g₂), for several values at a time.
#[expect(clippy::inline_always, reason = "it is compiled for the instructions of the function that calls it")]
#[inline(always)]
fn mixed<const N: usize>(first: f64, second: SecondLobe, of_lobe: impl Fn(f64) -> [f64; N]) -> [f64; N] {
    let of_first = of_lobe(first);
    if second.weight == 0.0 {
        return of_first;
    }
    let of_second = of_lobe(second.g);
    std::array::from_fn(|i| (1.0 - second.weight) * of_first[i] + second.weight * of_second[i])
}

/// (2/π) E(m), by the arithmetic–geometric mean (Abramowitz and Stegun 17.6).
#[expect(clippy::inline_always, reason = "it is compiled for the instructions of the function that calls it")]
#[inline(always)]
fn elliptic<const N: usize>(m: [f64; N]) -> [f64; N] {
    let (mut a, mut b, mut c2) = ([1.0; N], m.map(|m| (1.0 - m).max(0.0).sqrt()), m);
    let (mut sum, mut power) = (c2.map(|c2| 0.5 * c2), 0.5);
    while c2.iter().any(|c2| *c2 > 1e-16) {
        power *= 2.0;
        for i in 0..N {
            // A lane that has converged stays as it is.
            let goes_on = c2[i] > 1e-16;
            let (mean, root) = (0.5 * (a[i] + b[i]), (a[i] * b[i]).sqrt());
            let half = 0.5 * (a[i] - b[i]);
            let next = half * half;
            sum[i] = if goes_on { sum[i] + power * next } else { sum[i] };
            c2[i] = if goes_on { next } else { c2[i] };
            a[i] = if goes_on { mean } else { a[i] };
            b[i] = if goes_on { root } else { b[i] };
        }
    }
    std::array::from_fn(|i| (1.0 - sum[i]) / a[i])
}

#[cfg(test)]
mod tests;
