//! Computes media that scatter alike by similarity theory (Wyman et al. 1989), Eqs. 4 to 6 of the paper.

use optics_model::{Invalid, Medium};

/// The medium with anisotropy g' that is similar to another: σ_a' = σ_a (Eq. 4) and
/// σ_s' = σ_s (1 − g)/(1 − g') (Eq. 6).
pub fn similar(medium: &Medium, g: f64) -> Result<Medium, Invalid> {
    let absorption = medium.absorption_per_mm();
    // A g' of 1 makes an infinity, which the medium's own check refuses.
    let scattering = medium.reduced_scattering_per_mm() / (1.0 - g);
    let extinction = absorption + scattering;
    Medium::new(extinction, scattering / extinction, g)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Similar media have the same absorption and the same reduced scattering.
    #[test]
    fn similar_media_agree_after_reduction() {
        let white = Medium::new(6.0, 0.9991, 0.4).unwrap();
        for g in [-0.5, 0.0, 0.4, 0.8] {
            let other = similar(&white, g).unwrap();
            let absorption = |m: &Medium| m.sigma_t_per_mm() * (1.0 - m.albedo());
            let reduced = |m: &Medium| m.sigma_t_per_mm() * m.albedo() * (1.0 - m.g());
            assert!((absorption(&other) - absorption(&white)).abs() < 1e-12);
            assert!((reduced(&other) - reduced(&white)).abs() < 1e-12);
        }
        // By hand: σ_s = 5.9946, σ_s' = 5.9946 · 0.6/0.2 = 17.9838, σ_a = 0.0054.
        let forward = similar(&white, 0.8).unwrap();
        assert!((forward.sigma_t_per_mm() - 17.9892).abs() < 1e-9);
        let same = similar(&white, 0.4).unwrap();
        assert!((same.sigma_t_per_mm() - 6.0).abs() < 1e-12 && (same.albedo() - 0.9991).abs() < 1e-12);
    }

    /// A medium without scattering keeps its coefficients; impossible media are refused.
    #[test]
    fn black_media_stay_black() {
        let black = Medium::new(3.0, 0.0, 0.2).unwrap();
        assert_eq!(similar(&black, 0.7).unwrap(), Medium::new(3.0, 0.0, 0.7).unwrap());
        assert!(similar(&black, 1.0).is_err());
        assert_eq!(similar(&Medium::new(3.0, 0.5, 0.2).unwrap(), 1.0).unwrap_err().field(), "sigma_t_per_mm");
    }
}
