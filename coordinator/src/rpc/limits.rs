//! What all calls together may take: cores for fits, and streams.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tonic::Status;

/// Fits that wait for a core, besides those that have one.
const FITS_WAITING: usize = 256;
/// Streams that are watched or exported.
const STREAMS: usize = 1024;

/// Shared by all calls.
#[derive(Debug, Clone)]
pub(super) struct Limits {
    fits: Arc<Semaphore>,
    fits_waiting: Arc<Semaphore>,
    streams: Arc<Semaphore>,
}

impl Default for Limits {
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let semaphore = |permits| Arc::new(Semaphore::new(permits));
        Self {
            fits: semaphore(cores),
            fits_waiting: semaphore(cores + FITS_WAITING),
            streams: semaphore(STREAMS),
        }
    }
}

impl Limits {
    /// A core for a fit, as soon as one is free; refused if too many wait.
    pub(super) async fn fit(&self) -> Result<(OwnedSemaphorePermit, OwnedSemaphorePermit), Status> {
        let waiting = self.fits_waiting.clone().try_acquire_owned();
        let waiting = waiting.map_err(|_| {
            Status::resource_exhausted(format!("{FITS_WAITING} fits wait already: try again later"))
        })?;
        Ok((self.fits.clone().acquire_owned().await.map_err(stopping)?, waiting))
    }

    /// A place for a stream; refused if there are too many.
    pub(super) fn stream(&self) -> Result<OwnedSemaphorePermit, Status> {
        self.streams.clone().try_acquire_owned().map_err(|_| {
            Status::resource_exhausted(format!("{STREAMS} streams are open already: try again later"))
        })
    }
}

fn stopping(_: tokio::sync::AcquireError) -> Status {
    Status::unavailable("the coordinator is stopping")
}
