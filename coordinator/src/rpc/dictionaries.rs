//! Implements the gRPC service `farm.v1.Dictionaries`.

use farm_proto::ids::DictionaryId;
use farm_proto::wire::dictionaries_server::Dictionaries;
use farm_proto::wire::{
    CancelRequest, DeleteRequest, DeleteResponse, Dictionary, ExplainRequest, ExplainResponse, ExportRequest,
    GetRequest, JobStates, ListFailedRequest, ListFailedResponse, ListRequest, ListResponse, PauseRequest,
    Reason, Record, ResumeRequest, RetryRequest, SetPriorityRequest, SubmitRequest, WatchJobsRequest,
    WatchRequest,
};
use farm_proto::{DictionaryName, RECORDS_PROMISED, RequestLimits, to_status};
use optics_model::{Grid, Invalid};
use prost::Message as _;
use tonic::{Request, Response, Status};

use super::Context;
use super::outgoing::Outgoing;
use super::page::{page, page_size, page_token};
use super::status::{OrStatus, required};
use super::text::one_line;
use crate::authorisation::actor;
use crate::farm::detached;

/// Largest number of dictionaries per page.
const DICTIONARIES: u32 = 100;
/// Largest number of given-up jobs per page.
const FAILED: u32 = 1000;
/// Largest encoded grid: the lists of all clients have it.
const GRID_BYTES: usize = 64 << 10;

#[tonic::async_trait]
impl Dictionaries for Context {
    async fn submit(&self, request: Request<SubmitRequest>) -> Result<Response<Dictionary>, Status> {
        let by = actor(request.extensions());
        let request = request.into_inner();
        let name = DictionaryName::new(request.name).or_status()?;
        let grid = required("grid", request.grid)?;
        let bytes = grid.encoded_len();
        if bytes > GRID_BYTES {
            let allowed = format!("at most {GRID_BYTES} are allowed: give tables at fewer points");
            return Err(to_status(&Invalid::new("grid", format!("{bytes} bytes"), allowed)));
        }
        let grid = Grid::try_from(grid).map_err(|e| e.within("grid")).or_status()?;
        let priority = priority(request.priority).or_status()?;
        let farm = self.farm.clone();
        let status = detached(async move { farm.submit(&by, name, grid, priority).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn get(&self, request: Request<GetRequest>) -> Result<Response<Dictionary>, Status> {
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        Ok(Response::new((&self.farm.status(&name)?).into()))
    }

    async fn list(&self, request: Request<ListRequest>) -> Result<Response<ListResponse>, Status> {
        let request = request.into_inner();
        let most = page_size(request.page_size, DICTIONARIES, DICTIONARIES);
        let after = DictionaryId(page_token(&request.page_token).or_status()?);
        let statuses = self.farm.statuses(after, most + 1);
        let encoded = statuses.iter().map(|(id, status)| (id.0, Dictionary::from(status)));
        let (dictionaries, next_page_token) = page(encoded, most);
        Ok(Response::new(ListResponse { dictionaries, next_page_token }))
    }

    async fn list_failed(
        &self,
        request: Request<ListFailedRequest>,
    ) -> Result<Response<ListFailedResponse>, Status> {
        let request = request.into_inner();
        let name = DictionaryName::new(request.name).or_status()?;
        let most = page_size(request.page_size, 100, FAILED);
        let from = u32::try_from(page_token(&request.page_token).or_status()?).unwrap_or(u32::MAX);
        let failed = self.farm.failed_jobs(&name, from, most + 1)?;
        let (failed, next_page_token) = page(failed.into_iter().map(|f| (f.job + 1, f.into())), most);
        Ok(Response::new(ListFailedResponse { failed, next_page_token }))
    }

    async fn pause(&self, request: Request<PauseRequest>) -> Result<Response<Dictionary>, Status> {
        let by = actor(request.extensions());
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let farm = self.farm.clone();
        let status = detached(async move { farm.pause(&by, &name).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn resume(&self, request: Request<ResumeRequest>) -> Result<Response<Dictionary>, Status> {
        let by = actor(request.extensions());
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let farm = self.farm.clone();
        let status = detached(async move { farm.resume(&by, &name).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn cancel(&self, request: Request<CancelRequest>) -> Result<Response<Dictionary>, Status> {
        let by = actor(request.extensions());
        let request = request.into_inner();
        let name = DictionaryName::new(request.name).or_status()?;
        if request.reason.len() > RequestLimits::TEXT_BYTES {
            let given = format!("{} bytes", request.reason.len());
            let allowed = format!("at most {} are allowed", RequestLimits::TEXT_BYTES);
            return Err(to_status(&Invalid::new("reason", given, allowed)));
        }
        let farm = self.farm.clone();
        let status =
            detached(async move { farm.cancel(&by, &name, &one_line(&request.reason)).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn retry(&self, request: Request<RetryRequest>) -> Result<Response<Dictionary>, Status> {
        let by = actor(request.extensions());
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let farm = self.farm.clone();
        let status = detached(async move { farm.retry(&by, &name).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn set_priority(
        &self,
        request: Request<SetPriorityRequest>,
    ) -> Result<Response<Dictionary>, Status> {
        let by = actor(request.extensions());
        let request = request.into_inner();
        let (name, priority) =
            (DictionaryName::new(request.name).or_status()?, priority(request.priority).or_status()?);
        let farm = self.farm.clone();
        let status = detached(async move { farm.set_priority(&by, &name, priority).await }).await?;
        Ok(Response::new((&status).into()))
    }

    async fn delete(&self, request: Request<DeleteRequest>) -> Result<Response<DeleteResponse>, Status> {
        let by = actor(request.extensions());
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let farm = self.farm.clone();
        let records_deleted = detached(async move { farm.delete(&by, &name).await }).await?;
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
        let by = actor(request.extensions());
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let watch = self.farm.watch(name)?;
        Ok(Response::new(self.stream(&by, watch, |status| (&status).into())?))
    }

    type WatchJobsStream = Outgoing<JobStates>;

    async fn watch_jobs(
        &self,
        request: Request<WatchJobsRequest>,
    ) -> Result<Response<Self::WatchJobsStream>, Status> {
        let by = actor(request.extensions());
        let name = DictionaryName::new(request.into_inner().name).or_status()?;
        let watch = self.farm.watch_jobs(&name)?;
        Ok(Response::new(self.stream(&by, watch, |run| JobStates::new(run.first, &run.states))?))
    }

    type ExportStream = Outgoing<Record>;

    async fn export(&self, request: Request<ExportRequest>) -> Result<Response<Self::ExportStream>, Status> {
        let by = actor(request.extensions());
        let request = request.into_inner();
        let name = DictionaryName::new(request.name).or_status()?;
        let export = self.farm.export(name, request.first as usize, &request.indices)?;
        let promised = export.promised;
        let mut response = Response::new(self.stream(&by, export, Into::into)?);
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
