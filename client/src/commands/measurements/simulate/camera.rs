//! Adds the noise of a camera to simulated profiles: independent in every pixel, as the fit assumes for the errors of
//! photographs. Errors of a simulation are correlated between neighbouring pixels, so that the likelihood would
//! overestimate their information.

use anyhow::Result;
use optics_model::{Estimate, Invalid, Profile};

/// Default noise as a share of a pixel's value.
pub(super) const NOISE: f64 = 0.005;
/// Number of uniform numbers, with variance 1/12 each, whose sum is normal except in its far tails.
const UNIFORM: usize = 12;

/// A camera whose pixels have this noise.
#[derive(Debug)]
pub(super) struct SimulatedCamera {
    noise: f64,
    /// The noise of a seed is equal on every machine: it uses sums of integers, and no function that libraries round
    /// differently.
    random: blake3::OutputReader,
}

impl SimulatedCamera {
    /// `None` without noise; `noise` is a share of each value.
    pub(super) fn new(noise: f64, seed: u64) -> Result<Option<Self>> {
        if !(0.0..=0.5).contains(&noise) {
            return Err(Invalid::new("noise", noise, "allowed are shares from 0 to 0.5").into());
        }
        let mut hasher = blake3::Hasher::new_derive_key("resin-farm 2026-11 noise of a simulated camera");
        hasher.update(&seed.to_le_bytes());
        Ok((noise > 0.0).then(|| Self { noise, random: hasher.finalize_xof() }))
    }

    /// Profiles as photographed by the camera; their standard errors are those of its noise alone.
    pub(super) fn photograph(&mut self, profiles: &[Profile]) -> Result<Vec<Profile>> {
        let seen = |profile: &Profile| {
            let exact = profile.radiance_factor.values();
            let errors: Vec<f64> = exact.iter().map(|v| self.noise * f64::from(*v)).collect();
            let values = exact.iter().zip(&errors).map(|(v, e)| (f64::from(*v) + e * self.normal()) as f32);
            let values = values.collect();
            let errors = errors.iter().map(|e| *e as f32).collect();
            Ok(Profile { radiance_factor: Estimate::new(values, errors)?, derivatives: None })
        };
        profiles.iter().map(seen).collect()
    }

    fn normal(&mut self) -> f64 {
        let mut bytes = [0; 4 * UNIFORM];
        self.random.fill(&mut bytes);
        let (words, _) = bytes.as_chunks::<4>();
        let sum: u64 = words.iter().map(|word| u64::from(u32::from_le_bytes(*word))).sum();
        sum as f64 / 2.0_f64.powi(32) - UNIFORM as f64 / 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The pixels scatter by the stated noise.
    #[test]
    fn pixels_scatter_by_the_stated_noise() {
        let exact = Estimate::new(vec![0.8; 40_000], vec![0.1; 40_000]).unwrap();
        let exact = [Profile { radiance_factor: exact, derivatives: None }];
        let mut camera = SimulatedCamera::new(0.01, 3).unwrap().unwrap();
        let seen = camera.photograph(&exact).unwrap().remove(0).radiance_factor;
        assert!(seen.std_errors().iter().all(|e| *e == 0.008));
        let z: Vec<f64> = seen.values().iter().map(|v| (f64::from(*v) - 0.8) / 0.008).collect();
        let (n, sum) = (z.len() as f64, z.iter().sum::<f64>());
        let variance = z.iter().map(|z| z * z).sum::<f64>() / n;
        let neighbours = z.windows(2).map(|z| z[0] * z[1]).sum::<f64>() / n;
        // Four standard errors of each estimate.
        let within = 4.0 / n.sqrt();
        assert!((sum / n).abs() < within && neighbours.abs() < within, "{sum} {neighbours}");
        assert!((variance - 1.0).abs() < within * 2.0_f64.sqrt(), "{variance}");
        // The values are equal on every machine.
        assert_eq!(seen.values()[0].to_bits(), 1_061_897_663);
    }

    /// The noise is a share of at most one half.
    #[test]
    fn noise_is_at_most_a_half() {
        assert!(SimulatedCamera::new(0.0, 1).unwrap().is_none());
        for noise in [-0.1, 0.6, f64::NAN] {
            assert!(SimulatedCamera::new(noise, 1).unwrap_err().to_string().contains("noise"));
        }
    }
}
