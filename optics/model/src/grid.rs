//! The parameter grid of a dictionary and the numbering of its records.

mod effort;
mod jobs;
mod parts;
mod responses;
mod walks;

use std::sync::Arc;

use serde::Serialize;

use crate::invalid::{Invalid, Result};
use crate::medium::{
    TransportPoint, check_albedo, check_ior, check_optical_thickness, check_sigma_t, check_thickness,
};
use crate::profile::RecordShape;
use crate::scene::boards::check_boards;
use crate::scene::{Channel, Scene};
pub use effort::{Effort, NoiseLevel};
pub use jobs::ResponseJob;
pub use parts::MAX_PARTS;
pub use responses::{Responses, Variant};
pub use walks::{BATCH_WALKS, BLOCK_BATCHES, CHUNK_BATCHES, Quality, Walks};

/// Most records of one dictionary.
pub const MAX_RECORDS: u64 = 4_000_000;
/// Most bytes of one job's records, which a worker holds and the coordinator buffers.
pub const MAX_JOB_BYTES: u64 = 64 << 20;

/// Everything that a dictionary depends on: axes, scene, effort and seed.
///
/// Records are numbered with the albedo running fastest, then thickness, g, σ_t and sample index.
/// A *job* is one transport point with all its albedos, so its records are consecutive. The records of the responses, if
/// there are any, follow those of the axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    scene: Arc<Scene>,
    axes: Axes,
    effort: Effort,
    seed: u64,
    derivatives: bool,
    quality: Option<Quality>,
    responses: Option<Arc<Responses>>,
}

/// The axes of a grid; each must be strictly rising and not empty.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Axes {
    pub sigma_t_per_mm: Vec<f64>,
    pub albedo: Vec<f64>,
    pub g: Vec<f64>,
    pub thickness_mm: Vec<f64>,
    pub sample_ior: Vec<f64>,
}

impl Axes {
    /// Albedos between which cubic interpolation of profiles in √(1 − α), as in fits, errs by 0.1 % at most.
    pub const ALBEDO: [f64; 29] = [
        0.05, 0.12, 0.2, 0.28, 0.36, 0.44, 0.52, 0.59, 0.65, 0.71, 0.76, 0.8, 0.84, 0.87, 0.9, 0.92, 0.94,
        0.955, 0.966, 0.976, 0.983, 0.989, 0.993, 0.996, 0.998, 0.999, 0.9996, 0.9999, 0.99999,
    ];

    /// The axes of `lab`: the paper's, with fewer albedos.
    pub fn lab() -> Self {
        Self { albedo: Self::ALBEDO.to_vec(), ..Grid::paper().axes }
    }
}

impl Grid {
    pub fn new(
        scene: impl Into<Arc<Scene>>,
        axes: Axes,
        effort: impl Into<Effort>,
        seed: u64,
        derivatives: bool,
    ) -> Result<Self> {
        let scene = scene.into();
        scene.check_dispersion().map_err(|e| e.within("scene"))?;
        let axes = Axes {
            sigma_t_per_mm: axis("sigma_t_per_mm", axes.sigma_t_per_mm, check_sigma_t)?,
            albedo: axis("albedo", axes.albedo, check_albedo)?,
            g: axis("g", axes.g, |g| scene.phase().function(g).map(|_| g))?,
            thickness_mm: axis("thickness_mm", axes.thickness_mm, check_thickness)?,
            sample_ior: axis("sample_ior", axes.sample_ior, |v| check_ior("sample_ior", v))?,
        };
        let last = |axis: &[f64]| axis[axis.len() - 1];
        check_optical_thickness(last(&axes.sigma_t_per_mm), last(&axes.thickness_mm))?;
        let effort = effort.into();
        let grid = Self { scene, axes, effort, seed, derivatives, quality: None, responses: None };
        grid.check_records()?;
        let job_bytes = grid.albedo().len() as u64 * grid.record_bytes() as u64;
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
    /// The published albedo list is garbled by repetition; the number of records implies 0.05 to 0.85 in steps of 0.05.
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
        Self::new(Scene::paper(), axes, NoiseLevel::Paper, 1, false).expect("the paper's grid is valid")
    }

    /// The grid of `lab`, without responses.
    pub fn lab() -> Self {
        Self::new(Scene::lab(), Axes::lab(), NoiseLevel::Paper, 1, false).expect("the grid is valid")
    }

    fn check_records(&self) -> Result<()> {
        let records = self.job_count() as u128 * self.albedo().len() as u128;
        if records > u128::from(MAX_RECORDS) {
            return Err(Invalid::new("records", records, format!("a grid may have at most {MAX_RECORDS}")));
        }
        Ok(())
    }

    /// This grid with responses of its scene's uncertain quantities.
    pub fn with_responses(self, responses: Responses) -> Result<Self> {
        let grid = Self { responses: Some(Arc::new(responses)), ..self };
        grid.check_records()?;
        Ok(grid)
    }

    pub fn responses(&self) -> Option<&Responses> {
        self.responses.as_deref()
    }

    #[must_use]
    pub fn without_responses(self) -> Self {
        Self { responses: None, ..self }
    }

