//! Limits the cores for fits, in [`turns`](crate::turns), and the streams of all calls together and of each caller.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tonic::Status;

use crate::turns::{Core, Turns};

/// Largest number of streams that are watched or exported.
const STREAMS: usize = 1024;
/// Largest number of streams of one client's token, so that others can open some, too.
const STREAMS_OF_ONE: usize = 256;

/// Limits that all calls share.
#[derive(Debug, Clone)]
pub(super) struct Limits {
    fits: Arc<Turns>,
    streams: Arc<Semaphore>,
    /// Number of streams by the name of the token.
    streams_of: Arc<Mutex<HashMap<String, usize>>>,
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
        Self {
            fits: Arc::new(Turns::new(cores)),
            streams: Arc::new(Semaphore::new(STREAMS)),
            streams_of: Arc::default(),
        }
    }
}

impl Limits {
    /// Waits for a core for a fit, in the turn of the callers that share under this name (empty for those without a
    /// share); refused if too many wait.
    pub(super) async fn fit(&self, caller: &str) -> Result<Core, Status> {
        self.fits.core(caller).await
    }

    /// A place for a stream of the callers that share under this name (empty for those without a share); refused if
    /// there are too many.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// One token may have a limited number of open streams, and a stream that ends makes room.
    #[test]
    fn one_token_leaves_streams_for_others() {
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
