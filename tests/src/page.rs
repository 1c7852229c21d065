//! `farmctl web` at work.

use std::fs::File;
use std::path::Path;

use crate::process::{Process, SOON, farmctl, free_port, wait_for};

/// The server of a page.
#[derive(Debug)]
pub struct Page {
    pub process: Process,
    /// Where it listens.
    pub host: String,
    /// The folder below which the page is, between slashes.
    pub folder: String,
    /// The page for a browser that was let in.
    pub home: String,
    pub token: String,
}

impl Page {
    /// Starts it in a folder on a port that nobody has.
    ///
    /// # Panics
    /// If it does not tell its address.
    pub fn start(folder: &Path, options: &[&str]) -> Self {
        Self::start_at(folder, &format!("127.0.0.1:{}", free_port()), options)
    }

    /// The same at an address.
    ///
    /// # Panics
    /// If it does not tell its own.
    pub fn start_at(folder: &Path, listen: &str, options: &[&str]) -> Self {
        let (log, out) = (folder.join("web.log"), folder.join("web.out"));
        let mut command = farmctl(folder);
        command.args(["web", "--no-browser", "--listen", listen]).args(options);
        let output = File::create(&out).expect("the folder can be written to");
        let process = Process::spawn_into("farmctl", &mut command, &log, output);
        let url = wait_for("the page's address", SOON, || {
            let told = std::fs::read_to_string(&out).ok()?;
            Some(told.split_once("the page is at ")?.1.lines().next()?.to_owned())
        });
        let (home, token) = url.split_once("?token=").expect("the address has a token");
        let folder = home.trim_end_matches('/').rsplit('/').next().expect("the page has a folder");
        Self {
            process,
            host: listen.to_owned(),
            folder: format!("/{folder}/"),
            home: home.to_owned(),
            token: token.to_owned(),
        }
    }

    /// The address that lets a browser in.
    pub fn url(&self) -> String {
        format!("{}?token={}", self.home, self.token)
    }
}
