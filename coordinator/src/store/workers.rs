//! Stores and reads the machines of workers, and which of them are fenced off (table `workers`).

use farm_proto::ids::DictionaryId;
use optics_model::Digest;

use super::points::{self, delete_points, rows_of};
use super::{Exclusive, Result, Store, doing};
use crate::stored::{KnownMachine, Machine, Origin};

struct MachineRow {
    id: i64,
    label: String,
    token: String,
    address: String,
    host: String,
    fenced: Option<String>,
}

from_row!(MachineRow { id, label, token, address, host, fenced });

impl From<MachineRow> for KnownMachine {
    fn from(row: MachineRow) -> Self {
        let MachineRow { id, label, token, address, host, fenced } = row;
        Self { origin: Origin(id), machine: Machine { token, address, host }, label, fenced }
    }
}

impl Store {
    /// Row of a machine, inserted if there is none. A machine that is fenced off keeps its label and host.
    pub async fn register_worker(&self, machine: &Machine, label: &str) -> Result<Origin> {
        let (id,): (i64,) = sqlx::query_as(
            "INSERT INTO workers (identity, label, token, address, host) VALUES (?, ?, ?, ?, ?) \
             ON CONFLICT (identity) DO UPDATE SET \
             label = CASE WHEN fenced IS NULL THEN excluded.label ELSE label END, \
             host = CASE WHEN fenced IS NULL THEN excluded.host ELSE host END RETURNING id",
        )
        .bind(machine.identity())
        .bind(label)
        .bind(&machine.token)
        .bind(&machine.address)
        .bind(&machine.host)
        .fetch_one(self.writer()?)
        .await
        .map_err(doing("storing a worker"))?;
        Ok(Origin(id))
    }

    /// All machines in the table.
    pub async fn machines(&self) -> Result<Vec<KnownMachine>> {
        let rows: Vec<MachineRow> =
            sqlx::query_as("SELECT id, label, token, address, host, fenced FROM workers ORDER BY id")
                .fetch_all(&self.read)
                .await
                .map_err(doing("reading the workers"))?;
        Ok(rows.into_iter().map(Into::into).collect())
    }

    /// Deletes machines to which no record, claim or fence refers. One that still exists registers again under a new number.
    pub(super) async fn forget_useless_workers(&self) -> Result<()> {
        sqlx::query(
            "DELETE FROM workers WHERE fenced IS NULL AND id NOT IN (SELECT worker_id FROM contributions) \
             AND id NOT IN (SELECT worker_id FROM claims WHERE worker_id IS NOT NULL)",
        )
        .execute(self.writer()?)
        .await
        .map_err(doing("forgetting workers of which nothing is left"))?;
        Ok(())
    }
}

impl Exclusive<'_> {
    /// Fences machines off, and deletes the points with these identities and all points to which the machines have
    /// contributed, except those whose jobs are all verified; returns the jobs to be computed again.
    pub async fn fence(
        &self,
        machines: &[Origin],
        reason: &str,
        wrong: &[Digest],
    ) -> Result<Vec<(DictionaryId, u32)>> {
        let what = "fencing a machine off";
        let machines = rows_of(&machines.iter().map(|machine| machine.0).collect::<Vec<_>>());
        let mut tx = self.store.begin().await?;
        sqlx::query("UPDATE workers SET fenced = ? WHERE id IN (SELECT value FROM json_each(?))")
            .bind(reason)
            .bind(&machines)
            .execute(&mut *tx)
            .await
            .map_err(doing(what))?;
        let mut points: Vec<i64> = sqlx::query_scalar(
            "SELECT DISTINCT point_id FROM contributions WHERE worker_id IN (SELECT value FROM json_each(?)) \
             AND point_id NOT IN (SELECT point_id FROM jobs WHERE point_id IS NOT NULL \
                                  GROUP BY point_id HAVING min(verified) = 1)",
        )
        .bind(&machines)
        .fetch_all(&mut *tx)
        .await
        .map_err(doing(what))?;
        points.extend(points::find(&mut tx, wrong).await?.into_iter().map(|(_, point)| point));
        let deleted = delete_points(&mut tx, &points).await?;
        tx.commit().await.map_err(doing(what))?;
        Ok(deleted.jobs)
    }
}
