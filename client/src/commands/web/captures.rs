//! Lists the folders that `farmctl capture` has written and the session files from which it can make more; serves their
//! reports.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use farm_lab::capture::CaptureSession;
use rustix::fs::OFlags;
use serde::Serialize;
use tokio::io::AsyncReadExt as _;
use tonic::Status;

/// The files by which the folder of a capture is recognised.
const MARKS: [&str; 2] = ["report.html", "session.json"];
/// Largest file that is served, in bytes.
const LARGEST: u64 = 256 << 20;

/// Content security policy of reports, which have inline styles and no scripts.
const POLICY: &str = "default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; \
     frame-ancestors 'self'";

/// How deep folders are searched for session files, how many entries of all folders are looked at, and how many files are
/// read.
const DEPTH: usize = 3;
const MOST_ENTRIES: usize = 10_000;
const MOST_READ: usize = 500;

/// A folder that `farmctl capture` has written.
#[derive(Debug, Serialize)]
pub(super) struct Capture {
    /// As given on the command line.
    folder: String,
    /// Address of its report, relative to the page.
    report: String,
}

#[derive(Debug)]
pub(super) struct Captures {
    /// A folder keeps its place, which is in the addresses of its files.
    folders: Mutex<Vec<PathBuf>>,
}

impl Captures {
    /// The given folders, or else the captures in the working directory.
    pub fn new(given: Vec<PathBuf>) -> anyhow::Result<Self> {
        for folder in &given {
            anyhow::ensure!(
                is_capture(folder),
                "{} is no folder that `farmctl capture` wrote: it has no {}",
                folder.display(),
                MARKS.join(" and ")
            );
        }
        let mut folders = given;
        if folders.is_empty() {
            let here = std::fs::read_dir(".").into_iter().flatten().flatten().map(|entry| entry.path());
            folders = here.filter(|folder| is_capture(folder)).collect();
            folders.sort();
        }
        Ok(Self { folders: Mutex::new(folders) })
    }

    pub fn list(&self) -> Vec<Capture> {
        let capture = |(number, folder): (usize, &PathBuf)| Capture {
            folder: shown(folder),
            report: format!("captures/{number}/report.html"),
        };
        self.folders().iter().enumerate().map(capture).collect()
    }

    /// Adds a folder that was written since, and returns its name in `list`.
    pub fn add(&self, folder: PathBuf) -> String {
        let name = shown(&folder);
        let mut folders = self.folders.lock().unwrap_or_else(PoisonError::into_inner);
        if folders.iter().all(|known| shown(known) != name) {
            folders.push(folder);
        }
        name
    }

    fn folders(&self) -> Vec<PathBuf> {
        self.folders.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The folder of a capture by its name in `list`.
    pub fn folder(&self, name: &str) -> Result<PathBuf, Status> {
        let found = self.folders().into_iter().find(|folder| shown(folder) == name);
        let folder = found
            .ok_or_else(|| Status::not_found(format!("capture = {name:?}: this page has no such folder")))?;
        match link_in(&folder) {
            None => Ok(folder),
            Some(link) => Err(Status::failed_precondition(format!(
                "capture = {name:?}: {} is a link, which the page does not follow: put the file itself there",
                link.display()
            ))),
        }
    }

    /// A file of a capture; `None` if it does not exist.
    pub async fn file(&self, number: &str, name: &str) -> Option<Response> {
        let folder = self.folders().into_iter().nth(number.parse::<usize>().ok()?)?;
        let kind = kind(name)?;
        let file = open_own(&folder.join(name)).await?;
        let mut bytes = Vec::new();
        let headers = [(CONTENT_TYPE, kind), (CONTENT_SECURITY_POLICY, POLICY), (CACHE_CONTROL, "no-store")];
        Some(match file.take(LARGEST).read_to_end(&mut bytes).await {
            Ok(_) => (headers, bytes).into_response(),
            Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
        })
    }
}

/// The session files below the working directory, in alphabetical order. Links are not followed.
pub(super) fn session_files() -> Vec<PathBuf> {
    let all = toml_files(Path::new("."), MOST_ENTRIES).into_iter().take(MOST_READ);
    let mut found: Vec<PathBuf> = all.filter(|path| CaptureSession::is_at(path)).collect();
    found.sort();
    found
}

/// TOML files below a folder, without the "./" of the working directory, among at most this many entries: those of upper
/// folders come first.
fn toml_files(folder: &Path, most: usize) -> Vec<PathBuf> {
    let (mut found, mut left) = (Vec::new(), most);
    let mut folders = VecDeque::from([(folder.to_owned(), DEPTH)]);
    while let Some((folder, depth)) = folders.pop_front() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten().take(left) {
            left -= 1;
            let (Ok(kind), path) = (entry.file_type(), entry.path()) else { continue };
            let hidden = entry.file_name().to_string_lossy().starts_with('.');
            if kind.is_dir() && depth > 0 && !hidden {
                folders.push_back((path, depth - 1));
            } else if kind.is_file() && path.extension().is_some_and(|e| e == "toml") {
                found.push(path.strip_prefix(".").map_or(path.clone(), Path::to_owned));
            }
        }
    }
    found
}

