//! Runs `farmctl capture` for the page: one session at a time, with its present step.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::{Result, bail};
use farm_lab::capture;
use optics_model::Invalid;
use serde::{Deserialize, Serialize};

use super::captures::{Captures, session_files};
use crate::output::{INTERNAL_ERROR, sentence};

/// Inputs of `farmctl capture`.
#[derive(Debug, Deserialize)]
pub(super) struct CaptureInputs {
    /// A session file of the list.
    session: String,
    /// Name of the folder to write, in the working directory.
    folder: String,
}

#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct CaptureProgress {
    /// Empty if none was started.
    session: String,
    /// The present step, and the share of photographs that are read.
    step: String,
    share: f64,
    is_running: bool,
    /// Folder that was written, as in the list; empty before the end and after an error.
    folder: String,
    /// Shots to retake, and other doubts.
    warnings: Vec<String>,
    /// Empty if there is none.
    error: String,
}

/// The capture that was started last.
#[derive(Debug, Default)]
pub(super) struct CaptureRun {
    progress: Arc<Mutex<CaptureProgress>>,
}

impl CaptureRun {
    pub fn progress(&self) -> CaptureProgress {
        lock(&self.progress).clone()
    }

    /// Starts a session unless another one is running; its folder is added to `captures` at the end.
    pub fn start(&self, asked: CaptureInputs, captures: Arc<Captures>) -> Result<()> {
        let CaptureInputs { session, folder } = asked;
        let (path, folder) = checked(&session, &folder)?;
        let mut now = lock(&self.progress);
        if now.is_running {
            bail!("a capture is running: wait for its end");
        }
        *now = CaptureProgress { session, is_running: true, ..Default::default() };
        drop(now);
        tokio::spawn(run(path, folder, Arc::clone(&self.progress), captures));
        Ok(())
    }
}

/// Runs a session outside the async runtime. However it ends, another one may be started afterwards.
async fn run(
    session: PathBuf,
    folder: PathBuf,
    progress: Arc<Mutex<CaptureProgress>>,
    captures: Arc<Captures>,
) {
    let (steps, written_to) = (Arc::clone(&progress), folder.clone());
    let report = move |step: &str, share: f64| {
        let mut now = lock(&steps);
        (now.step, now.share) = (step.to_owned(), share);
    };
    let written = tokio::task::spawn_blocking(move || write(&session, &written_to, report)).await;
    let mut now = lock(&progress);
    now.is_running = false;
    match written {
        Ok(Ok(warnings)) => (now.warnings, now.folder) = (warnings, captures.add(folder)),
        Ok(Err(error)) => now.error = sentence(&error),
        Err(_) => INTERNAL_ERROR.clone_into(&mut now.error),
    }
}

fn lock(progress: &Mutex<CaptureProgress>) -> MutexGuard<'_, CaptureProgress> {
    progress.lock().unwrap_or_else(PoisonError::into_inner)
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
