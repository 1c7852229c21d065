//! The media of a chart as fits of materials, with the errors that they share, and as a media file.

use anyhow::Result;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use optics_chart::{ChartFit, LOW_ABSORPTION};
use optics_model::descent::DescentEnd;
use optics_model::fit::{
    Bound, Candidate, ChannelFit, Ends, Interval, Likelihood, MaterialFit, Refined, SharedErrors, Z,
};
use optics_model::scene::{Channel, RingLight};
use optics_model::{Digest, Medium};

use super::file::ChartFile;
use super::problem::NamedChart;
use super::settings::{ChartSettings, bare_print};
use crate::media_file::{MeasuredWith, MediaChart, MediaFile};

/// Shared sources of errors that are kept one by one.
const MOST_SOURCES: usize = 48;
/// Absorption in 1/mm that no chart distinguishes from a greater one.
const OPAQUE: f64 = 200.0;
/// Greatest half-width of the logarithm of a coefficient that counts as determined, a factor of 2.
const DETERMINED: f64 = std::f64::consts::LN_2;

/// All three numbers of each medium – ln σ_s(1 − g), arsinh(σ_a/a), ln(1 − g) – by channel and material.
struct Posterior {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

/// A medium with its number among all.
struct FoundMedium<'a> {
    posterior: &'a Posterior,
    first: usize,
    ior: f64,
    misfit: f64,
    /// Thickest slab of the material in mm.
    thickest_mm: f64,
    end: DescentEnd,
}

/// The media of a fit, and the errors that they share.
pub(super) fn fits(
    named: &NamedChart,
    file: &ChartFile,
    fit: &ChartFit,
    misfit: f64,
) -> (Vec<MaterialFit>, SharedErrors) {
    let posterior = Posterior::new(named, file, fit, misfit.max(1.0));
    let ior = index(named, fit)[0];
    let count = named.materials.len();
    let medium = |material: usize, channel: usize| {
        let slabs = named.chart.patches.iter().flat_map(|patch| &patch.slabs);
        let thickest_mm = slabs.filter(|(of, _)| *of == material).map(|(_, mm)| *mm).fold(0.0, f64::max);
        FoundMedium {
            posterior: &posterior,
            first: 3 * (channel * count + material),
            ior,
            misfit,
            thickest_mm,
            end: fit.end,
        }
    };
    let channel_fit = |material: usize, channel: usize| ChannelFit {
        channel: file.channels[channel].clone(),
        candidates: Vec::new(),
        refined: Some(medium(material, channel).refined()),
        outside: None,
        curves: Vec::new(),
    };
    let channels = 0..file.channels.len();
    let material_fit = |(material, name): (usize, &String)| MaterialFit {
        material: name.clone(),
        channels: channels.clone().map(|channel| channel_fit(material, channel)).collect(),
    };
    let fits = named.materials.iter().enumerate().map(material_fit).collect();
    let columns = posterior.sources();
    let changes = |material: usize, channel: usize| {
        let found = medium(material, channel);
        let slopes = found.slopes();
        let own = columns.rows(found.first, 3).into_owned();
        let own = slopes * own;
        (0..columns.ncols()).map(|k| [own[(0, k)], own[(1, k)], own[(2, k)], 0.0, 0.0]).collect::<Vec<_>>()
    };
    let media = (0..count).flat_map(|m| channels.clone().map(move |c| (m, c)));
    let media = media.flat_map(|(material, channel)| changes(material, channel)).collect();
    (fits, SharedErrors { sources: columns.ncols(), media, scene: Vec::new() })
}

/// Index of the media and its standard error.
pub(super) fn index(named: &NamedChart, fit: &ChartFit) -> [f64; 2] {
    let place = fit.unknowns.ior;
    let [ior, error] = named.chart.ior;
    [ior + error * fit.at[place], error * fit.covariance[(place, place)].sqrt()]
}

/// The media file of a chart.
pub(super) fn media_file(
    named: &NamedChart,
    file: &ChartFile,
    fit: &ChartFit,
    (fits, errors): (&[MaterialFit], &SharedErrors),
    chart: MediaChart,
    bytes: &[u8],
) -> Result<MediaFile> {
    let channel = |(c, name): (usize, &String)| {
        let rho =
            fit.unknowns.base(0, c).map_or(named.chart.bases[0][c].unwrap_or(0.5), |place| fit.at[place]);
        // Charts have no dark side.
        Channel::new(name.as_str(), rho.max(1e-3), 0.5 * rho.clamp(1e-3, 0.06))
    };
    let channels = file.channels.iter().enumerate().map(channel).collect::<Result<_, _>>()?;
    let scene = bare_print(RingLight::new(40.0, 50.0)?, 0.0, 0.0, channels)?;
    let with = MeasuredWith {
        dictionary: "none: a chart",
        digest: Digest::of_bytes(bytes),
        scene: &scene,
        mu: [1.0, 0.0],
    };
    let mut media = MediaFile::new(fits, errors, &with);
    media.chart = Some(chart);
    Ok(media)
}

