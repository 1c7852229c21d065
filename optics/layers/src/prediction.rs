//! The radiance factor of prints of measured media, with the standard error that the media's covariance gives.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use optics_model::phase::{PhaseShape, SecondLobe};
use optics_model::{Invalid, Medium};
use rayon::prelude::*;

use crate::print::{Print, PrintLayer};

/// A medium with the covariance of (ln σ_t, √(1 − α), ln(1 − g)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Uncertain {
    pub medium: Medium,
    pub second_lobe: SecondLobe,
    pub covariance: [[f64; 3]; 3],
}

/// A slab of a medium, or of a mixture of media.
#[derive(Debug, Clone, PartialEq)]
pub struct PrintedSlab {
    /// Index of each medium, and its share by volume.
    pub shares: Vec<(usize, f64)>,
    pub thickness_mm: f64,
}

/// A radiance factor.
#[derive(Debug, Clone, PartialEq)]
pub struct Predicted {
    pub value: f64,
    /// Changes by one standard deviation along each direction in which a medium is uncertain: its index, and the change.
    pub changes: Vec<(usize, f64)>,
}

impl Predicted {
    /// Root of the sum of the squares of the changes.
    pub fn std_error(&self) -> f64 {
        self.changes.iter().map(|(_, change)| change * change).sum::<f64>().sqrt()
    }

    /// The part of the standard error that one medium causes.
    pub fn std_error_of(&self, medium: usize) -> f64 {
        let own = self.changes.iter().filter(|(of, _)| *of == medium);
        own.map(|(_, change)| change * change).sum::<f64>().sqrt()
    }
}

/// Radiance factors over bases of these reflectances.
///
/// # Errors
/// If the shares of a slab are not positive or do not add up to 1, or a slab has no thickness.
pub fn predict(
    print: &Print,
    media: &[Uncertain],
    slabs: &[PrintedSlab],
    rho: &[f64],
) -> Result<Vec<Predicted>, Invalid> {
    slabs
        .iter()
        .enumerate()
        .try_for_each(|(i, s)| check(s, media.len()).map_err(|e| e.within(format_args!("slab[{i}]"))))?;
    let at = |media: &[Uncertain]| {
        let slabs: Vec<PrintLayer> =
            slabs.iter().map(|slab| mixed(media, slab)).collect::<Result<_, Invalid>>()?;
        Ok(print.radiance_factors(&slabs, rho))
    };
    let used = |medium: &usize| slabs.iter().any(|slab| slab.shares.iter().any(|(of, _)| of == medium));
    let directions: Vec<(usize, Vector3<f64>)> = (0..media.len())
        .filter(used)
        .flat_map(|medium| directions(&media[medium].covariance).map(|direction| (medium, direction)))
        .filter(|(_, direction)| direction.norm() > 0.0)
        .collect();
    let values = at(media)?;
    let changed = |(medium, direction): &(usize, Vector3<f64>)| {
        let moved = |sign: f64| {
            let mut media = media.to_vec();
            media[*medium] = media[*medium].moved(sign * direction);
            at(&media)
        };
        let (up, down) = (moved(1.0)?, moved(-1.0)?);
        let ends = up.iter().zip(&down).zip(&values);
        Ok((*medium, ends.map(|((up, down), value)| change(*up, *down, *value)).collect()))
    };
    let changes: Vec<(usize, Vec<f64>)> =
        directions.par_iter().map(changed).collect::<Result<_, Invalid>>()?;
    let predicted = |(i, value): (usize, &f64)| Predicted {
        value: *value,
        changes: changes.iter().map(|(medium, change)| (*medium, change[i])).collect(),
    };
    Ok(values.iter().enumerate().map(predicted).collect())
}

/// Half of the difference of both ends; where one end is at a limit of the medium, such as an albedo of 1, the other
/// counts.
fn change(up: f64, down: f64, value: f64) -> f64 {
    match () {
        () if down == value => up - value,
        () if up == value => value - down,
        () => 0.5 * (up - down),
    }
}

