//! Sends an answer to its caller piece by piece. Until it is read, its bytes count against the caller's budget, and its
//! connection has a deadline.

use std::time::Duration;

use bytes::Bytes;
use http_body::Frame;
use tokio::time::Instant;
use tonic::Status;

use super::budget::Account;
use crate::connections::{Admission, Unread};

/// Largest piece that is passed to the connection, which keeps it until the caller reads.
const PIECE: usize = 64 << 10;
/// Time limit until a message of an answer is read, in addition to the time for its bytes. Streams give up earlier, and
/// their status has to be delivered after that.
const PATIENCE: Duration = Duration::from_secs(150);
/// Slowest rate in bytes per second, from which the time for the bytes follows.
const SLOWEST: usize = 64 << 10;

/// An answer that is being sent.
#[derive(Debug)]
pub(super) struct Answer {
    account: Account,
    connection: Option<Admission>,
    /// The rest of a message.
    rest: Bytes,
    /// Marks the message as unread until it is read.
    unread: Option<Unread>,
}

impl Answer {
    pub fn new(account: Account, connection: Option<Admission>) -> Self {
        Self { account, connection, rest: Bytes::new(), unread: None }
    }

    /// The next piece of the current message. A call of this function means that the previous piece has been taken.
    pub fn next(&mut self) -> Option<Frame<Bytes>> {
        if self.rest.is_empty() {
            if self.unread.take().is_some() {
                self.account.release();
            }
            return None;
        }
        Some(Frame::data(self.rest.split_to(PIECE.min(self.rest.len()))))
    }

    /// Whether part of the current message has still to be sent.
    pub fn has_more(&self) -> bool {
        !self.rest.is_empty()
    }

    /// Accepts a message, whose first piece comes next; refused if the unread answers of its caller hold too much.
    pub fn take(&mut self, message: Bytes) -> Result<(), Status> {
        self.account.hold(message.len())?;
        let time = PATIENCE + Duration::from_secs((message.len() / SLOWEST) as u64);
        self.unread = self.connection.as_ref().map(|connection| connection.unread(Instant::now() + time));
        self.rest = message;
        Ok(())
    }
}
