//! The numbers that a chart determines, in one vector with a Gaussian prior: ln σ_s(1 − g) and arsinh(σ_a/a) of the media,
//! a factor on all thicknesses, reflectances of bases, sheen, index, the camera's matrix, and the light of each photograph.

use libm::{asinh, exp, log, sinh};
use nalgebra::{DMatrix, DVector};

use crate::camera::{self, ChartCamera, MATRIX_SPREAD, Matrix};
use crate::{Chart, StackPatch};

/// The absorption a in 1/mm below which a coordinate is proportional to σ_a, and above which it is its logarithm: what a
/// chart shows of white ends at zero.
pub const LOW_ABSORPTION: f64 = 0.02;
/// Standard deviations of both coordinates of a medium before a chart.
const MEDIA_SPREAD: [f64; 2] = [1.5, 3.0];
/// Standard deviation of a number that is held.
const HELD: f64 = 1e-6;
/// A base that is not known, and its standard deviation.
const BASE: [f64; 2] = [0.5, 0.3];
/// Light that a face returns in other directions than that of its mirrored image.
const SHEEN: [f64; 2] = [0.01, 0.01];
/// Standard deviations of a photograph's gain, and of each of the five other numbers of its light.
const LIGHT_SPREAD: [f64; 2] = [0.02, 0.1];
/// Numbers of the light of a photograph: gain, slopes and curvatures.
pub(crate) const OF_LIGHT: usize = 6;
/// Values that take part in starting values.
const START_VALUES: [f64; 2] = [0.01, 0.95];

/// Media that are known before a chart, as those of edges: the mean of their numbers and its covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct MediaPrior {
    /// ln σ_s(1 − g) and arsinh(σ_a/a), by channel and material.
    pub mean: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

/// The places of all numbers in the vector.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartUnknowns {
    materials: usize,
    channels: usize,
    /// Place of each base's reflectance by channel; None where it is known.
    bases: Vec<Vec<Option<usize>>>,
    /// The logarithm of the factor on all thicknesses.
    thickness: usize,
    pub sheen: usize,
    pub ior: usize,
    matrix: Option<usize>,
    light: usize,
    pub len: usize,
}

impl ChartUnknowns {
    pub(crate) fn new(chart: &Chart) -> Self {
        let mut next = 2 * chart.materials * chart.channels;
        let mut place = |count: usize| {
            next += count;
            next - count
        };
        let places_of_base = |rho: &Vec<Option<f64>>, place: &mut dyn FnMut(usize) -> usize| {
            rho.iter().map(|rho| rho.is_none().then(|| place(1))).collect::<Vec<_>>()
        };
        let bases = chart.bases.iter().map(|rho| places_of_base(rho, &mut place)).collect();
        let (thickness, sheen, ior) = (place(1), place(1), place(1));
        let matrix = (chart.camera == Some(ChartCamera::Free)).then(|| place(6));
        let light = place(chart.photos() * OF_LIGHT);
        let (materials, channels) = (chart.materials, chart.channels);
        Self { materials, channels, bases, thickness, sheen, ior, matrix, light, len: next }
    }

    /// Place of ln σ_s(1 − g) of a material; that of its absorption follows.
    pub fn medium(&self, channel: usize, material: usize) -> usize {
        2 * (channel * self.materials + material)
    }

    /// Place of the logarithm of the factor on all thicknesses.
    pub(crate) fn thickness(&self) -> usize {
        self.thickness
    }

    /// Place of a base's reflectance; None where it is known.
    pub fn base(&self, base: usize, channel: usize) -> Option<usize> {
        self.bases[base][channel]
    }

    /// The first number of a photograph's light.
    pub(crate) fn light(&self, photo: usize) -> usize {
        self.light + photo * OF_LIGHT
    }

    /// The numbers that the observation of a patch depends on besides its radiance factors.
    pub(crate) fn observed(&self, patch: &StackPatch, is_lit: bool) -> Vec<usize> {
        let matrix = self.matrix.into_iter().flat_map(|first| first..first + 6);
        let photo = patch.place.filter(|_| is_lit).map(|(photo, _)| self.light(photo));
        let light = photo.into_iter().flat_map(|first| first..first + OF_LIGHT);
        std::iter::once(self.sheen).chain(matrix).chain(light).collect()
    }

    /// The matrix of the camera.
    pub fn matrix(&self, chart: &Chart, at: &DVector<f64>) -> Option<Matrix> {
        match (chart.camera?, self.matrix) {
            (ChartCamera::Held(matrix), _) => Some(matrix),
            (ChartCamera::Free, first) => Some(camera::matrix(&at.as_slice()[first?..first? + 6])),
        }
    }