fn check(slab: &PrintedSlab, media: usize) -> Result<(), Invalid> {
    let sum: f64 = slab.shares.iter().map(|(_, share)| share).sum();
    if slab.shares.iter().any(|(medium, share)| *medium >= media || *share <= 0.0) || (sum - 1.0).abs() > 1e-6
    {
        let allowed = "shares by volume are above 0 and add up to 1";
        return Err(Invalid::new("shares", format!("{:?}", slab.shares), allowed));
    }
    optics_model::medium::check_thickness(slab.thickness_mm).map(|_| ())
}

/// Directions of one standard deviation: the roots of a covariance's eigenvalues along its eigenvectors.
fn directions(covariance: &[[f64; 3]; 3]) -> [Vector3<f64>; 3] {
    let eigen = SymmetricEigen::new(Matrix3::from_fn(|i, j| covariance[i][j]));
    std::array::from_fn(|i| eigen.eigenvectors.column(i) * eigen.eigenvalues[i].max(0.0).sqrt())
}

/// dᵀ C⁻¹ d in the directions in which a covariance is not 0, and their number; None if there are none.
pub fn chi2(difference: &[f64; 3], covariance: impl Fn(usize, usize) -> f64) -> Option<(f64, usize)> {
    /// Share of the greatest variance that counts as 0.
    const NONE: f64 = 1e-12;
    let eigen = SymmetricEigen::new(Matrix3::from_fn(covariance));
    let least = NONE * eigen.eigenvalues.max();
    let difference = Vector3::from(*difference);
    let kept: Vec<f64> = (0..3)
        .filter(|i| eigen.eigenvalues[*i] > least)
        .map(|i| eigen.eigenvectors.column(i).dot(&difference).powi(2) / eigen.eigenvalues[i])
        .collect();
    (!kept.is_empty()).then(|| (kept.iter().sum(), kept.len()))
}

impl Uncertain {
    /// A function of the medium, and the standard error that the covariance gives it.
    pub fn spread(&self, f: impl Fn(&Self) -> f64) -> (f64, f64) {
        let value = f(self);
        let moved =
            |direction: Vector3<f64>| change(f(&self.moved(direction)), f(&self.moved(-direction)), value);
        let squares = directions(&self.covariance).map(|direction| moved(direction).powi(2));
        (value, squares.iter().sum::<f64>().sqrt())
    }

    /// The medium as a slab.
    pub fn slab(&self, thickness_mm: f64) -> PrintLayer {
        let phase = PhaseShape::Lobes(self.second_lobe.limited_to(self.medium.g()));
        PrintLayer { medium: self.medium, phase, thickness_mm }
    }

    /// The medium moved in its coordinates; an albedo stays below 1.
    fn moved(&self, by: Vector3<f64>) -> Self {
        let m = self.medium;
        let sigma_t = (m.sigma_t_per_mm() * by[0].exp()).clamp(1e-6, 1e6);
        let albedo = 1.0 - ((1.0 - m.albedo()).sqrt() + by[1]).clamp(0.0, 1.0).powi(2);
        let g = (1.0 - (1.0 - m.g()) * by[2].exp()).clamp(-Print::MOST_G, Print::MOST_G);
        let medium = Medium::new(sigma_t, albedo, g).unwrap_or(m);
        Self { medium, ..*self }
    }
}

/// The slab of a mixture: σ_s, σ_a and σ_s p add up by volume. The phase function is that of two lobes with the mean
/// cosine, and the mean weight and anisotropy of the second lobe, of all scattering.
fn mixed(media: &[Uncertain], slab: &PrintedSlab) -> Result<PrintLayer, Invalid> {
    let (mut absorption, mut scattering, mut forward, mut weight, mut of_lobe) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (medium, share) in &slab.shares {
        let Uncertain { medium: m, second_lobe, .. } = media[*medium];
        let scattered = share * m.sigma_t_per_mm() * m.albedo();
        absorption += share * m.absorption_per_mm();
        scattering += scattered;
        forward += scattered * m.g();
        weight += scattered * second_lobe.weight();
        of_lobe += scattered * second_lobe.weight() * second_lobe.g();
    }
    let mean = |sum: f64, of: f64| if of > 0.0 { sum / of } else { 0.0 };
    let g = mean(forward, scattering);
    let lobe = SecondLobe::new(mean(weight, scattering), mean(of_lobe, weight))?.limited_to(g);
    // Rounded shares of media at the least extinction may lie below it.
    let extinction = (scattering + absorption).max(1e-6);
    let medium = Medium::new(extinction, scattering / extinction, g)?;
    Ok(PrintLayer { medium, phase: PhaseShape::Lobes(lobe), thickness_mm: slab.thickness_mm })
}

