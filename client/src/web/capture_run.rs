//! Runs `farmctl capture` for the page: one session at a time, with its present step.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Result;
use farm_lab::capture;
use optics_model::Invalid;
use tonic::Status;

use super::api::{CaptureProgressResponse, StartCaptureRequest};
use super::captures::{Captures, session_files};
use crate::output::sentence;

/// The capture that was started last.
#[derive(Debug, Default)]
pub(super) struct CaptureRun {
    progress: Arc<Mutex<CaptureProgressResponse>>,
}

impl CaptureRun {
    pub fn progress(&self) -> CaptureProgressResponse {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Starts a session unless another one is running; its folder is added to `captures` at the end.
    pub fn start(&self, request: StartCaptureRequest, captures: Arc<Captures>) -> Result<(), Status> {
        let StartCaptureRequest { session, folder } = request;
        let (path, folder) =
            checked(&session, &folder).map_err(|e| Status::invalid_argument(e.to_string()))?;
        let progress = Arc::clone(&self.progress);
        let set = move |change: &mut dyn FnMut(&mut CaptureProgressResponse)| {
            change(&mut progress.lock().unwrap_or_else(PoisonError::into_inner));
        };
        let mut is_busy = false;
        set(&mut |now| {
            is_busy = now.is_running;
            if !is_busy {
                *now = CaptureProgressResponse {
                    session: session.clone(),
                    is_running: true,
                    ..Default::default()
                };
            }
        });
        if is_busy {
            return Err(Status::failed_precondition("a capture is running: wait for its end"));
        }
        tokio::task::spawn_blocking(move || {
            let report = |step: &str, share: f64| {
                set(&mut |now| (now.step, now.share) = (step.to_owned(), share));
            };
            let written = write(&path, &folder, report);
            set(&mut |now| {
                now.is_running = false;
                match &written {
                    Ok(warnings) => {
                        now.warnings.clone_from(warnings);
                        now.folder = captures.add(folder.clone());
                    }
                    Err(error) => now.error = sentence(error),
                }
            });
        });
        Ok(())
    }
}

/// Writes the folder of a session; returns the warnings.
fn write(session: &Path, folder: &Path, report: impl FnMut(&str, f64)) -> Result<Vec<String>> {
    let captured = capture::capture(session, report)?;
    let notes = capture::write_folder(folder, &captured)?;
    Ok(captured.warnings(&folder.join(capture::FILES[0]), &notes))
}

/// The session file and the folder to write: files elsewhere are neither read nor written.
fn checked(session: &str, folder: &str) -> Result<(PathBuf, PathBuf), Invalid> {
    let path = session_files().into_iter().find(|path| path.display().to_string() == session);
    let path = path
        .ok_or_else(|| Invalid::new("session", format_args!("{session:?}"), "one of the list is needed"))?;
    let is_plain = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    if folder.is_empty() || folder.starts_with('.') || !folder.chars().all(is_plain) {
        let allowed = "a name of letters, digits, '-', '_' and '.' is needed, which does not begin with '.'";
        return Err(Invalid::new("folder", format_args!("{folder:?}"), allowed));
    }
    Ok((path, PathBuf::from(folder)))
}
