//! Questions to the farm's dictionaries, refused before they are sent if a coordinator would not take them.

use std::time::Duration;

use farm_link::Link;
use farm_proto::wire::fits_client::FitsClient;
use farm_proto::wire::{
    DesignRequest, DesignResponse, FitRequest, FitResponse, MapRequest, MapResponse, MeasureRequest,
    MeasureResponse, Measurement, ProfileRequest, ProfileResponse, ScaleRequest, ScaleResponse,
};
use farm_proto::{check_pixels, to_status};
use tonic::{Response, Status};

/// A request whose answer may take as long as a large database takes to be read through, or a million pixels to be fitted.
pub(crate) fn patient<T>(message: T) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.set_timeout(Duration::from_hours(12));
    request
}

type CallResult<T> = Result<Response<T>, Status>;

#[derive(Debug)]
pub(crate) struct Questions {
    client: FitsClient<Link>,
    most_pixels: usize,
}

impl Questions {
    /// Answers are as long as the question makes them: with curves, ten times as long.
    pub(crate) fn new(link: Link, most_pixels: usize) -> Self {
        Self { client: FitsClient::new(link).max_decoding_message_size(usize::MAX), most_pixels }
    }

    pub(crate) async fn fit(mut self, request: FitRequest) -> CallResult<FitResponse> {
        self.check("measurement", request.measurement.as_slice())?;
        self.client.fit(patient(request)).await
    }

    pub(crate) async fn map(mut self, request: MapRequest) -> CallResult<MapResponse> {
        self.check("measurement", request.measurement.as_slice())?;
        self.client.map(patient(request)).await
    }

    pub(crate) async fn scale(mut self, request: ScaleRequest) -> CallResult<ScaleResponse> {
        self.check("materials", &request.materials)?;
        self.client.scale(patient(request)).await
    }

    pub(crate) async fn measure(mut self, request: MeasureRequest) -> CallResult<MeasureResponse> {
        self.check("materials", &request.materials)?;
        self.client.measure(patient(request)).await
    }

    pub(crate) async fn design(mut self, request: DesignRequest) -> CallResult<DesignResponse> {
        self.client.design(request).await
    }

    pub(crate) async fn profile(mut self, request: ProfileRequest) -> CallResult<ProfileResponse> {
        self.client.profile(request).await
    }

    fn check(&self, field: &str, materials: &[Measurement]) -> Result<(), Status> {
        check_pixels(field, materials, self.most_pixels).map_err(|invalid| to_status(&invalid))
    }
}
