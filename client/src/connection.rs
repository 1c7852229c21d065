//! Connects to a farm: a server's, or one that runs in this process.

pub(crate) mod outage;
pub(crate) mod records;

use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use farm_coordinator::store::DataDir;
use farm_coordinator::{Config, Coordinator, Error, Gate, StoreError};
use farm_link::{ClientAccess, Link, Target, failure, refusal};
use farm_proto::wire::admin_client::AdminClient;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_proto::wire::farm_client::FarmClient;
use farm_proto::wire::fits_client::FitsClient;
use farm_proto::wire::measurements_client::MeasurementsClient;
use farm_proto::{RequestLimits, check_pixels, to_status, wire};
use optics_model::limits::FitLimits;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::cli::Global;

/// The purpose for which a command opens a farm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// Queries an existing farm.
    Ask,
    /// Computes a dictionary; a local farm is created if necessary, with a worker. What other commands have left
    /// unfinished waits.
    Compute,
    /// Keeps a farm running, with a worker; what is unfinished is continued.
    Serve,
}

#[derive(Debug)]
pub(crate) struct Connection {
    link: Link,
    address: String,
    host: Host,
}

/// The process that runs the farm.
#[derive(Debug)]
enum Host {
    Server,
    /// Another process that holds the data directory, and may end at any moment.
    Neighbour,
    Embedded(Embedded),
}

/// How long to wait for a data directory that an unresponsive process holds.
const HELD: Duration = Duration::from_secs(15);
/// Pause before the next attempt.
const LOOK_AGAIN: Duration = Duration::from_millis(100);

/// Does some work with a farm. If the farm ran in a neighbouring process that has ended, the work is repeated with the
/// next farm, which may run in this process.
pub(crate) async fn with_farm<T>(
    global: &Global,
    purpose: Purpose,
    work: impl AsyncFn(&Connection) -> Result<T>,
) -> Result<T> {
    loop {
        let connection = Connection::open(global, purpose).await?;
        let neighbour = matches!(connection.host, Host::Neighbour);
        let result = work(&connection).await.map_err(|error| connection.in_plain_words(error));
        connection.close().await?;
        match result {
            Err(error) if neighbour && is_gone(&error) => tokio::time::sleep(LOOK_AGAIN).await,
            result => return result,
        }
    }
}

/// A request whose answer may take as long as reading through a large database, or fitting a million pixels.
pub(crate) fn patient<T>(message: T) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.set_timeout(Duration::from_hours(12));
    request
}

/// The error of a failed transport.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Unreachable(String);

/// The error of a call to a server; if the transport failed, with the reason in plain words.
pub(crate) fn in_plain_words(error: anyhow::Error, url: &str) -> anyhow::Error {
    let status = error.chain().find_map(|cause| cause.downcast_ref::<tonic::Status>());
    match status.and_then(|status| failure(status, url)) {
        Some(why) => anyhow::Error::new(Unreachable(why)).context(format!("no coordinator answers at {url}")),
        None => error,
    }
}

/// Whether a call failed because the coordinator is gone.
pub(crate) fn is_gone(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| cause.downcast_ref().is_some_and(is_broken) || cause.is::<Unreachable>())
}

/// Whether a call was ended by a broken connection or the end of the coordinator.
pub(crate) fn is_broken(status: &tonic::Status) -> bool {
    use std::error::Error;
    // A status received from the coordinator has no source; one that the transport made has one.
    status.code() == tonic::Code::Unavailable || status.source().is_some()
}

/// A coordinator and perhaps a worker in this process.
#[derive(Debug)]
struct Embedded {
    coordinator: JoinHandle<Result<(), Error>>,
    worker: Option<JoinHandle<Result<farm_worker::EndReason, farm_worker::Error>>>,
    stop_coordinator: CancellationToken,
    stop_worker: CancellationToken,
}

/// The kernel in FARM_KERNEL, as for `farm-worker`.
pub(crate) fn kernel_name() -> Option<String> {
    std::env::var("FARM_KERNEL").ok().filter(|name| !name.is_empty())
}

/// The time in FARM_PACE_MS, as for `farm-worker`.
fn pace() -> Duration {
    let given = std::env::var("FARM_PACE_MS").ok().and_then(|text| text.parse().ok());
    Duration::from_millis(given.unwrap_or(0))
}

