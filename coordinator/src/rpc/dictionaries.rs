//! Service `farm.v1.Dictionaries`.

use std::ops::Range;
use std::time::Duration;

use farm_proto::ids::DictionaryId;
use farm_proto::status::DictionaryStatus;
use farm_proto::wire::dictionaries_server::Dictionaries;
use farm_proto::wire::{
    CancelRequest, DeleteRequest, DeleteResponse, Dictionary, ExplainRequest, ExplainResponse, ExportRequest,
    GetRequest, ListRequest, ListResponse, PauseRequest, Reason, Record, ResumeRequest, RetryRequest,
    SetPriorityRequest, SubmitRequest, WatchRequest,
};
use farm_proto::{DictionaryName, RECORDS_PROMISED, RequestLimits, to_status};
use optics_model::{Grid, Invalid};
use tokio::sync::watch;
use tonic::{Request, Response, Status};

use super::Context;
use super::outgoing::{Outgoing, Outlet, PATIENCE, outgoing};
use super::page::{page_size, page_token};
use super::status::{OrStatus, required};
use crate::farm::{Farm, detached, read_chunk};

/// Changes closer together than this are told as one.
const WATCH_PAUSE: Duration = Duration::from_millis(100);
/// Most dictionaries of one page.
const DICTIONARIES: u32 = 100;
/// Records on their way to a client that exports.
const EXPORT_QUEUE: usize = 4;