    /// This grid for all boards, without responses.
    pub fn for_all_boards(&self) -> Result<Self> {
        let scene = self.scene.for_all_boards()?;
        let grid = Self::new(scene, self.axes.clone(), self.effort, self.seed, self.derivatives)?;
        self.quality.map_or(Ok(grid.clone()), |quality| grid.with_quality(quality))
    }

    /// This grid over other boards, for records that are interpolated from this one's, which is for all boards.
    pub fn over_boards(&self, channels: Vec<Channel>) -> Result<Self> {
        if !self.scene.is_for_all_boards() {
            let allowed = "the dictionary has boards of its own: leave this out";
            return Err(Invalid::new("board", format_args!("{} channels", channels.len()), allowed));
        }
        check_boards("board", &channels)?;
        let scene = self.scene().clone().with_channels(channels)?;
        let responses = self.responses().map(|responses| {
            let over = |variant: &Variant| Variant { channels: scene.channels().to_vec(), ..variant.clone() };
            let variants = responses.variants().iter().map(over).collect();
            Responses::new(&scene, &self.axes, variants, responses.walks_factor()).map(Arc::new)
        });
        Ok(Self { responses: responses.transpose()?, scene: Arc::new(scene), ..self.clone() })
    }

    /// This grid with more walks where the noise is above a target.
    pub fn with_quality(self, quality: Quality) -> Result<Self> {
        let [_, first] = self.least_and_most_walks().map(Walks::get);
        if quality.max_walks().get() < first {
            let allowed = format!("points begin with up to {first}");
            return Err(Invalid::new("quality.max_walks", quality.max_walks().get(), allowed));
        }
        Ok(Self { quality: Some(quality), ..self })
    }

    pub fn quality(&self) -> Option<Quality> {
        self.quality
    }

    /// The scene, to be shared with jobs.
    pub fn shared_scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    pub fn axes(&self) -> &Axes {
        &self.axes
    }

    pub fn sigma_t_per_mm(&self) -> &[f64] {
        &self.axes.sigma_t_per_mm
    }

    pub fn albedo(&self) -> &[f64] {
        &self.axes.albedo
    }

    pub fn g(&self) -> &[f64] {
        &self.axes.g
    }

    pub fn thickness_mm(&self) -> &[f64] {
        &self.axes.thickness_mm
    }

    pub fn sample_ior(&self) -> &[f64] {
        &self.axes.sample_ior
    }

    /// This grid with another effort.
    pub fn with_effort(self, effort: impl Into<Effort>) -> Result<Self> {
        let quality = self.quality;
        let grid = Self { effort: effort.into(), quality: None, ..self };
        quality.map_or(Ok(grid.clone()), |quality| grid.with_quality(quality))
    }

    pub fn effort(&self) -> Effort {
        self.effort
    }

    /// The fewest and the most walks that a job of the axes begins with.
    pub fn least_and_most_walks(&self) -> [Walks; 2] {
        let last = |axis: &[f64]| axis[axis.len() - 1];
        let walks = |sigma_t, thickness| {
            let point = TransportPoint::new(sigma_t, self.g()[0], thickness, self.sample_ior()[0]);
            self.effort.walks(&point.expect("axes hold checked values"))
        };
        // The thickest sample needs the most walks.
        [
            walks(self.sigma_t_per_mm()[0], self.thickness_mm()[0]),
            walks(last(self.sigma_t_per_mm()), last(self.thickness_mm())),
        ]
    }

    pub fn seed(&self) -> u64 {
        self.seed
    }

    pub fn derivatives(&self) -> bool {
        self.derivatives
    }

    /// Bytes of one record's numbers.
    pub fn record_bytes(&self) -> usize {
        RecordShape::of(self).bytes()
    }
}

impl RecordShape {
    pub fn of(grid: &Grid) -> Self {
        Self {
            channels: grid.scene.channels().len(),
            pixels: grid.scene.sensor().pixels(),
            derivatives: grid.derivatives,
        }
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

    /// The paper's grid has 34,276 records in 836 jobs.
    #[test]
    fn paper_grid_has_34276_records() {
        let grid = Grid::paper();
        assert_eq!((grid.job_count(), grid.record_count()), (836, 34_276));
        assert_eq!(grid.sigma_t_per_mm().len(), 38);
        assert_eq!(grid.albedo().len(), 41);
        assert_eq!(grid.sigma_t_per_mm()[13..15], [4.5, 5.0]);
        assert_eq!(grid.sigma_t_per_mm()[33..], [22.0, 24.0, 26.0, 28.0, 30.0]);
        assert_eq!(grid.albedo()[16..19], [0.85, 0.875, 0.9]);
    }

    /// The values of an axis must rise strictly, and there must be at least one.
    #[test]
    fn axes_must_rise_and_be_non_empty() {
        for (g, field) in [
            (vec![0.0, 0.4], None),
            (vec![0.4, 0.4], Some("g[1]")),
            (vec![0.0, 1.0], Some("g[1]")),
            (vec![], Some("g")),
        ] {
            let grid = Grid::new(Scene::smooth(), Axes { g, ..Grid::paper().axes }, Walks::PAPER, 1, false);
            assert_eq!(grid.err().as_ref().map(Invalid::field), field);
        }
    }
}
