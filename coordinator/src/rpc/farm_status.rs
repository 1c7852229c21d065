//! Implements the gRPC service `farm.v1.Farm`.

use farm_proto::ids::WorkerId;
use farm_proto::wire::farm_server::Farm;
use farm_proto::wire::{
    Event, ListEventsRequest, ListEventsResponse, ListWorkersRequest, ListWorkersResponse, PacePeriod,
    PaceRequest, PaceResponse, StatusRequest, StatusResponse,
};
use farm_proto::{RequestLimits, to_status};
use optics_model::{Invalid, PHYSICS_VERSION};
use tonic::{Request, Response, Status};

use super::Context;
use super::page::{page, page_size, page_token};
use super::status::OrStatus;
use crate::dispatch::PERIOD;
use crate::store::StoredEvent;

/// Largest number of workers, or of events, per page.
const PAGE: u32 = 1000;
/// Number of events per page if the request does not give a size.
const EVENTS: u32 = 100;

#[tonic::async_trait]
impl Farm for Context {
    async fn status(&self, _: Request<StatusRequest>) -> Result<Response<StatusResponse>, Status> {
        let o = self.farm.overview();
        Ok(Response::new(StatusResponse {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            physics_version: PHYSICS_VERSION,
            jobs_pending: o.jobs_pending as u64,
            jobs_leased: o.jobs_leased as u64,
            dictionaries: o.dictionaries as u64,
            workers: o.workers as u64,
            threads: o.threads,
            jobs_done: o.jobs_done,
            uptime_ms: o.uptime_ms,
            database_bytes: o.database_bytes,
            checks_agreed: o.checks.0,
            checks_disputed: o.checks.1,
            checks_waiting: o.checks.2 as u64,
            store_fault: o.store_fault.unwrap_or_default(),
        }))
    }

    async fn pace(&self, _: Request<PaceRequest>) -> Result<Response<PaceResponse>, Status> {
        let (periods, now) = self.farm.paces();
        let period_ms = PERIOD.as_millis();
        Ok(Response::new(PaceResponse {
            period_ms: period_ms as u32,
            periods: periods.iter().map(|p| PacePeriod { jobs: p.jobs, scatterings: p.cost }).collect(),
            last_ms: (now.as_millis() % period_ms) as u32,
        }))
    }

    async fn list_workers(
        &self,
        request: Request<ListWorkersRequest>,
    ) -> Result<Response<ListWorkersResponse>, Status> {
        let request = request.into_inner();
        if request.page_token.len() > RequestLimits::TEXT_BYTES {
            let allowed = "one from an earlier answer is needed";
            return Err(to_status(&Invalid::new("page_token", "a long text", allowed)));
        }
        let most = page_size(request.page_size, PAGE, PAGE);
        let workers = self.farm.workers(&WorkerId(request.page_token), most + 1);
        let (workers, next_page_token) = page(workers.into_iter().map(|w| (w.id.0.clone(), w.into())), most);
        Ok(Response::new(ListWorkersResponse { workers, next_page_token }))
    }

    async fn list_events(
        &self,
        request: Request<ListEventsRequest>,
    ) -> Result<Response<ListEventsResponse>, Status> {
        let request = request.into_inner();
        let after = page_token(&request.page_token).or_status()?;
        let most = page_size(request.page_size, EVENTS, PAGE) as u32;
        let events = if request.newest {
            self.farm.newest_events(&request.dictionary, most).await?
        } else {
            self.farm.events(after, &request.dictionary, most).await?
        };
        let last = events.last().map_or(after, |e| e.id);
        let events = events.into_iter().map(event).collect();
        Ok(Response::new(ListEventsResponse { events, next_page_token: last.to_string() }))
    }
}

fn event(event: StoredEvent) -> Event {
    Event {
        id: event.id as u64,
        unix_ms: event.unix_ms as u64,
        kind: event.kind,
        dictionary: event.dictionary,
        job: event.job.map(|job| job as u32),
        worker: event.worker,
        message: event.message,
        actor: event.actor,
    }
}
