//! Describes the errors of an access file, or of a URL.

use std::path::PathBuf;

#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    #[error("reading access file {}: {source}", .path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "access file {} is open to every user of this machine (mode {mode:04o}), and it is secret: run `chmod 600 {}`",
        .path.display(), .path.display()
    )]
    TooOpen { path: PathBuf, mode: u32 },
    #[error("access file {}: {problem}", .path.display())]
    Content { path: PathBuf, problem: String },
    #[error("access file {}: {field} {problem}", .path.display())]
    Field { path: PathBuf, field: String, problem: String },
    #[error("server URL {url:?} {problem}")]
    Url { url: String, problem: String },
    #[error("no server is named: give its URL (--server) or an access file (--access)")]
    NoServer,
}

/// The innermost cause: the transport's own text is only "transport error".
pub(crate) fn root_cause(error: &dyn std::error::Error) -> String {
    std::iter::successors(Some(error), |e| e.source()).last().map_or_else(String::new, ToString::to_string)
}
