//! The work of a dictionary: divided jobs, target errors, and reused records.

use anyhow::Result;
use farm_tests::farm::Farm;
use farm_tests::grids::{small_grid, traced};
use farm_tests::process::SOON;
use optics_model::grid::Axes;
use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, Quality, Record, Walks};
use optics_tracer::{trace, trace_block};
use std::sync::atomic::AtomicBool;

/// One transport point with few pixels, so that many walks are cheap.
fn one_point(walks: u64) -> Result<Grid> {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0],
        albedo: vec![0.5, 0.99],
        g: vec![0.4],
        thickness_mm: vec![0.5],
        sample_ior: vec![1.53],
    };
    let sensor = optics_model::scene::Sensor::new(10.0, 12, 0.0)?;
    let scene = small_grid().scene().clone().with_sensor(sensor);
    Ok(Grid::new(scene, axes, Walks::new(walks)?, 1, false)?)
}

/// Blocks that are traced separately have the records of the whole job.
#[test]
fn separately_traced_blocks_form_the_whole() -> Result<()> {
    let job = JobSpec::of(&one_point(2_250_000)?, 0);
    let stop = AtomicBool::new(false);
    let whole = trace(&job, &stop)?;
    let mut total = optics_model::sums::Sums::new(&job);
    let blocks: Vec<_> = [2, 0, 1].map(|block| (block, trace_block(&job, block, &stop))).into();
    for next in 0..3 {
        let sums = blocks.iter().find(|(block, _)| *block == next).map(|(_, sums)| sums.clone());
        total.merge(&sums.expect("all three were traced")?);
    }
    assert_eq!(total.into_records(&job), whole);
    Ok(())
}

/// The blocks of the job are computed by two workers.
#[tokio::test(flavor = "multi_thread")]
async fn divided_job_has_the_undivided_bytes() -> Result<()> {
    let (mut farm, grid) = (Farm::start(&[]), one_point(4_250_000)?);
    let mut workers = [farm.worker("a", &[]), farm.worker("b", &[])];
    farm.submit_grid("divided", &grid).await?;
    let status = farm.watched("divided").await?;
    let whole = Digest::of_jobs([Digest::of_records(&traced(&grid, 0))]);
    assert_eq!(status.records_digest, Some(whole));
    for worker in &mut workers {
        assert_eq!(worker.terminate(SOON), 0);
    }
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

fn noise(records: &[Record]) -> f64 {
    Quality::noise_of(records)
}

/// The bytes are those of a grid with as many walks.
#[tokio::test(flavor = "multi_thread")]
async fn points_are_traced_until_the_target_error() -> Result<()> {
    let mut farm = Farm::start(&[]);
    let plain = small_grid();
    let first: Vec<f64> = (0..plain.job_count()).map(|job| noise(&traced(&plain, job))).collect();
    let target = 0.6 * first.iter().copied().fold(0.0, f64::max);
    let grid = plain.clone().with_quality(Quality::new(target, Walks::new(1_000_000)?)?)?;
    let mut worker = farm.worker("worker", &[]);
    farm.submit_grid("quality", &grid).await?;
    let status = farm.watched("quality").await?;
    let (fewest, most) = status.walks;
    assert_eq!(fewest, plain.walks_of(0).get(), "some points reach the target at once");
    assert!(most > 2 * plain.walks_of(0).get(), "the noisiest need more than (1/0.6)² times as many: {most}");

    let mut digests = Vec::new();
    for (job, first) in first.iter().enumerate() {
        // The records of a plain grid with the final number of walks.
        let mut spec = JobSpec::of(&plain, job);
        let mut records = traced(&plain, job);
        while let Some(more) =
            Quality::new(target, Walks::new(1_000_000)?)?.more_walks(spec.walks(), noise(&records))
        {
            spec = spec.with_walks(more);
            records = trace(&spec, &AtomicBool::new(false))?;
        }
        assert!(noise(&records) <= target, "job {job}: {} after {first}", noise(&records));
        digests.push(Digest::of_records(&records));
    }
    assert_eq!(status.records_digest, Some(Digest::of_jobs(digests)));
    assert_eq!(worker.terminate(SOON), 0);
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

/// The bytes of the finer grid equal those of a grid that is computed completely.
#[tokio::test(flavor = "multi_thread")]
async fn finer_grid_computes_only_missing_points() -> Result<()> {
    let mut farm = Farm::start(&[]);
    let mut worker = farm.worker("worker", &[]);
    let coarse = small_grid();
    farm.submit_grid("coarse", &coarse).await?;
    farm.watched("coarse").await?;
    let finer = |sigma_t: Vec<f64>, albedo: Vec<f64>| {
        let axes = Axes {
            sigma_t_per_mm: sigma_t,
            albedo,
            g: coarse.g().to_vec(),
            thickness_mm: coarse.thickness_mm().to_vec(),
            sample_ior: coarse.sample_ior().to_vec(),
        };
        Grid::new(coarse.scene().clone(), axes, coarse.effort(), coarse.seed(), false)
    };
    // One extinction is new, and one albedo is left out, which does not change the others.
    let fine = finer(vec![1.0, 4.0, 6.0, 8.0], vec![0.5, 0.99])?;
    let submitted = farm.submit_grid("fine", &fine).await?;
    assert_eq!((submitted.jobs_done, submitted.jobs_total()), (12, 16));
    assert_eq!(submitted.records_reused, 24);
    let status = farm.watched("fine").await?;
    let digests = (0..fine.job_count()).map(|job| Digest::of_records(&traced(&fine, job)));
    assert_eq!(status.records_digest, Some(Digest::of_jobs(digests)));
    // An equal grid under another name needs no computation.
    assert_eq!(farm.submit_grid("again", &coarse).await?.jobs_done, 12);
    assert_eq!(worker.terminate(SOON), 0);
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}
