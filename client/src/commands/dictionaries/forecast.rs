//! Forecasts time and room that the dictionary of a grid takes on this machine, by tracing a few of its jobs.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use farm_proto::status::DictionaryStatus;
use optics_model::job::JobSpec;
use optics_model::{Grid, PackedRecords, Walks};
use tokio::time::Instant;

use crate::output::{duration, grouped};

/// Time after which no more jobs are traced, if there are enough.
const ENOUGH: Duration = Duration::from_secs(1);
/// Walks of a chunk, which one thread traces at a time.
const WALKS: u64 = 12_500;
/// Fewest and most sets of jobs that are traced.
const FEWEST: usize = 3;
const MOST: usize = 32;

/// Time and room that a dictionary takes on this machine.
#[derive(Debug)]
pub(super) struct Forecast {
    time: Duration,
    bytes: u64,
}

impl Forecast {
    /// Traces sets of jobs that are spread evenly over their costs.
    pub(super) fn new(grid: &Grid) -> Self {
        let sets = grid.walk_sets();
        let start = Instant::now();
        let mut times = Vec::new();
        for set in evenly(MOST.min(sets.len())).map(|place| &sets[(place * sets.len() as f64) as usize]) {
            times.push(set_time(grid, set));
            if start.elapsed() > ENOUGH && times.len() >= FEWEST {
                break;
            }
        }
        let mean = times.iter().sum::<f64>() / times.len().max(1) as f64;
        let bytes = grid.job_count() as u64 * job_bytes(grid);
        Self { time: Duration::from_secs_f64(mean * sets.len() as f64), bytes }
    }

    /// A sentence about a dictionary, of which a part may be there.
    pub(super) fn text(&self, status: &DictionaryStatus) -> String {
        let (done, total) = (status.records_done() as u64, status.records_total() as u64);
        format!(
            "{}: {} of its {} records are computed, in about {} on this machine, and kept: {:.0} MB in all",
            status.name,
            grouped(total.saturating_sub(done)),
            grouped(total),
            duration(self.time.mul_f64((1.0 - status.work_done).clamp(0.0, 1.0))),
            (self.bytes as f64 / 1e6).max(1.0),
        )
    }
}

/// Room that the records of a job take in the store: all have one size.
pub(super) fn job_bytes(grid: &Grid) -> u64 {
    PackedRecords::bytes_of(&JobSpec::of(grid, 0)) as u64
}

/// Places between 0 and 1 after van der Corput: any first few of them are spread evenly.
fn evenly(count: usize) -> impl Iterator<Item = f64> {
    (1..=count as u32).map(|i| f64::from(i.reverse_bits()) / (f64::from(u32::MAX) + 1.0))
}

/// Seconds that jobs that share their walks take: what does not depend on their number, and the rest by two numbers of
/// walks that occupy all threads.
fn set_time(grid: &Grid, set: &[u32]) -> f64 {
    let walks = set.iter().map(|job| grid.walks_of(*job as usize).get()).max().unwrap_or(WALKS);
    let round = WALKS * rayon::current_num_threads() as u64;
    let [few, more] = [round, 3 * round].map(|number| number.min(walks));
    // Tables that many sets share are made by the first run.
    let first = traced_time(grid, set, few);
    if first > ENOUGH.as_secs_f64() {
        return first * walks as f64 / few as f64;
    }
    let short = traced_time(grid, set, few);
    if more == few {
        return short;
    }
    let per_walk = (traced_time(grid, set, more) - short).max(0.0) / (more - few) as f64;
    short + per_walk * (walks - few) as f64
}

/// Seconds that this number of walks takes.
fn traced_time(grid: &Grid, set: &[u32], walks: u64) -> f64 {
    let shortened = |job: &u32| {
        let scene = grid.scene_of(*job as usize).clone();
        let job = JobSpec::of(grid, *job as usize);
        let albedo = job.albedo().to_vec();
        JobSpec::new(scene, job.point(), albedo, Walks::new(walks)?, job.seed(), job.derivatives())
    };
    let Ok(jobs) = set.iter().map(shortened).collect::<Result<Vec<_>, _>>() else { return 0.0 };
    let start = Instant::now();
    let _ = optics_layers::records_of_set(&jobs, &AtomicBool::new(false));
    start.elapsed().as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first places are spread evenly, whatever their number.
    #[test]
    fn first_places_are_spread_evenly() {
        assert_eq!(evenly(4).collect::<Vec<_>>(), [0.5, 0.25, 0.75, 0.125]);
        let mean = evenly(32).sum::<f64>() / 32.0;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
    }
}
