//! Answers `POST /ask/VERB`: the inputs of a verb as JSON give its answer as `--json` prints it.
//!
//! Lists of folders, the progress of a capture and files to save are for the page alone.

mod dictionary;
mod files;
mod measure;
mod prints;

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result};
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use optics_model::Invalid;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use tokio::task::{JoinSet, block_in_place};
use tonic::{Code, Status};

use super::capture_run::CaptureRun;
use super::captures::{Captures, session_files};
use super::farm::FarmAccess;
use crate::output::{INTERNAL_ERROR, envelope, sentence};

/// The page's farm and folders.
#[derive(Debug)]
pub(super) struct PageState {
    pub farm: Arc<FarmAccess>,
    /// The answer of `about`.
    pub about: Value,
    pub captures: Arc<Captures>,
    pub run: CaptureRun,
}

/// A file of the user's browser.
#[derive(Debug, Deserialize)]
struct GivenFile {
    name: String,
    base64: String,
}

impl GivenFile {
    fn bytes(&self) -> Result<Vec<u8>, Invalid> {
        let bytes = STANDARD.decode(&self.base64);
        bytes.map_err(|_| Invalid::new("file.base64", &self.name, "the content in Base64 is needed"))
    }
}

pub(super) async fn ask(
    State(state): State<Arc<PageState>>,
    Path(verb): Path<String>,
    body: Bytes,
) -> Response {
    // A task of its own, which ends with the request: its panic is an error of this question alone.
    let mut task = JoinSet::new();
    task.spawn(Box::pin(async move { answer(&state, &verb, &body).await }));
    let json = |code: StatusCode, text: String| (code, [(CONTENT_TYPE, "application/json")], text);
    match task.join_next().await {
        Some(Ok(Ok(text))) => json(StatusCode::OK, text).into_response(),
        Some(Ok(Err(error))) => json(status_code(&error), refusal(&error)).into_response(),
        _ => json(StatusCode::INTERNAL_SERVER_ERROR, json!({ "error": INTERNAL_ERROR }).to_string())
            .into_response(),
    }
}

async fn answer(state: &PageState, verb: &str, body: &[u8]) -> Result<String> {
    match verb {
        "about" => envelope(verb, &state.about),
        "captures" => envelope(verb, &state.captures.list()),
        "sessions" => {
            let names =
                |paths: Vec<PathBuf>| paths.iter().map(|p| p.display().to_string()).collect::<Vec<_>>();
            envelope(verb, &names(block_in_place(session_files)))
        }
        "capture" => envelope(verb, &state.run.start(inputs(body)?, Arc::clone(&state.captures))?),
        "progress" => envelope(verb, &state.run.progress()),
        "check" => block_in_place(|| measure::check(&inputs(body)?)),
        "open" => block_in_place(|| measure::open(state, &inputs(body)?)),
        "mixtures" => envelope(verb, &measure::mixtures(&inputs(body)?)?.all()),
        "measure" => measure::measure(state, inputs(body)?).await,
        "map" => envelope(verb, &json!({ "maps": measure::maps(state, inputs(body)?).await? })),
        "files" => envelope(verb, &files::media(state, inputs(body)?).await?),
        "figures" => envelope(verb, &files::figures(state, inputs(body)?).await?),
        "predict" => block_in_place(|| envelope(verb, &prints::predict(inputs(body)?)?)),
        "compare" => prints::compare(state, &inputs(body)?).await,
        "grid" => block_in_place(|| envelope(verb, &dictionary::size(state, &inputs(body)?)?)),
        "submit" => envelope(verb, &dictionary::submit(state, &inputs(body)?).await?),
        "simulate" => envelope(verb, &dictionary::simulate(state, inputs(body)?).await?),
        _ => Err(Status::not_found(format!("the page asks nothing called {verb:?}")).into()),
    }
}

fn inputs<T: DeserializeOwned>(body: &[u8]) -> Result<T> {
    serde_json::from_slice(body).context("inputs")
}

/// The message of an error, and the field of an input that is not valid.
fn refusal(error: &anyhow::Error) -> String {
    let invalid = error.chain().find_map(|cause| cause.downcast_ref::<Invalid>());
    json!({ "error": sentence(error), "field": invalid.map(Invalid::field) }).to_string()
}

/// The page repeats questions whose farm was not reached, and knows farms of older versions by what they lack.
fn status_code(error: &anyhow::Error) -> StatusCode {
    let status = error.chain().find_map(|cause| cause.downcast_ref::<Status>());
    match status.map(Status::code) {
        Some(Code::NotFound) => StatusCode::NOT_FOUND,
        Some(Code::Unavailable) => StatusCode::SERVICE_UNAVAILABLE,
        Some(Code::Unimplemented) => StatusCode::NOT_IMPLEMENTED,
        _ => StatusCode::BAD_REQUEST,
    }
}
