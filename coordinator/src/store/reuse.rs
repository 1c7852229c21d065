//! Ends jobs that need no computing, since their records came for another dictionary.

use std::collections::HashMap;
use std::sync::Arc;

use farm_proto::ids::DictionaryId;
use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, PackedRecords};
use sqlx::SqliteConnection;

use super::records::JobRecords;
use super::{LedgerGuard, Result, Store, doing};

/// A job whose records are stored, and the row of their point.
struct Reusable {
    job: u32,
    point: i64,
    digest: Digest,
}

/// Albedos with the bytes of their records.
type PointRecords = Vec<(f64, bytes::Bytes)>;

impl LedgerGuard<'_> {
    /// Ends those open jobs of a dictionary whose records are stored already. `jobs` are the numbers and identities of
    /// the open jobs; `grids` are the grids of all dictionaries. Returns the jobs with the digests of their records.
    pub async fn reuse(
        &self,
        dictionary: DictionaryId,
        grid: &Grid,
        jobs: &[(u32, Digest)],
        grids: &HashMap<DictionaryId, Arc<Grid>>,
    ) -> Result<Vec<(u32, Digest)>> {
        let identities: Vec<Digest> = jobs.iter().map(|(_, identity)| *identity).collect();
        let points = self.store.points_of(&identities).await?;
        let mut reusable = Vec::new();
        for (job, identity) in jobs {
            let Some(&point) = points.get(identity) else { continue };
            let there = self.store.verified_records(point, grids).await?;
            if let Some(records) = records_for(grid, *job, &there) {
                reusable.push(Reusable { job: *job, point, digest: records.digest() });
            }
        }
        let mut reused = Vec::with_capacity(reusable.len());
        let mut tx = self.store.begin().await?;
        for job in &reusable {
            if end(&mut tx, dictionary, grid, job).await? {
                reused.push((job.job, job.digest));
            }
        }
        tx.commit().await.map_err(doing("storing jobs that need no computing"))?;
        Ok(reused)
    }
}

impl Store {
    /// The intact records of a point. Damaged records are computed again.
    async fn verified_records(
        &self,
        point: i64,
        grids: &HashMap<DictionaryId, Arc<Grid>>,
    ) -> Result<PointRecords> {
        let jobs: Vec<(i64, i64)> = sqlx::query_as("SELECT dictionary_id, job FROM jobs WHERE point_id = ?")
            .bind(point)
            .fetch_all(&self.read)
            .await
            .map_err(doing("looking for jobs of a point"))?;
        let mut there = Vec::new();
        for (dictionary, job) in jobs {
            let id = DictionaryId(dictionary);
            let Some(grid) = grids.get(&id) else { continue };
            for found in self.finished_jobs(id, grid, job as usize..job as usize + 1).await? {
                match found {
                    Ok(JobRecords { records, .. }) => {
                        there.extend(grid.albedo().iter().copied().zip(records.each()));
                    }
                    Err(damaged) => {
                        tracing::warn!(dictionary, %damaged, "damaged records are not used again");
                    }
                }
            }
        }
        Ok(there)
    }
}

/// All records that a job needs, if they are among these.
fn records_for(grid: &Grid, job: u32, there: &PointRecords) -> Option<PackedRecords> {
    let mut bytes = Vec::with_capacity(grid.albedo().len() * grid.record_bytes());
    for albedo in grid.albedo() {
        let (_, record) = there.iter().find(|(a, _)| a == albedo)?;
        bytes.extend_from_slice(record);
    }
    PackedRecords::new(&JobSpec::of(grid, job as usize), bytes.into()).ok()
}

/// Ends a job with stored records; false if a result of its own has ended it a moment ago.
async fn end(
    tx: &mut SqliteConnection,
    dictionary: DictionaryId,
    grid: &Grid,
    Reusable { job, point, digest }: &Reusable,
) -> Result<bool> {
    let ended = sqlx::query(
        "INSERT OR IGNORE INTO jobs (dictionary_id, job, point_id, walks, records_digest, reused) \
         VALUES (?, ?, ?, ?, ?, 1)",
    )
    .bind(dictionary.0)
    .bind(*job)
    .bind(*point)
    .bind(grid.walks_of(*job as usize).get() as i64)
    .bind(&digest.as_bytes()[..])
    .execute(tx)
    .await
    .map_err(doing("storing a job that needs no computing"))?;
    Ok(ended.rows_affected() > 0)
}
