//! Draws simulated profiles.

use std::path::{Path, PathBuf};

use anyhow::Result;
use farm_figures::numbers::{albedo, significant};
use farm_figures::simulated_figure;
use optics_model::fit::PredictedChannel;
use optics_model::job::JobSpec;
use optics_model::{Medium, Record};

use crate::figure_files::{self, FigureSize};

/// One figure per medium and thickness; returns the files.
pub(super) fn draw(
    jobs: &[JobSpec],
    records: &[Vec<Record>],
    path: &Path,
    size: FigureSize,
) -> Result<Vec<PathBuf>> {
    let mut figures = Vec::new();
    for (job, records) in jobs.iter().zip(records) {
        let (scene, point) = (job.scene(), job.point());
        let x_mm: Vec<f64> = (0..scene.sensor().pixels()).map(|i| scene.sensor().centre_mm(i)).collect();
        for (record, &a) in records.iter().zip(job.albedo()) {
            let medium = Medium::new(point.sigma_t_per_mm(), a, point.g())?;
            let channels = scene.channels().iter().zip(&record.profiles).map(|(channel, profile)| {
                let numbers = |all: &[f32]| all.iter().copied().map(f64::from).collect::<Vec<f64>>();
                PredictedChannel {
                    channel: channel.name().to_owned(),
                    values: numbers(profile.radiance_factor.values()),
                    std_errors: Some(numbers(profile.radiance_factor.std_errors())),
                    gradient: Vec::new(),
                }
            });
            let channels: Vec<_> = channels.collect();
            let picture =
                simulated_figure(&medium, point.thickness_mm(), job.walks().get(), &x_mm, &channels)?;
            let name =
                [significant(medium.sigma_t_per_mm(), 4), albedo(a), significant(medium.g(), 3)].join("-");
            figures.push((format!("{name}-{}mm", significant(point.thickness_mm(), 4)), picture));
        }
    }
    figure_files::write_all(&figures, path, size)
}
