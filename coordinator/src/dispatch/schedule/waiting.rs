//! Keeps the parts of a dictionary that wait for a worker.

use super::Dictionary;
use super::job::{Job, Part, Stage};

impl Dictionary {
    /// Number of parts that wait for a worker.
    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    /// Whether a part waits for a worker.
    #[cfg(debug_assertions)]
    pub fn waits(&self, index: u32, part: u32) -> bool {
        self.pending.contains(&(self.jobs[index as usize].rank, index, part))
    }

    /// Jobs with parts that wait, each with the first of these, the costliest or the cheapest job first.
    pub(super) fn waiting(&self, cheapest: bool) -> impl Iterator<Item = (u32, u32)> {
        let mut last = None;
        std::iter::from_fn(move || {
            let next = match (cheapest, last) {
                (false, None) => self.pending.first(),
                (false, Some(rank)) => self.pending.range((rank + 1, 0, 0)..).next(),
                (true, None) => self.pending.last(),
                (true, Some(rank)) => self.pending.range(..(rank, 0, 0)).next_back(),
            };
            let &(rank, job, _) = next?;
            last = Some(rank);
            Some((job, self.waiting_part(job)?))
        })
    }

    /// Other jobs that share their walks with a job, whose part of the same number waits and is given out for the first
    /// time.
    pub(super) fn companions(&self, index: u32, part: u32) -> Vec<u32> {
        let job = &self.jobs[index as usize];
        if !job.is_untried() {
            return Vec::new();
        }
        let [first, end] = job.set;
        // One look-up per job, since a divided one may have very many parts.
        let at_rank = |rank| self.pending.range((rank, 0, 0)..(rank + 1, 0, 0)).next();
        let others = (first..end)
            .filter_map(at_rank)
            .filter(|(rank, other, _)| *other != index && self.pending.contains(&(*rank, *other, part)));
        let alike = |other: &Job| other.walks == job.walks && other.is_untried();
        others.map(|(_, other, _)| *other).filter(|other| alike(&self.jobs[*other as usize])).collect()
    }

    /// The first part of a job that waits.
    pub(super) fn waiting_part(&self, index: u32) -> Option<u32> {
        let rank = self.jobs.get(index as usize)?.rank;
        self.pending.range((rank, index, 0)..=(rank, index, u32::MAX)).next().map(|(.., part)| *part)
    }

    /// Takes a part that waits, and counts the attempt.
    pub(super) fn begin(&mut self, index: u32, part: u32) -> u32 {
        self.pending.remove(&(self.jobs[index as usize].rank, index, part));
        self.attempt(index)
    }

    /// Counts one more attempt at a job; returns its number.
    pub(super) fn attempt(&mut self, index: u32) -> u32 {
        let job = &mut self.jobs[index as usize];
        job.attempts = job.attempts.saturating_add(1);
        job.attempts
    }

    /// Whether a part of the job was given out before without a result.
    pub(super) fn is_retry(&self, index: u32) -> bool {
        let job = &self.jobs[index as usize];
        job.attempts > job.walks.blocks()
    }

    /// Takes a certain part that waits; false if it does not.
    pub(super) fn take(&mut self, index: u32, part: u32, attempt: u32) -> bool {
        let job = &mut self.jobs[index as usize];
        let waits = self.pending.remove(&(job.rank, index, part));
        if waits {
            job.attempts = job.attempts.max(attempt);
        }
        waits
    }

    /// A part that is no longer leased waits again, if it is still to be done.
    pub(super) fn put_back(&mut self, index: u32, part: u32) {
        let job = &self.jobs[index as usize];
        if matches!(&job.stage, Stage::Open { parts } if parts.get(part as usize) == Some(&Part::Open)) {
            self.pending.insert((job.rank, index, part));
        }
    }
}
