//! Numbers a grid's jobs and records: first those of the axes, then those of the responses.

use std::sync::Arc;

use super::{Grid, Walks};
use crate::medium::{Medium, TransportPoint};
use crate::scene::Scene;

/// A job of the responses: a variant of the scene, or the baseline, at the transport point of one of the axes' jobs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ResponseJob {
    /// None for the baseline: the scene itself with the walks of the variants.
    pub variant: Option<usize>,
    pub nominal_job: usize,
}

impl Grid {
    /// Jobs: transport points of the axes, then those of the responses.
    pub fn job_count(&self) -> usize {
        let of_variant = self.response_lengths().iter().product::<usize>();
        self.nominal_jobs() + self.responses().map_or(0, |r| r.traced().len() * of_variant)
    }

    /// Transport points of the axes, each of them one job.
    pub fn nominal_jobs(&self) -> usize {
        self.axis_lengths().iter().product()
    }

    /// Records of the axes. Those of the responses are numbered after them, up to [`Self::stored_records`].
    pub fn record_count(&self) -> usize {
        self.nominal_jobs() * self.albedo().len()
    }

    /// Records of all jobs.
    pub fn stored_records(&self) -> usize {
        self.job_count() * self.albedo().len()
    }

    /// The variant and the nominal job of a job of the responses; None for jobs of the axes.
    pub fn response_of(&self, job: usize) -> Option<ResponseJob> {
        let responses = self.responses()?;
        let index = job.checked_sub(self.nominal_jobs())?;
        let [n_ior, n_sigma, n_g, n_t] = self.response_lengths();
        let (rest, t) = (index / n_t, index % n_t);
        let (rest, g) = (rest / n_g, rest % n_g);
        let (rest, sigma) = (rest / n_sigma, rest % n_sigma);
        let (variant, ior) = (responses.traced().nth(rest / n_ior)?, rest % n_ior);
        let nominal_job = self.job_of([ior, responses.sigma_t()[sigma], responses.g()[g], t]);
        Some(ResponseJob { variant, nominal_job })
    }

    /// The job of a variant, or of the baseline, at the transport point of a job of the axes; None if it is not traced
    /// there.
    pub fn response_job(&self, variant: Option<usize>, nominal_job: usize) -> Option<usize> {
        let responses = self.responses()?;
        let variant = responses.traced().position(|traced| traced == variant)?;
        let [_, n_sigma, n_g, n_t] = self.axis_lengths();
        let (rest, t) = (nominal_job / n_t, nominal_job % n_t);
        let (rest, g) = (rest / n_g, rest % n_g);
        let (ior, sigma) = (rest / n_sigma, rest % n_sigma);
        let sigma = responses.sigma_t().binary_search(&sigma).ok()?;
        let g = responses.g().binary_search(&g).ok()?;
        let [n_ior, n_sigma, n_g, n_t] = self.response_lengths();
        Some(self.nominal_jobs() + (((variant * n_ior + ior) * n_sigma + sigma) * n_g + g) * n_t + t)
    }

    /// The scene that a job is traced in.
    pub fn scene_of(&self, job: usize) -> &Arc<Scene> {
        match (self.response_of(job).and_then(|place| place.variant), self.responses()) {
            (Some(variant), Some(responses)) => responses.scene(variant),
            _ => &self.scene,
        }
    }

    /// Walks that a job begins with.
    pub fn walks_of(&self, job: usize) -> Walks {
        let walks = self.effort.walks(&self.point(job));
        match (self.response_of(job), self.responses()) {
            (Some(place), Some(responses))
                if place.variant.is_none_or(|variant| responses.is_by_baseline(variant)) =>
            {
                walks.times(responses.walks_factor())
            }
            _ => walks,
        }
    }

    /// The jobs, grouped by the walks that they share, the costliest first.
    pub fn walk_sets(&self) -> Vec<Vec<u32>> {
        let walks = |job: u32| {
            let slab = self.point(job as usize).walked_slab();
            // Variants of the scene have walks of their own, and so has the baseline.
            let variant = self.response_of(job as usize).map(|response| response.variant);
            (-slab.optical_thickness, slab, variant)
        };
        let mut jobs: Vec<_> = (0..self.job_count() as u32).map(|job| (walks(job), job)).collect();
        jobs.sort_by(|a, b| a.partial_cmp(b).expect("numbers of points are finite"));
        let sets = jobs.chunk_by(|a, b| a.0 == b.0);
        sets.map(|set| set.iter().map(|(_, job)| *job).collect()).collect()
    }

    /// Lengths of the axes that number the jobs of a variant, as [`Self::axis_lengths`].
    fn response_lengths(&self) -> [usize; 4] {
        let [n_ior, .., n_t] = self.axis_lengths();
        self.responses().map_or([0; 4], |r| [n_ior, r.sigma_t().len(), r.g().len(), n_t])
    }

    /// The transport point of a job.
    ///
    /// # Panics
    /// If `job` is not below [`Self::job_count`].
    pub fn point(&self, job: usize) -> TransportPoint {
        let [_, n_sigma, n_g, n_t] = self.axis_lengths();
        assert!(job < self.job_count(), "job {job} is not of this grid");
        let job = self.response_of(job).map_or(job, |place| place.nominal_job);
        let (rest, t) = (job / n_t, job % n_t);
        let (rest, g) = (rest / n_g, rest % n_g);
        let (ior, sigma) = (rest / n_sigma, rest % n_sigma);
        TransportPoint::new(
            self.sigma_t_per_mm()[sigma],
            self.g()[g],
            self.thickness_mm()[t],
            self.sample_ior()[ior],
        )
        .expect("axes hold checked values")
    }

    /// The axes' job of a transport point, if it is one of this grid's.
    pub fn job_at(&self, point: &TransportPoint) -> Option<usize> {
        let index = |axis: &[f64], value: f64| axis.binary_search_by(|v| v.total_cmp(&value)).ok();
        let ior = index(self.sample_ior(), point.sample_ior())?;
        let sigma = index(self.sigma_t_per_mm(), point.sigma_t_per_mm())?;
        let (g, t) = (index(self.g(), point.g())?, index(self.thickness_mm(), point.thickness_mm())?);
        Some(self.job_of([ior, sigma, g, t]))
    }

    fn job_of(&self, [ior, sigma_t, g, thickness]: [usize; 4]) -> usize {
        let [_, n_sigma, n_g, n_t] = self.axis_lengths();
        ((ior * n_sigma + sigma_t) * n_g + g) * n_t + thickness
    }

    /// Number of the first record of a job; its others follow.
    pub fn first_record(&self, job: usize) -> usize {
        job * self.albedo().len()
    }

    /// The transport point and the medium of a record.
    pub fn parameters(&self, record: usize) -> (TransportPoint, Medium) {
        let point = self.point(record / self.albedo().len());
        let albedo = self.albedo()[record % self.albedo().len()];
        let medium =
            Medium::new(point.sigma_t_per_mm(), albedo, point.g()).expect("axes hold checked values");
        (point, medium)
    }

    /// Number of the record at these indices into the axes.
    pub fn record_at(&self, ior: usize, sigma_t: usize, g: usize, thickness: usize, albedo: usize) -> usize {
        self.first_record(self.job_of([ior, sigma_t, g, thickness])) + albedo
    }

    /// Lengths of the axes that number the jobs, slowest first.
    fn axis_lengths(&self) -> [usize; 4] {
        [self.sample_ior(), self.sigma_t_per_mm(), self.g(), self.thickness_mm()].map(<[f64]>::len)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
