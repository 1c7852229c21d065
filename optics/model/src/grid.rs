//! The parameter grid of a dictionary and the numbering of its records.

mod parts;

use crate::invalid::{Invalid, Result};
use crate::medium::{
    Medium, TransportPoint, check_albedo, check_g, check_ior, check_optical_thickness, check_sigma_t,
    check_thickness,
};
use crate::profile::{Estimate, Record};
use crate::scene::Scene;
pub use parts::MAX_PARTS;

/// Walks of one batch: the unit of the random streams and of the standard errors.
pub const BATCH_WALKS: u64 = 2500;
/// Batches of one block: what a divided job's parts trace, each on its own. Part of the physics version, since sums are
/// added up within blocks first.
pub const BLOCK_BATCHES: u64 = 400;
/// Most records of one dictionary.
pub const MAX_RECORDS: u64 = 4_000_000;
/// Most bytes of one job's records: what a worker holds and the coordinator buffers.
pub const MAX_JOB_BYTES: u64 = 64 << 20;

const MAX_WALKS: u64 = 1_000_000_000_000;

/// Number of random walks per transport point: a multiple of [`BATCH_WALKS`], at least two batches,
/// since the standard errors come from the spread between batches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Walks(u64);

impl Walks {
    /// As many as match the noise of the paper's 250,000 samples per pixel.
    pub const PAPER: Self = Self(250_000);

    pub fn new(walks: u64) -> Result<Self> {
        if (2 * BATCH_WALKS..=MAX_WALKS).contains(&walks) && walks.is_multiple_of(BATCH_WALKS) {
            Ok(Self(walks))
        } else {
            let least = 2 * BATCH_WALKS;
            let nearest = (walks.min(MAX_WALKS) + BATCH_WALKS / 2) / BATCH_WALKS * BATCH_WALKS;
            let nearest = nearest.clamp(least, MAX_WALKS);
            let allowed = format!(
                "allowed are multiples of {BATCH_WALKS} from {least} to {MAX_WALKS}; the nearest is {nearest}"
            );
            Err(Invalid::new("walks", walks, allowed))
        }
    }

    pub fn get(self) -> u64 {
        self.0
    }

    pub fn batches(self) -> u64 {
        self.0 / BATCH_WALKS
    }

    /// Blocks that the batches fill; the last may be smaller.
    pub fn blocks(self) -> u32 {
        self.batches().div_ceil(BLOCK_BATCHES) as u32
    }

    /// Batches of a block.
    pub fn batches_of_block(self, block: u32) -> u64 {
        BLOCK_BATCHES.min(self.batches().saturating_sub(u64::from(block) * BLOCK_BATCHES))
    }
}

/// When to stop tracing a transport point: see [`Quality::noise_of`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    relative_std_error: f64,
    max_walks: Walks,
}

impl Quality {
    pub fn new(relative_std_error: f64, max_walks: Walks) -> Result<Self> {
        if !(1e-6..=1.0).contains(&relative_std_error) {
            let allowed = "allowed are 0.000001 to 1";
            return Err(Invalid::new("relative_std_error", relative_std_error, allowed));
        }
        Ok(Self { relative_std_error, max_walks })
    }

    pub fn relative_std_error(self) -> f64 {
        self.relative_std_error
    }

    pub fn max_walks(self) -> Walks {
        self.max_walks
    }

    /// Largest over records and channels of the root mean square of a profile's standard errors over its mean; 0 for
    /// a profile that is 0 everywhere.
    pub fn noise_of(records: &[Record]) -> f64 {
        let noise = |estimate: &Estimate| {
            let n = estimate.values().len() as f64;
            let mean = estimate.values().iter().map(|v| f64::from(*v)).sum::<f64>() / n;
            let square = estimate.std_errors().iter().map(|e| f64::from(*e).powi(2)).sum::<f64>() / n;
            if mean > 0.0 { square.sqrt() / mean } else { 0.0 }
        };
        let profiles = records.iter().flat_map(|r| &r.profiles);
        profiles.map(|p| noise(&p.radiance_factor)).fold(0.0, f64::max)
    }

