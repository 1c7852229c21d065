//! The flow of work through a real farm, and invalid requests.

mod effort;

use std::time::Duration;

use anyhow::{Context, Result};
use bytes::Bytes;
use farm_proto::lease::Lease;
use farm_proto::wire::leases_client::LeasesClient;
use farm_proto::wire::{
    CompletionKind, ExportRequest, FitRequest, GetRequest, RegisterRequest, SubmitRequest,
};
use farm_proto::{PROTOCOL_VERSION, wire};
use farm_tests::farm::Farm;
use farm_tests::grids::{small_grid, traced};
use farm_tests::process::SOON;
use farm_tests::test_worker::{falsified, on_wire, with_number};
use optics_model::fit::ChannelFit;
use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, MeasuredProfile, Measurement, PHYSICS_VERSION, Record, Walks};
use tonic::Code;
use tonic_types::StatusExt;

fn all_records(grid: &Grid) -> Vec<Vec<Record>> {
    (0..grid.job_count()).map(|job| traced(grid, job)).collect()
}

fn digest(jobs: &[Vec<Record>]) -> Digest {
    Digest::of_jobs(jobs.iter().map(|records| Digest::of_records(records)))
}

async fn exported(farm: &Farm, name: &str) -> Result<Vec<Record>> {
    let request = ExportRequest { name: name.to_owned(), ..Default::default() };
    let mut stream = farm.dictionaries().export(request).await?.into_inner();
    let mut records = Vec::new();
    while let Some(record) = stream.message().await? {
        records.push(Record::try_from(record)?);
    }
    Ok(records)
}

