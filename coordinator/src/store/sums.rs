//! Stores the blocks of divided jobs (table `sums`), and merges them in their order as they arrive.

use std::collections::BTreeSet;

use optics_model::Digest;
use optics_model::job::JobSpec;
use optics_model::sums::Sums;
use sqlx::{Connection, SqliteConnection};

use super::{Result, Store, StoreError, doing};

/// Point, block, sums and their digest.
type BlockRow = (i64, i64, Vec<u8>, Vec<u8>);

/// Adds a block's sums. When all blocks are present, returns their total and deletes them.
///
/// Blocks that follow each other from the first on are merged into one row at once, so that a job of many blocks
/// takes little room; since they are always added from left to right the total has the same bits in whatever order they
/// arrived.
pub(super) async fn add(
    tx: &mut SqliteConnection,
    point: i64,
    job: &JobSpec,
    block: u32,
    bytes: &[u8],
) -> Result<Option<Sums>> {
    let blocks = job.walks().blocks();
    let (mut merged, mut total) = match merged(tx, point).await? {
        Some((merged, bytes)) => (merged, Some(decode(job, batches_before(job, merged), point, &bytes)?)),
        None => (0, None),
    };
    if block < merged {
        return Ok(None);
    }
    if block > merged {
        insert(tx, point, i64::from(block), bytes).await?;
        return Ok(None);
    }
    let mut next = Some(bytes.to_vec());
    while let Some(bytes) = next {
        let sums = decode(job, job.walks().batches_of_block(merged), point, &bytes)?;
        total.get_or_insert_with(|| Sums::new(job)).merge(&sums);
        merged += 1;
        next = take(tx, point, i64::from(merged)).await?;
    }
    sqlx::query("DELETE FROM sums WHERE point_id = ? AND block < 0")
        .bind(point)
        .execute(&mut *tx)
        .await
        .map_err(doing("merging sums"))?;
    if merged == blocks {
        return Ok(total);
    }
    if let Some(total) = total {
        insert(tx, point, -1 - i64::from(merged), &total.to_le_bytes()).await?;
    }
    Ok(None)
}

/// Number of batches of the first `blocks` blocks.
fn batches_before(job: &JobSpec, blocks: u32) -> u64 {
    (0..blocks).map(|block| job.walks().batches_of_block(block)).sum()
}

fn decode(job: &JobSpec, batches: u64, point: i64, bytes: &[u8]) -> Result<Sums> {
    Sums::from_le_bytes(job, batches, bytes).map_err(|error| corrupt(point, error.to_string()))
}

/// The number of merged blocks, and their sums.
async fn merged(tx: &mut SqliteConnection, point: i64) -> Result<Option<(u32, Vec<u8>)>> {
    let row: Option<(i64, Vec<u8>, Vec<u8>)> =
        sqlx::query_as("SELECT block, sums, digest FROM sums WHERE point_id = ? AND block < 0")
            .bind(point)
            .fetch_optional(tx)
            .await
            .map_err(doing("reading merged sums"))?;
    let Some((block, sums, digest)) = row else { return Ok(None) };
    Ok(Some(((-1 - block) as u32, checked(point, sums, &digest)?)))
}

async fn take(tx: &mut SqliteConnection, point: i64, block: i64) -> Result<Option<Vec<u8>>> {
    let row: Option<(Vec<u8>, Vec<u8>)> =
        sqlx::query_as("DELETE FROM sums WHERE point_id = ? AND block = ? RETURNING sums, digest")
            .bind(point)
            .bind(block)
            .fetch_optional(tx)
            .await
            .map_err(doing("taking a block's sums"))?;
    row.map(|(sums, digest)| checked(point, sums, &digest)).transpose()
}

fn checked(point: i64, sums: Vec<u8>, digest: &[u8]) -> Result<Vec<u8>> {
    if Digest::of_bytes(&sums).as_bytes()[..] != *digest {
        return Err(corrupt(point, "they differ from what was stored".to_owned()));
    }
    Ok(sums)
}

fn corrupt(point: i64, why: String) -> StoreError {
    StoreError::Corrupt { table: "sums", row: point, column: "sums", why }
}

/// Stores a block's sums. A block that is stored already stays: it may be the subject of a check.
async fn insert(tx: &mut SqliteConnection, point: i64, block: i64, bytes: &[u8]) -> Result<()> {
    sqlx::query("INSERT OR IGNORE INTO sums (point_id, block, sums, digest) VALUES (?, ?, ?, ?)")
        .bind(point)
        .bind(block)
        .bind(bytes)
        .bind(&Digest::of_bytes(bytes).as_bytes()[..])
        .execute(tx)
        .await
        .map_err(doing("storing a block's sums"))?;
    Ok(())
}

impl Store {
    /// The damage of the stored blocks of a divided job, read on a separate connection; None if they are intact.
    pub async fn damaged_blocks(&self, job: &JobSpec) -> Result<Option<String>> {
        let mut connection = self.fresh_connection().await?;
        let rows: Result<Vec<BlockRow>> = sqlx::query_as(
            "SELECT point_id, block, sums, sums.digest FROM sums JOIN points ON points.id = point_id \
             WHERE identity = ? ORDER BY block",
        )
        .bind(&job.sums_identity().as_bytes()[..])
        .fetch_all(&mut connection)
        .await
        .map_err(doing("reading blocks once more"));
        // The connection has only read: an error in closing it does no harm.
        let _ = connection.close().await;
        let damage = |(point, block, sums, digest): BlockRow| {
            let batches = match u32::try_from(block) {
                Ok(block) => job.walks().batches_of_block(block),
                Err(_) => batches_before(job, (-1 - block) as u32),
            };
            checked(point, sums, &digest).and_then(|sums| decode(job, batches, point, &sums)).err()
        };
        Ok(rows?.into_iter().find_map(damage).map(|error| error.to_string()))
    }

    /// Blocks of a divided job that are stored.
    pub async fn stored_blocks(&self, job: &JobSpec) -> Result<BTreeSet<u32>> {
        let rows: Vec<(i64,)> = sqlx::query_as(
            "SELECT block FROM sums JOIN points ON points.id = point_id WHERE identity = ? ORDER BY block",
        )
        .bind(&job.sums_identity().as_bytes()[..])
        .fetch_all(&self.read)
        .await
        .map_err(doing("looking for blocks"))?;
        let blocks = rows.into_iter().flat_map(|(block,)| {
            if block < 0 { 0..(-1 - block) as u32 } else { block as u32..block as u32 + 1 }
        });
        Ok(blocks.collect())
    }
}
