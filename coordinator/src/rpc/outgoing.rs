//! Streams items to clients as fast as they take them, and sends a status if the end is not reached.
//!
//! A client that takes nothing for [`PATIENCE`] loses its stream, so that it does not hold records and a place here for
//! ever. When it reads on, it receives the items in flight and then `DEADLINE_EXCEEDED`, and can request the rest.

use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use farm_proto::status::DictionaryStatus;
use optics_model::Record;
use tokio::sync::mpsc;
use tokio_stream::Stream;
use tokio_util::sync::CancellationToken;
use tonic::Status;

use crate::farm::{Backup, BackupPart, Export, FarmError, JobRun, JobWatch, Watch};

/// Time limit for a client to read one item.
pub(super) const PATIENCE: Duration = Duration::from_mins(2);

/// A source of the items of a stream.
pub(super) trait Source: Send + 'static {
    type Item: Send;

    /// The next item; None at the end.
    fn next(&mut self) -> impl Future<Output = Result<Option<Self::Item>, FarmError>> + Send;
}

impl Source for Watch {
    type Item = DictionaryStatus;

    fn next(&mut self) -> impl Future<Output = Result<Option<Self::Item>, FarmError>> + Send {
        Self::next(self)
    }
}

impl Source for JobWatch {
    type Item = JobRun;

    fn next(&mut self) -> impl Future<Output = Result<Option<Self::Item>, FarmError>> + Send {
        Self::next(self)
    }
}

impl Source for Export {
    type Item = Record;

    fn next(&mut self) -> impl Future<Output = Result<Option<Self::Item>, FarmError>> + Send {
        Self::next(self)
    }
}

impl Source for Backup {
    type Item = BackupPart;

    fn next(&mut self) -> impl Future<Output = Result<Option<Self::Item>, FarmError>> + Send {
        Self::next(self)
    }
}

/// Forwards all items of a source, as fast as the client takes them, until the source ends, the client is gone, or the
/// coordinator stops.
pub(super) async fn hand_on<S: Source, T>(mut source: S, encode: impl Fn(S::Item) -> T, outlet: Outlet<T>) {
    loop {
        let next = tokio::select! {
            _ = outlet.closed() => return,
            next = source.next() => next,
        };
        match next {
            Ok(Some(item)) => {
                if outlet.send(encode(item)).await.is_err() {
                    return;
                }
            }
            Ok(None) => return outlet.finish(),
            Err(error) => return outlet.fail(error.into()),
        }
    }
}

/// The status with which a stream ends early; None if it is complete.
type Last = Arc<Mutex<Option<Status>>>;

/// The sending end of a stream. A stream whose outlet is dropped without [`Outlet::finish`] or [`Outlet::fail`] ends
/// with an error.
#[derive(Debug)]
pub(super) struct Outlet<T> {
    sender: mpsc::Sender<Result<T, Status>>,
    last: Last,
    shutdown: CancellationToken,
    patience: Duration,
}

/// The receiving end, which the client reads.
#[derive(Debug)]
pub(super) struct Outgoing<T> {
    receiver: mpsc::Receiver<Result<T, Status>>,
    last: Last,
}

/// The rest of the stream is not sent: the client is gone or reads nothing, or the coordinator is stopping.
#[derive(Debug)]
pub(super) struct Gone;

/// A stream with up to `queue` items in flight. It ends with `shutdown`, or when an item is not read within `patience`.
pub(super) fn outgoing<T>(
    queue: usize,
    patience: Duration,
    shutdown: CancellationToken,
) -> (Outlet<T>, Outgoing<T>) {
    let (sender, receiver) = mpsc::channel(queue);
    let last =
        Arc::new(Mutex::new(Some(Status::internal("the stream was broken off: ask for the rest again"))));
    (Outlet { sender, last: last.clone(), shutdown, patience }, Outgoing { receiver, last })
}

