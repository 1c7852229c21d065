//! Computes the distribution of χ².

/// Probability that noise alone makes χ² at least as large, with these degrees of freedom.
///
/// The cube root of χ²/k is close to normal (Wilson and Hilferty 1931): good to 1e-3 from three degrees of freedom on.
pub(crate) fn exceedance(chi2: f64, degrees_of_freedom: f64) -> f64 {
    if degrees_of_freedom <= 0.0 {
        return 1.0;
    }
    let spread = 2.0 / (9.0 * degrees_of_freedom);
    let z = (libm::cbrt(chi2 / degrees_of_freedom) - (1.0 - spread)) / spread.sqrt();
    0.5 * libm::erfc(z / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles from tables of χ²; without degrees of freedom nothing is unlikely.
    #[test]
    fn chi2_matches_tabled_quantiles() {
        assert_eq!([0.0, -2.5].map(|k| exceedance(5.0, k)), [1.0; 2]);
        for (chi2, k, p) in [
            (3.940, 10.0, 0.95),
            (9.342, 10.0, 0.5),
            (18.307, 10.0, 0.05),
            (124.342, 100.0, 0.05),
            (149.449, 100.0, 0.001),
        ] {
            let found = exceedance(chi2, k);
            assert!((found / p - 1.0_f64).abs() < 0.02, "{chi2} with {k}: {found}");
        }
    }
}
