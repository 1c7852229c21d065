//! Stores many results in one transaction, with few queries.
//!
//! Every query is a message to SQLite's thread and an answer, which costs more than the query itself. So all rows with
//! which the results of a transaction must be compared are read at once, the outcome of each is decided here, and new
//! rows are written in statements of many rows, several at a time. The transaction begins with the first query and is
//! committed by the last, without messages of their own.

mod facts;
mod script;

use std::collections::HashMap;

use bytes::Bytes;
use optics_model::{Digest, PackedRecords, Quality};
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use self::facts::{Ended, Facts};
use self::script::Script;
use super::{Result, doing, points, sums};
use crate::stored::{Completion, JobResult, Outcome};

/// Most values of one query that are looked up or written.
const ROWS: usize = 256;

/// The contents of the store that concern these results, and the additions of this transaction.
struct Known {
    facts: Facts,
    points: Points,
}

/// Points in the order in which results refer to them.
#[derive(Default)]
struct Points {
    places: HashMap<Digest, usize>,
    points: Vec<Point>,
}

struct Point {
    identity: Digest,
    /// Its row, if it has one.
    id: Option<i64>,
    /// Albedos with their profiles as bytes; those that are stored come first.
    records: Vec<(f64, Bytes)>,
    /// Number of these that are stored.
    stored: usize,
}

/// The data to be written for a result that ends its job.
struct End<'a> {
    completion: &'a Completion,
    point: usize,
    digest: Digest,
    /// The point that gathered its blocks.
    gathered: Option<i64>,
}

/// Begins a transaction, stores results in it, and commits it; returns the outcome of each, in their order. After an error
/// the transaction may still be open.
pub(super) async fn store(tx: &mut SqliteConnection, completions: &[Completion]) -> Result<Vec<Outcome>> {
    let mut known = Known { facts: Facts::look(tx, completions).await?, points: Points::default() };
    let wanted: Vec<&Completion> = completions.iter().filter(|c| known.is_wanted(c)).collect();
    known.points = Points::look(tx, &wanted, &known.facts).await?;
    let (mut outcomes, mut ends) = (Vec::with_capacity(completions.len()), Vec::new());
    for completion in completions {
        let outcome = match known.verdict(completion) {
            Some(outcome) => outcome,
            None => known.take(tx, completion, &mut ends).await?,
        };
        outcomes.push(outcome);
    }
    #[cfg(test)]
    assert!(completions.iter().all(|c| c.quality != Some(super::tests::defect())), "a simulated defect");
    let mut script = Script::new(tx);
    known.points.write(&mut script, known.facts.last_point).await?;
    write_ends(&mut script, &ends, &known.points).await?;
    clear_up(&mut script, &ends, &known.points).await?;
    script.commit().await?;
    Ok(outcomes)
}

impl Known {
    /// Whether a result is to be kept, as far as is known before it is examined.
    fn is_wanted(&self, completion: &Completion) -> bool {
        let job = (completion.dictionary, completion.job_number);
        !self.is_refused(completion) && self.facts.ended.get(&job).is_none_or(|ended| ended.records.is_none())
    }

    /// Whether its worker was fenced off or its dictionary deleted since it was admitted.
    fn is_refused(&self, completion: &Completion) -> bool {
        self.facts.fenced.contains(&completion.worker)
            || !self.facts.dictionaries.contains(&completion.dictionary)
    }

    /// The outcome of a result of which nothing is kept; None if the result is to be kept.
    fn verdict(&self, completion: &Completion) -> Option<Outcome> {
        if self.is_refused(completion) {
            return Some(Outcome::Unwanted);
        }
        let Ended { records: Some(records), walks } =
            self.facts.ended.get(&(completion.dictionary, completion.job_number))?
        else {
            return None;
        };
        // Records of other walks, and sums, cannot be compared with these.
        let comparable = matches!(completion.content, JobResult::Records(_))
            && walks.is_none_or(|walks| walks == completion.job.walks());
        let before = || Outcome::Before { records: *records, new: completion.content.digest() };
        Some(if comparable { before() } else { Outcome::Unwanted })
    }

