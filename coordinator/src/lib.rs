//! The coordinator: splits a grid into jobs, leases them to workers, stores the records, answers fits.
//!
//! `rpc → farm → (dispatch, store, optics-fit)`, never back; dispatch and store do not depend on each other. The caller
//! owns the port and the stop signal.
//!
//! `docs/glossary.md` explains the terms.

#![warn(clippy::print_stdout, clippy::print_stderr, reason = "they panic where the output is full or closed")]

mod actor;
pub mod authorisation;
pub mod cli;
pub mod clock;
pub mod config;
pub mod connections;
pub mod dispatch;
mod farm;
mod gate;
mod metrics;
mod quota;
mod recompute;
mod rpc;
pub mod store;
pub mod stored;
#[cfg(test)]
mod testing;
mod throttle;

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use farm_proto::METHODS;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use clock::Clock;
pub use config::Config;
use farm::Farm;
pub use farm::{FarmError, load_dictionary};
pub use gate::{Gate, Listener};
use metrics::{BuildInfo, Metrics, MetricsServer};
use optics_model::PHYSICS_VERSION;
pub use store::StoreError;
use store::{Commit, DataDir, Store};
use throttle::Throttle;

/// Interval of the checks of everything that changes with time alone.
const LOOK_OVER: Duration = Duration::from_secs(1);

/// An access file that cannot be read is logged at most this often.
const LOG_INTERVAL: Duration = Duration::from_mins(1);

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("serving gRPC: {0}")]
    Serve(#[from] tonic::transport::Error),
    #[error("asking for the address of the listening socket: {0}")]
    Address(std::io::Error),
}

/// The rest of a call, boxed so that it is compiled here: an `async fn` is compiled by each crate that awaits it.
type Answer<'a, T> = Pin<Box<dyn Future<Output = Result<T, Error>> + Send + 'a>>;

/// A coordinator that has locked its data directory and loaded its contents.
#[derive(Debug)]
pub struct Coordinator {
    farm: Arc<Farm>,
    config: Config,
}

impl Coordinator {
    /// Locks the data directory, creating it if necessary, and resumes the work that is left in it.
    pub fn open(config: &Config) -> Answer<'_, Self> {
        Box::pin(Self::load(config))
    }

    async fn load(config: &Config) -> Result<Self, Error> {
        let build = BuildInfo {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            physics_version: PHYSICS_VERSION.to_string(),
        };
        let metrics = Metrics::new(build, METHODS.iter().copied());
        let of_commits = metrics.clone();
        let committed = move |commit: Commit| {
            of_commits.committed(commit.took, commit.results as u64, commit.records as u64);
        };
        let store = Store::open(DataDir::lock(&config.data_dir)?, committed).await?;
        let farm = Farm::load(store, config, metrics).await?;
        Ok(Self { farm, config: config.clone() })
    }

    /// Serves the callers that the gate admits until `shutdown`, then closes the database. Metrics are served over HTTP
    /// on a separate listener, if there is one.
    pub fn serve(
        self,
        listener: Listener,
        gate: Gate,
        metrics: Option<TcpListener>,
        shutdown: CancellationToken,
    ) -> Answer<'static, ()> {
        Box::pin(self.serve_until(listener, gate, metrics, shutdown))
    }

    async fn serve_until(
        self,
        listener: Listener,
        gate: Gate,
        metrics: Option<TcpListener>,
        shutdown: CancellationToken,
    ) -> Result<(), Error> {
        let address = listener.local_addr().map_err(Error::Address)?;
        if let Err(error) = self.farm.store().dir().publish_address(address) {
            tracing::warn!(%error, "commands in the same folder will not find this coordinator");
        }
        if self.config.start_is_event {
            self.farm.started();
        }
        tracing::info!(%address, "coordinator is serving");
        let metrics = metrics
            .map(|listener| tokio::spawn(metrics::serve(listener, self.metrics_server(), shutdown.clone())));
        let overseer = tokio::spawn(look_over(self.farm.clone(), gate.clone(), shutdown.clone()));
        let served = rpc::serve(self.farm.clone(), &self.config, gate, listener, shutdown.clone()).await;
        shutdown.cancel();
        let _ = overseer.await;
        if let Some(metrics) = metrics {
            let _ = metrics.await;
        }
        self.farm.store().dir().forget_address();
        self.farm.close().await;
        self.farm.store().check_place()?;
        Ok(served?)
    }

    fn metrics_server(&self) -> MetricsServer {
        let (farm, ready) = (self.farm.clone(), self.farm.clone());
        MetricsServer::new(self.farm.metrics().clone(), move || farm.snapshot(), move || ready.ready())
    }
}

async fn look_over(farm: Arc<Farm>, gate: Gate, shutdown: CancellationToken) {
    let (clock, errors) = (Clock::start(), Throttle::new(LOG_INTERVAL));
    let mut tick = tokio::time::interval(LOOK_OVER);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = shutdown.cancelled() => return,
            _ = tick.tick() => {}
        }
        if let Err(error) = farm.store().check_place() {
            tracing::error!(%error, "stopping");
            return shutdown.cancel();
        }
        if let Err(error) = gate.look_over() {
            farm.metrics().access_file_unread();
            if let Some(times) = errors.count(clock.now()) {
                tracing::error!(%error, times, "the access file has changed and cannot be used: nothing is changed");
            }
        }
        let freed = farm.look_over();
        if freed > 0 {
            tracing::warn!(freed, "leases have expired: their workers were silent too long");
        }
    }
}
