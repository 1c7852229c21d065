//! Implements the gRPC service `farm.v1.Fits`.

use farm_proto::wire::fits_server::Fits;
use farm_proto::wire::{
    DesignRequest, DesignResponse, FitRequest, FitResponse, MapRequest, MapResponse, MeasureRequest,
    MeasureResponse, ProfileRequest, ProfileResponse, ScaleRequest, ScaleResponse, SimilarRequest,
    SimilarResponse,
};
use farm_proto::{DictionaryName, check_pixels, to_status, wire};
use optics_fit as fit;
use optics_fit::{FitDictionary, MeasurePlan};
use optics_model::fit::{DesignQuestion, FitOptions, MaterialFit, MuRange, ProfileQuestion};
use optics_model::limits::FitLimits;
use optics_model::scene::Channel;
use optics_model::{Invalid, Measurement, Medium};
use tonic::{Request, Response, Status};

use super::Context;
use super::status::{OrStatus, required};
use super::text::lines;
use super::work::{check_answer, check_design};
use crate::actor::Actor;
use crate::authorisation::actor;

/// Largest number of similar media per question.
const SIMILAR: usize = 10_000;

#[tonic::async_trait]
impl Fits for Context {
    async fn fit(&self, request: Request<FitRequest>) -> Result<Response<FitResponse>, Status> {
        let by = actor(request.extensions());
        let request = request.into_inner();
        let name = dictionary_name(request.dictionary).or_status()?;
        let options = options(request.options.as_ref()).or_status()?;
        let measurement = self.measurement(request.measurement)?;
        let channels = channels([&measurement]);
        let most = self.answer_bytes;
        let question = move |d: &FitDictionary| {
            check_answer(d.grid(), std::slice::from_ref(&measurement), &options, most)?;
            fit::fit(d, &measurement, &options)
        };
        let answer = self.ask(&by, &name, &channels, question).await?;
        Ok(Response::new(FitResponse { fit: Some(answer.into()) }))
    }

    async fn scale(&self, request: Request<ScaleRequest>) -> Result<Response<ScaleResponse>, Status> {
        let by = actor(request.extensions());
        let request = request.into_inner();
        let name = dictionary_name(request.dictionary).or_status()?;
        let options = options(request.options.as_ref()).or_status()?;
        let range =
            MuRange::try_from(request.mu.unwrap_or_default()).map_err(|e| e.within("mu")).or_status()?;
        let materials = self.materials(request.materials).or_status()?;
        let plan = MeasurePlan { search_mu: Some(range), ..MeasurePlan::default() };
        let channels = channels(&materials);
        let most = self.answer_bytes;
        let question = move |d: &fit::FitDictionary| {
            check_answer(d.grid(), &materials, &options, most)?;
            let curve = fit::scale(d, &materials, &options, &range)?;
            let common = fit::measure(d, &materials, &options, &plan)?.common;
            let options = options.with_mu(curve.best.mu, curve.std_error.unwrap_or(0.0))?;
            let fits: Result<Vec<_>, Invalid> = materials.iter().map(|m| fit::fit(d, m, &options)).collect();
            Ok((curve, fits?, common))
        };
        let (curve, fits, common) = self.ask(&by, &name, &channels, question).await?;
        let (scale, materials) = (Some(curve.into()), encoded(fits));
        Ok(Response::new(ScaleResponse { scale, materials, common: Some(common.into()) }))
    }

    async fn similar(&self, request: Request<SimilarRequest>) -> Result<Response<SimilarResponse>, Status> {
        let request = request.into_inner();
        if request.g.len() > SIMILAR {
            let allowed = format!("at most {SIMILAR} are allowed");
            return Err(to_status(&Invalid::new("g", format_args!("{} values", request.g.len()), allowed)));
        }
        let medium = Medium::try_from(required("medium", request.medium)?)
            .map_err(|e| e.within("medium"))
            .or_status()?;
        let similar = |(i, g): (usize, f64)| {
            optics_model::phase::check_g(g)
                .and_then(|g| fit::similar(&medium, g))
                .map(Into::into)
                .map_err(|e| e.within(format_args!("g[{i}]")))
        };
        let media = request.g.into_iter().enumerate().map(similar).collect::<Result<_, _>>().or_status()?;
        Ok(Response::new(SimilarResponse { media }))
    }

