//! Keeps the state of one job of a dictionary.

use optics_model::{Digest, Walks};

use crate::stored::{EndedJob, Origin};

/// The state of a block of a divided job, or of the whole of an undivided one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    Open,
    Stored,
}

#[derive(Debug)]
pub enum Stage {
    Open { parts: Vec<Part> },
    Done(Done),
    GivenUp { reason: String, quarantined: bool },
}

/// The records of a job that is done.
#[derive(Debug, Clone, Copy)]
pub struct Done {
    pub records: Digest,
    /// The machine that computed them, if it did so alone.
    pub by: Option<Origin>,
    /// They came for another dictionary.
    pub reused: bool,
    /// The coordinator has computed the same.
    pub verified: bool,
}

/// A failed attempt, with its reason.
#[derive(Debug, Clone)]
pub struct Strike {
    pub machine: Origin,
    /// The process that fell silent while it computed; it may still come back.
    pub silent: Option<String>,
    pub reason: String,
}

#[derive(Debug)]
pub struct Job {
    pub stage: Stage,
    pub walks: Walks,
    /// Leases given out so far.
    pub attempts: u32,
    pub strikes: Vec<Strike>,
    /// Place in the order of work.
    pub rank: u32,
    /// The half-open range of ranks of the jobs that share its walks.
    pub set: [u32; 2],
    /// Expected time of the whole job, in scatterings.
    pub cost: f64,
}

impl Job {
    /// A job without results; `parts` is the number of parts to compute.
    pub fn new(walks: Walks, parts: u32, cost_per_walk: f64) -> Self {
        Self {
            stage: open(parts),
            walks,
            attempts: 0,
            strikes: Vec::new(),
            rank: 0,
            set: [0; 2],
            cost: cost_per_walk * walks.get() as f64,
        }
    }

    pub fn is_divided(&self) -> bool {
        self.walks.blocks() > 1
    }

    pub fn has_part(&self, part: u32) -> bool {
        part < self.walks.blocks()
    }

    /// Parts that have still to be computed.
    pub fn open_parts(&self) -> impl Iterator<Item = u32> {
        let parts = match &self.stage {
            Stage::Open { parts } => &parts[..],
            _ => &[],
        };
        parts.iter().zip(0..).filter(|(part, _)| **part == Part::Open).map(|(_, i)| i)
    }

    /// Cost of one part.
    pub fn part_cost(&self) -> f64 {
        self.cost / f64::from(self.walks.blocks())
    }

    /// Whether none of its parts was given out a second time, and no attempt at it has failed.
    pub fn is_untried(&self) -> bool {
        self.strikes.is_empty() && self.attempts < self.walks.blocks()
    }

    /// Whether a machine has failed at it.
    pub fn is_struck_by(&self, machine: Origin) -> bool {
        self.strikes.iter().any(|strike| strike.machine == machine)
    }

    /// Number of machines that have failed at it.
    pub fn machines_struck(&self) -> usize {
        let first = |(i, strike): &(usize, &Strike)| {
            !self.strikes[..*i].iter().any(|before| before.machine == strike.machine)
        };
        self.strikes.iter().enumerate().filter(first).count()
    }

    /// Sets the end of the job, as recorded in the store.
    pub fn end(&mut self, end: &EndedJob) {
        self.stage = match end {
            EndedJob::Done { walks, records, by, reused, verified, .. } => {
                self.set_walks(*walks);
                Stage::Done(Done { records: *records, by: *by, reused: *reused, verified: *verified })
            }
            EndedJob::GivenUp { reason, quarantined, .. } => {
                Stage::GivenUp { reason: reason.clone(), quarantined: *quarantined }
            }
        };
    }

    /// Restarts the job with these numbers of walks and parts.
    pub fn reopen(&mut self, walks: Walks, parts: u32) {
        self.set_walks(walks);
        self.stage = open(parts);
        self.strikes.clear();
    }

    fn set_walks(&mut self, walks: Walks) {
        self.cost *= walks.get() as f64 / self.walks.get() as f64;
        self.walks = walks;
    }
}

fn open(parts: u32) -> Stage {
    Stage::Open { parts: vec![Part::Open; parts as usize] }
}
