//! Waits for a server that temporarily does not answer, with a message at the beginning and at the end of the outage.

use std::time::Duration;

use anyhow::Result;
use farm_link::{failure, is_passing};
use tonic::Status;

use crate::connection::Connection;
use crate::output::sentence;

/// First and longest pause before the next attempt.
const PAUSE: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(5));

#[derive(Debug)]
pub(crate) struct Outage<'a> {
    connection: &'a Connection,
    pause: Duration,
    reported: bool,
}

impl<'a> Outage<'a> {
    /// No outage so far.
    pub(crate) fn new(connection: &'a Connection) -> Self {
        Self { connection, pause: PAUSE.0, reported: false }
    }

    /// Waits until the next attempt. Permanent errors are returned; so is every error of a farm on this machine, whose
    /// folder another process can take over.
    pub(crate) async fn outlast(&mut self, error: anyhow::Error, print: impl FnOnce(String)) -> Result<()> {
        let status = error.chain().find_map(|cause| cause.downcast_ref::<Status>());
        let Some(status) = status.filter(|status| self.connection.is_server() && is_passing(status)) else {
            return Err(error);
        };
        if !std::mem::replace(&mut self.reported, true) {
            let url = self.connection.address();
            print(waits(url, &failure(status, url).unwrap_or_else(|| why(status, &error))));
        }
        tokio::time::sleep(self.pause).await;
        self.pause = PAUSE.1.min(2 * self.pause);
        Ok(())
    }

    /// Records that the server has answered.
    pub(crate) fn is_over(&mut self, print: impl FnOnce(String)) {
        self.pause = PAUSE.0;
        if std::mem::take(&mut self.reported) {
            print(format!("the coordinator at {} answers again", self.connection.address()));
        }
    }
}

/// The reason of a failure; the transport's message would require knowledge of HTTP/2.
fn why(status: &Status, error: &anyhow::Error) -> String {
    use std::error::Error as _;
    if status.source().is_some() { "the connection was cut".to_owned() } else { sentence(error) }
}

fn waits(url: &str, why: &str) -> String {
    format!("the coordinator at {url} does not answer and is waited for: {why}")
}