impl Posterior {
    /// The numbers that a chart determines, and ln(1 − g), which follows from them and from what was known before.
    fn new(named: &NamedChart, file: &ChartFile, fit: &ChartFit, factor: f64) -> Self {
        let media = named.materials.len() * file.channels.len();
        let settings = &file.settings;
        let known: Vec<usize> = (0..3 * media).filter(|i| i % 3 < 2).collect();
        let found = fit.at.rows(0, 2 * media).into_owned();
        let own = fit.covariance.view((0, 0), (2 * media, 2 * media)).into_owned() * (factor * factor);
        let before = named.before.as_ref().map(|before| (before.mean.clone(), before.covariance.clone()));
        let (before_mean, before) =
            before.unwrap_or_else(|| Self::assumed(named.materials.len(), media, settings));
        let before_known = DMatrix::from_fn(known.len(), known.len(), |i, j| before[(known[i], known[j])]);
        let across = DMatrix::from_fn(3 * media, known.len(), |i, j| before[(i, known[j])]);
        let inverse = before_known.clone().cholesky().map(|root| root.inverse());
        let gain = &across * inverse.unwrap_or_else(|| DMatrix::zeros(known.len(), known.len()));
        let from = DVector::from_fn(known.len(), |i, _| found[i] - before_mean[known[i]]);
        let mut mean = &before_mean + &gain * from;
        let mut covariance = &before - &gain * (&before_known - &own) * gain.transpose();
        // Exactly, where the chart itself determines it.
        for (i, p) in known.iter().enumerate() {
            mean[*p] = found[i];
            for (j, q) in known.iter().enumerate() {
                covariance[(*p, *q)] = own[(i, j)];
            }
        }
        Self { mean, covariance }
    }

    /// One g of each material in all channels; the prior of the other numbers is of no account.
    fn assumed(materials: usize, media: usize, settings: &ChartSettings) -> (DVector<f64>, DMatrix<f64>) {
        let covariance = |i: usize, j: usize| match i % 3 == 2 && j % 3 == 2 {
            true if (i / 3) % materials == (j / 3) % materials => settings.g_std_error.powi(2),
            false if i == j => 1.0,
            _ => 0.0,
        };
        let ln = libm::log(1.0 - settings.g);
        let mean = DVector::from_fn(3 * media, |i, _| if i % 3 == 2 { ln } else { 0.0 });
        (mean, DMatrix::from_fn(3 * media, 3 * media, covariance))
    }

    /// Changes by one standard deviation of each of the largest independent sources, as columns.
    fn sources(&self) -> DMatrix<f64> {
        let n = self.mean.len();
        let scale = DVector::from_fn(n, |i, _| self.covariance[(i, i)].max(1e-30).sqrt());
        let correlation = DMatrix::from_fn(n, n, |i, j| self.covariance[(i, j)] / (scale[i] * scale[j]));
        let eigen = SymmetricEigen::new(correlation);
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        order.truncate(MOST_SOURCES);
        DMatrix::from_fn(n, order.len(), |i, k| {
            // A little less than all, so that what is left of a medium's own variance is not negative.
            let root = (0.999 * eigen.eigenvalues[order[k]].max(0.0)).sqrt();
            scale[i] * eigen.eigenvectors[(i, order[k])] * root
        })
    }
}

