//! Group commit: results that come in while others are written are committed together.
//!
//! A commit with `synchronous=FULL` waits for the disk; with one commit per job that wait would bound the farm. The
//! writer takes all results that are there, up to a bound, writes them in one transaction, and only then tells those
//! who sent them.

use std::time::Duration;

use farm_proto::ids::DictionaryId;
use farm_proto::job::JobSpec;
use farm_proto::sums::Sums;
use farm_proto::{Digest, Profile, Quality, Record, Walks};
use sqlx::{Connection, SqliteConnection};
use tokio::sync::{mpsc, oneshot};

use super::{Result, Store, StoreError, doing, jobs, points, sums};

/// Results of one transaction.
const BATCH: usize = 1024;
/// Bytes after which a transaction takes no more results.
const BATCH_BYTES: usize = 32 << 20;
/// Results that may wait for the writer.
const QUEUE: usize = 4096;

/// A result to be stored.
#[derive(Debug)]
pub struct Completion {
    pub dictionary: DictionaryId,
    pub job_number: u32,
    pub job: JobSpec,
    /// Row of the worker.
    pub worker: i64,
    pub content: Content,
    /// If the records must reach a target error.
    pub quality: Option<Quality>,
}

#[derive(Debug)]
pub enum Content {
    Records(Vec<Record>),
    /// Of the block that the job names, as bytes.
    Sums(Vec<u8>),
}

/// What became of a result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stored {
    /// The job is done.
    Finished { records: Digest },
    /// A block is stored; others are missing.
    Part,
    /// The target error is not reached: nothing is kept, and more walks are needed.
    MoreWalks(Walks),
    /// Nothing is kept: the dictionary was deleted, the worker is fenced off, or the job is done and this cannot be compared
    /// with its records.
    Unwanted,
    /// The job was done before, with the records that have this digest.
    Before { records: Digest },
}

/// How a commit went, for whoever measures.
#[derive(Debug, Clone, Copy)]
pub struct Commit {
    pub results: usize,
    pub records: usize,
    pub took: Duration,
}

pub(super) type Request = (Completion, oneshot::Sender<Result<Stored>>);

impl Content {
    fn bytes(&self) -> usize {
        match self {
            Self::Records(records) => records
                .iter()
                .flat_map(|r| &r.profiles)
                .flat_map(Profile::estimates)
                .map(|e| 8 * e.values().len())
                .sum(),
            Self::Sums(bytes) => bytes.len(),
        }
    }
}

impl Store {
    /// Stores a result durably: when this returns it is on the disk.
    pub async fn complete(&self, completion: Completion) -> Result<Stored> {
        let (sender, receiver) = oneshot::channel();
        self.completions.send((completion, sender)).await.map_err(|_| StoreError::Closed)?;
        receiver.await.map_err(|_| StoreError::Closed)?
    }
}

pub(super) fn queue() -> (mpsc::Sender<Request>, mpsc::Receiver<Request>) {
    mpsc::channel(QUEUE)
}

/// Writes until all senders are gone.
pub(super) async fn run(
    pool: sqlx::SqlitePool,
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
        let results = write_all(&pool, &completions).await;
        let finished = |(completion, result): (&Completion, &Result<Stored>)| match result {
            Ok(Stored::Finished { .. }) => completion.job.albedo().len(),
            _ => 0,
        };
        let records = completions.iter().zip(&results).map(finished).sum();
        committed(Commit { results: completions.len(), records, took: start.elapsed() });
        for (sender, result) in senders.into_iter().zip(results) {
            // Whoever asked may have gone; the result is stored nevertheless.
            let _ = sender.send(result);
        }
    }
}

/// All in one transaction; if that fails, each in its own, so that one bad result does not stop the others.
async fn write_all(pool: &sqlx::SqlitePool, completions: &[Completion]) -> Vec<Result<Stored>> {
    if completions.len() > 1
        && let Ok(stored) = write(pool, completions).await
    {
        return stored.into_iter().map(Ok).collect();
    }
    let mut results = Vec::with_capacity(completions.len());
    for completion in completions {
        let stored = write(pool, std::slice::from_ref(completion)).await;
        results.push(stored.map(|stored| stored[0]));
    }
    results
}

