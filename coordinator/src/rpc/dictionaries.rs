//! Service `farm.v1.Dictionaries`.

use std::time::Duration;

use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::dictionaries_server::Dictionaries;
use farm_proto::wire::{
    Dictionary, ExportRequest, GetRequest, ListRequest, ListResponse, Record, SubmitRequest, WatchRequest,
};
use farm_proto::{DictionaryName, Grid, Invalid};
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::Context;
use super::status::required;
use crate::farm::{detached, read_chunk};

/// Changes closer together than this are told as one.
const WATCH_PAUSE: Duration = Duration::from_millis(100);
/// Records on their way to a client that exports.
const EXPORT_QUEUE: usize = 4;

#[tonic::async_trait]
impl Dictionaries for Context {
    async fn submit(&self, request: Request<SubmitRequest>) -> Result<Response<Dictionary>, Status> {
        let request = request.into_inner();
        let name = DictionaryName::new(request.name)?;
        let grid = Grid::try_from(required("grid", request.grid)?).map_err(|e| e.within("grid"))?;
        let farm = self.farm.clone();
        let status = detached(async move { farm.submit(name, grid).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn get(&self, request: Request<GetRequest>) -> Result<Response<Dictionary>, Status> {
        let name = DictionaryName::new(request.into_inner().name)?;
        Ok(Response::new((&self.farm.status(&name)?).into()))
    }

    async fn list(&self, _: Request<ListRequest>) -> Result<Response<ListResponse>, Status> {
        let dictionaries = self.farm.statuses().iter().map(Into::into).collect();
        Ok(Response::new(ListResponse { dictionaries }))
    }

    type WatchStream = ReceiverStream<Result<Dictionary, Status>>;

    async fn watch(&self, request: Request<WatchRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let name = DictionaryName::new(request.into_inner().name)?;
        // Before the first look, so that no change falls between the two.
        let changes = self.farm.changes();
        let first = self.farm.status(&name)?;
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(watch(self.clone(), name, first, changes, sender));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    type ExportStream = ReceiverStream<Result<Record, Status>>;

    async fn export(&self, request: Request<ExportRequest>) -> Result<Response<Self::ExportStream>, Status> {
        let request = request.into_inner();
        let name = DictionaryName::new(request.name)?;
        let grid = self.farm.status(&name)?.grid;
        let (total, chunk) = (grid.record_count(), read_chunk(&grid));
        if let Some((i, bad)) = request.indices.iter().enumerate().find(|(_, n)| **n as usize >= total) {
            let allowed = format!("the dictionary has records 0 to {}", total - 1);
            return Err(Invalid::new(format!("indices[{i}]"), bad, allowed).to_status());
        }
        let ranges: Vec<_> = if request.indices.is_empty() {
            (0..total).step_by(chunk).map(|first| first..(first + chunk).min(total)).collect()
        } else {
            request.indices.into_iter().map(|n| n as usize..n as usize + 1).collect()
        };
        let (sender, receiver) = mpsc::channel(EXPORT_QUEUE);
        tokio::spawn(export(self.clone(), name, ranges, sender));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

/// Hands an item to the client; false if it has gone or the coordinator stops, which must not wait for slow readers.
async fn deliver<T>(
    context: &Context,
    sender: &mpsc::Sender<Result<T, Status>>,
    item: Result<T, Status>,
) -> bool {
    tokio::select! {
        () = context.shutdown.cancelled() => {
            // If there is room the client learns why its stream ends.
            let _ = sender.try_send(Err(Status::unavailable("the coordinator is stopping")));
            false
        }
        sent = sender.send(item) => sent.is_ok(),
    }
}

/// Sends every change until the dictionary has ended, the client has gone or the coordinator stops.
async fn watch(
    context: Context,
    name: DictionaryName,
    mut status: DictionaryStatus,
    mut changes: watch::Receiver<()>,
    sender: mpsc::Sender<Result<Dictionary, Status>>,
) {
    loop {
        let running = status.state() == DictionaryState::Running;
        if !deliver(&context, &sender, Ok((&status).into())).await || !running {
            return;
        }
        loop {
            tokio::select! {
                () = context.shutdown.cancelled() => {
                    let _ = sender.try_send(Err(Status::unavailable("the coordinator is stopping")));
                    return;
                }
                () = sender.closed() => return,
                changed = changes.changed() => if changed.is_err() { return },
            }
            tokio::time::sleep(WATCH_PAUSE).await;
            changes.mark_unchanged();
            match context.farm.status(&name) {
                Ok(now) if now == status => {}
                Ok(now) => {
                    status = now;
                    break;
                }
                Err(error) => {
                    deliver(&context, &sender, Err(error.into())).await;
                    return;
                }
            }
        }
    }
}

/// Sends the records of ranges of numbers, as fast as the client takes them.
async fn export(
    context: Context,
    name: DictionaryName,
    ranges: Vec<std::ops::Range<usize>>,
    sender: mpsc::Sender<Result<Record, Status>>,
) {
    for range in ranges {
        match context.farm.records(&name, range).await {
            Ok(records) => {
                for record in records {
                    if !deliver(&context, &sender, Ok(record.into())).await {
                        return;
                    }
                }
            }
            Err(error) => {
                deliver(&context, &sender, Err(error.into())).await;
                return;
            }
        }
    }
}
