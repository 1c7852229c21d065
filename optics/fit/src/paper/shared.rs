//! What several channels share – a scale factor, an anisotropy – and how its uncertainty reaches each of them.
//!
//! The unknowns of channel i are its own, x_i, and the shared ones, θ. With H_i the second derivative of its Eq. 1 and
//! ψ_i = Σ K δr what noise does to the gradient, eliminating every x_i leaves S δθ = Σ_i φ_i with
//!
//!   φ_i = ψ_i,θ − H_i,θx H_i,xx⁻¹ ψ_i,x,   S = Σ_i H_i,θθ − H_i,θx H_i,xx⁻¹ H_i,xθ   (a Schur complement),
//!
//! and then δx_i = H_i,xx⁻¹ (ψ_i,x − H_i,xθ δθ). A channel's own noise moves it directly and through θ, which are
//! correlated; that of the others through θ alone.
//!
//! At the common optimum the channels' pulls φ_i on θ add up to zero, but need not be as small as their noise says: where
//! they scatter more, as they do if something in the photographs is not in the model, the covariance of θ is scaled up
//! to them (a Birge ratio, as for measurements of one quantity that disagree).

use glam::{DMat4, DVec4};

use crate::paper::noise::{Noise, outer};
use crate::paper::refine::invert;

/// A channel's noise, and which unknowns are its own.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part<'a> {
    pub noise: &'a Noise,
    pub own: [bool; 4],
    /// Where the channel's error falls, by all unknowns, at the common optimum.
    pub downhill: DVec4,
}

/// The shared unknowns as functions of all channels' data.
#[derive(Debug)]
pub(crate) struct Shared {
    /// Which unknowns are shared.
    which: [bool; 4],
    /// S⁻¹, zero outside the shared unknowns.
    inverse: DMat4,
    /// Covariance of φ of every channel.
    pulls: Vec<DMat4>,
    pull: DMat4,
    /// What one standard error of a scale factor that was given does to Σ φ.
    by_scale: DVec4,
    /// Variance of the pulls over what noise explains, at least 1.
    disagreement: f64,
}

/// The identity on what is free.
pub(crate) fn mask(free: [bool; 4]) -> DMat4 {
    DMat4::from_diagonal(DVec4::from_array(free.map(|free| if free { 1.0 } else { 0.0 })))
}

/// Takes ψ to φ: what is left on the shared unknowns once the own ones have followed.
fn eliminated(hessian: DMat4, inverse_own: DMat4, shared: [bool; 4]) -> DMat4 {
    mask(shared) * (DMat4::IDENTITY - hessian * inverse_own)
}

/// S⁻¹ of the channels' second derivatives, each with its own unknowns; zero if it is singular.
pub(crate) fn inverse_of_shared(
    channels: impl IntoIterator<Item = (DMat4, DMat4)>,
    shared: [bool; 4],
) -> DMat4 {
    let ridge = DMat4::from_diagonal(DVec4::splat(1e-12));
    let complement =
        |(hessian, inverse_own)| eliminated(hessian, inverse_own, shared) * hessian * mask(shared);
    let sum = channels.into_iter().map(complement).fold(ridge, |a, b| a + b);
    invert(sum, shared).unwrap_or(DMat4::ZERO)
}

impl Shared {
    pub(crate) fn new(parts: &[Part], shared: [bool; 4]) -> Self {
        let inverse_own = |part: &Part| part.noise.inverse_hessian(part.own);
        let inverse = inverse_of_shared(parts.iter().map(|p| (p.noise.hessian, inverse_own(p))), shared);
        let eliminated = |p: &Part| eliminated(p.noise.hessian, inverse_own(p), shared);
        let pulls: Vec<DMat4> = parts
            .iter()
            .map(|p| {
                let a = eliminated(p);
                a * p.noise.own() * a.transpose()
            })
            .collect();
        let pull = pulls.iter().fold(DMat4::ZERO, |sum, p| sum + *p);
        let by_scale = parts.iter().map(|p| eliminated(p) * p.noise.by_scale).fold(DVec4::ZERO, |a, b| a + b);
        let found: Vec<DVec4> = parts.iter().map(|p| eliminated(p) * p.downhill).collect();
        let disagreement = disagreement(&found, &pulls, shared);
        Self { which: shared, inverse, pulls, pull, by_scale, disagreement }
    }

    /// Covariance of the shared unknowns.
    pub(crate) fn covariance(&self) -> DMat4 {
        let random = self.inverse * self.pull * self.inverse.transpose();
        random * self.disagreement + outer(self.inverse * self.by_scale)
    }

    /// Covariance of all unknowns of a channel, of which `part.own` are its own.
    pub(crate) fn of(&self, channel: usize, part: &Part) -> DMat4 {
        let (noise, inverse_own) = (part.noise, part.noise.inverse_hessian(part.own));
        // δ = H_xx⁻¹ ψ + (1 − H_xx⁻¹ H) δθ.
        let through = (DMat4::IDENTITY - inverse_own * noise.hessian) * mask(self.which) * self.inverse;
        let own = inverse_own + through * eliminated(noise.hessian, inverse_own, self.which);
        let others = self.pull - self.pulls[channel];
        own * noise.own() * own.transpose()
            + through * (others + self.pull * (self.disagreement - 1.0)) * through.transpose()
            + outer(inverse_own * noise.by_scale + through * self.by_scale)
    }
}