/// Settings of the embedded coordinator.
fn coordinator(data: &Path) -> Result<Config> {
    // No limit on a question's pixels: it would protect other users.
    // Its one worker is this process: a check would compare it with itself.
    let mut config = Config { question_pixels: usize::MAX, check_share: 0.0, ..Config::new(data) };
    if let Some(given) = std::env::var_os("FARM_FIT_MEMORY").filter(|given| !given.is_empty()) {
        let mib = given.to_str().and_then(|given| given.parse::<usize>().ok());
        let mib = mib
            .with_context(|| format!("FARM_FIT_MEMORY is {}: a number of MiB is needed", given.display()))?;
        config.fit_memory_bytes = mib.saturating_mul(1 << 20);
    }
    Ok(config)
}

/// Whether commands use the farm of a folder on this machine.
fn is_local(global: &Global) -> bool {
    global.local || (global.server.is_none() && global.access.is_none())
}

/// Whether commands use a folder on this machine that holds no farm yet.
pub(crate) fn lacks_farm(global: &Global) -> bool {
    is_local(global) && global.data.join(DATABASE).try_exists().is_ok_and(|there| !there)
}

/// The file by which a farm's folder is recognised.
const DATABASE: &str = "farm.db";

impl Connection {
    pub(crate) async fn open(global: &Global, purpose: Purpose) -> Result<Self> {
        if is_local(global) {
            return Self::local(&global.data, purpose).await;
        }
        let access = global.access.as_deref().map(ClientAccess::read).transpose()?;
        Self::remote(&Target::new(access.as_ref(), global.server.as_deref())?).await
    }

    async fn remote(target: &Target) -> Result<Self> {
        let url = target.url().to_owned();
        let link = target
            .connect()
            .await
            .map_err(|error| {
                if let Some(status) = refusal(&error) {
                    return status.into();
                }
                if let Some(why) = failure(&error, &url) {
                    return anyhow::Error::new(Unreachable(why));
                }
                let cause =
                    std::iter::successors(Some(&error as &dyn std::error::Error), |e| e.source()).last();
                anyhow::anyhow!("{}", cause.map_or_else(String::new, ToString::to_string))
            })
            .with_context(|| format!("no coordinator answers at {url}"))?;
        Ok(Self { link, address: url, host: Host::Server })
    }

    async fn local(data: &Path, purpose: Purpose) -> Result<Self> {
        let there = match data.join(DATABASE).try_exists() {
            Err(error) if error.kind() == ErrorKind::PermissionDenied => {
                let place =
                    format!("looking for a farm in {}: is the folder another user's?", data.display());
                return Err(anyhow::Error::new(error).context(place));
            }
            there => there.unwrap_or(false),
        };
        if purpose == Purpose::Ask && !there {
            bail!(
                "there is no farm in {}: run `farmctl submit` first, or name its folder with --data or a server \
                 with --server",
                data.display()
            );
        }
        // Starting a coordinator only for a query is not recorded as an event.
        let config = Config {
            start_is_event: purpose != Purpose::Ask,
            holds_unfinished: purpose != Purpose::Serve,
            ..coordinator(data)?
        };
        let start = tokio::time::Instant::now();
        loop {
            match Coordinator::open(&config).await {
                Ok(coordinator) => return Self::embed(coordinator, purpose).await,
                Err(Error::Store(StoreError::InUse { .. })) if start.elapsed() < HELD => {}
                Err(error) => return Err(error.into()),
            }
            // The holder may have just started and not listen yet, or be about to end.
            if let Some(address) = DataDir::address(data)
                && let Ok(connection) = Self::remote(&loopback(&address)?).await
            {
                return Ok(Self { host: Host::Neighbour, ..connection });
            }
            tokio::time::sleep(LOOK_AGAIN).await;
        }
    }

    /// Settings of a worker on all cores.
    fn worker(coordinator: Target) -> farm_worker::Config {
        farm_worker::Config { kernel: kernel_name(), pace: pace(), ..farm_worker::Config::new(coordinator) }
    }