    /// How many walks to trace after a round of `walks` that left this noise; None if it is enough.
    ///
    /// Noise falls with the root of the walks; a tenth is added, so that one more round mostly suffices. The answer
    /// depends on nothing but the records, so that it is the same everywhere.
    pub fn more_walks(self, walks: Walks, noise: f64) -> Option<Walks> {
        if noise <= self.relative_std_error || walks.get() >= self.max_walks.get() {
            return None;
        }
        let wanted = walks.get() as f64 * (noise / self.relative_std_error).powi(2) * 1.1;
        let batches = ((wanted / BATCH_WALKS as f64).ceil() as u64).max(walks.batches() + 1);
        Some(Walks((batches * BATCH_WALKS).min(self.max_walks.get())))
    }
}

/// Everything that a dictionary depends on: axes, scene, effort and seed.
///
/// Records are numbered with the albedo running fastest, then thickness, g, σ_t and sample index.
/// A *job* is one transport point with all its albedos, so its records are consecutive.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    scene: Scene,
    sigma_t_per_mm: Vec<f64>,
    albedo: Vec<f64>,
    g: Vec<f64>,
    thickness_mm: Vec<f64>,
    sample_ior: Vec<f64>,
    walks: Walks,
    seed: u64,
    derivatives: bool,
    quality: Option<Quality>,
}

/// The axes of a grid; each must be strictly rising and not empty.
#[derive(Debug, Clone, PartialEq)]
pub struct Axes {
    pub sigma_t_per_mm: Vec<f64>,
    pub albedo: Vec<f64>,
    pub g: Vec<f64>,
    pub thickness_mm: Vec<f64>,
    pub sample_ior: Vec<f64>,
}

impl Grid {
    pub fn new(scene: Scene, axes: Axes, walks: Walks, seed: u64, derivatives: bool) -> Result<Self> {
        let grid = Self {
            scene,
            sigma_t_per_mm: axis("sigma_t_per_mm", axes.sigma_t_per_mm, check_sigma_t)?,
            albedo: axis("albedo", axes.albedo, check_albedo)?,
            g: axis("g", axes.g, check_g)?,
            thickness_mm: axis("thickness_mm", axes.thickness_mm, check_thickness)?,
            sample_ior: axis("sample_ior", axes.sample_ior, |v| check_ior("sample_ior", v))?,
            walks,
            seed,
            derivatives,
            quality: None,
        };
        let last = |axis: &[f64]| axis[axis.len() - 1];
        check_optical_thickness(last(&grid.sigma_t_per_mm), last(&grid.thickness_mm))?;
        let records = grid.job_count() as u128 * grid.albedo.len() as u128;
        if records > u128::from(MAX_RECORDS) {
            return Err(Invalid::new("records", records, format!("a grid may have at most {MAX_RECORDS}")));
        }
        let job_bytes = grid.albedo.len() as u64 * grid.record_bytes() as u64;
        if job_bytes > MAX_JOB_BYTES {
            return Err(Invalid::new(
                "records of one job",
                format_args!("{job_bytes} bytes"),
                format!("albedos × channels × pixels may take at most {MAX_JOB_BYTES} bytes"),
            ));
        }
        Ok(grid)
    }

    /// The 34,276 records of Elek, Sumin et al. 2017, supplement, Sec. 5.2.
    ///
    /// The published albedo list is garbled by repetition; 0.05 to 0.85 in steps of 0.05 is what the
    /// number of records leaves.
    pub fn paper() -> Self {
        let steps = |from: u32, to: u32, scale: f64| (from..=to).map(move |i| f64::from(i) / scale);
        let sigma_t_per_mm = steps(4, 16, 4.0)
            .chain(steps(9, 16, 2.0))
            .chain(steps(9, 20, 1.0))
            .chain(steps(11, 15, 0.5))
            .collect();
        let albedo = steps(1, 17, 20.0)
            .chain([0.875, 0.9, 0.915, 0.92])
            .chain(steps(93, 99, 100.0))
            .chain([0.993])
            .chain(steps(995, 999, 1000.0))
            .chain([0.9991, 0.9993, 0.9995, 0.9997, 0.9999, 0.99993, 0.99999])
            .collect();
        let axes = Axes {
            sigma_t_per_mm,
            albedo,
            g: vec![0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.8],
            thickness_mm: vec![0.5, 1.0],
            sample_ior: vec![1.53],
        };
        Self::new(Scene::paper(), axes, Walks::PAPER, 1, false).expect("the paper's grid is valid")
    }

