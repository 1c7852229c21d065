//! Streams items to clients as fast as they take them. A stream that does not reach its end ends with a status.

use std::future::Future;
use std::pin::Pin;

use farm_proto::status::DictionaryStatus;
use futures_util::{TryStreamExt as _, stream};
use optics_model::Record;
use tokio_stream::Stream;
use tokio_util::sync::CancellationToken;
use tonic::Status;

use crate::farm::{Backup, BackupPart, Export, FarmError, JobRun, JobWatch, Watch};
use crate::quota::Held;

/// A source of the items of a stream.
pub(super) trait Source: Send + 'static {
    type Item: Send;

    /// The next item; None at the end.
    fn next(&mut self) -> impl Future<Output = Result<Option<Self::Item>, FarmError>> + Send;
}

macro_rules! sources {
    ($($source:ty: $item:ty),*) => {$(
        impl Source for $source {
            type Item = $item;

            fn next(&mut self) -> impl Future<Output = Result<Option<$item>, FarmError>> + Send {
                Self::next(self)
            }
        }
    )*};
}

sources!(Watch: DictionaryStatus, JobWatch: JobRun, Export: Record, Backup: BackupPart);

/// The stream that a client reads.
pub(super) type Outgoing<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// The items of a source, until it ends or the coordinator stops. The place is given back when the client has gone.
pub(super) fn outgoing<S: Source, T: 'static>(
    source: S,
    encode: impl Fn(S::Item) -> T + Send + 'static,
    shutdown: CancellationToken,
    place: Held,
) -> Outgoing<T> {
    let items = stream::try_unfold((source, shutdown, place), |(mut source, shutdown, place)| async move {
        let next = tokio::select! {
            biased;
            () = shutdown.cancelled() => return Err(FarmError::Stopping),
            next = source.next() => next?,
        };
        Ok(next.map(|item| (item, (source, shutdown, place))))
    });
    Box::pin(items.map_ok(encode).map_err(Status::from))
}

#[cfg(test)]
mod tests {
    use tokio_stream::StreamExt as _;
    use tonic::Code;

    use super::*;
    use crate::quota::{Limit, Quota};

    /// Counts down to its end, or to an error.
    struct Countdown(u32, Option<FarmError>);

    impl Source for Countdown {
        type Item = u32;

        async fn next(&mut self) -> Result<Option<u32>, FarmError> {
            match (self.0, self.1.take()) {
                (0, None) => Ok(None),
                (0, Some(error)) => Err(error),
                (left, error) => {
                    *self = Self(left - 1, error);
                    Ok(Some(left))
                }
            }
        }
    }

    /// A stream has all items of its source, and a status if that fails or the coordinator stops. Its place comes back.
    #[tokio::test]
    async fn cut_stream_ends_with_a_status() {
        let quota = Quota::new("streams", "wait");
        for (error, stops, expected) in [
            (None, false, (vec![2, 1], None)),
            (Some(FarmError::Broken), false, (vec![2, 1], Some(Code::Internal))),
            (None, true, (vec![2], Some(Code::Unavailable))),
        ] {
            let shutdown = CancellationToken::new();
            let place = quota.hold(vec![Limit::all_callers(1)], 1).unwrap();
            let mut stream = outgoing(Countdown(2, error), |item| item, shutdown.clone(), place);
            let (mut items, mut code) = (Vec::new(), None);
            while let Some(item) = stream.next().await {
                match item {
                    Ok(item) => items.push(item),
                    Err(status) => code = Some(status.code()),
                }
                if stops {
                    shutdown.cancel();
                }
            }
            assert_eq!((items, code), expected);
        }
    }
}
