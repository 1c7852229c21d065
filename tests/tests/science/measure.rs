//! Recovery of the parameters of independently traced media with a dictionary.
//!
//! In the normal run the dictionary has the paper's grid at three anisotropies; with `FARM_TEST_EFFORT=8` it is the
//! paper's whole dictionary, with many more media.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

mod imperfect;
mod misfit;
mod mixtures;
mod plain;
mod response;
mod set_up;
mod table_1;
mod there_and_back;

use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use farm_tests::statistics::{Normal, effort};
use optics_fit::{DictionaryBuilder, FitDictionary};
use optics_model::grid::Axes;
use optics_model::job::JobSpec;
use optics_model::{Grid, MeasuredProfile, Medium, PackedRecords, TransportPoint, Walks};
use optics_tracer::trace;

/// The dictionary of the tests, traced once.
pub(crate) fn dictionary() -> &'static FitDictionary {
    static DICTIONARY: OnceLock<FitDictionary> = OnceLock::new();
    DICTIONARY.get_or_init(|| {
        let paper = Grid::paper();
        let g = if effort() >= 8 { paper.g().to_vec() } else { vec![0.3, 0.4, 0.5] };
        let axes = Axes {
            sigma_t_per_mm: paper.sigma_t_per_mm().to_vec(),
            albedo: paper.albedo().to_vec(),
            g,
            thickness_mm: paper.thickness_mm().to_vec(),
            sample_ior: paper.sample_ior().to_vec(),
        };
        let grid = Grid::new(paper.scene().clone(), axes, Walks::PAPER, 1, false).unwrap();
        let mut builder = DictionaryBuilder::new(grid.clone());
        for job in 0..grid.job_count() {
            let job = JobSpec::of(&grid, job);
            let records = trace(&job, &AtomicBool::new(false)).unwrap();
            builder.add(&PackedRecords::pack(&job, &records));
        }
        builder.build()
    })
}

/// Noise of most photographs, as a share of the value.
pub(crate) const NOISE: f64 = 0.01;

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
    let point = TransportPoint::new(medium.sigma_t_per_mm(), medium.g(), thickness_mm, 1.53).unwrap();
    let walks = Walks::new(walks).unwrap();
    let job = JobSpec::new(scene.clone(), point, vec![medium.albedo()], walks, 1_000 + seed, false).unwrap();
    let record = trace(&job, &AtomicBool::new(false)).unwrap().remove(0);
    let traced = &record.profiles[channel].radiance_factor;
    let mean = |v: &[f32]| v.iter().map(|v| f64::from(*v)).sum::<f64>() / v.len() as f64;
    let level = mean(traced.std_errors()) / mean(traced.values());
    let exact: Vec<f64> = traced.values().iter().map(|v| f64::from(*v) / mu).collect();
    let mut noise = Normal::new(seed * 2 + u64::from(thickness_mm < 0.75));
    let values = exact.iter().map(|v| v * (1.0 + noise_share * noise.normal())).collect();
    let std_errors = exact.iter().map(|v| noise_share * v).collect();
    let x = (0..360).map(|i| scene.sensor().centre_mm(i)).collect();
    let name = scene.channels()[channel].name().to_owned();
    (MeasuredProfile::new(name, thickness_mm, x, values, Some(std_errors)).unwrap(), level)
}
