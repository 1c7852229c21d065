//! Makes dictionaries and measurements for tests from a formula.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use optics_layers::records;
use optics_model::fit::FitSettings;
use optics_model::grid::{Axes, Responses};
use optics_model::job::JobSpec;
use optics_model::scene::{Prior, PriorKind, Scene, Scope, Sensor};
use optics_model::{
    Estimate, Grid, MeasuredProfile, Measurement, Medium, PackedRecords, Profile, Record, TransportPoint,
    Walks,
};

use super::{DictionaryBuilder, FitDictionary};

/// Edge profiles that stand for simulated ones: smooth, and different for every parameter combination.
pub(super) fn profile_value(x: f64, sigma_t: f64, albedo: f64, g: f64, thickness: f64, channel: f64) -> f64 {
    let width = 0.3 + thickness / (sigma_t * (1.0 - g));
    let level = albedo * (0.2 + 0.1 * channel);
    level + 0.3 * albedo * libm::tanh(x / width) / (1.0 + thickness)
}

pub(super) fn coarse_axes() -> Axes {
    Axes {
        sigma_t_per_mm: vec![1.0, 2.0, 4.0, 8.0],
        albedo: vec![0.3, 0.6, 0.9],
        g: vec![0.0, 0.4],
        thickness_mm: vec![0.5, 1.0],
        sample_ior: vec![1.5],
    }
}

/// Axes as dense as the paper's, over a part of their range.
pub(super) fn dense_axes() -> Axes {
    Axes {
        sigma_t_per_mm: (0..15).map(|i| 1.5 * 1.12_f64.powi(i)).collect(),
        albedo: vec![0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.94, 0.97, 0.99],
        g: vec![0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
        ..coarse_axes()
    }
}

pub(super) fn dictionary(pixels: u32) -> FitDictionary {
    noisy_dictionary(coarse_axes(), pixels, 0.0)
}

/// A dictionary whose records have levels with a normal error that all albedos of a transport point share, as with random
/// walks.
pub(super) fn noisy_dictionary(axes: Axes, pixels: u32, noise: f64) -> FitDictionary {
    let (grid, record) = noisy_records(axes, pixels, noise);
    dictionary_of(&grid, record)
}

/// Dictionaries with dense axes. Each is built once.
pub(super) fn dense(pixels: u32, noise: f64) -> &'static FitDictionary {
    static ALL: Mutex<BTreeMap<(u32, u64), &FitDictionary>> = Mutex::new(BTreeMap::new());
    let build = || &*Box::leak(Box::new(noisy_dictionary(dense_axes(), pixels, noise)));
    ALL.lock().unwrap().entry((pixels, noise.to_bits())).or_insert_with(build)
}

/// The grid of such records, and a function that makes the record of an index.
pub(super) fn noisy_records(axes: Axes, pixels: u32, noise: f64) -> (Grid, impl Fn(usize) -> Record) {
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, pixels, 0.0).unwrap());
    let grid = Grid::new(scene, axes, Walks::PAPER, 1, false).unwrap();
    let record = {
        let grid = grid.clone();
        move |index: usize| {
            let gain = 1.0 + noise * normal(index as u64 / grid.albedo().len() as u64);
            exact_record(&grid, index, 3, |x, medium, thickness, channel| {
                let (s, a, g) = (medium.sigma_t_per_mm(), medium.albedo(), medium.g());
                gain * profile_value(x, s, a, g, thickness, channel as f64)
            })
        }
    };
    (grid, record)
}

/// A record without noise, whose channels have these values at x, for a medium and a thickness.
pub(super) fn exact_record(
    grid: &Grid,
    index: usize,
    channels: usize,
    value: impl Fn(f64, &Medium, f64, usize) -> f64,
) -> Record {
    let (point, medium) = grid.parameters(index);
    let sensor = grid.scene().sensor();
    let profile = |channel: usize| {
        let at = |i| value(sensor.centre_mm(i), &medium, point.thickness_mm(), channel) as f32;
        exact_profile((0..sensor.pixels()).map(at).collect())
    };
    Record { index, profiles: (0..channels).map(profile).collect() }
}