/// χ² of the pulls a degree of freedom, but at least 1.
fn disagreement(found: &[DVec4], covariances: &[DMat4], shared: [bool; 4]) -> f64 {
    let unknowns = shared.iter().filter(|s| **s).count();
    let freedom = unknowns * found.len().saturating_sub(1);
    if freedom == 0 {
        return 1.0;
    }
    let square = |(pull, covariance): (&DVec4, &DMat4)| {
        let inverse = invert(*covariance, shared).unwrap_or(DMat4::ZERO);
        pull.dot(inverse * *pull).max(0.0)
    };
    let sum: f64 = found.iter().zip(covariances).map(square).sum();
    (sum / freedom as f64).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: f64) -> Noise {
        let v = |k: f64| {
            DVec4::from_array(
                [0.0, 1.0, 2.0, 3.0].map(|i| (seed + 1.7 * k + 2.3 * i + 0.37 * i * i * k).sin()),
            )
        };
        let square = |k: f64| (0..6).fold(DMat4::ZERO, |sum, n| sum + outer(v(k + f64::from(n))));
        Noise::for_test(square(0.0), square(20.0), v(50.0))
    }

    /// The whole system of all channels' unknowns at once, solved by elimination, gives the same covariances.
    #[test]
    fn eliminating_channel_by_channel_solves_the_whole_system() {
        let noises = [noise(0.3), noise(1.1), noise(2.9)];
        let (own, shared) = ([true, true, false, false], [false, false, true, true]);
        let parts = noises.each_ref().map(|noise| Part { noise, own, downhill: DVec4::ZERO });
        let found = Shared::new(&parts, shared);
        // Unknowns: (x₀, x₁) of each channel, then θ.
        let (n, theta) = (8, 6);
        let place = |channel: usize, unknown: usize| {
            if unknown < 2 { 2 * channel + unknown } else { theta + unknown - 2 }
        };
        let mut whole = vec![vec![0.0; n]; n];
        let mut source = vec![vec![0.0; n]; n];
        let mut by_scale = vec![0.0; n];
        for (c, noise) in noises.iter().enumerate() {
            for i in 0..4 {
                by_scale[place(c, i)] += noise.by_scale[i];
                for j in 0..4 {
                    whole[place(c, i)][place(c, j)] += noise.hessian.col(j)[i];
                    source[place(c, i)][place(c, j)] += noise.own().col(j)[i];
                }
            }
        }
        let inverse = inverted(whole);
        let covariance = |i: usize, j: usize| -> f64 {
            let mut sum = 0.0;
            for k in 0..n {
                for l in 0..n {
                    sum += inverse[i][k] * (source[k][l] + by_scale[k] * by_scale[l]) * inverse[j][l];
                }
            }
            sum
        };
        for (c, part) in parts.iter().enumerate() {
            let of = found.of(c, part);
            for i in 0..4 {
                for j in 0..4 {
                    let exact = covariance(place(c, i), place(c, j));
                    assert!((of.col(j)[i] - exact).abs() < 1e-6 * (1.0 + exact.abs()), "{c} {i} {j}");
                }
            }
        }
        let both = found.covariance();
        assert!((both.col(3)[2] - covariance(theta, theta + 1)).abs() < 1e-6);
    }

    /// Three channels that each pull by twice their standard deviation: χ² is 12 with two degrees of freedom.
    #[test]
    fn channels_that_disagree_widen_what_they_share() {
        let shared = [false, false, true, false];
        let covariance = DMat4::from_diagonal(DVec4::new(1.0, 1.0, 0.09, 1.0));
        let pull = |v: f64| DVec4::new(5.0, 0.0, v, 0.0);
        let found = disagreement(&[pull(0.6), pull(-0.6), pull(0.6)], &[covariance; 3], shared);
        assert!((found - 6.0).abs() < 1e-9, "{found}");
        assert_eq!(disagreement(&[pull(0.1), pull(-0.1), pull(0.0)], &[covariance; 3], shared), 1.0);
        assert_eq!(disagreement(&[pull(9.0)], &[covariance], shared), 1.0);
    }

    fn inverted(mut a: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        let n = a.len();
        let mut b: Vec<Vec<f64>> =
            (0..n).map(|i| (0..n).map(|j| if i == j { 1.0 } else { 0.0 }).collect()).collect();
        for i in 0..n {
            let pivot = a[i][i];
            for j in 0..n {
                a[i][j] /= pivot;
                b[i][j] /= pivot;
            }
            for k in (0..n).filter(|k| *k != i) {
                let factor = a[k][i];
                for j in 0..n {
                    a[k][j] -= factor * a[i][j];
                    b[k][j] -= factor * b[i][j];
                }
            }
        }
        b
    }
}