    /// The same grid with more walks where the noise is above a target.
    pub fn with_quality(self, quality: Quality) -> Result<Self> {
        if quality.max_walks.get() < self.walks.get() {
            let allowed = format!("at least `walks`, {}, are needed", self.walks.get());
            return Err(Invalid::new("quality.max_walks", quality.max_walks.get(), allowed));
        }
        Ok(Self { quality: Some(quality), ..self })
    }

    pub fn quality(&self) -> Option<Quality> {
        self.quality
    }

    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    pub fn sigma_t_per_mm(&self) -> &[f64] {
        &self.sigma_t_per_mm
    }

    pub fn albedo(&self) -> &[f64] {
        &self.albedo
    }

    pub fn g(&self) -> &[f64] {
        &self.g
    }

    pub fn thickness_mm(&self) -> &[f64] {
        &self.thickness_mm
    }

    pub fn sample_ior(&self) -> &[f64] {
        &self.sample_ior
    }

    pub fn walks(&self) -> Walks {
        self.walks
    }

    pub fn seed(&self) -> u64 {
        self.seed
    }

    pub fn derivatives(&self) -> bool {
        self.derivatives
    }

    /// Transport points, each of them one job.
    pub fn job_count(&self) -> usize {
        self.axis_lengths().iter().product()
    }

    pub fn record_count(&self) -> usize {
        self.job_count() * self.albedo.len()
    }

    /// Numbers of one record's profiles times four bytes each.
    pub fn record_bytes(&self) -> usize {
        let estimates = if self.derivatives { 3 } else { 1 };
        self.scene.channels().len() * self.scene.sensor().pixels() * estimates * 2 * size_of::<f32>()
    }

    /// The transport point of a job.
    ///
    /// # Panics
    /// If `job` is not below [`Self::job_count`].
    pub fn point(&self, job: usize) -> TransportPoint {
        let [_, n_sigma, n_g, n_t] = self.axis_lengths();
        assert!(job < self.job_count(), "job {job} is not of this grid");
        let (rest, t) = (job / n_t, job % n_t);
        let (rest, g) = (rest / n_g, rest % n_g);
        let (ior, sigma) = (rest / n_sigma, rest % n_sigma);
        TransportPoint::new(self.sigma_t_per_mm[sigma], self.g[g], self.thickness_mm[t], self.sample_ior[ior])
            .expect("axes hold checked values")
    }

    /// The job of a transport point, if it is one of this grid's.
    pub fn job_at(&self, point: &TransportPoint) -> Option<usize> {
        let [_, n_sigma, n_g, n_t] = self.axis_lengths();
        let place = |axis: &[f64], value: f64| axis.binary_search_by(|v| v.total_cmp(&value)).ok();
        let ior = place(&self.sample_ior, point.sample_ior())?;
        let sigma = place(&self.sigma_t_per_mm, point.sigma_t_per_mm())?;
        let (g, t) = (place(&self.g, point.g())?, place(&self.thickness_mm, point.thickness_mm())?);
        Some(((ior * n_sigma + sigma) * n_g + g) * n_t + t)
    }

    /// Number of the first record of a job; its others follow.
    pub fn first_record(&self, job: usize) -> usize {
        job * self.albedo.len()
    }

    /// What a record was computed for: its transport point and medium.
    pub fn parameters(&self, record: usize) -> (TransportPoint, Medium) {
        let point = self.point(record / self.albedo.len());
        let albedo = self.albedo[record % self.albedo.len()];
        let medium =
            Medium::new(point.sigma_t_per_mm(), albedo, point.g()).expect("axes hold checked values");
        (point, medium)
    }

    /// Number of the record at these indices into the axes.
    pub fn record_at(&self, ior: usize, sigma_t: usize, g: usize, thickness: usize, albedo: usize) -> usize {
        let [_, n_sigma, n_g, n_t] = self.axis_lengths();
        (((ior * n_sigma + sigma_t) * n_g + g) * n_t + thickness) * self.albedo.len() + albedo
    }