#[cfg(test)]
mod tests {
    use optics_model::Scene;

    use super::*;

    fn medium(sigma_t: f64, albedo: f64, variances: [f64; 3]) -> Uncertain {
        let covariance =
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { variances[i] } else { 0.0 }));
        let medium = Medium::new(sigma_t, albedo, 0.4).unwrap();
        Uncertain { medium, second_lobe: SecondLobe::new(0.05, -0.5).unwrap(), covariance }
    }

    fn slab(shares: &[(usize, f64)]) -> PrintedSlab {
        PrintedSlab { shares: shares.to_vec(), thickness_mm: 0.7 }
    }

    /// A mixture of a medium with itself is the medium; one with a clear medium has half of its coefficients.
    #[test]
    fn mixtures_add_by_volume() {
        let (white, clear) = (medium(6.0, 0.99, [0.0; 3]), medium(1e-6, 0.0, [0.0; 3]));
        let same = mixed(&[white, white], &slab(&[(0, 0.3), (1, 0.7)])).unwrap();
        assert!(
            (same.medium.sigma_t_per_mm() - 6.0).abs() < 1e-12 && (same.medium.albedo() - 0.99).abs() < 1e-12
        );
        assert!((same.phase.second_lobe().unwrap().weight() - 0.05).abs() < 1e-12);
        let half = mixed(&[white, clear], &slab(&[(0, 0.5), (1, 0.5)])).unwrap();
        assert!((half.medium.sigma_t_per_mm() - 3.0).abs() < 1e-5, "{half:?}");
        assert!((half.medium.g() - 0.4).abs() < 1e-9 && (half.medium.albedo() - 0.99).abs() < 1e-5);
    }

    /// The standard error is the slope times that of the medium, and errors of two media add up as squares.
    #[test]
    fn errors_follow_from_covariances() {
        let print = Print::new(&Scene::smooth(), 1.53, 0.5);
        let value = |sigma_t: f64| {
            let media = [medium(sigma_t, 0.9, [0.0; 3])];
            predict(&print, &media, &[slab(&[(0, 1.0)])], &[0.5]).unwrap()[0].value
        };
        let slope = (value(6.0 * 0.01_f64.exp()) - value(6.0 * (-0.01_f64).exp())) / 0.02;
        let uncertain = medium(6.0, 0.9, [0.02_f64.powi(2), 0.0, 0.0]);
        let one = predict(&print, &[uncertain], &[slab(&[(0, 1.0)])], &[0.5]).unwrap();
        assert!((one[0].std_error() / (0.02 * slope.abs()) - 1.0).abs() < 1e-3, "{one:?} {slope}");
        let halves =
            predict(&print, &[uncertain, uncertain], &[slab(&[(0, 0.5), (1, 0.5)])], &[0.5]).unwrap();
        assert!((halves[0].std_error() / one[0].std_error() - 0.5_f64.sqrt()).abs() < 1e-2, "{halves:?}");
    }

    #[test]
    fn wrong_shares_are_refused() {
        let print = Print::new(&Scene::smooth(), 1.53, 0.5);
        let refused = |shares: &[(usize, f64)]| {
            predict(&print, &[medium(6.0, 0.9, [0.0; 3])], &[slab(shares)], &[0.5]).unwrap_err().to_string()
        };
        for shares in [&[(0, 0.9)][..], &[(1, 1.0)], &[(0, 1.5), (0, -0.5)], &[]] {
            assert!(refused(shares).starts_with("slab[0].shares = "), "{}", refused(shares));
        }
    }
}
