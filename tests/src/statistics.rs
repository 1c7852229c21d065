//! Computes means and shares with standard errors, and random numbers for noise.

use std::fmt;

use optics_model::Medium;

/// Mean of independent samples and its standard error.
#[derive(Debug, Clone, Copy)]
pub struct Mean {
    pub mean: f64,
    pub std_error: f64,
}

impl Mean {
    /// # Panics
    /// With fewer than two samples.
    pub fn of(samples: &[f64]) -> Self {
        assert!(samples.len() > 1, "a standard error needs two samples");
        let n = samples.len() as f64;
        let mean = samples.iter().sum::<f64>() / n;
        let variance = samples.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Self { mean, std_error: (variance / n).sqrt() }
    }

    /// Difference to another mean, in standard errors of the difference.
    pub fn z(self, other: Self) -> f64 {
        (self.mean - other.mean) / libm::hypot(self.std_error, other.std_error)
    }
}

/// Root mean square of each side's standard errors over the 21 pixels around each one.
///
/// Where bright paths are rare, a pixel's own estimate of its error is noisy, and small when its value is small: the
/// bright paths are missing from both. Neighbours have nearly the same true error.
pub fn errors_of_neighbours(std_errors: &[f64]) -> Vec<f64> {
    const REACH: usize = 10;
    let smooth = |side: &[f64]| -> Vec<f64> {
        (0..side.len())
            .map(|i| {
                let around = &side[i.saturating_sub(REACH)..(i + REACH + 1).min(side.len())];
                (around.iter().map(|e| e * e).sum::<f64>() / around.len() as f64).sqrt()
            })
            .collect()
    };
    let (dark, light) = std_errors.split_at(std_errors.len() / 2);
    [smooth(dark), smooth(light)].concat()
}

/// χ² per pixel of two profiles with independent errors.
pub fn chi2_per_pixel(a: &[Mean], b: &[Mean]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.z(*b).powi(2)).sum::<f64>() / a.len() as f64
}

/// The median.
///
/// # Panics
/// Without values.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The quantile of a share from 0 to 1.
///
/// # Panics
/// Without values.
pub fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (share * values.len() as f64) as usize;
    values[place.min(values.len() - 1)]
}

/// The share of trials in which a condition held, with the binomial standard error.
#[derive(Debug, Clone, Copy)]
pub struct Share {
    pub share: f64,
    pub std_error: f64,
}

impl Share {
    /// None without trials.
    pub fn of(held: impl IntoIterator<Item = bool>) -> Option<Self> {
        let held: Vec<bool> = held.into_iter().collect();
        let n = held.len() as f64;
        let share = held.iter().filter(|held| **held).count() as f64 / n;
        (n > 0.0).then(|| Self { share, std_error: (share * (1.0 - share) / n).sqrt() })
    }

    /// Trials of groups that share their errors, as intervals of one session do: the standard error is that of the ratio
    /// of two sums over independent groups. None without trials.
    pub fn of_groups(groups: &[Vec<bool>]) -> Option<Self> {
        let held = |group: &[bool]| group.iter().filter(|held| **held).count() as f64;
        let n = groups.iter().map(Vec::len).sum::<usize>() as f64;
        let share = groups.iter().map(|group| held(group)).sum::<f64>() / n;
        let off = |group: &Vec<bool>| (held(group) - share * group.len() as f64).powi(2);
        (n > 0.0).then(|| Self { share, std_error: groups.iter().map(off).sum::<f64>().sqrt() / n })
    }
}

/// Writes the share in per cent.
impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1} ± {:.1}", 100.0 * self.share, 100.0 * self.std_error)
    }
}

/// Factor on the length of statistical tests: `FARM_TEST_EFFORT=16 cargo test …`.
///
/// # Panics
/// If the variable is not a whole number.
pub fn effort() -> u64 {
    effort_or(1, 1)
}

/// Length of a statistical test that has another unit in its long form: a number without an effort, and for each unit of
/// it.
///
/// # Panics
/// If the variable is not a whole number.
pub fn effort_or(normal: u64, unit: u64) -> u64 {
    let parse = |v: String| unit * v.parse::<u64>().expect("FARM_TEST_EFFORT is a whole number");
    std::env::var("FARM_TEST_EFFORT").map_or(normal, parse)
}

/// Random numbers for noise on traced profiles: a SplitMix64 stream.
#[derive(Debug, Clone)]
pub struct Normal(u64);

impl Normal {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0xD134_2543_DE82_EF95))
    }

    /// Uniform from 0 to 1.
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Log-uniform between two limits.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        low * libm::pow(high / low, self.uniform())
    }

    /// A medium with σ_t from 1.1 to 28 /mm and 1 − α from 0.001 to 0.7, both log-uniform.
    pub fn medium(&mut self, g: f64) -> Medium {
        let (sigma_t, co_albedo) = (self.log_uniform(1.1, 28.0), self.log_uniform(1e-3, 0.7));
        Medium::new(sigma_t, 1.0 - co_albedo, g).unwrap()
    }

    /// Standard normal, after Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(1.0 - self.uniform())).sqrt();
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }
}
