//! Table `records`: one row a record.

use farm_proto::Record;
use farm_proto::ids::DictionaryId;
use farm_proto::profile::RecordShape;
use sqlx::{Sqlite, Transaction};
use std::ops::Range;

use super::{Result, Store, StoreError, codec, doing};

#[derive(sqlx::FromRow)]
struct RecordRow {
    id: i64,
    record: i64,
    profiles: Vec<u8>,
}

impl RecordRow {
    fn decode(self, shape: RecordShape) -> Result<Record> {
        let profiles = codec::decode(&self.profiles, shape).map_err(|why| StoreError::Corrupt {
            table: "records",
            row: self.id,
            column: "profiles",
            why,
        })?;
        Ok(Record { index: self.record as usize, profiles })
    }
}

pub(super) async fn insert(
    tx: &mut Transaction<'_, Sqlite>,
    dictionary: DictionaryId,
    records: &[Record],
) -> Result<()> {
    for record in records {
        sqlx::query("INSERT INTO records (dictionary_id, record, profiles) VALUES (?, ?, ?)")
            .bind(dictionary.0)
            .bind(record.index as i64)
            .bind(codec::encode(record))
            .execute(&mut **tx)
            .await
            .map_err(doing("storing a record"))?;
    }
    Ok(())
}

impl Store {
    /// The stored records whose numbers lie in a range, in order.
    pub async fn records(
        &self,
        dictionary: DictionaryId,
        range: Range<usize>,
        shape: RecordShape,
    ) -> Result<Vec<Record>> {
        let rows: Vec<RecordRow> = sqlx::query_as(
            "SELECT id, record, profiles FROM records \
             WHERE dictionary_id = ? AND record >= ? AND record < ? ORDER BY record",
        )
        .bind(dictionary.0)
        .bind(range.start as i64)
        .bind(range.end as i64)
        .fetch_all(&self.read)
        .await
        .map_err(doing("reading records"))?;
        rows.into_iter().map(|row| row.decode(shape)).collect()
    }
}