async fn write(pool: &sqlx::SqlitePool, completions: &[Completion]) -> Result<Vec<Stored>> {
    let mut connection = pool.acquire().await.map_err(doing("waiting for the database"))?;
    let written = write_in(&mut connection, completions).await;
    if written.is_err() {
        // On a full disk SQLite ends the transaction by itself and sqlx still counts it as open: the connection
        // would refuse every later one.
        connection.close_on_drop();
    }
    written
}

async fn write_in(connection: &mut SqliteConnection, completions: &[Completion]) -> Result<Vec<Stored>> {
    let mut tx =
        connection.begin_with("BEGIN IMMEDIATE").await.map_err(doing("beginning to store records"))?;
    let mut stored = Vec::with_capacity(completions.len());
    for completion in completions {
        stored.push(store(&mut tx, completion).await?);
    }
    tx.commit().await.map_err(doing("committing records"))?;
    Ok(stored)
}

async fn store(tx: &mut SqliteConnection, completion: &Completion) -> Result<Stored> {
    let Completion { dictionary, job_number, job, worker, content, quality } = completion;
    // It may have been fenced off since its result was admitted; one that is not known cannot be.
    let fenced: Option<(bool,)> = sqlx::query_as("SELECT fenced IS NOT NULL FROM workers WHERE id = ?")
        .bind(worker)
        .fetch_optional(&mut *tx)
        .await
        .map_err(doing("looking for the worker"))?;
    if fenced == Some((true,)) {
        return Ok(Stored::Unwanted);
    }
    let before: Option<(Option<Vec<u8>>, Option<i64>)> = sqlx::query_as(
        "SELECT records_digest, walks FROM dictionaries \
         LEFT JOIN jobs ON dictionary_id = dictionaries.id AND job = ? WHERE dictionaries.id = ?",
    )
    .bind(job_number)
    .bind(dictionary.0)
    .fetch_optional(&mut *tx)
    .await
    .map_err(doing("looking for the job"))?;
    let Some((before, walks)) = before else { return Ok(Stored::Unwanted) };
    if let Some(digest) = before {
        // Records of other walks, and sums, cannot be compared with these.
        let comparable = matches!(content, Content::Records(_))
            && walks.is_none_or(|walks| walks == job.walks().get() as i64);
        if !comparable {
            return Ok(Stored::Unwanted);
        }
        return Ok(Stored::Before { records: jobs::decode_digest(i64::from(*job_number), &digest)? });
    }
    let merged;
    let mut gathered = None;
    let records = match content {
        Content::Records(records) => records,
        Content::Sums(bytes) => {
            let block = job.block().unwrap_or(0);
            let point = points::point(tx, Digest::of_sums(job)).await?;
            points::contribute(tx, point, *worker).await?;
            gathered = Some(point);
            let Some(total) = sums::add(tx, point, job, block, bytes).await? else { return Ok(Stored::Part) };
            merged = Sums::into_records(total, job);
            &merged
        }
    };
    if let Some(more) = quality.and_then(|q| q.more_walks(job.walks(), Quality::noise_of(records))) {
        if let Some(gathered) = gathered {
            points::forget_gathered(tx, gathered).await?;
        }
        return Ok(Stored::MoreWalks(more));
    }
    let point = points::point(tx, job.identity()).await?;
    if let Some(gathered) = gathered {
        points::hand_over(tx, gathered, point).await?;
    }
    points::contribute(tx, point, *worker).await?;
    points::insert_records(tx, point, job.albedo(), records).await?;
    let digest = Digest::of_records(records);
    sqlx::query(
        "INSERT OR REPLACE INTO jobs (dictionary_id, job, point_id, walks, records_digest) VALUES (?, ?, ?, ?, ?)",
    )
    .bind(dictionary.0)
    .bind(job_number)
    .bind(point)
    .bind(job.walks().get() as i64)
    .bind(&digest.as_bytes()[..])
    .execute(&mut *tx)
    .await
    .map_err(doing("storing the end of a job"))?;
    Ok(Stored::Finished { records: digest })
}