    /// Takes a result that is to be kept: adds it to `ends` if it ends its job.
    async fn take<'a>(
        &mut self,
        tx: &mut SqliteConnection,
        completion: &'a Completion,
        ends: &mut Vec<End<'a>>,
    ) -> Result<Outcome> {
        let Completion { job, worker, content, quality, .. } = completion;
        let merged;
        let (records, gathered) = match content {
            JobResult::Records(records) => (records, None),
            JobResult::Sums(bytes) => {
                let point = points::point(tx, job.sums_identity()).await?;
                self.facts.last_point = self.facts.last_point.max(point);
                points::contribute(tx, point, *worker).await?;
                let block = job.block().unwrap_or(0);
                let Some(total) = sums::add(tx, point, job, block, bytes).await? else {
                    return Ok(Outcome::Part);
                };
                merged = PackedRecords::pack(job, &total.into_records(job));
                (&merged, Some(point))
            }
        };
        if let Some(more) =
            quality.and_then(|q| q.more_walks(job.walks(), Quality::noise_of(&records.unpack())))
        {
            if let Some(gathered) = gathered {
                points::delete_points(tx, &[gathered]).await?;
            }
            return Ok(Outcome::MoreWalks(more));
        }
        let Some(point) = self.points.put(job.identity(), job.albedo(), records) else {
            return Ok(Outcome::Differs);
        };
        let digest = records.digest();
        let ended = Ended { records: Some(digest), walks: Some(job.walks()) };
        self.facts.ended.insert((completion.dictionary, completion.job_number), ended);
        ends.push(End { completion, point, digest, gathered });
        Ok(Outcome::Finished { records: digest })
    }
}

fn push_list<'a, T>(query: &mut QueryBuilder<Sqlite>, values: &'a [T])
where
    T: Copy + sqlx::Type<Sqlite> + sqlx::Encode<'a, Sqlite> + 'a,
{
    let mut list = query.separated(",");
    for value in values {
        list.push_bind(*value);
    }
}

impl Points {
    /// The points of some results, with their stored records of the albedos in question.
    async fn look(tx: &mut SqliteConnection, completions: &[&Completion], facts: &Facts) -> Result<Self> {
        let mut points = Self::default();
        let mut albedos = Vec::new();
        for completion in completions {
            points.place(completion.job.identity());
            albedos.extend_from_slice(completion.job.albedo());
        }
        albedos.sort_by(f64::total_cmp);
        albedos.dedup();
        let mut of_row = HashMap::new();
        for (place, point) in points.points.iter_mut().enumerate() {
            point.id = facts.points.get(&point.identity).copied();
            of_row.extend(point.id.map(|id| (id, place)));
        }
        let ids: Vec<i64> = of_row.keys().copied().collect();
        let pairs = ids.chunks(ROWS).flat_map(|ids| albedos.chunks(ROWS).map(move |albedos| (ids, albedos)));
        let pairs: Vec<(&[i64], &[f64])> = pairs.collect();
        for (ids, albedos) in pairs {
            let query = "SELECT point_id, albedo, profiles FROM records WHERE point_id IN (";
            let mut query = QueryBuilder::<Sqlite>::new(query);
            push_list(&mut query, ids);
            query.push(") AND albedo IN (");
            push_list(&mut query, albedos);
            query.push(")");
            let rows: Vec<(i64, f64, Vec<u8>)> = query
                .build_query_as()
                .fetch_all(&mut *tx)
                .await
                .map_err(doing("looking for records of a point"))?;
            for (id, albedo, profiles) in rows {
                points.points[of_row[&id]].records.push((albedo, profiles.into()));
            }
        }
        for point in &mut points.points {
            point.stored = point.records.len();
        }
        Ok(points)
    }

