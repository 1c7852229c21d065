//! Commits results in groups: those that arrive while others are written share one commit.
//!
//! A commit with `synchronous=FULL` waits for the disk; with one commit per job that wait would bound the farm. The
//! writer takes all results that wait, up to a bound, writes them in one transaction, and only then acknowledges them.

use std::future::poll_fn;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};

use super::{LedgerGuard, Place, Result, StoreError, batch, doing};
use crate::stored::{Completion, Outcome};

/// Most results of one transaction.
const BATCH: usize = 1024;
/// Bytes after which a transaction takes no more results.
const BATCH_BYTES: usize = 32 << 20;
/// Results that may wait for the writer.
const QUEUE: usize = 4096;

/// The size and duration of a commit, for the metrics.
#[derive(Debug, Clone, Copy)]
pub struct Commit {
    pub results: usize,
    pub records: usize,
    pub took: Duration,
}

pub(super) type Request = (Completion, oneshot::Sender<Result<Outcome>>);

impl LedgerGuard<'_> {
    /// Stores a result durably: when this returns it is on the disk.
    pub async fn complete(&self, completion: Completion) -> Result<Outcome> {
        let (sender, receiver) = oneshot::channel();
        self.store.completions.send((completion, sender)).await.map_err(|_| StoreError::Closed)?;
        receiver.await.map_err(|_| StoreError::Closed)?
    }
}

pub(super) fn queue() -> (mpsc::Sender<Request>, mpsc::Receiver<Request>) {
    mpsc::channel(QUEUE)
}

/// Writes until all senders are gone.
pub(super) async fn run(
    pool: sqlx::SqlitePool,
    place: Place,
    mut queue: mpsc::Receiver<Request>,
    committed: impl Fn(Commit) + Send,
) {
    let mut requests = Vec::new();
    while let Some(first) = queue.recv().await {
        let mut bytes = first.0.content.bytes();
        requests.push(first);
        while requests.len() < BATCH
            && bytes < BATCH_BYTES
            && let Ok(next) = queue.try_recv()
        {
            bytes += next.0.content.bytes();
            requests.push(next);
        }
        let start = tokio::time::Instant::now();
        let (completions, senders): (Vec<_>, Vec<_>) = requests.drain(..).unzip();
        let mut results = write_all(&pool, &completions).await;
        if let Err(lost) = place.check() {
            let lost = Arc::new(lost);
            results.fill_with(|| Err(StoreError::Together(lost.clone())));
        }
        let finished = |(completion, result): (&Completion, &Result<Outcome>)| match result {
            Ok(Outcome::Finished { .. }) => completion.job.albedo().len(),
            _ => 0,
        };
        let records = completions.iter().zip(&results).map(finished).sum();
        committed(Commit { results: completions.len(), records, took: start.elapsed() });
        for (sender, result) in senders.into_iter().zip(results) {
            // The caller may have gone; the result is stored nevertheless.
            let _ = sender.send(result);
        }
    }
}

/// Writes all results in one transaction; if one of them makes that fail, each in its own, so that it stops no other.
async fn write_all(pool: &sqlx::SqlitePool, completions: &[Completion]) -> Vec<Result<Outcome>> {
    match write(pool, completions).await {
        Ok(stored) => return stored.into_iter().map(Ok).collect(),
        Err(error) if completions.len() == 1 => return vec![Err(error)],
        Err(error) if concerns_all(&error) => {
            let error = Arc::new(error);
            return completions.iter().map(|_| Err(StoreError::Together(error.clone()))).collect();
        }
        Err(_) => {}
    }
    let mut results = Vec::with_capacity(completions.len());
    for completion in completions {
        let stored = write(pool, std::slice::from_ref(completion)).await;
        results.push(stored.map(|stored| stored[0]));
    }
    results
}

/// If writing panics the writer continues.
async fn guarded<T>(writing: impl Future<Output = Result<T>>) -> Result<T> {
    let mut writing = pin!(writing);
    poll_fn(|context| {
        let poll = catch_unwind(AssertUnwindSafe(|| writing.as_mut().poll(context)));
        poll.unwrap_or(Poll::Ready(Err(StoreError::Defect)))
    })
    .await
}

/// Whether the database accepts no write at present: locked, read-only, disk full, reading or writing fails. Then each
/// result by itself would only wait as long again.
fn concerns_all(error: &StoreError) -> bool {
    const BUSY: i32 = 5;
    const LOCKED: i32 = 6;
    const READ_ONLY: i32 = 8;
    const IO: i32 = 10;
    const FULL: i32 = 13;
    const CANNOT_OPEN: i32 = 14;
    let StoreError::Query { source, .. } = error else { return false };
    match source {
        sqlx::Error::Database(error) => {
            // Extended codes carry the primary one in their last byte.
            let code = error.code().and_then(|code| code.parse::<i32>().ok()).map(|code| code & 0xFF);
            code.is_some_and(|code| [BUSY, LOCKED, READ_ONLY, IO, FULL, CANNOT_OPEN].contains(&code))
        }
        sqlx::Error::PoolTimedOut | sqlx::Error::PoolClosed => true,
        _ => false,
    }
}

/// Writes all results in one transaction.
async fn write(pool: &sqlx::SqlitePool, completions: &[Completion]) -> Result<Vec<Outcome>> {
    let mut connection = pool.acquire().await.map_err(doing("waiting for the database"))?;
    let written = guarded(batch::store(&mut connection, completions)).await;
    if written.is_err() {
        // The transaction may be open, or ended by SQLite itself, as on a full disk: closing rolls it back.
        connection.close_on_drop();
    }
    written
}