    /// Lengths of the axes that number the jobs, slowest first.
    fn axis_lengths(&self) -> [usize; 4] {
        [self.sample_ior.len(), self.sigma_t_per_mm.len(), self.g.len(), self.thickness_mm.len()]
    }
}

fn axis(name: &str, values: Vec<f64>, check: impl Fn(f64) -> Result<f64>) -> Result<Vec<f64>> {
    const MAX: usize = 10_000;
    if values.is_empty() || values.len() > MAX {
        return Err(Invalid::new(
            name,
            format_args!("{} values", values.len()),
            format!("1 to {MAX} are allowed"),
        ));
    }
    let rename = |e: Invalid, i: usize| Invalid::new(format!("{name}[{i}]"), values[i], e.allowed());
    for (i, &value) in values.iter().enumerate() {
        check(value).map_err(|e| rename(e, i))?;
        if i > 0 && value <= values[i - 1] {
            return Err(Invalid::new(format!("{name}[{i}]"), value, "values must be strictly rising"));
        }
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refused_number_of_walks_is_told_the_nearest_that_is_allowed() {
        for (given, nearest) in [
            (0, 5000),
            (3749, 5000),
            (6249, 5000),
            (6250, 7500),
            (1_000_001, 1_000_000),
            (MAX_WALKS + 1, MAX_WALKS),
            (u64::MAX, MAX_WALKS),
        ] {
            let error = Walks::new(given).unwrap_err();
            assert!(error.allowed().ends_with(&format!("; the nearest is {nearest}")), "{given}: {error}");
            assert!(Walks::new(nearest).is_ok());
        }
    }

    #[test]
    fn the_papers_grid_has_34276_records_in_836_jobs() {
        let grid = Grid::paper();
        assert_eq!((grid.job_count(), grid.record_count()), (836, 34_276));
        assert_eq!(grid.sigma_t_per_mm().len(), 38);
        assert_eq!(grid.albedo().len(), 41);
        assert_eq!(grid.sigma_t_per_mm()[13..15], [4.5, 5.0]);
        assert_eq!(grid.sigma_t_per_mm()[33..], [22.0, 24.0, 26.0, 28.0, 30.0]);
        assert_eq!(grid.albedo()[16..19], [0.85, 0.875, 0.9]);
    }

    #[test]
    fn record_numbers_and_parameters_are_inverse() {
        let grid = Grid::paper();
        let record = grid.record_at(0, 16, 4, 1, 34);
        let (point, medium) = grid.parameters(record);
        assert_eq!((medium.sigma_t_per_mm(), medium.albedo(), medium.g()), (6.0, 0.9991, 0.4));
        assert_eq!(point.thickness_mm(), 1.0);
        assert_eq!(grid.first_record(record / 41) + 34, record);
    }

    #[test]
    fn jobs_are_found_by_their_points() {
        let grid = Grid::paper();
        assert!((0..grid.job_count()).all(|job| grid.job_at(&grid.point(job)) == Some(job)));
        let between = TransportPoint::new(6.5, 0.41, 1.0, 1.53).unwrap();
        assert_eq!(grid.job_at(&between), None);
    }

    #[test]
    fn axes_must_rise_and_hold_something() {
        let with_g = |g: Vec<f64>| {
            let axes = Axes {
                sigma_t_per_mm: vec![1.0],
                albedo: vec![0.5],
                g,
                thickness_mm: vec![1.0],
                sample_ior: vec![1.5],
            };
            Grid::new(Scene::smooth(), axes, Walks::PAPER, 1, false)
        };
        assert!(with_g(vec![0.0, 0.4]).is_ok());
        assert_eq!(with_g(vec![0.4, 0.4]).unwrap_err().field(), "g[1]");
        assert_eq!(with_g(vec![0.0, 1.0]).unwrap_err().field(), "g[1]");
        assert_eq!(with_g(vec![]).unwrap_err().field(), "g");
    }

    #[test]
    fn walks_are_whole_batches_and_enough_for_an_error() {
        assert!(Walks::new(5_000).is_ok());
        for bad in [0, 2_500, 6_000] {
            assert!(Walks::new(bad).unwrap_err().to_string().contains("multiples of 2500"));
        }
    }
}
