//! A real farm in this process: coordinator on a loopback port, workers over gRPC, data in a temporary folder.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use farm_coordinator::{Config, Coordinator};
use farm_link::Target;
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_proto::wire::fits_client::FitsClient;
use farm_proto::wire::{SubmitRequest, WatchRequest};
use optics_model::grid::Axes;
use optics_model::scene::{Channel, Scene, Sensor};
use optics_model::{Grid, Walks};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tonic::transport::Channel as Link;

use crate::hand::HandWorker;

/// A grid of 12 jobs and 36 records that takes a second of one core.
pub fn small_grid() -> Grid {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0, 4.0, 8.0],
        albedo: vec![0.5, 0.9, 0.99],
        g: vec![0.0, 0.4],
        thickness_mm: vec![0.5, 1.0],
        sample_ior: vec![1.53],
    };
    let channels = vec![Channel::new("R", 0.985, 0.024).unwrap(), Channel::new("G", 0.972, 0.023).unwrap()];
    let scene = Scene::paper().with_channels(channels).unwrap();
    let scene = scene.with_sensor(Sensor::new(10.0, 90, 0.0).unwrap());
    Grid::new(scene, axes, Walks::new(25_000).unwrap(), 1, false).unwrap()
}

/// A coordinator task; the data directory is the caller's.
#[derive(Debug)]
pub struct TestCoordinator {
    address: SocketAddr,
    stop: CancellationToken,
    task: JoinHandle<Result<(), farm_coordinator::Error>>,
}

impl TestCoordinator {
    pub async fn start(data: &Path, lease: Duration, port: u16) -> Result<Self> {
        let config = Config { lease, ..Config::new(data) };
        let coordinator = Coordinator::open(&config).await?;
        let listener = TcpListener::bind(("127.0.0.1", port)).await?;
        let address = listener.local_addr()?;
        let stop = CancellationToken::new();
        let task = tokio::spawn(coordinator.serve(listener, None, stop.clone()));
        Ok(Self { address, stop, task })
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }

    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    pub async fn link(&self) -> Result<Link> {
        Ok(Link::from_shared(self.url())?.connect().await?)
    }

    pub async fn stop(self) -> Result<()> {
        self.stop.cancel();
        Ok(self.task.await??)
    }
}

/// A worker task with one tracing thread.
#[derive(Debug)]
pub struct TestWorker {
    stop: CancellationToken,
    task: JoinHandle<Result<farm_worker::Ended, farm_worker::Error>>,
}

impl TestWorker {
    pub fn start(url: &str) -> Self {
        let target = Target::new(None, Some(url)).unwrap();
        let config = farm_worker::Config { threads: 1, ..farm_worker::Config::new(target) };
        let stop = CancellationToken::new();
        let task = tokio::spawn(farm_worker::run(config, stop.clone()));
        Self { stop, task }
    }

    pub async fn stop(self) -> Result<()> {
        self.stop.cancel();
        self.task.await??;
        Ok(())
    }
}

/// Coordinator, data folder and clients.
#[derive(Debug)]
pub struct TestFarm {
    dir: tempfile::TempDir,
    pub coordinator: TestCoordinator,
    link: Link,
}

impl TestFarm {
    pub async fn start() -> Result<Self> {
        Self::with_lease(Duration::from_secs(30)).await
    }

    pub async fn with_lease(lease: Duration) -> Result<Self> {
        let dir = tempfile::tempdir()?;
        let coordinator = TestCoordinator::start(&dir.path().join("data"), lease, 0).await?;
        let link = coordinator.link().await?;
        Ok(Self { dir, coordinator, link })
    }

    pub fn link(&self) -> Link {
        self.link.clone()
    }

    pub fn data(&self) -> PathBuf {
        self.dir.path().join("data")
    }

    pub fn worker(&self) -> TestWorker {
        TestWorker::start(&self.coordinator.url())
    }

    pub fn dictionaries(&self) -> DictionariesClient<Link> {
        DictionariesClient::new(self.link.clone())
    }

    /// A worker by hand.
    pub async fn hand(&self, label: &str) -> Result<HandWorker, tonic::Status> {
        HandWorker::register(self.link.clone(), label).await
    }

    pub fn fits(&self) -> FitsClient<Link> {
        FitsClient::new(self.link.clone())
    }

    pub async fn submit(&self, name: &str, grid: &Grid) -> Result<DictionaryStatus> {
        let request = SubmitRequest { name: name.to_owned(), grid: Some(grid.into()), priority: 0 };
        Ok(self.dictionaries().submit(request).await?.into_inner().try_into()?)
    }

    /// Waits until the dictionary is done.
    pub async fn done(&self, name: &str) -> Result<DictionaryStatus> {
        done(self.link.clone(), name).await
    }

    /// Stops the coordinator and returns the data folder, still there.
    pub async fn into_dir(self) -> Result<tempfile::TempDir> {
        drop(self.link);
        self.coordinator.stop().await?;
        Ok(self.dir)
    }
}

/// Watches a dictionary until it is done.
pub async fn done(link: Link, name: &str) -> Result<DictionaryStatus> {
    let request = WatchRequest { name: name.to_owned() };
    let mut updates = DictionariesClient::new(link).watch(request).await?.into_inner();
    let mut last = None;
    while let Some(update) = updates.message().await? {
        last = Some(DictionaryStatus::try_from(update)?);
    }
    let status = last.context("the watch told nothing")?;
    ensure!(status.state() == DictionaryState::Done, "{:?}", status.failed);
    Ok(status)
}