#[tonic::async_trait]
impl Dictionaries for Context {
    async fn submit(&self, request: Request<SubmitRequest>) -> Result<Response<Dictionary>, Status> {
        let request = request.into_inner();
        let name = DictionaryName::new(request.name).or_status()?;
        let grid =
            Grid::try_from(required("grid", request.grid)?).map_err(|e| e.within("grid")).or_status()?;
        let priority = priority(request.priority).or_status()?;
        let farm = self.farm.clone();
        let status = detached(async move { farm.submit(name, grid, priority).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn get(&self, request: Request<GetRequest>) -> Result<Response<Dictionary>, Status> {
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        Ok(Response::new((&self.farm.status(&name)?).into()))
    }

    async fn list(&self, request: Request<ListRequest>) -> Result<Response<ListResponse>, Status> {
        let request = request.into_inner();
        let most = page_size(request.page_size, DICTIONARIES, DICTIONARIES);
        let (page, last) =
            self.farm.statuses(DictionaryId(page_token(&request.page_token).or_status()?), most);
        Ok(Response::new(ListResponse {
            dictionaries: page.iter().map(Into::into).collect(),
            next_page_token: last.map(|id| id.0.to_string()).unwrap_or_default(),
        }))
    }

    async fn pause(&self, request: Request<PauseRequest>) -> Result<Response<Dictionary>, Status> {
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let farm = self.farm.clone();
        let status = detached(async move { farm.pause(&name).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn resume(&self, request: Request<ResumeRequest>) -> Result<Response<Dictionary>, Status> {
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let farm = self.farm.clone();
        let status = detached(async move { farm.resume(&name).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn cancel(&self, request: Request<CancelRequest>) -> Result<Response<Dictionary>, Status> {
        let request = request.into_inner();
        let name = DictionaryName::new(request.name).or_status()?;
        if request.reason.len() > RequestLimits::TEXT_BYTES {
            let given = format!("{} bytes", request.reason.len());
            let allowed = format!("at most {} are allowed", RequestLimits::TEXT_BYTES);
            return Err(to_status(&Invalid::new("reason", given, allowed)));
        }
        let farm = self.farm.clone();
        let status = detached(async move { farm.cancel(&name, &request.reason).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn retry(&self, request: Request<RetryRequest>) -> Result<Response<Dictionary>, Status> {
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let farm = self.farm.clone();
        let status = detached(async move { farm.retry(&name).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn set_priority(
        &self,
        request: Request<SetPriorityRequest>,
    ) -> Result<Response<Dictionary>, Status> {
        let request = request.into_inner();
        let (name, priority) =
            (DictionaryName::new(request.name).or_status()?, priority(request.priority).or_status()?);
        let farm = self.farm.clone();
        let status = detached(async move { farm.set_priority(&name, priority).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn delete(&self, request: Request<DeleteRequest>) -> Result<Response<DeleteResponse>, Status> {
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let farm = self.farm.clone();
        let records_deleted = detached(async move { farm.delete(&name).await }).await?;
        Ok(Response::new(DeleteResponse { records_deleted }))
    }

    async fn explain(&self, request: Request<ExplainRequest>) -> Result<Response<ExplainResponse>, Status> {
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let reasons = self.farm.explain(&name)?.into_iter();
        let reasons = reasons.map(|r| Reason { code: r.code.to_owned(), text: r.text }).collect();
        Ok(Response::new(ExplainResponse { reasons }))
    }

    type WatchStream = Outgoing<Dictionary>;

    async fn watch(&self, request: Request<WatchRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        // Before the first look, so that no change falls between the two.
        let changes = self.farm.changes();
        let first = self.farm.status(&name)?;
        let place = self.limits.stream()?;
        let (outlet, updates) = outgoing(1, PATIENCE, self.shutdown.clone());
        let farm = self.farm.clone();
        tokio::spawn(async move {
            watch(&farm, name, first, changes, outlet).await;
            drop(place);
        });
        Ok(Response::new(updates))
    }

    type ExportStream = Outgoing<Record>;

    async fn export(&self, request: Request<ExportRequest>) -> Result<Response<Self::ExportStream>, Status> {
        let request = request.into_inner();
        let name = DictionaryName::new(request.name).or_status()?;
        let grid = self.farm.status(&name)?.grid;
        let ranges = ranges(&grid, request.first, &request.indices).or_status()?;
        let promised = self.farm.finished_records(&name, &ranges)?;
        let place = self.limits.stream()?;
        let (outlet, records) = outgoing(EXPORT_QUEUE, PATIENCE, self.shutdown.clone());
        let farm = self.farm.clone();
        tokio::spawn(async move {
            export(&farm, name, ranges, outlet).await;
            drop(place);
        });
        let mut response = Response::new(records);
        response.metadata_mut().insert(RECORDS_PROMISED, promised.into());
        Ok(response)
    }
}

fn priority(priority: i32) -> Result<i32, Invalid> {
    let range = RequestLimits::PRIORITY;
    if range.contains(&priority) {
        return Ok(priority);
    }
    let allowed = format!("allowed are {} to {}", range.start(), range.end());
    Err(Invalid::new("priority", priority, allowed))
}

/// Sends every change until the dictionary has ended, the client has gone or the coordinator stops.
async fn watch(
    farm: &Farm,
    name: DictionaryName,
    mut status: DictionaryStatus,
    mut changes: watch::Receiver<()>,
    outlet: Outlet<Dictionary>,
) {
    loop {
        let running = status.state().is_open();
        if outlet.send((&status).into()).await.is_err() {
            return;
        }
        if !running {
            return outlet.finish();
        }
        loop {
            tokio::select! {
                _ = outlet.closed() => return,
                changed = changes.changed() => if changed.is_err() { return },
            }
            tokio::time::sleep(WATCH_PAUSE).await;
            changes.mark_unchanged();
            match farm.status(&name) {
                Ok(now) if same(&now, &status) => {}
                Ok(now) => {
                    status = now;
                    break;
                }
                Err(error) => return outlet.fail(error.into()),
            }
        }
    }
}

/// Whether nothing has changed that people would see: the time that is left changes all the time, by a little.
fn same(a: &DictionaryStatus, b: &DictionaryStatus) -> bool {
    let near = match (a.eta_s, b.eta_s) {
        (Some(a), Some(b)) => (a - b).abs() <= 0.1 * a.max(b),
        (a, b) => a == b,
    };
    near && DictionaryStatus { eta_s: None, ..a.clone() } == DictionaryStatus { eta_s: None, ..b.clone() }
}

/// The numbers of the records that are wanted, in pieces that are read at once.
fn ranges(grid: &Grid, first: u32, indices: &[u32]) -> Result<Vec<Range<usize>>, Invalid> {
    let (total, chunk) = (grid.record_count(), read_chunk(grid));
    let allowed = || format!("the dictionary has records 0 to {}", total - 1);
    if let Some((i, bad)) = indices.iter().enumerate().find(|(_, n)| **n as usize >= total) {
        return Err(Invalid::new(format!("indices[{i}]"), bad, allowed()));
    }
    let first = first as usize;
    // One beyond the last is what a client asks for that has everything.
    if first > total {
        return Err(Invalid::new("first", first, allowed()));
    }
    if indices.is_empty() {
        return Ok((first..total).step_by(chunk).map(|from| from..(from + chunk).min(total)).collect());
    }
    let numbers = indices.iter().map(|n| *n as usize).filter(|n| *n >= first);
    Ok(numbers.map(|n| n..n + 1).collect())
}

/// Sends the records of ranges of numbers, as fast as the client takes them.
async fn export(farm: &Farm, name: DictionaryName, ranges: Vec<Range<usize>>, outlet: Outlet<Record>) {
    for range in ranges {
        match farm.records(&name, range).await {
            Ok(records) => {
                for record in records {
                    if outlet.send(record.into()).await.is_err() {
                        return;
                    }
                }
            }
            Err(error) => return outlet.fail(error.into()),
        }
    }
    outlet.finish();
}
