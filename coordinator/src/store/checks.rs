//! Stores open checks (table `claims`), and the secret that decides which results are checked (table `secrets`).

use farm_proto::ids::DictionaryId;
use optics_model::Digest;

use super::{Result, Store, StoreError, doing};
use crate::stored::{Claim, OpenCheck, Origin, Secret};

struct ClaimRow {
    dictionary_id: i64,
    job: i64,
    block: i64,
    worker_id: Option<i64>,
    digest: Vec<u8>,
}

from_row!(ClaimRow { dictionary_id, job, block, worker_id, digest });

impl ClaimRow {
    fn claim(&self) -> Result<Claim> {
        let digest = self.digest[..].try_into().map_err(|_| StoreError::Corrupt {
            table: "claims",
            row: self.job,
            column: "digest",
            why: format!("{} bytes", self.digest.len()),
        })?;
        Ok(Claim { by: self.worker_id.map(Origin), digest: Digest::from_bytes(digest) })
    }
}

impl Store {
    /// Stores the claims of a check. The check is deleted if it has no claims, or if its dictionary is gone.
    pub async fn note_check(&self, check: &OpenCheck) -> Result<()> {
        let what = "noting how a check stands";
        let mut tx = self.begin().await?;
        sqlx::query("DELETE FROM claims WHERE dictionary_id = ? AND job = ? AND block = ?")
            .bind(check.dictionary.0)
            .bind(check.job)
            .bind(check.block)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
        for (place, claim) in (0_i64..).zip(&check.claims) {
            sqlx::query(
                "INSERT INTO claims (dictionary_id, job, block, place, worker_id, digest) \
                 SELECT id, ?, ?, ?, ?, ? FROM dictionaries WHERE id = ?",
            )
            .bind(check.job)
            .bind(check.block)
            .bind(place)
            .bind(claim.by.map(|by| by.0))
            .bind(&claim.digest.as_bytes()[..])
            .bind(check.dictionary.0)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
        }
        tx.commit().await.map_err(doing(what))
    }

    /// Checks that were not settled when the coordinator ended.
    pub async fn open_checks(&self) -> Result<Vec<OpenCheck>> {
        let rows: Vec<ClaimRow> = sqlx::query_as(
            "SELECT dictionary_id, job, block, worker_id, digest FROM claims \
             ORDER BY dictionary_id, job, block, place",
        )
        .fetch_all(&self.read)
        .await
        .map_err(doing("reading open checks"))?;
        let same = |a: &ClaimRow, b: &ClaimRow| {
            (a.dictionary_id, a.job, a.block) == (b.dictionary_id, b.job, b.block)
        };
        let check = |rows: &[ClaimRow]| {
            let ClaimRow { dictionary_id, job, block, .. } = rows[0];
            let claims = rows.iter().map(ClaimRow::claim).collect::<Result<_>>()?;
            let dictionary = DictionaryId(dictionary_id);
            Ok(OpenCheck { dictionary, job: job as u32, block: block as u32, claims })
        };
        rows.chunk_by(same).map(check).collect()
    }

    /// The secret of this database; `fresh` becomes it if there is none yet.
    pub async fn secret(&self, fresh: Secret) -> Result<Secret> {
        let what = "reading the secret of the database";
        sqlx::query("INSERT OR IGNORE INTO secrets (name, value) VALUES ('checks', ?)")
            .bind(&fresh.0[..])
            .execute(self.writer()?)
            .await
            .map_err(doing(what))?;
        let value: Vec<u8> = sqlx::query_scalar("SELECT value FROM secrets WHERE name = 'checks'")
            .fetch_one(self.writer()?)
            .await
            .map_err(doing(what))?;
        let why = format!("{} bytes", value.len());
        let corrupt = |_| StoreError::Corrupt { table: "secrets", row: 0, column: "value", why };
        value.try_into().map(Secret).map_err(corrupt)
    }
}
