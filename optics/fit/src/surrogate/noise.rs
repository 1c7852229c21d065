//! Estimates the noise of the records in predictions from the residuals of the neighbouring records.

use super::{ALBEDO, Coordinates, G, SIGMA_T, Surrogate, add_scaled, albedo, interpolation};
use crate::dictionary::wide::wide;
use crate::surrogate::local_axis::{Direction, Weights};

/// Assumed share of walks that are scattered again, q: it is lower in thin slabs and higher in thick ones.
const SCATTERED_ON: f64 = 0.9;

/// The records' noise in a prediction, estimated from the neighbouring records.
#[derive(Debug)]
pub(crate) struct NoiseFactors {
    /// Profiles f_k: Σ f_k f_kᵀ is the covariance.
    pub factors: Vec<Vec<f64>>,
    /// Number of independent profiles from which it was estimated.
    pub degrees: f64,
}

/// The records from which a prediction's noise comes.
#[derive(Debug, Default)]
pub(crate) struct NoisePlace {
    ior: usize,
    albedo: f64,
    /// Optical thickness at every σ_t: records with the same one have the same walks.
    depths: Vec<f32>,
    sigma_t: Direction,
    g: Direction,
}

impl NoisePlace {
    /// Correlation of the records' noise in two predictions: that of the walks that both share, times that of the same
    /// walks at both albedos. Records of the same optical thickness share their walks, and so do channels. Where numbers
    /// of scatterings n are distributed like qⁿ, the correlation of Σ αⁿ over walks is √((1 − qα²)(1 − qα′²))/(1 − qαα′).
    pub(crate) fn in_common(&self, other: &Self) -> f64 {
        if self.ior != other.ior {
            return 0.0;
        }
        let (a, b) = (self.albedo, other.albedo);
        let left = |product: f64| 1.0 - SCATTERED_ON * product;
        let of_walks = (left(a * a) * left(b * b)).sqrt() / left(a * b);
        let same_walks = |node: usize, of_other: usize| self.depths[node] == other.depths[of_other];
        of_walks * self.sigma_t.cosine_where(&other.sigma_t, same_walks) * self.g.cosine(&other.g)
    }
}

impl Surrogate<'_> {
    /// The records' noise in a prediction at any thickness near one of the dictionary's.
    pub(crate) fn noise_factors_at(&self, thickness_mm: f64, x: Coordinates) -> NoiseFactors {
        let (index, ratio) = self.nearest_thickness(thickness_mm);
        self.noise_factors(index, [x[SIGMA_T] + libm::log(ratio), x[ALBEDO], x[G]])
    }

    /// Index of the dictionary's nearest thickness, and the ratio of the given thickness to it.
    pub(super) fn nearest_thickness(&self, thickness_mm: f64) -> (usize, f64) {
        let axis = self.dictionary.grid().thickness_mm();
        let off = |t: &f64| libm::log(thickness_mm / t).abs();
        let nearest = axis.iter().enumerate().min_by(|a, b| off(a.1).total_cmp(&off(b.1)));
        nearest.map_or((0, 1.0), |(index, nominal)| (index, thickness_mm / nominal))
    }

    /// The records from which the noise of a prediction comes.
    pub(crate) fn noise_at(&self, thickness_mm: f64, x: Coordinates) -> NoisePlace {
        let (thickness, ratio) = self.nearest_thickness(thickness_mm);
        let thickness_mm = self.grid().thickness_mm()[thickness];
        let depth = |sigma_t: &f64| (sigma_t * thickness_mm) as f32;
        let depths = self.grid().sigma_t_per_mm().iter().map(depth).collect();
        let directions = [self.sigma_t.direction(x[SIGMA_T] + libm::log(ratio)), self.g.direction(x[G])];
        self.noise_place(x[ALBEDO], depths, directions)
    }

    /// The records of a prediction's noise, from given directions and the optical thicknesses of their nodes.
    pub(super) fn noise_place(
        &self,
        albedo_coordinate: f64,
        depths: Vec<f32>,
        [sigma_t, g]: [Direction; 2],
    ) -> NoisePlace {
        NoisePlace { ior: self.ior, albedo: albedo(albedo_coordinate).clamp(0.0, 1.0), depths, sigma_t, g }
    }

    /// Profiles f_k such that Σ f_k f_kᵀ is the covariance that the records' noise gives to the model at `x`, over all
    /// pixels: the weighted residuals of the neighbouring records from the local model.
    fn noise_factors(&self, thickness: usize, x: Coordinates) -> NoiseFactors {
        let a = interpolation(&self.albedo, x[ALBEDO]);
        let (first_s, window_s, hat_s) = self.sigma_t.hat(x[SIGMA_T]);
        let (first_g, window_g, hat_g) = self.g.hat(x[G]);
        let (ns, ng) = (window_s.len(), window_g.len());
        let pixels = self.dictionary.grid().scene().sensor().pixels();
        let image = |n: usize| -> Vec<f64> {
            let mut image = vec![0.0; pixels];
            for (j, weight) in a.values.iter().enumerate() {
                let row = self.row([first_s + n / ng, first_g + n % ng, thickness, a.first + j], 0..pixels);
                image.iter_mut().zip(&*row).for_each(|(v, r)| *v += weight * f64::from(*r));
            }
            image
        };
        let images: Vec<Vec<f64>> = (0..ns * ng).map(image).collect();
        let add = |into: &mut [f64], factor: f64, of: &[f64]| {
            wide(
                #[inline(always)]
                || add_scaled(into, factor, of),
            );
        };
        // The models along both axes, one after the other.
        let along_s: Vec<Vec<f64>> = (0..ns * ng)
            .map(|n| {
                let mut smooth = vec![0.0; pixels];
                (0..ns).for_each(|m| add(&mut smooth, hat_s[n / ng][m], &images[m * ng + n % ng]));
                smooth
            })
            .collect();
        let square = |w: &Weights| w.values.iter().map(|w| w * w).sum::<f64>();
        let leverage = square(&self.sigma_t.weights(x[SIGMA_T])) * square(&self.g.weights(x[G]));
        let (mut factors, mut total) = (Vec::new(), 0.0);
        // Sum of squares of the weights, sum of variances of the residuals.
        let (mut squared, mut free) = (0.0, 0.0);
        for (n, image) in images.iter().enumerate() {
            let (i, k) = (n / ng, n % ng);
            let mut rest = image.clone();
            (0..ng).for_each(|m| add(&mut rest, -hat_g[k][m], &along_s[i * ng + m]));
            let squares =
                hat_s[i].iter().map(|h| h * h).sum::<f64>() * hat_g[k].iter().map(|h| h * h).sum::<f64>();
            // Variance of a residual over that of a record.
            let left = 1.0 - 2.0 * hat_s[i][i] * hat_g[k][k] + squares;
            if left < 1e-6 {
                continue;
            }
            let weight = window_s[i] * window_g[k];
            total += weight;
            squared += weight * weight;
            free += left;
            let size = (weight * leverage / left).sqrt();
            for v in &mut rest {
                *v *= size;
            }
            factors.push(rest);
        }
        let size = if total > 0.0 { total.sqrt().recip() } else { 0.0 };
        factors.iter_mut().flatten().for_each(|v| *v *= size);
        let records = if squared > 0.0 { total * total / squared } else { 0.0 };
        let degrees = records * free / factors.len().max(1) as f64;
        NoiseFactors { factors, degrees }
    }
}