    async fn map(&self, request: Request<MapRequest>) -> Result<Response<MapResponse>, Status> {
        let by = actor(request.extensions());
        let request = request.into_inner();
        let name = dictionary_name(request.dictionary).or_status()?;
        let options = options(request.options.as_ref()).or_status()?;
        let measurement = self.measurement(request.measurement)?;
        let boards = boards(request.board).or_status()?;
        let channels = channels([&measurement]);
        let question = move |d: &FitDictionary| fit::distance_map(d, &measurement, &options);
        let maps = self.ask_over(&by, &name, (&channels, boards), question).await?;
        Ok(Response::new(MapResponse { maps: maps.into_iter().map(Into::into).collect() }))
    }

    async fn measure(&self, request: Request<MeasureRequest>) -> Result<Response<MeasureResponse>, Status> {
        let by = actor(request.extensions());
        let mut request = request.into_inner();
        let keep = request.keep.take();
        let question = keep.is_some().then(|| request.clone());
        keep.iter().try_for_each(|keep| lines("keep.note", &keep.note).map(drop)).or_status()?;
        let name = dictionary_name(request.dictionary).or_status()?;
        let options = options(request.options.as_ref()).or_status()?;
        let search_mu = request.search_mu.map(MuRange::try_from).transpose();
        let search_mu = search_mu.map_err(|e| e.within("search_mu")).or_status()?;
        let g_change = request.g_change.unwrap_or(MeasurePlan::default().g_change);
        let MeasureRequest { common_g, g_spread, .. } = request;
        let plan = MeasurePlan { search_mu, common_g, g_spread, g_change };
        let plan = plan.checked().or_status()?;
        let materials = self.materials(request.materials).or_status()?;
        let mixtures = farm_proto::mixtures(request.mixtures).or_status()?;
        let boards = boards(request.board).or_status()?;
        let channels = channels(&materials);
        let most = self.answer_bytes;
        let measure = move |d: &fit::FitDictionary| {
            check_answer(d.grid(), &materials, &options, most)?;
            let mut measured = fit::measure(d, &materials, &options, &plan)?;
            let unmixed =
                mixtures.map(|m| fit::unmix(d, &materials, &m, &measured, &options, &plan)).transpose()?;
            if let Some(unmixed) = &unmixed {
                unmixed.replace(&mut measured.materials);
            }
            Ok((measured, unmixed, d.grid().clone()))
        };
        let (answer, unmixed, grid) = self.ask_over(&by, &name, (&channels, boards), measure).await?;
        let mut answer = MeasureResponse {
            scale: answer.scale.map(Into::into),
            mu: answer.common.mu,
            mu_std_error: answer.common.mu_std_error,
            g: answer.common.g,
            materials: encoded(answer.materials),
            common: Some(answer.common.into()),
            unmixed: unmixed.map(Into::into),
            shared_errors: Some(answer.shared_errors.into()),
            kept_id: String::new(),
            not_kept: String::new(),
        };
        if let (Some(keep), Some(question)) = (keep, question) {
            match self.keep(&by, keep, question, &answer, &grid).await {
                Ok(id) => answer.kept_id = id,
                Err(why) => why.message().clone_into(&mut answer.not_kept),
            }
        }
        Ok(Response::new(answer))
    }

    async fn design(&self, request: Request<DesignRequest>) -> Result<Response<DesignResponse>, Status> {
        let by = actor(request.extensions());
        let mut request = request.into_inner();
        let name = dictionary_name(std::mem::take(&mut request.dictionary)).or_status()?;
        let question = DesignQuestion::try_from(request).or_status()?;
        let channels = Vec::from_iter(question.settings().channel.clone());
        let question = move |d: &FitDictionary| {
            check_design(d.grid(), &question)?;
            fit::design(d, &question)
        };
        let answer = self.ask(&by, &name, &channels, question).await?;
        Ok(Response::new(answer.into()))
    }

