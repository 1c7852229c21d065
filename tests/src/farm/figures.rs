//! Reads the coordinator's metrics.

use std::io::{Read, Write};
use std::net::TcpStream;

use super::Farm;
use crate::process::SOON;

impl Farm {
    /// A page of the metrics port: status code and text. None without an answer.
    pub fn page(&self, path: &str) -> Option<(u16, String)> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.metrics)).ok()?;
        stream.set_read_timeout(Some(SOON)).ok()?;
        write!(stream, "GET {path} HTTP/1.1\r\nHost: farm\r\nConnection: close\r\n\r\n").ok()?;
        let mut text = String::new();
        stream.read_to_string(&mut text).ok()?;
        let code = text.split(' ').nth(1)?.parse().ok()?;
        Some((code, text.split_once("\r\n\r\n")?.1.to_owned()))
    }

    /// A metric since the coordinator's start, such as `farm_jobs_completed_total{outcome="stored"}`.
    ///
    /// # Panics
    /// If the coordinator does not report it.
    pub fn figure(&self, name: &str) -> u64 {
        let (_, text) = self.page("/metrics").expect("the coordinator serves metrics");
        let line = text.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix(' '));
        line.map_or(0.0, |value| value.parse::<f64>().expect("a number")) as u64
    }
}
