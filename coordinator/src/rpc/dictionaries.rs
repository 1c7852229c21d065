//! Service `farm.v1.Dictionaries`.

use std::time::Duration;

use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::dictionaries_server::Dictionaries;
use farm_proto::wire::{
    Dictionary, ExportRequest, GetRequest, ListRequest, ListResponse, Record, SubmitRequest, WatchRequest,
};
use farm_proto::{DictionaryName, Grid, Invalid};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::Context;
use super::status::required;

/// Changes closer together than this are told as one.
const WATCH_PAUSE: Duration = Duration::from_millis(100);
/// Records read at a time for an export.
const EXPORT_CHUNK: usize = 64;

#[tonic::async_trait]
impl Dictionaries for Context {
    async fn submit(&self, request: Request<SubmitRequest>) -> Result<Response<Dictionary>, Status> {
        let request = request.into_inner();
        let name = DictionaryName::new(request.name)?;
        let grid = Grid::try_from(required("grid", request.grid)?).map_err(|e| e.within("grid"))?;
        let status = self.farm.submit(name, grid).await?;
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
        let first = self.farm.status(&name)?;
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(watch(self.clone(), name, first, sender));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    type ExportStream = ReceiverStream<Result<Record, Status>>;

    async fn export(&self, request: Request<ExportRequest>) -> Result<Response<Self::ExportStream>, Status> {
        let request = request.into_inner();
        let name = DictionaryName::new(request.name)?;
        let total = self.farm.status(&name)?.records_total();
        if let Some((i, bad)) = request.indices.iter().enumerate().find(|(_, n)| **n as usize >= total) {
            let allowed = format!("the dictionary has records 0 to {}", total - 1);
            return Err(Invalid::new(format!("indices[{i}]"), bad, allowed).to_status());
        }
        let ranges: Vec<_> = if request.indices.is_empty() {
            (0..total).step_by(EXPORT_CHUNK).map(|first| first..(first + EXPORT_CHUNK).min(total)).collect()
        } else {
            request.indices.into_iter().map(|n| n as usize..n as usize + 1).collect()
        };
        let (sender, receiver) = mpsc::channel(EXPORT_CHUNK);
        tokio::spawn(export(self.clone(), name, ranges, sender));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

/// Sends every change until the dictionary has ended, the client has gone or the coordinator stops.
async fn watch(
    context: Context,
    name: DictionaryName,
    mut status: DictionaryStatus,
    sender: mpsc::Sender<Result<Dictionary, Status>>,
) {
    let mut changes = context.farm.changes();
    loop {
        if sender.send(Ok((&status).into())).await.is_err() || status.state() != DictionaryState::Running {
            return;
        }
        loop {
            tokio::select! {
                () = context.shutdown.cancelled() => {
                    let _ = sender.send(Err(Status::unavailable("the coordinator is stopping"))).await;
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
                    let _ = sender.send(Err(error.into())).await;
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
        let records = tokio::select! {
            () = context.shutdown.cancelled() => Err(Status::unavailable("the coordinator is stopping")),
            records = context.farm.records(&name, range) => records.map_err(Status::from),
        };
        match records {
            Ok(records) => {
                for record in records {
                    if sender.send(Ok(record.into())).await.is_err() {
                        return;
                    }
                }
            }
            Err(status) => {
                let _ = sender.send(Err(status)).await;
                return;
            }
        }
    }
}
