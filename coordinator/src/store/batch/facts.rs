//! Looks up the stored facts about the jobs and points of some results, in one query.

use std::collections::{HashMap, HashSet};

use farm_proto::ids::DictionaryId;
use optics_model::{Digest, Walks};
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::ROWS;
use crate::store::{Result, doing, jobs, points};
use crate::stored::{Completion, Origin};

#[derive(Debug, Default)]
pub(super) struct Facts {
    pub dictionaries: HashSet<DictionaryId>,
    /// Workers that are fenced off.
    pub fenced: HashSet<Origin>,
    pub ended: HashMap<(DictionaryId, u32), Ended>,
    /// Rows of the points that are stored.
    pub points: HashMap<Digest, i64>,
    /// The last row of any point.
    pub last_point: i64,
}

/// The end of a job, with its records and number of walks; without records if it was given up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ended {
    pub records: Option<Digest>,
    pub walks: Option<Walks>,
}

const DICTIONARY: i64 = 0;
const FENCED: i64 = 1;
const ENDED: i64 = 2;
const POINT: i64 = 3;
const LAST_POINT: i64 = 4;

/// One fact; the meaning of its columns depends on the kind.
struct FactRow {
    kind: i64,
    id: i64,
    job: i64,
    digest: Option<Vec<u8>>,
    walks: Option<i64>,
}

from_row!(FactRow { kind, id, job, digest, walks });

impl Facts {
    /// Begins the transaction, and looks in it.
    pub(super) async fn look(tx: &mut SqliteConnection, completions: &[Completion]) -> Result<Self> {
        let mut facts = Self::default();
        for (number, some) in completions.chunks(ROWS).enumerate() {
            let mut query = QueryBuilder::<Sqlite>::new(if number == 0 { "BEGIN IMMEDIATE;" } else { "" });
            query.push(
                "SELECT 0 AS kind, id, 0 AS job, NULL AS digest, NULL AS walks FROM dictionaries \
                 UNION ALL SELECT 1, id, 0, NULL, NULL FROM workers WHERE fenced IS NOT NULL \
                 UNION ALL SELECT 4, coalesce(max(id), 0), 0, NULL, NULL FROM points \
                 UNION ALL SELECT 2, dictionary_id, job, records_digest, walks FROM jobs \
                 WHERE (dictionary_id, job) IN (",
            );
            query.push_values(some, |mut row, c| {
                row.push_bind(c.dictionary.0).push_bind(c.job_number);
            });
            query.push(") UNION ALL SELECT 3, id, 0, identity, NULL FROM points WHERE identity IN (");
            let mut identities = query.separated(",");
            for completion in some {
                identities.push_bind(completion.job.identity().as_bytes().to_vec());
            }
            query.push(")");
            let rows = query.build_query_as().fetch_all(&mut *tx).await;
            for row in rows.map_err(doing("looking for jobs and points"))? {
                facts.note(row)?;
            }
        }
        Ok(facts)
    }

    fn note(&mut self, row: FactRow) -> Result<()> {
        let FactRow { kind, id, job, digest, walks } = row;
        match kind {
            DICTIONARY => drop(self.dictionaries.insert(DictionaryId(id))),
            FENCED => drop(self.fenced.insert(Origin(id))),
            ENDED => {
                let records = digest.map(|digest| jobs::decode_digest(job, &digest)).transpose()?;
                let walks = walks.and_then(|walks| Walks::new(walks as u64).ok());
                self.ended.insert((DictionaryId(id), job as u32), Ended { records, walks });
            }
            POINT => self.points.extend(points::identified((digest.unwrap_or_default(), id))),
            LAST_POINT => self.last_point = id,
            _ => unreachable!("the query has no other kinds"),
        }
        Ok(())
    }
}
