//! What all calls together may take, and each caller of it: cores for fits, and streams.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tonic::Status;

/// Fits that wait for a core, besides those that have one.
const FITS_WAITING: usize = 256;
/// Those of one client's token.
const FITS_OF_ONE_WAITING: usize = 64;
/// Streams that are watched or exported.
const STREAMS: usize = 1024;
/// Those of one client's token: others need some, too.
const STREAMS_OF_ONE: usize = 256;

/// Shared by all calls.
#[derive(Debug, Clone)]
pub(super) struct Limits {
    cores: usize,
    fits: Arc<Semaphore>,
    /// By the name of the token.
    fits_of: Arc<Mutex<HashMap<String, Share>>>,
    fits_waiting: Arc<Semaphore>,
    streams: Arc<Semaphore>,
    /// By the name of the token.
    streams_of: Arc<Mutex<HashMap<String, usize>>>,
}

/// What the fits of one token may take.
#[derive(Debug, Clone)]
struct Share {
    cores: Arc<Semaphore>,
    waiting: Arc<Semaphore>,
}

/// What a fit holds while it waits and while it is computed.
#[derive(Debug)]
pub(super) struct FitPlace {
    _core: OwnedSemaphorePermit,
    _own: Option<[OwnedSemaphorePermit; 2]>,
    _waiting: OwnedSemaphorePermit,
}

/// The place of a stream, until it is dropped.
#[derive(Debug)]
pub(super) struct StreamPlace {
    _place: OwnedSemaphorePermit,
    caller: String,
    streams_of: Arc<Mutex<HashMap<String, usize>>>,
}

impl Drop for StreamPlace {
    fn drop(&mut self) {
        let mut streams_of = self.streams_of.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = streams_of.get_mut(&self.caller) {
            *count -= 1;
            if *count == 0 {
                streams_of.remove(&self.caller);
            }
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let semaphore = |permits| Arc::new(Semaphore::new(permits));
        Self {
            cores,
            fits: semaphore(cores),
            fits_of: Arc::default(),
            fits_waiting: semaphore(cores + FITS_WAITING),
            streams: semaphore(STREAMS),
            streams_of: Arc::default(),
        }
    }
}

impl Limits {
    /// A core for a fit of whoever shares by this name, which is empty for those without a share, as soon as one is free;
    /// refused if too many wait. One never has all cores, if there are several, nor all places to wait in.
    pub(super) async fn fit(&self, caller: &str) -> Result<FitPlace, Status> {
        let share = (!caller.is_empty()).then(|| self.share_of(caller));
        let own_waiting = share.as_ref().map(|share| share.waiting.clone().try_acquire_owned()).transpose();
        let own_waiting = own_waiting.map_err(|_| {
            let why =
                format!("{FITS_OF_ONE_WAITING} fits of this token ({caller}) wait already: try again later");
            Status::resource_exhausted(why)
        })?;
        let waiting = self.fits_waiting.clone().try_acquire_owned();
        let waiting = waiting.map_err(|_| {
            Status::resource_exhausted(format!("{FITS_WAITING} fits wait already: try again later"))
        })?;
        let own = match share.zip(own_waiting) {
            None => None,
            Some((share, waiting)) => Some([share.cores.acquire_owned().await.map_err(stopping)?, waiting]),
        };
        let core = self.fits.clone().acquire_owned().await.map_err(stopping)?;
        Ok(FitPlace { _core: core, _own: own, _waiting: waiting })
    }

    fn share_of(&self, caller: &str) -> Share {
        let cores = self.cores.saturating_sub(1).max(1);
        let semaphore = |permits| Arc::new(Semaphore::new(permits));
        let share = || Share { cores: semaphore(cores), waiting: semaphore(cores + FITS_OF_ONE_WAITING) };
        let mut fits_of = self.fits_of.lock().unwrap_or_else(PoisonError::into_inner);
        fits_of.entry(caller.to_owned()).or_insert_with(share).clone()
    }

    /// A place for a stream of whoever shares by this name, which is empty for those without a share; refused if there are
    /// too many.
    pub(super) fn stream(&self, caller: &str) -> Result<StreamPlace, Status> {
        let place = self.streams.clone().try_acquire_owned().map_err(|_| {
            Status::resource_exhausted(format!("{STREAMS} streams are open already: try again later"))
        })?;
        let mut streams_of = self.streams_of.lock().unwrap_or_else(PoisonError::into_inner);
        let count = streams_of.entry(caller.to_owned()).or_default();
        if *count == STREAMS_OF_ONE && !caller.is_empty() {
            let why = format!("{STREAMS_OF_ONE} streams of this token ({caller}) are open already: end some");
            return Err(Status::resource_exhausted(why));
        }
        *count += 1;
        let streams_of = self.streams_of.clone();
        Ok(StreamPlace { _place: place, caller: caller.to_owned(), streams_of })
    }
}

fn stopping(_: tokio::sync::AcquireError) -> Status {
    Status::unavailable("the coordinator is stopping")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn one_token_leaves_a_core_for_the_fits_of_others() {
        let limits = Limits { cores: 2, fits: Arc::new(Semaphore::new(2)), ..Limits::default() };
        let soon = |caller: &'static str| {
            tokio::time::timeout(std::time::Duration::from_secs(1), limits.fit(caller))
        };
        let of_alice = soon("alice").await.unwrap().unwrap();
        assert!(soon("alice").await.is_err(), "she has her share");
        let of_bob = soon("bob").await.unwrap().unwrap();
        drop(of_alice);
        let of_alice = soon("alice").await.unwrap().unwrap();
        let waits = |_| {
            tokio::spawn({
                let limits = limits.clone();
                async move { limits.fit("alice").await }
            })
        };
        let waiting: Vec<_> = (0..FITS_OF_ONE_WAITING).map(waits).collect();
        // Time goes on when all of them wait.
        let all_wait = || tokio::time::sleep(std::time::Duration::from_millis(1));
        all_wait().await;
        let refused = soon("alice").await.unwrap().unwrap_err();
        assert_eq!(refused.message(), "64 fits of this token (alice) wait already: try again later");
        drop(of_bob);
        assert!(soon("bob").await.unwrap().is_ok(), "others find a place to wait in, and a core");
        waiting.iter().for_each(tokio::task::JoinHandle::abort);
        all_wait().await;
        drop(of_alice);
        let alone = (soon("").await.unwrap(), soon("").await.unwrap());
        assert!(alone.0.is_ok() && alone.1.is_ok(), "who has no share is not kept waiting");
    }

    #[test]
    fn one_token_leaves_streams_for_others_and_what_ends_makes_room() {
        let limits = Limits::default();
        let mut of_bob: Vec<_> = (0..STREAMS_OF_ONE).map(|_| limits.stream("bob").unwrap()).collect();
        let refused = limits.stream("bob").unwrap_err();
        assert_eq!(refused.message(), "256 streams of this token (bob) are open already: end some");
        let of_alice = limits.stream("alice").unwrap();
        of_bob.pop();
        of_bob.push(limits.stream("bob").unwrap());
        drop((of_bob, of_alice));
        assert!(limits.streams_of.lock().unwrap().is_empty());
        let all: Vec<_> = (0..STREAMS).map(|_| limits.stream("").unwrap()).collect();
        assert!(limits.stream("alice").unwrap_err().message().starts_with("1024 streams are open"));
        drop(all);
    }
}
