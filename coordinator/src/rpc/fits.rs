//! Service `farm.v1.Fits`.

use farm_proto::fit::FitOptions;
use farm_proto::wire::fits_server::Fits;
use farm_proto::wire::{FitRequest, FitResponse};
use farm_proto::{DictionaryName, Measurement};
use tonic::{Request, Response, Status};

use super::Context;
use super::status::required;

#[tonic::async_trait]
impl Fits for Context {
    async fn fit(&self, request: Request<FitRequest>) -> Result<Response<FitResponse>, Status> {
        let request = request.into_inner();
        let options = FitOptions::try_from(&request)?;
        let name = DictionaryName::new(request.dictionary).map_err(|e| e.within("dictionary"))?;
        let measurement = Measurement::try_from(required("measurement", request.measurement)?)
            .map_err(|e| e.within("measurement"))?;
        let material = measurement.material().to_owned();
        let channels = self.farm.fit(&name, measurement, options).await?;
        Ok(Response::new(FitResponse { material, channels: channels.into_iter().map(Into::into).collect() }))
    }
}