    async fn profile(&self, request: Request<ProfileRequest>) -> Result<Response<ProfileResponse>, Status> {
        let by = actor(request.extensions());
        let mut request = request.into_inner();
        let name = dictionary_name(std::mem::take(&mut request.dictionary)).or_status()?;
        let boards = boards(std::mem::take(&mut request.board)).or_status()?;
        let question = ProfileQuestion::try_from(request).or_status()?;
        let channels = question.channels().to_vec();
        let answer =
            self.ask_over(&by, &name, (&channels, boards), move |d| fit::profile(d, &question)).await?;
        Ok(Response::new(answer.into()))
    }
}

impl Context {
    /// Answers a question about channels of a dictionary once a core is free.
    async fn ask<T: Send + 'static>(
        &self,
        by: &Actor,
        name: &DictionaryName,
        channels: &[String],
        question: impl FnOnce(&FitDictionary) -> Result<T, Invalid> + Send + 'static,
    ) -> Result<T, Status> {
        self.ask_over(by, name, (channels, Vec::new()), question).await
    }

    /// Answers a question over these boards.
    async fn ask_over<T: Send + 'static>(
        &self,
        by: &Actor,
        name: &DictionaryName,
        (channels, boards): (&[String], Vec<Channel>),
        question: impl FnOnce(&FitDictionary) -> Result<T, Invalid> + Send + 'static,
    ) -> Result<T, Status> {
        let _place = self.limits.fit(by.shares_as()).await?;
        let start = tokio::time::Instant::now();
        let answer = self.farm.ask(name, (channels, boards), question).await?;
        self.farm.metrics().fitted(start.elapsed());
        Ok(answer)
    }

    fn measurement(&self, measurement: Option<wire::Measurement>) -> Result<Measurement, Status> {
        let measurement = required("measurement", measurement)?;
        check_pixels("measurement", std::slice::from_ref(&measurement), self.question_pixels).or_status()?;
        Measurement::try_from(measurement).map_err(|e| e.within("measurement")).or_status()
    }

    fn materials(&self, materials: Vec<wire::Measurement>) -> Result<Vec<Measurement>, Invalid> {
        let n = materials.len();
        if !(1..=FitLimits::MATERIALS).contains(&n) {
            let allowed = format!("1 to {} are allowed", FitLimits::MATERIALS);
            return Err(Invalid::new("materials", n, allowed));
        }
        check_pixels("materials", &materials, self.question_pixels)?;
        let decode = |(i, m): (usize, wire::Measurement)| {
            Measurement::try_from(m).map_err(|e| e.within(format_args!("materials[{i}]")))
        };
        materials.into_iter().enumerate().map(decode).collect()
    }
}

fn dictionary_name(name: String) -> Result<DictionaryName, Invalid> {
    DictionaryName::new(name).map_err(|e| e.within("dictionary"))
}

fn options(options: Option<&wire::FitOptions>) -> Result<FitOptions, Invalid> {
    FitOptions::try_from(options.cloned().unwrap_or_default()).map_err(|e| e.within("options"))
}

fn boards(board: Vec<wire::Channel>) -> Result<Vec<Channel>, Invalid> {
    let decode = |(i, channel): (usize, wire::Channel)| {
        Channel::try_from(channel).map_err(|e| e.within(format_args!("board[{i}]")))
    };
    board.into_iter().enumerate().map(decode).collect()
}

/// Names of the measured channels.
fn channels<'a>(materials: impl IntoIterator<Item = &'a Measurement>) -> Vec<String> {
    let names = materials.into_iter().flat_map(Measurement::channels);
    let names: std::collections::BTreeSet<&str> = names.collect();
    names.into_iter().map(str::to_owned).collect()
}

fn encoded(fits: Vec<MaterialFit>) -> Vec<wire::MaterialFit> {
    fits.into_iter().map(Into::into).collect()
}
