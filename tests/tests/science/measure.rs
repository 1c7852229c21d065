//! Recovery of the parameters of independently traced media with a dictionary.
//!
//! In the normal run the dictionary has the paper's grid at three anisotropies; with `FARM_TEST_EFFORT=8` it is the
//! paper's whole dictionary, with many more media.

mod imperfect;
mod misfit;
mod mixtures;
mod plain;
mod response;
mod set_up;
mod table_1;
mod there_and_back;

use farm_tests::statistics::{Normal, effort};
use farm_tests::stored;
use optics_fit::{FitDictionary, MeasurePlan};
use optics_model::fit::{Common, MuRange};
use optics_model::grid::Axes;
use optics_model::job::JobSpec;
use optics_model::{Grid, MeasuredProfile, Measurement, Medium, Record, Scene, TransportPoint, Walks};

/// The dictionary of the tests.
pub(crate) fn dictionary() -> &'static FitDictionary {
    let paper = Grid::paper();
    let g = if effort() >= 8 { paper.g().to_vec() } else { vec![0.3, 0.4, 0.5] };
    let axes = Axes { g, ..paper.axes().clone() };
    stored::dictionary(&Grid::new(paper.scene().clone(), axes, Walks::PAPER, 1, false).unwrap())
}

/// Noise of most photographs, as a share of the value.
pub(crate) const NOISE: f64 = 0.01;
pub(crate) const SLABS_MM: [f64; 2] = [0.5, 1.0];
/// Refractive index of the samples.
pub(crate) const IOR: f64 = 1.53;

/// The record of a slab of a medium.
pub(crate) fn traced(scene: &Scene, medium: &Medium, thickness_mm: f64, walks: u64, seed: u64) -> Record {
    let point = TransportPoint::new(medium.sigma_t_per_mm(), medium.g(), thickness_mm, IOR).unwrap();
    let (albedo, walks) = (vec![medium.albedo()], Walks::new(walks).unwrap());
    let job = JobSpec::new(scene.clone(), point, albedo, walks, seed, false).unwrap();
    stored::records(&job).unpack().remove(0)
}

/// The radiance factors of a record's channel.
pub(crate) fn values(record: &Record, channel: usize) -> Vec<f64> {
    record.profiles[channel].radiance_factor.values().iter().map(|v| f64::from(*v)).collect()
}

/// Centres of the pixels of a scene's sensor.
pub(crate) fn centres_mm(scene: &Scene) -> Vec<f64> {
    (0..scene.sensor().pixels()).map(|i| scene.sensor().centre_mm(i)).collect()
}

/// A profile with noise of its standard errors.
pub(crate) fn noisy(
    (channel, thickness_mm): (&str, f64),
    x: Vec<f64>,
    exact: &[f64],
    std_error: impl Fn(f64) -> f64,
    noise: &mut Normal,
) -> MeasuredProfile {
    let std_errors: Vec<f64> = exact.iter().map(|v| std_error(*v)).collect();
    let values = exact.iter().zip(&std_errors).map(|(v, e)| v + e * noise.normal()).collect();
    MeasuredProfile::new(channel, thickness_mm, x, values, Some(std_errors)).unwrap()
}

/// A medium's profile in one channel with relative noise and its standard errors, and the relative error of its level
/// due to the number of walks.
pub(crate) fn photograph(
    medium: &Medium,
    channel: usize,
    thickness_mm: f64,
    seed: u64,
    walks: u64,
    mu: f64,
    noise_share: f64,
) -> (MeasuredProfile, f64) {
    let scene = Grid::paper().scene().clone();
    let record = traced(&scene, medium, thickness_mm, walks, 1_000 + seed);
    let traced = &record.profiles[channel].radiance_factor;
    let mean = |v: &[f32]| v.iter().map(|v| f64::from(*v)).sum::<f64>() / v.len() as f64;
    let level = mean(traced.std_errors()) / mean(traced.values());
    let exact: Vec<f64> = values(&record, channel).iter().map(|v| v / mu).collect();
    let mut noise = Normal::new(seed * 2 + u64::from(thickness_mm < 0.75));
    let slab = (scene.channels()[channel].name(), thickness_mm);
    (noisy(slab, centres_mm(&scene), &exact, |v| noise_share * v, &mut noise), level)
}

/// Materials with a medium in each channel, darker by a factor. Channels have successive seeds.
pub(crate) fn materials<'a>(
    media: impl IntoIterator<Item = (&'a str, [Medium; 3])>,
    seed: u64,
    walks: u64,
    mu: f64,
) -> Vec<Measurement> {
    let material = |(m, (name, media)): (u64, (&str, [Medium; 3]))| {
        let slab = |c: usize, mm| photograph(&media[c], c, mm, seed + 3 * m + c as u64, walks, mu, NOISE).0;
        let profiles = (0..3).flat_map(|channel| SLABS_MM.map(|mm| slab(channel, mm)));
        Measurement::new(name, profiles.collect()).unwrap()
    };
    (0..).zip(media).map(material).collect()
}

/// The options of a fit that estimates the scale factor of all profiles.
pub(crate) fn unknown_factor() -> MeasurePlan {
    MeasurePlan { search_mu: Some(MuRange::default()), ..MeasurePlan::default() }
}

fn print_common(common: &Common) {
    let (mu, std_error, g) = (common.mu, common.mu_std_error, common.g);
    let ends = common.g_interval.map(|i| [i.low, i.high]);
    println!("μ {mu:.4} ± {std_error:.4}; g {g:.3?}, {ends:.3?}");
}