impl FoundMedium<'_> {
    fn number(&self, i: usize) -> f64 {
        self.posterior.mean[self.first + i]
    }

    fn std_error(&self, i: usize) -> f64 {
        self.posterior.covariance[(self.first + i, self.first + i)].max(0.0).sqrt()
    }

    /// σ_s, σ_a in 1/mm, and g.
    fn coefficients(&self) -> [f64; 3] {
        let g = 1.0 - libm::exp(self.number(2));
        [libm::exp(self.number(0)) / (1.0 - g), LOW_ABSORPTION * libm::sinh(self.number(1)), g]
    }

    /// Slopes of ln σ_t, √(1 − α) and ln(1 − g) in the numbers.
    fn slopes(&self) -> DMatrix<f64> {
        let [scattering, absorption, _] = self.coefficients();
        let extinction = scattering + absorption;
        let by_number = libm::hypot(absorption, LOW_ABSORPTION);
        // √(1 − α) begins at zero with any slope: where nothing is absorbed, as if the standard error were.
        let seen = absorption.max(self.std_error(1) * LOW_ABSORPTION).max(1e-9);
        let root = (seen / (scattering + seen)).sqrt();
        let by_absorption = 0.5 * scattering / (root * (scattering + seen).powi(2));
        let share = scattering / extinction;
        #[rustfmt::skip]
        let slopes = DMatrix::from_row_slice(3, 3, &[
            share, by_number / extinction, -share,
            -by_absorption * seen, by_absorption * by_number, by_absorption * seen,
            0.0, 0.0, 1.0,
        ]);
        slopes
    }

    fn refined(&self) -> Refined {
        let [scattering, absorption, g] = self.coefficients();
        let extinction = (scattering + absorption).clamp(1e-6, 1e6);
        let medium = Medium::new(extinction, scattering / (scattering + absorption), g.clamp(-0.99, 0.99))
            .expect("coefficients are positive");
        let slopes = self.slopes();
        let covariance = self.posterior.covariance.view((self.first, self.first), (3, 3));
        let covariance = &slopes * covariance * slopes.transpose();
        let error = |i: usize| covariance[(i, i)].max(0.0).sqrt();
        let about = |value: f64, half: f64| interval(value * libm::exp(-half), value * libm::exp(half));
        let (s_half, a_half) = (Z * self.std_error(0), Z * self.std_error(1));
        let ends =
            [-a_half, a_half].map(|by| LOW_ABSORPTION * libm::sinh((self.number(1) + by).clamp(0.0, 12.0)));
        let is_opaque = absorption * self.thickest_mm > 1.0;
        let reduced = Interval {
            open_low: s_half > 2.0 * DETERMINED,
            open_high: s_half > 2.0 * DETERMINED,
            ..about(libm::exp(self.number(0)), s_half)
        };
        let open_high = a_half > 2.0 * DETERMINED && (is_opaque || ends[1] > OPAQUE);
        let absorbed = Interval { open_high, ..interval(ends[0], ends[1]) };
        let roots = [-1.0, 1.0].map(|sign| (1.0 - medium.albedo()).sqrt() + sign * Z * error(1));
        let albedo = interval(1.0 - roots[1].clamp(0.0, 1.0).powi(2), 1.0 - roots[0].max(0.0).powi(2));
        let g_half = Z * self.std_error(2);
        let g_ends = [g_half, -g_half].map(|by| (1.0 - (1.0 - g) * libm::exp(by)).max(-0.99));
        let is_resolved = s_half < DETERMINED && !open_high && self.end.is_minimum();
        let none = Ends { low: f64::NEG_INFINITY, high: f64::INFINITY };
        Refined {
            best: Candidate { medium, sample_ior: self.ior, error: self.misfit, thicknesses: Vec::new() },
            // A chart determines σ_s(1 − g) and σ_a.
            resolved: is_resolved,
            resolved_at_g: is_resolved,
            valley: g_half > 0.1,
            sigma_t_per_mm: about(extinction, Z * error(0)),
            albedo,
            g: interval(g_ends[0], g_ends[1]),
            reduced_scattering_per_mm: reduced,
            absorption_per_mm: absorbed,
            covariance: std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)])),
            correlation: covariance[(0, 2)] / (error(0) * error(2)).max(1e-30),
            // The answer has them for all patches together.
            measurement_noise: f64::NAN,
            dictionary_share: 0.0,
            misfit: self.misfit,
            suspicion: None,
            likelihood: Likelihood {
                chi2: f64::NAN,
                degrees_of_freedom: f64::NAN,
                probability: f64::NAN,
                nuisances: Vec::new(),
                outliers: Vec::new(),
                stretches: Vec::new(),
                bound: Bound {
                    sigma_t_per_mm: none,
                    albedo: none,
                    g: none,
                    reduced_scattering_per_mm: none,
                    absorption_per_mm: none,
                },
                budget: Vec::new(),
                scene: Vec::new(),
            },
            from_mixtures: false,
            second_lobe: None,
            descent: self.end,
        }
    }
}

fn interval(low: f64, high: f64) -> Interval {
    Interval { low, high, open_low: false, open_high: false }
}