    /// Mean and precision of the prior. The media begin where stacks with them on top are as bright as measured.
    pub(crate) fn prior(&self, chart: &Chart) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let mut mean = DVector::zeros(self.len);
        let mut precision = DMatrix::zeros(self.len, self.len);
        let mut set = |place: usize, [value, spread]: [f64; 2]| {
            mean[place] = value;
            precision[(place, place)] = spread.powi(-2);
        };
        for channel in 0..self.channels {
            for material in 0..self.materials {
                let [scattering, absorption] = start(chart, channel, material);
                let place = self.medium(channel, material);
                set(place, [log(scattering), MEDIA_SPREAD[0]]);
                set(place + 1, [asinh(absorption / LOW_ABSORPTION), MEDIA_SPREAD[1]]);
            }
        }
        self.bases.iter().flatten().flatten().for_each(|place| set(*place, BASE));
        set(self.thickness, [0.0, chart.thickness.max(HELD)]);
        set(self.sheen, SHEEN);
        set(self.ior, [0.0, 1.0]);
        self.matrix.into_iter().flat_map(|first| first..first + 6).for_each(|p| set(p, [0.0, MATRIX_SPREAD]));
        for place in self.light..self.len {
            let spread = LIGHT_SPREAD[usize::from(!(place - self.light).is_multiple_of(OF_LIGHT))];
            set(place, [0.0, spread]);
        }
        if let Some(prior) = &chart.prior {
            let media = 2 * self.materials * self.channels;
            let inverse = prior.covariance.clone().cholesky()?.inverse();
            mean.rows_mut(0, media).copy_from(&prior.mean);
            precision.view_mut((0, 0), (media, media)).copy_from(&inverse);
        }
        Some((mean, precision))
    }

    /// The numbers with all coefficients of the media times a factor.
    pub(crate) fn scaled(&self, at: &DVector<f64>, factor: f64) -> DVector<f64> {
        let mut scaled = at.clone();
        for place in (0..2 * self.materials * self.channels).step_by(2) {
            let [scattering, absorption] = coefficients([at[place], at[place + 1]]);
            scaled[place] = log(factor * scattering);
            scaled[place + 1] = asinh(factor * absorption / LOW_ABSORPTION);
        }
        scaled
    }

    /// The least and the most that a number may be.
    pub(crate) fn limits(&self, place: usize) -> [f64; 2] {
        let is_base = self.bases.iter().flatten().any(|base| *base == Some(place));
        match place {
            _ if place < 2 * self.materials * self.channels && place % 2 == 1 => [0.0, f64::INFINITY],
            _ if is_base => [0.0, 0.99],
            _ if place == self.sheen => [0.0, 0.2],
            _ => [f64::NEG_INFINITY, f64::INFINITY],
        }
    }

    /// σ_s(1 − g) and σ_a in 1/mm.
    pub fn coefficients(&self, at: &DVector<f64>, channel: usize, material: usize) -> [f64; 2] {
        let place = self.medium(channel, material);
        coefficients([at[place], at[place + 1]])
    }
}

/// σ_s(1 − g) and σ_a in 1/mm of both coordinates of a medium.
pub(crate) fn coefficients([scattering, absorption]: [f64; 2]) -> [f64; 2] {
    [exp(scattering.clamp(-12.0, 9.0)), LOW_ABSORPTION * sinh(absorption.clamp(0.0, 12.0))]
}

/// σ_s(1 − g) and σ_a whose thick slab has the mean value of the patches with most of a material near the top, after
/// Kubelka and Munk: σ_a/σ_s(1 − g) = 3 (1 − R)²/(16 R).
fn start(chart: &Chart, channel: usize, material: usize) -> [f64; 2] {
    const SCATTERING_PER_MM: f64 = 6.0;
    let share = |patch: &&StackPatch| {
        // Slabs further down are seen less: by half for each.
        let weights = (0..patch.slabs.len()).map(|i| 0.5_f64.powi(i as i32));
        let own = patch.slabs.iter().zip(weights.clone()).filter(|((of, _), _)| *of == material);
        own.map(|(_, weight)| weight).sum::<f64>() / weights.sum::<f64>()
    };
    let (mut sum, mut value) = (1e-12, 0.0);
    for patch in &chart.patches {
        let weight = share(&patch).powi(4);
        sum += weight;
        value += weight * patch.values.get(channel).copied().unwrap_or(0.5);
    }
    let value = (value / sum).clamp(START_VALUES[0], START_VALUES[1]);
    [SCATTERING_PER_MM, SCATTERING_PER_MM * 3.0 * (1.0 - value).powi(2) / (16.0 * value)]
}
