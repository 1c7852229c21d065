//! Exports finished records of a dictionary as they are read.

use std::ops::Range;
use std::sync::Arc;

use farm_proto::{DictionaryName, RequestLimits};
use optics_model::{Grid, Invalid, Record};

use super::{Farm, Result};

/// A stream of records to a client.
#[derive(Debug)]
pub(crate) struct Export {
    farm: Arc<Farm>,
    name: DictionaryName,
    /// Ranges that are still to be read, the next last.
    ranges: Vec<Range<usize>>,
    /// Records that have been read, the next last.
    read: Vec<Record>,
    /// Number of the requested records that are done.
    pub promised: usize,
}

impl Farm {
    /// The finished records of the axes from the number `first` on, or those of the `indices` that are not below it; these
    /// may be of responses.
    pub(crate) fn export(
        self: &Arc<Self>,
        name: DictionaryName,
        first: usize,
        indices: &[u32],
    ) -> Result<Export> {
        let (_, grid) = self.found(&name)?;
        let mut ranges = ranges(&grid, first, indices)?;
        let promised = self.scheduler.query(|dispatcher, _| {
            let finished = dispatcher
                .schedule()
                .by_name(&name)
                .map(|d| ranges.iter().map(|r| d.finished_records(r.clone())).sum());
            finished.unwrap_or_default()
        });
        ranges.reverse();
        Ok(Export { farm: self.clone(), name, ranges, read: Vec::new(), promised })
    }
}

impl Export {
    pub(crate) async fn next(&mut self) -> Result<Option<Record>> {
        loop {
            if let Some(record) = self.read.pop() {
                return Ok(Some(record));
            }
            let Some(range) = self.ranges.pop() else { return Ok(None) };
            self.read = self.farm.records(&self.name, range).await?;
            self.read.reverse();
        }
    }
}

/// Records of a grid that are read at a time: whole jobs, as they are stored, of some 2 MiB together. Each stream whose
/// client is slow holds as many. Larger jobs are read in parts.
fn at_a_time(grid: &Grid) -> usize {
    const BYTES: usize = 2 << 20;
    const MOST_BYTES: usize = 8 << 20;
    let (record, of_job) = (grid.record_bytes(), grid.albedo().len());
    match BYTES / (record * of_job) {
        0 => of_job.min(MOST_BYTES / record).max(1),
        jobs => jobs.min(1024) * of_job,
    }
}

/// The numbers of the requested records, in pieces that are read at once.
fn ranges(grid: &Grid, first: usize, indices: &[u32]) -> Result<Vec<Range<usize>>, Invalid> {
    let (total, chunk) = (grid.record_count(), at_a_time(grid));
    let stored = grid.stored_records();
    if indices.len() > RequestLimits::INDICES {
        let allowed =
            format!("at most {} are allowed: ask for the others in another call", RequestLimits::INDICES);
        return Err(Invalid::new("indices", format!("{} numbers", indices.len()), allowed));
    }
    let allowed = || format!("the dictionary has records 0 to {}", stored - 1);
    if let Some((i, bad)) = indices.iter().enumerate().find(|(_, n)| **n as usize >= stored) {
        return Err(Invalid::new(format!("indices[{i}]"), bad, allowed()));
    }
    // A client that has everything requests the number after the last one.
    if first > stored {
        return Err(Invalid::new("first", first, allowed()));
    }
    if indices.is_empty() {
        // The borders are those of whole pieces from record 0 on, so that no job is read twice.
        let pieces = first / chunk..total.div_ceil(chunk);
        let piece = |n: usize| (n * chunk).max(first)..((n + 1) * chunk).min(total);
        return Ok(pieces.map(piece).filter(|piece| !piece.is_empty()).collect());
    }
    let mut ranges: Vec<Range<usize>> = Vec::new();
    for number in indices.iter().map(|n| *n as usize).filter(|n| *n >= first) {
        match ranges.last_mut() {
            Some(range) if range.end == number && range.len() < chunk => range.end += 1,
            _ => ranges.push(number..number + 1),
        }
    }
    Ok(ranges)
}

#[cfg(test)]
mod tests {
    use optics_model::Walks;
    use optics_model::grid::Axes;
    use optics_model::scene::{Scene, Sensor};

    use super::*;

    /// Consecutive indices are read as one range.
    #[test]
    fn consecutive_indices_are_read_together() {
        let grid = Grid::paper();
        assert_eq!(ranges(&grid, 0, &[5, 6, 7, 3, 3, 4]).unwrap(), [5..8, 3..4, 3..5]);
        assert_eq!(ranges(&grid, 6, &[5, 6, 7, 9]).unwrap(), [6..8, 9..10]);
    }

    /// An export that starts at any record reads up to the same boundaries as a whole one.
    #[test]
    fn ranges_keep_the_chunk_boundaries() {
        let grid = Grid::paper();
        let chunk = at_a_time(&grid);
        let from = |first| ranges(&grid, first, &[]).unwrap();
        assert_eq!(from(0)[..2], [0..chunk, chunk..2 * chunk]);
        assert_eq!(from(chunk + 7)[..2], [chunk + 7..2 * chunk, 2 * chunk..3 * chunk]);
        assert_eq!((from(34_275).len(), &from(34_275)[0]), (1, &(34_275..34_276)));
        assert!(from(34_276).is_empty());
    }

    /// Whole jobs are read at a time, unless they are very large.
    #[test]
    fn whole_jobs_are_read_unless_very_large() {
        let paper = Grid::paper();
        assert_eq!(at_a_time(&paper), 9 * paper.albedo().len());
        let with = |pixels, albedos: usize| {
            let scene = Scene::paper().with_sensor(Sensor::new(10.0, pixels, 0.0).unwrap());
            let albedo = (1..=albedos).map(|i| i as f64 / (albedos + 1) as f64).collect();
            let axes = Axes { albedo, ..paper.axes().clone() };
            at_a_time(&Grid::new(scene, axes, Walks::PAPER, 1, false).unwrap())
        };
        // A record has 15 bytes a pixel, and 6.
        assert_eq!(with(4, 2), 1024 * 2);
        assert_eq!(with(100, 10), 139 * 10);
        assert_eq!(with(4000, 200), (8 << 20) / (15 * 4000 + 6));
    }

    /// The number of requested indices is bounded, and each must exist.
    #[test]
    fn export_requests_are_bounded() {
        let grid = Grid::paper();
        let most = vec![1; RequestLimits::INDICES];
        assert_eq!(ranges(&grid, 0, &most).unwrap().len(), most.len());
        let error = ranges(&grid, 0, &[most, vec![2]].concat()).unwrap_err().to_string();
        let expected = "indices = 10001 numbers is not valid: at most 10000 are allowed: ask for the others";
        assert!(error.starts_with(expected), "{error}");
        let error = ranges(&grid, 0, &[7, 34_276]).unwrap_err().to_string();
        assert!(error.starts_with("indices[1] = 34276"), "{error}");
    }
}
