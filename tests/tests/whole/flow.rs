//! Requests that a real farm refuses, divided jobs and target errors.

use std::sync::atomic::AtomicBool;

use anyhow::Result;
use farm_proto::wire::leases_client::LeasesClient;
use farm_proto::wire::{FitRequest, GetRequest, RegisterRequest, SubmitRequest};
use farm_proto::{PROTOCOL_VERSION, wire};
use farm_tests::farm::Farm;
use farm_tests::grids::{small_grid, traced};
use optics_model::grid::Axes;
use optics_model::job::JobSpec;
use optics_model::scene::Sensor;
use optics_model::{Digest, Grid, MeasuredProfile, Measurement, PHYSICS_VERSION, Quality, Walks};
use tonic::Code;
use tonic_types::StatusExt;

#[tokio::test(flavor = "multi_thread")]
async fn worker_of_another_version_is_refused() -> Result<()> {
    let farm = Farm::start(&[]);
    // Programs from before protocol versions send none.
    for (physics_version, protocol_version, what) in
        [(PHYSICS_VERSION + 1, PROTOCOL_VERSION, "physics"), (PHYSICS_VERSION, 0, "protocol")]
    {
        let instance = "i".to_owned();
        let about = RegisterRequest { physics_version, protocol_version, instance, ..Default::default() };
        let refused = LeasesClient::new(farm.link()).register(about).await.unwrap_err();
        assert_eq!(refused.code(), Code::FailedPrecondition);
        let message = refused.message();
        assert!(message.contains(what) && message.contains("install the same"), "{message}");
    }
    Ok(())
}

/// Submitting is idempotent, and a name belongs to one grid.
#[tokio::test(flavor = "multi_thread")]
async fn submission_is_idempotent() -> Result<()> {
    let (farm, grid) = (Farm::start(&[]), small_grid());
    let first = farm.submit_grid("small", &grid).await?;
    assert_eq!(farm.submit_grid("small", &grid).await?, first);
    let mut other = wire::Grid::from(&grid);
    other.seed += 1;
    let request = SubmitRequest { name: "small".to_owned(), grid: Some(other.clone()), priority: 0 };
    assert_eq!(farm.dictionaries().submit(request).await.unwrap_err().code(), Code::AlreadyExists);
    other.g = vec![1.0];
    let request = SubmitRequest { name: "new".to_owned(), grid: Some(other), priority: 0 };
    let refused = farm.dictionaries().submit(request).await.unwrap_err();
    let details = refused.get_details_bad_request().expect("the field is named in the details");
    assert_eq!(details.field_violations[0].field, "grid.g[0]");
    let unknown = farm.dictionaries().get(GetRequest { name: "none".to_owned() }).await.unwrap_err();
    assert_eq!(
        (unknown.code(), unknown.message()),
        (Code::NotFound, "dictionary none does not exist; there are: small")
    );
    Ok(())
}

/// The number of pixels is limited, not that of bytes.
#[tokio::test(flavor = "multi_thread")]
async fn question_with_too_many_pixels_is_refused() -> Result<()> {
    let farm = Farm::start(&[]);
    let x: Vec<f64> = (0..100_000).map(|i| f64::from(i) * 1e-4 - 5.0).collect();
    let profile =
        |i: usize| MeasuredProfile::new(i.to_string(), 0.5, x.clone(), x.clone(), Some(vec![0.1; x.len()]));
    let profiles = (0..11).map(profile).collect::<Result<_, _>>()?;
    let measurement = Some((&Measurement::new("m", profiles)?).into());
    let request = FitRequest { dictionary: "small".to_owned(), measurement, options: None };
    let refused = farm.fits().fit(request).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);
    let expected = "measurement = 1100000 pixels is not valid: a coordinator accepts at most 1048576";
    assert!(refused.message().starts_with(expected), "{}", refused.message());
    Ok(())
}

/// The blocks of the job, which has few pixels so that many walks are cheap, are computed by two workers.
#[tokio::test(flavor = "multi_thread")]
async fn divided_job_has_the_undivided_bytes() -> Result<()> {
    let small = small_grid();
    let axes =
        Axes { sigma_t_per_mm: vec![1.0], g: vec![0.4], thickness_mm: vec![0.5], ..small.axes().clone() };
    let scene = small.scene().clone().with_sensor(Sensor::new(10.0, 12, 0.0)?);
    let grid = Grid::new(scene, axes, Walks::new(4_250_000)?, 1, false)?;
    let farm = Farm::start(&[]);
    let _workers = [farm.worker("a", &[]), farm.worker("b", &[])];
    farm.submit_grid("divided", &grid).await?;
    let whole = Digest::of_jobs([Digest::of_records(&traced(&grid, 0))]);
    assert_eq!(farm.watched("divided").await?.records_digest, Some(whole));
    Ok(())
}

/// The bytes are those of a grid with as many walks.
#[tokio::test(flavor = "multi_thread")]
async fn points_are_traced_until_the_target_error() -> Result<()> {
    let farm = Farm::start(&[]);
    let plain = small_grid();
    let first: Vec<f64> = (0..plain.job_count()).map(|job| Quality::noise_of(&traced(&plain, job))).collect();
    let target = 0.6 * first.iter().copied().fold(0.0, f64::max);
    let quality = Quality::new(target, Walks::new(1_000_000)?)?;
    let grid = plain.clone().with_quality(quality)?;
    let _worker = farm.worker("worker", &[]);
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
        while let Some(more) = quality.more_walks(spec.walks(), Quality::noise_of(&records)) {
            spec = spec.with_walks(more);
            records = optics_layers::records(&spec, &AtomicBool::new(false))?;
        }
        assert!(
            Quality::noise_of(&records) <= target,
            "job {job}: {} after {first}",
            Quality::noise_of(&records)
        );
        digests.push(Digest::of_records(&records));
    }
    assert_eq!(status.records_digest, Some(Digest::of_jobs(digests)));
    Ok(())
}
