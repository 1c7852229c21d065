//! Runs `farmctl web`.

use std::fs::File;
use std::path::Path;

use crate::process::{Process, SOON, farmctl, free_port, wait_for};

/// The server of a page.
#[derive(Debug)]
pub struct Page {
    pub process: Process,
    /// Host and port.
    pub host: String,
    /// Path prefix of the page, between slashes.
    pub folder: String,
    /// Address of the page without the token.
    pub home: String,
    pub token: String,
}

impl Page {
    /// Starts it in a folder on a free port.
    ///
    /// # Panics
    /// If it does not print its address.
    pub fn start(folder: &Path, options: &[&str]) -> Self {
        Self::start_at(folder, &format!("127.0.0.1:{}", free_port()), options)
    }

    /// Starts it in a folder at an address.
    ///
    /// # Panics
    /// If it does not print its address.
    pub fn start_at(folder: &Path, listen: &str, options: &[&str]) -> Self {
        let (log, out) = (folder.join("web.log"), folder.join("web.out"));
        let mut command = farmctl(folder);
        command.args(["web", "--no-browser", "--listen", listen]).args(options);
        let out_file = File::create(&out).expect("the folder can be written to");
        let process = Process::spawn_into("farmctl", &mut command, &log, out_file);
        let url = wait_for("the page's address", SOON, || {
            let output = std::fs::read_to_string(&out).ok()?;
            Some(output.split_once("the page is at ")?.1.lines().next()?.to_owned())
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

    /// The address with the token.
    pub fn url(&self) -> String {
        format!("{}?token={}", self.home, self.token)
    }
}
