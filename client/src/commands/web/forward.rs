//! Forwards calls to the farm unchanged.

use std::convert::Infallible;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::http::{Request, Response};
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::Service;

use super::farm::FarmAccess;

/// A gRPC service that returns the farm's answers.
#[derive(Debug, Clone)]
pub(super) struct Forward(pub Arc<FarmAccess>);

impl Service<Request<Body>> for Forward {
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Response<Body>, Infallible>> + Send>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        let farm = Arc::clone(&self.0);
        Box::pin(async move { Ok(farm.call(request).await.unwrap_or_else(Status::into_http)) })
    }
}
