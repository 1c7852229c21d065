//! Provides traced profiles, kept in a folder if one is given: `FARM_TEST_TRUTHS=DIR`.
//!
//! A file is named after the identity of its job, so it never becomes outdated.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use optics_model::job::JobSpec;
use optics_model::scene::{Scene, Sensor};
use optics_model::{Grid, PackedRecords, TransportPoint, Walks};
use optics_tracer::trace;

use super::media::Subject;

/// Fine pixels per pixel of the dictionary: enough for shifts and blurs.
pub(super) const FINE: usize = 4;
/// Additional pixels at either end, so that the truth can be shifted and blurred.
pub(super) const MARGIN: usize = 20;

/// The paper's scene with only its first channel.
pub(super) fn scene() -> Scene {
    let paper = Grid::paper().scene().clone();
    let first = paper.channels()[..1].to_vec();
    paper.with_channels(first).unwrap()
}

/// An exact profile, on fine pixels about the edge.
#[derive(Debug, Clone)]
pub(super) struct Truth {
    pub pitch_mm: f64,
    pub values: Vec<f64>,
}

/// The job of a slab of a medium, with a sensor of fine pixels.
pub(super) fn job(subject: &Subject, slab: usize, size: f64, walks: Walks) -> JobSpec {
    let coarse = scene().sensor();
    let pixels = coarse.pixels() + 2 * MARGIN;
    let width_mm = pixels as f64 * coarse.pitch_mm();
    let fine = Sensor::new(width_mm, (pixels * FINE) as u32, coarse.polar_deg()).unwrap();
    let (m, thickness_mm) = (&subject.medium, subject.thickness_mm(slab, size));
    let point = TransportPoint::new(m.sigma_t_per_mm(), m.g(), thickness_mm, 1.53).unwrap();
    let seed = 420_000 + subject.number;
    JobSpec::new(scene().with_sensor(fine), point, vec![m.albedo()], walks, seed, false).unwrap()
}

impl Truth {
    pub(super) fn of(subject: &Subject, slab: usize, size: f64, walks: Walks) -> Self {
        let job = job(subject, slab, size, walks);
        let values = records(&job).radiance_factors(0, 0).map(f64::from).collect();
        Self { pitch_mm: job.scene().sensor().pitch_mm(), values }
    }
}

/// The records of a job, from the folder if it has them.
pub(crate) fn records(job: &JobSpec) -> PackedRecords {
    records_within(folder().as_deref(), job)
}

fn records_within(folder: Option<&Path>, job: &JobSpec) -> PackedRecords {
    let file = folder.map(|folder| folder.join(format!("{}.records", job.sums_identity())));
    if let Some(bytes) = file.as_ref().and_then(|file| std::fs::read(file).ok()) {
        return PackedRecords::new(job, bytes.into()).unwrap();
    }
    let packed = PackedRecords::pack(job, &trace(job, &AtomicBool::new(false)).unwrap());
    if let Some(file) = file {
        write_whole(&file, packed.bytes());
    }
    packed
}

fn folder() -> Option<PathBuf> {
    let folder = PathBuf::from(std::env::var_os("FARM_TEST_TRUTHS")?);
    std::fs::create_dir_all(&folder).unwrap();
    Some(folder)
}

/// Writes a file under another name and renames it, so that an interrupted test leaves no partial file.
fn write_whole(file: &Path, bytes: &[u8]) {
    let part = file.with_extension(format!("part-{}", std::process::id()));
    std::fs::write(&part, bytes).unwrap();
    std::fs::rename(&part, file).unwrap();
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fine pixels average to those of the dictionary.
    #[test]
    fn fine_pixels_sum_to_dictionary_pixels() {
        let job = job(&Subject::draw(3, (0.4, 0.4)), 0, 1.0, Walks::new(25_000).unwrap());
        let coarse =
            JobSpec::new(scene(), job.point(), job.albedo().to_vec(), job.walks(), job.seed(), false);
        let coarse: Vec<f32> = records_within(None, &coarse.unwrap()).radiance_factors(0, 0).collect();
        let fine: Vec<f32> = records_within(None, &job).radiance_factors(0, 0).collect();
        for (i, value) in coarse.iter().enumerate() {
            let mean = fine[(i + MARGIN) * FINE..][..FINE].iter().sum::<f32>() / FINE as f32;
            assert!((mean - value).abs() < 1e-5, "pixel {i}: {mean} {value}");
        }
    }

    /// The records in the folder are those that were traced.
    #[test]
    fn stored_truths_are_the_traced_ones() {
        let folder = tempfile::tempdir().unwrap();
        let job = |number| job(&Subject::draw(number, (0.4, 0.4)), 1, 0.0, Walks::new(5000).unwrap());
        let traced = records_within(Some(folder.path()), &job(1));
        assert_eq!(records_within(Some(folder.path()), &job(1)), traced);
        assert_ne!(records_within(Some(folder.path()), &job(2)), traced);
        let names = std::fs::read_dir(folder.path()).unwrap().map(|f| f.unwrap().path());
        let files: Vec<PathBuf> = names.collect();
        assert!(files.len() == 2 && files.iter().all(|f| f.extension().unwrap() == "records"), "{files:?}");
        // A file is read instead of traced again, as the bytes of another job show.
        std::fs::copy(&files[0], &files[1]).unwrap();
        assert_eq!(
            records_within(Some(folder.path()), &job(1)),
            records_within(Some(folder.path()), &job(2))
        );
    }
}