pub(super) fn exact_profile(values: Vec<f32>) -> Profile {
    let std_errors = vec![0.0; values.len()];
    Profile { radiance_factor: Estimate::new(values, std_errors).unwrap(), derivatives: None }
}

/// The dictionary of these records.
pub(super) fn dictionary_of(grid: &Grid, record: impl Fn(usize) -> Record) -> FitDictionary {
    build(DictionaryBuilder::new(grid.clone()), grid, record)
}

/// The dictionary of these records, with all values rounded.
pub(super) fn rounded_dictionary_of(grid: &Grid, record: impl Fn(usize) -> Record) -> FitDictionary {
    build(DictionaryBuilder::rounded(grid), grid, record)
}

/// Adds the jobs from the last to the first.
fn build(mut builder: DictionaryBuilder, grid: &Grid, record: impl Fn(usize) -> Record) -> FitDictionary {
    for job in (0..grid.job_count()).rev() {
        let first = grid.first_record(job);
        let records: Vec<Record> = (first..first + grid.albedo().len()).map(&record).collect();
        builder.add(&PackedRecords::pack(&JobSpec::of(grid, job), &records));
    }
    builder.build()
}

/// A standard normal number, determined by `n`: the sum of twelve uniform ones.
pub(super) fn normal(n: u64) -> f64 {
    let uniform = |i: u64| {
        let mut z = (n * 12 + i + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..12).map(uniform).sum::<f64>() - 6.0
}

/// The traced profile of a slab in the scene's first channel, with an index of 1.53.
pub(super) fn traced_profile(scene: Scene, medium: &Medium, mm: f64, walks: Walks, seed: u64) -> Vec<f64> {
    let point = TransportPoint::new(medium.sigma_t_per_mm(), medium.g(), mm, 1.53).unwrap();
    let job = JobSpec::new(scene, point, vec![medium.albedo()], walks, seed, false).unwrap();
    let record = records(&job, &AtomicBool::new(false)).unwrap().remove(0);
    record.profiles[0].radiance_factor.values().iter().map(|v| f64::from(*v)).collect()
}

/// The change of a profile by the quantities' differences from the scene in standard deviations: the gel's brightens the
/// middle, not quite in proportion; the ring's darkens the rims.
pub(super) fn change(x: f64, albedo: f64, g: f64, [gel, ring]: [f64; 2]) -> f64 {
    let middle = 0.02 * libm::exp(-x * x) * (1.0 - 0.3 * g);
    albedo * (middle * gel * (1.0 + 0.05 * gel) - 0.004 * ring * (x / 5.0).powi(2))
}

/// A dictionary of the formula with 120 pixels and this number of uncertain quantities: the gel of the scene, then the ring.
pub(super) fn uncertain_dictionary(quantities: usize) -> FitDictionary {
    let gel = Prior::new(PriorKind::Thickness, vec![1, 3], 0.02, Scope::Slab).unwrap();
    let ring = Prior::new(PriorKind::RingAngle, Vec::new(), 1.0, Scope::Session).unwrap();
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, 120, 0.0).unwrap());
    let scene = scene.with_priors([gel, ring][..quantities].to_vec()).unwrap();
    let responses = Responses::of(&scene, &dense_axes(), |varied| Ok(varied.channels().to_vec())).unwrap();
    let grid = Grid::new(scene, dense_axes(), Walks::PAPER, 1, false).unwrap();
    let grid = responses.map_or(Ok(grid.clone()), |responses| grid.with_responses(responses)).unwrap();
    dictionary_of(&grid, |index| {
        let mut quantities = [0.0; 2];
        if let Some(variant) = grid.response_of(index / grid.albedo().len()).and_then(|place| place.variant) {
            let variant = &grid.responses().unwrap().variants()[variant];
            quantities[variant.prior] = variant.step / grid.scene().priors()[variant.prior].std_error();
        }
        exact_record(&grid, index, 3, |x, m, thickness, channel| {
            let (s, a, g) = (m.sigma_t_per_mm(), m.albedo(), m.g());
            profile_value(x, s, a, g, thickness, channel as f64) + change(x, a, g, quantities)
        })
    })
}

