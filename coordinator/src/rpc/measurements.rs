//! Implements the gRPC service `farm.v1.Measurements`, and keeps the measurements of `Fits.Measure`.

use farm_proto::wire::measurements_server::Measurements;
use farm_proto::wire::{
    AnnotateMeasurementRequest, DeleteMeasurementRequest, DeleteMeasurementResponse, GetMeasurementRequest,
    Keep, KeptMeasurement, ListMeasurementsRequest, ListMeasurementsResponse, MeasureRequest,
    MeasureResponse, MeasurementSummary,
};
use optics_model::{Digest, Grid};
use prost::Message as _;
use tonic::{Request, Response, Status};

use super::Context;
use super::page::{page, page_size, page_token};
use super::status::OrStatus;
use super::text::{lines, one_line, short_line};
use crate::actor::Actor;
use crate::authorisation::actor;
use crate::farm::NewMeasurement;
use crate::store::StoredMeasurement;

/// Number of measurements per page if the request does not give one, and the largest.
const USUAL_PAGE: u32 = 20;
const PAGE: u32 = 200;

#[tonic::async_trait]
impl Measurements for Context {
    async fn list(
        &self,
        request: Request<ListMeasurementsRequest>,
    ) -> Result<Response<ListMeasurementsResponse>, Status> {
        let request = request.into_inner();
        let before = match page_token(&request.page_token).or_status()? {
            0 => i64::MAX,
            before => before,
        };
        let most = page_size(request.page_size, USUAL_PAGE, PAGE);
        let found = self.farm.measurements(before, most as u32 + 1).await?;
        let (measurements, next_page_token) = page(found.into_iter().map(|m| (m.number, summary(m))), most);
        Ok(Response::new(ListMeasurementsResponse { measurements, next_page_token }))
    }

    async fn get(
        &self,
        request: Request<GetMeasurementRequest>,
    ) -> Result<Response<KeptMeasurement>, Status> {
        let (stored, content) = self.farm.measurement(&request.into_inner().id).await?;
        let kept = KeptMeasurement::decode(&content[..])
            .map_err(|error| Status::data_loss(format!("measurement {}: {error}", stored.id)))?;
        Ok(Response::new(KeptMeasurement { summary: Some(summary(stored)), ..kept }))
    }

    async fn annotate(
        &self,
        request: Request<AnnotateMeasurementRequest>,
    ) -> Result<Response<MeasurementSummary>, Status> {
        let by = actor(request.extensions());
        let AnnotateMeasurementRequest { id, title, note } = request.into_inner();
        let title = title.map(|title| short_line(&title));
        let note = note.map(|note| lines("note", &note)).transpose().or_status()?;
        let stored = self.farm.annotate_measurement(&by, &id, title.as_deref(), note.as_deref()).await?;
        Ok(Response::new(summary(stored)))
    }

    async fn delete(
        &self,
        request: Request<DeleteMeasurementRequest>,
    ) -> Result<Response<DeleteMeasurementResponse>, Status> {
        let by = actor(request.extensions());
        self.farm.delete_measurement(&by, &request.into_inner().id).await?;
        Ok(Response::new(DeleteMeasurementResponse {}))
    }
}

impl Context {
    /// Keeps an answer with its question; returns its id.
    pub(super) async fn keep(
        &self,
        by: &Actor,
        keep: Keep,
        question: MeasureRequest,
        answer: &MeasureResponse,
        grid: &Grid,
    ) -> Result<String, Status> {
        let note = lines("keep.note", &keep.note).or_status()?;
        let digest = format!("{}\n{}", Digest::of_grid(grid), Digest::of_bytes(&question.encode_to_vec()));
        let dictionary = question.dictionary.clone();
        let names: Vec<String> = question.materials.iter().map(|m| one_line(&m.material)).collect();
        let kept = KeptMeasurement {
            summary: None,
            request: Some(question),
            answer: Some(answer.clone()),
            grid: Some(grid.into()),
        };
        let new = NewMeasurement {
            question: Digest::of_bytes(digest.as_bytes()),
            title: short_line(&keep.title),
            note,
            source: one_line(&keep.source),
            command: one_line(&keep.command),
            dictionary,
            materials: names.join("\n"),
            channels: answer.materials.iter().map(|m| m.channels.len()).sum(),
            content: kept.encode_to_vec(),
        };
        Ok(self.farm.keep_measurement(by, new).await?)
    }
}

fn summary(stored: StoredMeasurement) -> MeasurementSummary {
    MeasurementSummary {
        id: stored.id,
        kept_unix_ms: stored.kept_unix_ms as u64,
        owner: stored.owner,
        title: stored.title,
        note: stored.note,
        source: stored.source,
        command: stored.command,
        dictionary: stored.dictionary,
        materials: stored.materials.lines().map(str::to_owned).collect(),
        channels: stored.channels as u32,
    }
}