    fn place(&mut self, identity: Digest) -> usize {
        *self.places.entry(identity).or_insert_with(|| {
            self.points.push(Point { identity, id: None, records: Vec::new(), stored: 0 });
            self.points.len() - 1
        })
    }

    /// Adds the missing records to a point. Returns None, and adds nothing, if the point has different records.
    fn put(&mut self, identity: Digest, albedo: &[f64], records: &PackedRecords) -> Option<usize> {
        let place = self.place(identity);
        let point = &mut self.points[place];
        let before = point.records.len();
        for (bytes, albedo) in records.each().zip(albedo) {
            match point.records[..before].iter().find(|(a, _)| a == albedo) {
                None => point.records.push((*albedo, bytes)),
                Some((_, there)) if *there == bytes => {}
                Some(_) => {
                    point.records.truncate(before);
                    return None;
                }
            }
        }
        Some(place)
    }

    /// Inserts a row for each point with records that has none.
    async fn insert(&mut self, script: &mut Script<'_>, last: i64) -> Result<()> {
        let is_new = |p: &&mut Point| p.id.is_none() && !p.records.is_empty();
        let new = self.points.iter_mut().filter(is_new).zip(last + 1..);
        let rows: Vec<(i64, Digest)> = new.map(|(p, id)| (*p.id.insert(id), p.identity)).collect();
        script
            .insert("INSERT INTO points (id, identity)", &rows, |mut row, (id, identity)| {
                row.push_bind(*id).push_bind(identity.as_bytes().to_vec());
            })
            .await
    }

    /// Writes the points and records that are not stored yet; `last` is the last row of a point.
    async fn write(&mut self, script: &mut Script<'_>, last: i64) -> Result<()> {
        self.insert(script, last).await?;
        let fresh = |point: &Point| {
            let id = point.id;
            let fresh = point.records[point.stored..].iter();
            fresh
                .filter_map(move |(albedo, profiles)| Some((id?, *albedo, profiles.clone())))
                .collect::<Vec<_>>()
        };
        let rows: Vec<(i64, f64, Bytes)> = self.points.iter().flat_map(fresh).collect();
        let into = "INSERT INTO records (point_id, albedo, profiles)";
        script
            .insert(into, &rows, |mut row, (id, albedo, profiles)| {
                row.push_bind(*id).push_bind(*albedo).push_bind(&profiles[..]);
            })
            .await
    }

    fn id(&self, place: usize) -> i64 {
        self.points[place].id.expect("a point with records was given its row")
    }
}

/// Deletes the blocks that were gathered, now that their jobs are done.
async fn clear_up(script: &mut Script<'_>, ends: &[End<'_>], points: &Points) -> Result<()> {
    for End { gathered, point, .. } in ends {
        if let Some(gathered) = gathered {
            let tx = script.written().await?;
            points::credit(tx, *gathered, points.id(*point)).await?;
            points::delete_points(tx, &[*gathered]).await?;
        }
    }
    Ok(())
}

/// Writes the ends of jobs, and the machines that computed their points.
async fn write_ends(script: &mut Script<'_>, ends: &[End<'_>], points: &Points) -> Result<()> {
    script
        .insert("INSERT OR IGNORE INTO contributions (point_id, worker_id)", ends, |mut row, end| {
            row.push_bind(points.id(end.point)).push_bind(end.completion.worker.0);
        })
        .await?;
    // A job that was given up may have been done after all.
    let into = "INSERT OR REPLACE INTO jobs (dictionary_id, job, point_id, walks, records_digest)";
    script
        .insert(into, ends, |mut row, End { completion, point, digest, .. }| {
            row.push_bind(completion.dictionary.0)
                .push_bind(completion.job_number)
                .push_bind(points.id(*point))
                .push_bind(completion.job.walks().get() as i64)
                .push_bind(digest.as_bytes().to_vec());
        })
        .await
}