    async fn embed(coordinator: Coordinator, purpose: Purpose) -> Result<Self> {
        let any_port = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let (listener, gate) = Gate::own_user(any_port).context("opening a port on loopback")?;
        let target = loopback(&listener.local_addr()?.to_string())?;
        let (stop_coordinator, stop_worker) = (CancellationToken::new(), CancellationToken::new());
        let coordinator = tokio::spawn(coordinator.serve(listener, gate, None, stop_coordinator.clone()));
        let worker = (purpose != Purpose::Ask).then(|| {
            let work = farm_worker::run(Self::worker(target.clone()), stop_worker.clone());
            let stop_coordinator = stop_coordinator.clone();
            tokio::spawn(async move {
                let ended = work.await;
                if ended.is_err() {
                    // Without its worker the farm would wait for ever.
                    stop_coordinator.cancel();
                }
                ended
            })
        });
        let embedded = Embedded { coordinator, worker, stop_coordinator, stop_worker };
        match Self::remote(&target).await {
            Ok(connection) => Ok(Self { host: Host::Embedded(embedded), ..connection }),
            Err(error) => {
                // The coordinator's own error is the better explanation.
                embedded.close().await?;
                Err(error)
            }
        }
    }

    pub(crate) fn link(&self) -> Link {
        self.link.clone()
    }

    pub(crate) fn address(&self) -> &str {
        &self.address
    }

    /// Whether the farm runs in this process and ends with it.
    pub(crate) fn is_embedded(&self) -> bool {
        matches!(self.host, Host::Embedded(_))
    }

    /// Whether the farm ran in this process and has ended by itself.
    pub(crate) fn has_ended(&self) -> bool {
        matches!(&self.host, Host::Embedded(embedded) if embedded.coordinator.is_finished())
    }

    /// Whether the farm continues when this process ends.
    pub(crate) fn is_server(&self) -> bool {
        matches!(self.host, Host::Server)
    }

    /// The error of a call; if the connection to a server failed, with the reason in plain words.
    pub(crate) fn in_plain_words(&self, error: anyhow::Error) -> anyhow::Error {
        if self.is_server() { in_plain_words(error, &self.address) } else { error }
    }

    pub(crate) fn dictionaries(&self) -> DictionariesClient<Link> {
        DictionariesClient::new(self.link.clone()).max_decoding_message_size(RequestLimits::MESSAGE_BYTES)
    }

    /// A client without a limit on the size of answers, which depends on the question: with curves it is ten times as
    /// large.
    pub(crate) fn fits(&self) -> FitsClient<Link> {
        FitsClient::new(self.link.clone()).max_decoding_message_size(usize::MAX)
    }

    /// A client for a question about measurements. More pixels than a coordinator accepts are refused here.
    pub(crate) fn fits_of(
        &self,
        field: &str,
        materials: &[wire::Measurement],
    ) -> Result<FitsClient<Link>, tonic::Status> {
        check_pixels(field, materials, self.question_pixels()).map_err(|invalid| to_status(&invalid))?;
        Ok(self.fits())
    }

    /// Largest number of pixels of one question. In this process only memory is the limit; a neighbour checks its own
    /// limit.
    fn question_pixels(&self) -> usize {
        if self.is_server() { FitLimits::QUESTION_PIXELS } else { usize::MAX }
    }

    /// A client for kept measurements, whose answers may be as large as those of a measurement.
    pub(crate) fn measurements(&self) -> MeasurementsClient<Link> {
        MeasurementsClient::new(self.link.clone()).max_decoding_message_size(usize::MAX)
    }

    pub(crate) fn admin(&self) -> AdminClient<Link> {
        AdminClient::new(self.link.clone()).max_decoding_message_size(RequestLimits::MESSAGE_BYTES)
    }

    pub(crate) fn farm(&self) -> FarmClient<Link> {
        FarmClient::new(self.link.clone())
    }

    /// Stops the embedded farm: the worker returns its leases, the coordinator closes its database.
    pub(crate) async fn close(self) -> Result<()> {
        drop(self.link);
        match self.host {
            Host::Embedded(embedded) => embedded.close().await,
            Host::Server | Host::Neighbour => Ok(()),
        }
    }
}

/// The address of a farm of this machine, without TLS and token.
fn loopback(address: &str) -> Result<Target> {
    Ok(Target::new(None, Some(&format!("http://{address}")))?)
}

impl Embedded {
    async fn close(self) -> Result<()> {
        self.stop_worker.cancel();
        let worker = match self.worker {
            Some(worker) => worker.await.context("the embedded worker")?.map(drop),
            None => Ok(()),
        };
        self.stop_coordinator.cancel();
        self.coordinator.await.context("the embedded coordinator")??;
        Ok(worker?)
    }
}
