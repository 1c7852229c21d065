//! Traces the records of a job, each channel with the indices of its wavelength.

use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use optics_model::Record;
use optics_model::job::JobSpec;
use optics_model::scene::{Channel, Scene};

/// The records of a job. If indices depend on the wavelength, each channel has walks of its own.
pub(crate) fn traced(job: &JobSpec) -> Result<Vec<Record>> {
    let scene = job.scene();
    if !scene.is_dispersive() {
        return traced_in(job, scene.clone());
    }
    let channel_records = |channel: &Channel| traced_in(job, scene.of_channel(channel)?);
    let (first, others) = scene.channels().split_first().context("a scene has channels")?;
    let mut all = channel_records(first)?;
    for channel in others {
        for (record, own) in all.iter_mut().zip(channel_records(channel)?) {
            record.profiles.extend(own.profiles);
        }
    }
    Ok(all)
}

fn traced_in(job: &JobSpec, scene: Scene) -> Result<Vec<Record>> {
    let albedo = job.albedo().to_vec();
    let job = JobSpec::new(scene, job.point(), albedo, job.walks(), job.seed(), job.derivatives())?;
    Ok(optics_layers::records(&job, &AtomicBool::new(false))?)
}