/// The records of the farm are those of the tracer, bit for bit.
#[tokio::test(flavor = "multi_thread")]
async fn farm_records_match_the_tracer() -> Result<()> {
    let (mut farm, grid) = (Farm::start(&[]), small_grid());
    let mut workers = [farm.worker("a", &[]), farm.worker("b", &[])];
    farm.submit_grid("small", &grid).await?;
    let status = farm.watched("small").await?;
    let expected = all_records(&grid);
    assert_eq!(status.records_digest, Some(digest(&expected)));
    assert_eq!(exported(&farm, "small").await?, expected.concat());
    assert_eq!((status.records_done(), status.work_done), (36, 1.0));
    for worker in &mut workers {
        assert_eq!(worker.terminate(SOON), 0);
    }
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

/// A simulated measurement, fitted over gRPC, gives its own record.
#[tokio::test(flavor = "multi_thread")]
async fn simulated_measurement_fits_its_own_record() -> Result<()> {
    let (mut farm, grid) = (Farm::start(&[]), small_grid());
    let mut worker = farm.worker("worker", &[]);
    farm.submit_grid("small", &grid).await?;
    farm.watched("small").await?;
    let (records, sensor) = (all_records(&grid).concat(), grid.scene().sensor());
    let profile = |thickness: usize| {
        let record = &records[grid.record_at(0, 1, 1, thickness, 2)];
        let x = (0..sensor.pixels()).map(|i| sensor.centre_mm(i)).collect();
        let values =
            record.profiles[1].radiance_factor.values().iter().map(|v| f64::from(*v) / 0.9).collect();
        MeasuredProfile::new("G", grid.thickness_mm()[thickness], x, values, None)
    };
    let measurement = Measurement::new("m", vec![profile(0)?, profile(1)?])?;
    let request = FitRequest {
        dictionary: "small".to_owned(),
        measurement: Some((&measurement).into()),
        options: Some(wire::FitOptions { mu: Some(0.9), top: Some(3), ..Default::default() }),
    };
    let answer = farm.fits().fit(request).await?.into_inner();
    let answer = answer.fit.context("a fit")?;
    let fit = ChannelFit::try_from(answer.channels[0].clone())?;
    let best = &fit.candidates[0];
    assert_eq!((answer.material.as_str(), fit.channel.as_str(), fit.candidates.len()), ("m", "G", 3));
    assert_eq!((best.medium.sigma_t_per_mm(), best.medium.albedo(), best.medium.g()), (4.0, 0.99, 0.4));
    // A descent ends where −2 ln L would fall by less than 1e-4.
    assert!(best.error < 1e-3 && fit.candidates[1].error > 10.0 * best.error, "{fit:?}");
    assert_eq!(worker.terminate(SOON), 0);
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

async fn leased(farm: &Farm, name: &str) -> Result<u64> {
    let dictionary = farm.dictionaries().get(GetRequest { name: name.to_owned() }).await?.into_inner();
    Ok(dictionary.jobs_leased)
}

/// A worker that stops hands its leases back at once.
#[tokio::test(flavor = "multi_thread")]
async fn stopping_worker_returns_its_leases() -> Result<()> {
    // With leases of an hour, the second worker can continue only after a hand-back.
    let (mut farm, grid) = (Farm::start(&["--lease", "3600"]), small_grid());
    farm.submit_grid("small", &grid).await?;
    let mut first = farm.worker("worker", &["--pace-ms", "250"]);
    while leased(&farm, "small").await? == 0 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(first.terminate(SOON), 0);
    assert_eq!(leased(&farm, "small").await?, 0);
    let mut second = farm.worker("worker", &[]);
    let status = tokio::time::timeout(Duration::from_mins(1), farm.watched("small")).await??;
    assert!(status.failed.is_empty());
    assert_eq!(second.terminate(SOON), 0);
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

/// The late result of a silent worker is a duplicate, or a conflict if it differs.
#[tokio::test(flavor = "multi_thread")]
async fn silent_worker_loses_its_job() -> Result<()> {
    let mut farm = Farm::with_tokens(&["silent", "healthy"], &["--lease", "1"]);
    let grid = small_grid();
    farm.submit_grid("small", &grid).await?;
    let mut silent = farm.test_worker_with("silent", "silent").await?;
    let lease = silent.acquire(1).await?.remove(0);
    let records = traced(&grid, lease.key.job as usize);
    let mut worker = farm.worker_of("healthy");
    farm.watched("small").await?;
    assert_eq!(silent.complete(&lease, on_wire(&records)).await?, CompletionKind::Duplicate);
    assert_eq!(silent.complete(&lease, falsified(&records)).await?, CompletionKind::Conflict);
    assert_eq!(exported(&farm, "small").await?, all_records(&grid).concat());
    assert_eq!(worker.terminate(SOON), 0);
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

/// Nothing is stored, and the error names the field.
#[tokio::test(flavor = "multi_thread")]
async fn records_of_another_shape_are_refused() -> Result<()> {
    let (mut farm, grid) = (Farm::start(&[]), small_grid());
    farm.submit_grid("small", &grid).await?;
    let mut worker = farm.test_worker("test").await?;
    let lease = worker.acquire(1).await?.remove(0);
    let good = on_wire(&traced(&grid, lease.key.job as usize));

    let of_record = good.len() / grid.albedo().len();
    let bad = [
        (with_number(&good, of_record + 3 * 4, f32::NAN), "profiles[0].radiance_factor.values[3]"),
        (good.slice(4..), "records"),
        ([good.clone(), good.clone()].concat().into(), "records"),
        (Bytes::new(), "records"),
    ];
    for (records, field) in bad {
        let refused = worker.complete(&lease, records).await.unwrap_err();
        assert_eq!(refused.code(), Code::InvalidArgument);
        let details = refused.get_details_bad_request().expect("the field is named in the details");
        assert!(details.field_violations[0].field.contains(field), "{details:?}");
    }
    let other = JobSpec::of(&grid, lease.key.job as usize).with_walks(Walks::new(50_000)?);
    let other = Lease { job: other, ..lease.clone() };
    assert_eq!(worker.complete(&other, good.clone()).await?, CompletionKind::Refused);
    assert!(exported(&farm, "small").await?.is_empty());
    assert_eq!(worker.complete(&lease, good).await?, CompletionKind::Stored);
    assert_eq!(exported(&farm, "small").await?.len(), 3);
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn worker_of_another_version_is_refused() -> Result<()> {
    let mut farm = Farm::start(&[]);
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
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

/// Submitting is idempotent, and a name belongs to one grid.
#[tokio::test(flavor = "multi_thread")]
async fn submission_is_idempotent() -> Result<()> {
    let (mut farm, grid) = (Farm::start(&[]), small_grid());
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
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

/// A dictionary that is not complete cannot be fitted to.
#[tokio::test(flavor = "multi_thread")]
async fn incomplete_dictionary_is_not_fitted() -> Result<()> {
    let (mut farm, grid) = (Farm::start(&[]), small_grid());
    farm.submit_grid("small", &grid).await?;
    let x: Vec<f64> = (0..20).map(|i| f64::from(i) * 0.5 - 4.75).collect();
    let measurement = Measurement::new("m", vec![MeasuredProfile::new("R", 0.5, x.clone(), x, None)?])?;
    let measurement = Some((&measurement).into());
    let request = FitRequest { dictionary: "small".to_owned(), measurement, options: None };
    let refused = farm.fits().fit(request).await.unwrap_err();
    assert_eq!(refused.code(), Code::FailedPrecondition);
    assert!(refused.message().contains("0 of 36 records are done"), "{}", refused.message());
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

/// The number of pixels is limited, not that of bytes.
#[tokio::test(flavor = "multi_thread")]
async fn question_with_too_many_pixels_is_refused() -> Result<()> {
    let mut farm = Farm::start(&[]);
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
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

/// Workers continue after the coordinator was away for a while.
#[tokio::test(flavor = "multi_thread")]
async fn workers_outlive_an_absent_coordinator() -> Result<()> {
    let grid = small_grid();
    let mut farm = Farm::start(&[]);
    farm.submit_grid("small", &grid).await?;
    let mut worker = farm.worker("worker", &[]);
    tokio::time::sleep(Duration::from_millis(100)).await;
    assert_eq!(farm.stop_coordinator(), 0);
    tokio::time::sleep(Duration::from_millis(300)).await;
    farm.start_coordinator();
    let status = tokio::time::timeout(Duration::from_mins(2), farm.watched("small")).await??;
    assert_eq!(status.records_digest, Some(digest(&all_records(&grid))));
    assert_eq!(worker.terminate(SOON), 0);
    assert_eq!(farm.stop_coordinator(), 0);
    Ok(())
}

/// A client that requests all records and reads none does not keep the coordinator from stopping.
#[tokio::test(flavor = "multi_thread")]
async fn unread_answer_does_not_delay_a_stop() -> Result<()> {
    let mut farm = Farm::start(&[]);
    let mut grid = wire::Grid::from(&small_grid());
    // Records of 0.4 MB, far more than the link's windows hold.
    grid.scene.as_mut().unwrap().sensor.as_mut().unwrap().pixels = 8192;
    grid.walks = 5000;
    grid.derivatives = true;
    let mut worker = farm.worker("worker", &[]);
    farm.submit_grid("large", &Grid::try_from(grid)?).await?;
    farm.watched("large").await?;
    assert_eq!(worker.terminate(SOON), 0);
    let request = ExportRequest { name: "large".to_owned(), ..Default::default() };
    let mut unread = farm.dictionaries().export(request).await?.into_inner();
    assert!(unread.message().await?.is_some());
    let start = tokio::time::Instant::now();
    assert_eq!(farm.stop_coordinator(), 0);
    assert!(start.elapsed() < Duration::from_secs(8), "it took {:?}", start.elapsed());
    while let Ok(Some(_)) = unread.message().await {}
    Ok(())
}
