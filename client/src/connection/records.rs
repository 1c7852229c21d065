//! Streams the finished records of a dictionary: all promised ones, or an error.
//!
//! A coordinator closes a stream that is not read, and connections break. Then the remaining records are requested
//! again, from the first that has not been received. Records that are listed by index are requested in batches of as
//! many as one call may list.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use farm_proto::status::DictionaryStatus;
use farm_proto::wire::{ExportRequest, GetRequest};
use farm_proto::{RECORDS_PROMISED, RequestLimits, wire};
use optics_model::Record;
use tonic::{Code, Status, Streaming};

use crate::connection::{Connection, is_broken};
use crate::output::grouped;

/// Number of attempts to request the remaining records without receiving one.
const TRIES: u32 = 10;
/// Pause before an attempt.
const PAUSE: Duration = Duration::from_secs(1);

/// A stream of records, in the order of their numbers.
#[derive(Debug)]
pub(crate) struct RecordStream<'a> {
    connection: &'a Connection,
    dictionary: &'a DictionaryStatus,
    indices: Vec<u32>,
    /// Number of indices that have been requested.
    asked: usize,
    stream: Streaming<wire::Record>,
    /// Number of requested records that the coordinator reported as done.
    promised: usize,
    received: usize,
    /// Smallest number of the records that have not been received.
    next: u32,
    tries: u32,
}

impl<'a> RecordStream<'a> {
    /// Requests the records of these numbers, which must increase; all records if there are none.
    pub(crate) async fn ask(
        connection: &'a Connection,
        dictionary: &'a DictionaryStatus,
        indices: Vec<u32>,
    ) -> Result<Self> {
        let asked = indices.len().min(RequestLimits::INDICES);
        let (stream, promised) = ask(connection, dictionary, &indices[..asked], 0).await?;
        Ok(Self { connection, dictionary, indices, asked, stream, promised, received: 0, next: 0, tries: 0 })
    }

    /// Number of requested records that were done when the stream began.
    pub(crate) fn promised(&self) -> usize {
        self.promised
    }

    /// The next record; `None` after the last.
    pub(crate) async fn next(&mut self) -> Result<Option<Record>> {
        loop {
            match self.stream.message().await {
                // An older coordinator ignores the offset and begins at the first record.
                Ok(Some(record)) if record.index < self.next => {}
                Ok(Some(record)) => {
                    self.next = record.index + 1;
                    self.received += 1;
                    self.tries = 0;
                    return Ok(Some(record.try_into()?));
                }
                Ok(None) if self.received < self.promised => {
                    let early = anyhow::anyhow!("the coordinator ended the stream without a reason");
                    return Err(early.context(self.incomplete()));
                }
                Ok(None) if self.asked < self.indices.len() => self.ask_for_more().await?,
                Ok(None) => return Ok(None),
                Err(status) => self.go_on_after(status).await?,
            }
        }
    }

    /// The next records, fewer than `most` only at the end.
    pub(crate) async fn next_batch(&mut self, most: usize) -> Result<Vec<Record>> {
        let mut batch = Vec::with_capacity(most.min(self.promised));
        while batch.len() < most
            && let Some(record) = self.next().await?
        {
            batch.push(record);
        }
        Ok(batch)
    }

    /// Requests the next batch of the indices.
    async fn ask_for_more(&mut self) -> Result<()> {
        self.next = self.indices[self.asked];
        self.asked = self.indices.len().min(self.asked + RequestLimits::INDICES);
        match self.ask_for_rest().await.map_err(anyhow::Error::downcast) {
            Ok(()) => Ok(()),
            Err(Ok(status)) => self.go_on_after(status).await,
            Err(Err(error)) => Err(error.context(self.incomplete())),
        }
    }

    /// Requests the remaining records, unless the error is permanent.
    async fn go_on_after(&mut self, mut status: Status) -> Result<()> {
        while may_go_on(&status) && self.tries < TRIES {
            self.tries += 1;
            if self.tries > 1 {
                tokio::time::sleep(PAUSE).await;
            }
            match self.ask_for_rest().await {
                Ok(()) => return Ok(()),
                Err(error) => match error.downcast::<Status>() {
                    Ok(again) => status = again,
                    Err(error) => return Err(error.context(self.incomplete())),
                },
            }
        }
        Err(self.connection.in_plain_words(status.into()).context(self.incomplete()))
    }

    async fn ask_for_rest(&mut self) -> Result<()> {
        let name = self.dictionary.name.to_string();
        let now = self.connection.dictionaries().get(GetRequest { name }).await?.into_inner();
        ensure!(
            DictionaryStatus::try_from(now)?.grid_digest == self.dictionary.grid_digest,
            "dictionary {} has been replaced by another one meanwhile",
            self.dictionary.name
        );
        let indices = &self.indices[..self.asked];
        let begin = indices.partition_point(|n| *n < self.next);
        if begin == indices.len() && begin > 0 {
            // All of them have been received; an empty list would mean all records.
            return Ok(());
        }
        let (stream, rest) = ask(self.connection, self.dictionary, &indices[begin..], self.next).await?;
        self.stream = stream;
        self.promised = self.promised.max(self.received + rest);
        Ok(())
    }

    fn incomplete(&self) -> String {
        let (came, promised) = (grouped(self.received as u64), grouped(self.promised as u64));
        format!("only {came} of {promised} records came, run the same command again")
    }
}

/// Whether an error concerns the stream or the connection, not the request.
fn may_go_on(status: &Status) -> bool {
    matches!(status.code(), Code::DeadlineExceeded) || is_broken(status)
}

/// The stream of the records from `first` on, and the number of those that are done.
async fn ask(
    connection: &Connection,
    dictionary: &DictionaryStatus,
    indices: &[u32],
    first: u32,
) -> Result<(Streaming<wire::Record>, usize)> {
    let request = ExportRequest { name: dictionary.name.to_string(), indices: indices.to_vec(), first };
    let answer = connection.dictionaries().export(request).await?;
    let promised = match answer.metadata().get(RECORDS_PROMISED) {
        Some(number) => {
            let number = number.to_str().ok().and_then(|n| n.parse().ok());
            number.with_context(|| format!("{RECORDS_PROMISED}: a number is expected of the coordinator"))?
        }
        // Older coordinators do not state the number.
        None if indices.is_empty() && first == 0 => dictionary.records_done(),
        None => 0,
    };
    Ok((answer.into_inner(), promised))
}