/// Opens a file up to the size limit. Links are not followed: otherwise a user who may write to the folder could read
/// the files of its owner.
async fn open_own(path: &Path) -> Option<tokio::fs::File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file =
        tokio::fs::OpenOptions::new().read(true).custom_flags(flags.bits() as i32).open(path).await.ok()?;
    let about = file.metadata().await.ok()?;
    (about.is_file() && about.len() <= LARGEST).then_some(file)
}

/// The path of a link in a folder, if there is one.
fn link_in(folder: &Path) -> Option<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).find(|path| path.is_symlink())
}

fn shown(folder: &Path) -> String {
    let below = folder.strip_prefix(".").unwrap_or(folder);
    if below.as_os_str().is_empty() { ".".to_owned() } else { below.display().to_string() }
}

fn is_capture(folder: &Path) -> bool {
    MARKS.iter().all(|name| folder.join(name).is_file())
}

/// Media type of a capture's file; `None` for names that no such file has.
fn kind(name: &str) -> Option<&'static str> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.starts_with('.') || !name.chars().all(plain) {
        return None;
    }
    match name.rsplit_once('.')?.1 {
        "html" => Some("text/html; charset=utf-8"),
        "png" => Some("image/png"),
        "svg" => Some("image/svg+xml"),
        "csv" | "toml" => Some("text/plain; charset=utf-8"),
        "json" => Some("application/json"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Only the known files of a capture are served.
    #[tokio::test]
    async fn only_files_of_a_capture_are_served() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("session");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(dir.path().join("secret.json"), "").unwrap();
        assert!(Captures::new(vec![folder.clone()]).is_err());
        for name in MARKS {
            std::fs::write(folder.join(name), name).unwrap();
        }
        std::fs::write(folder.join("key.pem"), "").unwrap();
        let captures = Captures::new(vec![folder]).unwrap();
        assert_eq!(captures.list()[0].report, "captures/0/report.html");
        assert!(
            captures.folder(&captures.list()[0].folder).is_ok() && captures.folder("secret.json").is_err()
        );
        assert_eq!([".", "./a", "a/b"].map(|folder| shown(Path::new(folder))), [".", "a", "a/b"]);
        let report = captures.file("0", "report.html").await.unwrap();
        assert_eq!(report.headers()[CONTENT_TYPE], "text/html; charset=utf-8");
        std::os::unix::fs::symlink("../secret.json", captures.folders()[0].join("link.json")).unwrap();
        let pipe = captures.folders()[0].join("pipe.json");
        let (kind, mode) = (rustix::fs::FileType::Fifo, 0o600.into());
        rustix::fs::mknodat(rustix::fs::CWD, pipe, kind, mode, 0).unwrap();
        let refused = captures.folder(&captures.list()[0].folder).unwrap_err();
        assert!(refused.message().contains("link.json is a link"), "{refused}");
        for name in "link.json|pipe.json|../secret.json|..%2fsecret.json|key.pem||..|nothing.json".split('|')
        {
            assert!(captures.file("0", name).await.is_none(), "{name}");
        }
        for number in ["1", "-1"] {
            assert!(captures.file(number, "report.html").await.is_none(), "{number}");
        }
    }
}
