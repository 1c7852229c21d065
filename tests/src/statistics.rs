//! Means with standard errors.

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

    /// Difference to another mean in standard errors, both counted.
    pub fn z(self, other: Self) -> f64 {
        (self.mean - other.mean) / self.std_error.hypot(other.std_error)
    }
}

/// χ² per pixel of two profiles with independent errors.
pub fn chi2_per_pixel(a: &[Mean], b: &[Mean]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.z(*b).powi(2)).sum::<f64>() / a.len() as f64
}