/// Centres of pixels over 10 mm.
pub(super) fn centres(pixels: usize) -> Vec<f64> {
    (0..pixels).map(|i| (i as f64 + 0.5) * 10.0 / pixels as f64 - 5.0).collect()
}

/// A profile over 10 mm of these exact values, with noise as it is stated: this standard error of a value, and normal
/// numbers from the first one.
pub(super) fn noisy_profile(
    (channel, thickness_mm, pixels): (&str, f64, usize),
    exact: impl Fn(f64) -> f64,
    std_error: impl Fn(f64) -> f64,
    first: u64,
) -> MeasuredProfile {
    let x = centres(pixels);
    let exact: Vec<f64> = x.iter().map(|x| exact(*x)).collect();
    let noisy = |(i, v): (usize, &f64)| v + std_error(*v) * normal(first + i as u64);
    let values = exact.iter().enumerate().map(noisy).collect();
    let std_errors = exact.iter().map(|v| std_error(*v)).collect();
    MeasuredProfile::new(channel, thickness_mm, x, values, Some(std_errors)).unwrap()
}

/// A measurement in channel G at both thicknesses with 1 % of normal noise, which is stated as standard errors if `told`.
pub(super) fn noisy_measurement(medium: (f64, f64, f64), seed: u64, told: bool) -> Measurement {
    let (sigma_t, albedo, g) = medium;
    let profile = |(t, thickness): (u64, f64)| {
        let exact = |x| profile_value(x, sigma_t, albedo, g, thickness, 1.0);
        let noisy =
            noisy_profile(("G", thickness, 360), exact, |v| 0.01 * v, (seed * 2 + t) * 360 + 1_000_000);
        if told { noisy } else { changed(&noisy, |_, v, _| (v, None)) }
    };
    Measurement::new("test", vec![profile((0, 0.5)), profile((1, 1.0))]).unwrap()
}

/// The profile with another value and standard error at x.
pub(super) fn changed(
    p: &MeasuredProfile,
    pixel: impl Fn(f64, f64, f64) -> (f64, Option<f64>),
) -> MeasuredProfile {
    let error = |i: usize| p.std_errors().map_or(0.0, |errors| errors[i]);
    let pixels = p.x_mm().iter().zip(p.values()).enumerate().map(|(i, (x, v))| pixel(*x, *v, error(i)));
    let (values, errors): (Vec<f64>, Vec<Option<f64>>) = pixels.unzip();
    let errors = errors.into_iter().collect();
    MeasuredProfile::new(p.channel(), p.thickness_mm(), p.x_mm().to_vec(), values, errors).unwrap()
}

/// The measurement with other profiles.
pub(super) fn remade(
    m: &Measurement,
    profile: impl FnMut(&MeasuredProfile) -> MeasuredProfile,
) -> Measurement {
    Measurement::new(m.material(), m.profiles().iter().map(profile).collect()).unwrap()
}

/// A set-up without errors.
pub(super) fn exact_set_up() -> FitSettings {
    FitSettings {
        thickness_std_error_mm: 0.0,
        origin_std_error_mm: 0.0,
        blur_std_error_mm: 0.0,
        gain_std_error: 0.0,
        offset_std_error: 0.0,
        slope_std_error: 0.0,
        wedge_std_error: 0.0,
        ..FitSettings::default()
    }
}

/// A measurement of a medium at both thicknesses, in channel G, over `width` mm.
pub(super) fn measured(sigma_t: f64, albedo: f64, g: f64, pixels: usize, width: f64) -> Measurement {
    let profile = |thickness: f64| {
        let pitch = width / pixels as f64;
        let x: Vec<f64> = (0..pixels).map(|i| (i as f64 + 0.5) * pitch - width / 2.0).collect();
        let ripple = |i: usize| 0.003 * ((i * 7919) % 13) as f64 / 13.0;
        let value = |(i, x): (usize, &f64)| profile_value(*x, sigma_t, albedo, g, thickness, 1.0) + ripple(i);
        let values = x.iter().enumerate().map(value).collect();
        MeasuredProfile::new("G", thickness, x, values, None).unwrap()
    };
    Measurement::new("test", vec![profile(0.5), profile(1.0)]).unwrap()
}
