//! An answer on its way to its caller: counted until it is read, piece by piece, and for so long.

use std::time::Duration;

use bytes::Bytes;
use http_body::Frame;
use tokio::time::Instant;
use tonic::Status;

use super::budget::Account;
use crate::connections::{Admission, Unread};

/// Largest piece that is handed to the connection, which keeps it until the caller reads.
const PIECE: usize = 64 << 10;
/// Longest time until a message of an answer is read, apart from that for its bytes. Streams give up earlier, and then have
/// to be heard.
const PATIENCE: Duration = Duration::from_secs(150);
/// Bytes that must be read in a second beyond that.
const SLOWEST: usize = 64 << 10;

/// What an answer holds.
#[derive(Debug)]
pub(super) struct Answer {
    account: Account,
    connection: Option<Admission>,
    /// What is left of a message.
    rest: Bytes,
    /// Until the message is read.
    unread: Option<Unread>,
}

impl Answer {
    pub fn new(account: Account, connection: Option<Admission>) -> Self {
        Self { account, connection, rest: Bytes::new(), unread: None }
    }

    /// The next piece of a message that is under way. The caller asks, so that what was given before has been taken.
    pub fn next(&mut self) -> Option<Frame<Bytes>> {
        if self.rest.is_empty() {
            if self.unread.take().is_some() {
                self.account.release();
            }
            return None;
        }
        Some(Frame::data(self.rest.split_to(PIECE.min(self.rest.len()))))
    }

    /// Whether there is a message under way.
    pub fn has_more(&self) -> bool {
        !self.rest.is_empty()
    }

    /// Takes a message, whose first piece comes next; refused if the unread answers of its caller hold too much.
    pub fn take(&mut self, message: Bytes) -> Result<(), Status> {
        self.account.hold(message.len())?;
        let time = PATIENCE + Duration::from_secs((message.len() / SLOWEST) as u64);
        self.unread = self.connection.as_ref().map(|connection| connection.unread(Instant::now() + time));
        self.rest = message;
        Ok(())
    }
}
