//! Stores and reads the machines of workers, and which of them are fenced off (table `workers`).

use farm_proto::ids::DictionaryId;

use super::{Result, Store, doing};
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

    /// Notes that a machine has confirmed the records of a job.
    pub async fn note_agreement(&self, dictionary: DictionaryId, job: u32, machine: Origin) -> Result<()> {
        sqlx::query(
            "INSERT OR IGNORE INTO contributions (point_id, worker_id, confirmed) \
             SELECT point_id, ?, 1 FROM jobs WHERE dictionary_id = ? AND job = ? AND point_id IS NOT NULL",
        )
        .bind(machine.0)
        .bind(dictionary.0)
        .bind(job)
        .execute(self.writer()?)
        .await
        .map_err(doing("noting that a result was checked"))?;
        Ok(())
    }

    /// Deletes machines to which no record, vote or fence refers. One that still exists registers again under a new number.
    pub(super) async fn forget_useless_workers(&self) -> Result<()> {
        sqlx::query(
            "DELETE FROM workers WHERE fenced IS NULL AND id NOT IN (SELECT worker_id FROM contributions) \
             AND id NOT IN (SELECT worker_id FROM votes WHERE worker_id IS NOT NULL) \
             AND id NOT IN (SELECT worker_id FROM set_aside WHERE worker_id IS NOT NULL)",
        )
        .execute(self.writer()?)
        .await
        .map_err(doing("forgetting workers of which nothing is left"))?;
        Ok(())
    }
}