impl<T> Outlet<T> {
    /// Sends an item to the client. A stop of the coordinator does not wait for slow readers.
    pub(super) async fn send(&self, item: T) -> Result<(), Gone> {
        tokio::select! {
            () = self.shutdown.cancelled() => Err(self.stopping()),
            sent = tokio::time::timeout(self.patience, self.sender.send(Ok(item))) => {
                if let Ok(sent) = sent {
                    return sent.map_err(|_| Gone);
                }
                let waited = self.patience.as_secs();
                self.end_with(Some(Status::deadline_exceeded(format!(
                    "nothing was read for {waited} s, so the stream was ended early: ask for the rest again"
                ))));
                Err(Gone)
            }
        }
    }

    /// Waits until the client has gone or the coordinator stops.
    pub(super) async fn closed(&self) -> Gone {
        tokio::select! {
            () = self.shutdown.cancelled() => self.stopping(),
            () = self.sender.closed() => Gone,
        }
    }

    /// Marks the stream as complete.
    pub(super) fn finish(self) {
        self.end_with(None);
    }

    /// Ends the stream with an error, after the items in flight.
    pub(super) fn fail(self, status: Status) {
        self.end_with(Some(status));
    }

    fn stopping(&self) -> Gone {
        self.end_with(Some(Status::unavailable("the coordinator is stopping")));
        Gone
    }

    fn end_with(&self, last: Option<Status>) {
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = last;
    }
}

impl<T> Stream for Outgoing<T> {
    type Item = Result<T, Status>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let item = ready!(self.receiver.poll_recv(cx));
        let last = || self.last.lock().unwrap_or_else(PoisonError::into_inner).take().map(Err);
        Poll::Ready(item.or_else(last))
    }
}

#[cfg(test)]
mod tests {
    use tokio_stream::StreamExt;
    use tonic::Code;

    use super::*;

    fn stream() -> (Outlet<u32>, Outgoing<u32>, CancellationToken) {
        let shutdown = CancellationToken::new();
        let (outlet, outgoing) = outgoing(2, PATIENCE, shutdown.clone());
        (outlet, outgoing, shutdown)
    }

    /// The items and, if the stream did not reach its end, the code.
    async fn read(outgoing: Outgoing<u32>) -> (Vec<u32>, Option<Code>) {
        let all: Vec<_> = outgoing.collect().await;
        let code = all.iter().find_map(|item| Some(item.as_ref().err()?.code()));
        (all.into_iter().map_while(Result::ok).collect(), code)
    }

    /// A reader that pauses for less than the limit gets all items.
    #[tokio::test(start_paused = true)]
    async fn brief_pause_loses_no_items() {
        let (outlet, outgoing, _shutdown) = stream();
        let sending = tokio::spawn(async move {
            for item in 0..5 {
                outlet.send(item).await.unwrap();
            }
            outlet.finish();
        });
        tokio::time::sleep(PATIENCE.mul_f64(0.99)).await;
        assert_eq!(read(outgoing).await, (vec![0, 1, 2, 3, 4], None));
        sending.await.unwrap();
    }

    /// A stream ends without an error only if it was finished; if its reader stalls, or it was dropped or failed, it ends
    /// with a status, after the items that were already in flight.
    #[tokio::test(start_paused = true)]
    async fn only_a_finished_stream_ends_without_error() {
        let (outlet, outgoing, _shutdown) = stream();
        outlet.send(0).await.unwrap();
        outlet.send(1).await.unwrap();
        assert!(outlet.send(2).await.is_err(), "there is no reader");
        drop(outlet);
        assert_eq!(read(outgoing).await, (vec![0, 1], Some(Code::DeadlineExceeded)));

        let (outlet, outgoing, _shutdown) = stream();
        outlet.send(0).await.unwrap();
        drop(outlet);
        assert_eq!(read(outgoing).await, (vec![0], Some(Code::Internal)));

        let (outlet, outgoing, _shutdown) = stream();
        outlet.fail(Status::data_loss("damaged"));
        assert_eq!(read(outgoing).await, (vec![], Some(Code::DataLoss)));

        let (outlet, outgoing, shutdown) = stream();
        outlet.send(0).await.unwrap();
        outlet.send(1).await.unwrap();
        shutdown.cancel();
        assert!(outlet.send(2).await.is_err());
        drop(outlet);
        assert_eq!(read(outgoing).await, (vec![0, 1], Some(Code::Unavailable)));
    }
}
