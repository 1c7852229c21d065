//! The store of the model: jobs that have ended, blocks, the origin of each result, and fenced-off machines.

use std::collections::{BTreeMap, BTreeSet};

use farm_proto::ids::DictionaryId;
use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, Quality, Scene, Walks};

use crate::stored::{EndedJob, KnownMachine, Machine, OpenCheck, Origin, Outcome, StoredDictionary};
use crate::testing::{self, axes};

/// Blocks of a job with a certain number of walks, and the machines that computed them.
type Blocks = BTreeMap<u32, Origin>;

#[derive(Debug, Clone)]
pub struct DoneJob {
    pub walks: Walks,
    pub records: Digest,
    pub by: BTreeSet<Origin>,
    pub verified: bool,
}

#[derive(Debug, Default)]
pub struct ModelStore {
    pub dictionaries: BTreeMap<DictionaryId, StoredDictionary>,
    pub done: BTreeMap<(DictionaryId, u32), DoneJob>,
    pub given_up: BTreeMap<(DictionaryId, u32), (String, bool)>,
    pub blocks: BTreeMap<(DictionaryId, u32, u64), Blocks>,
    pub fenced: BTreeMap<Origin, String>,
    pub wrong: BTreeSet<Origin>,
    pub met: BTreeMap<Origin, Machine>,
    pub checks: BTreeMap<(DictionaryId, u32, u32), OpenCheck>,
    last_id: i64,
}

/// The final number of walks of the jobs of a kind of dictionary; None if the initial number suffices.
fn walks_needed(kind: u64) -> Option<Walks> {
    let walks = match kind {
        2 => 500_000,
        3 => 2_500_000,
        _ => return None,
    };
    Some(Walks::new(walks).unwrap())
}

impl ModelStore {
    /// Creates a dictionary of one of five kinds: undivided, divided, begun with too few walks (twice), and of an older
    /// physics version.
    pub fn create(&mut self, kind: usize) -> DictionaryId {
        self.last_id += 1;
        let id = DictionaryId(self.last_id);
        let sigma_t: &[f64] = if kind == 0 { &[1.0, 2.0, 30.0] } else { &[1.0, 2.0] };
        // Every other dictionary of the first kind has a subset of the albedos.
        let albedo: &[f64] = if kind == 0 && self.last_id % 2 == 0 { &[0.5, 0.9] } else { &[0.5] };
        let walks = if kind == 1 { Walks::new(2_500_000).unwrap() } else { Walks::PAPER };
        let grid = Grid::new(Scene::paper(), axes(sigma_t, albedo), walks, kind as u64, false).unwrap();
        let grid = match walks_needed(kind as u64) {
            Some(most) => grid.with_quality(Quality::new(0.01, most).unwrap()).unwrap(),
            None => grid,
        };
        let mut stored = testing::stored(id.0, &format!("d{}", id.0), grid);
        if kind == 4 {
            stored.grid_digest = Digest::from_bytes([1; 32]);
        }
        self.dictionaries.insert(id, stored);
        id
    }

    pub fn delete(&mut self, id: DictionaryId) {
        self.dictionaries.remove(&id);
        self.done.retain(|(of, _), _| *of != id);
        self.given_up.retain(|(of, _), _| *of != id);
        self.blocks.retain(|(of, ..), _| *of != id);
        self.checks.retain(|(of, ..), _| *of != id);
    }

    pub fn note_check(&mut self, check: OpenCheck) {
        let place = (check.dictionary, check.job, check.block);
        if check.claims.is_empty() || !self.dictionaries.contains_key(&check.dictionary) {
            self.checks.remove(&place);
        } else {
            self.checks.insert(place, check);
        }
    }

    /// The known machines.
    pub fn machines(&self) -> impl Iterator<Item = KnownMachine> {
        self.met.iter().map(|(origin, machine)| KnownMachine {
            origin: *origin,
            machine: machine.clone(),
            label: String::new(),
            fenced: self.fenced.get(origin).cloned(),
        })
    }

    pub fn ended(&self, id: DictionaryId) -> Vec<EndedJob> {
        let is_own = |job: &(DictionaryId, u32)| job.0 == id;
        let done = self.done.iter().filter(|(job, _)| is_own(job)).map(|((_, job), done)| {
            let by = if done.by.len() == 1 { done.by.first().copied() } else { None };
            let (records, verified) = (done.records, done.verified);
            EndedJob::Done { job: *job, walks: done.walks, records, by, verified, reused: false }
        });
        let given_up =
            self.given_up.iter().filter(|(job, _)| is_own(job)).map(|((_, job), (reason, quarantined))| {
                EndedJob::GivenUp { job: *job, reason: reason.clone(), quarantined: *quarantined }
            });
        done.chain(given_up).collect()
    }

    /// The digest of a result to which these machines have contributed: all wrong ones find the same.
    pub fn digest(&self, id: DictionaryId, job: u32, spec: &JobSpec, by: &BTreeSet<Origin>) -> Digest {
        let wrong = by.iter().any(|by| self.wrong.contains(by));
        let (walks, kind) = (spec.walks().get(), self.kind(id));
        Digest::of_bytes(format!("{kind:?} {job} {walks} {wrong:?}").as_bytes())
    }

    /// The kind of a dictionary: dictionaries of one kind have the same walks in the jobs that both have. Each dictionary
    /// with a target error is a kind of its own, since its final number of walks is not known in advance.
    pub fn kind(&self, dictionary: DictionaryId) -> Option<u64> {
        let stored = self.dictionaries.get(&dictionary)?;
        Some(if stored.grid.quality().is_some() { 1000 + dictionary.0 as u64 } else { stored.grid.seed() })
    }

    /// Ends a job with the records of another one.
    pub fn take_over(&mut self, place: (DictionaryId, u32), from: (DictionaryId, u32)) -> Option<DoneJob> {
        let done = DoneJob { verified: false, ..self.done.get(&from)?.clone() };
        self.blocks.retain(|(id, job, _), _| (*id, *job) != place);
        self.done.insert(place, done.clone());
        Some(done)
    }

    pub fn stored_blocks(&self, id: DictionaryId, job: u32, walks: Walks) -> BTreeSet<u32> {
        self.blocks.get(&(id, job, walks.get())).map(|b| b.keys().copied().collect()).unwrap_or_default()
    }

    /// Stores a result like the real store; None if its dictionary is gone.
    pub fn complete(&mut self, id: DictionaryId, job: u32, spec: &JobSpec, by: Origin) -> Option<Outcome> {
        let dictionary = self.dictionaries.get(&id)?;
        if self.fenced.contains_key(&by) {
            return Some(Outcome::Unwanted);
        }
        if let Some(done) = self.done.get(&(id, job)) {
            let comparable = spec.block().is_none() && done.walks == spec.walks();
            let before = Outcome::Before { records: done.records, new: done.records };
            return Some(if comparable { before } else { Outcome::Unwanted });
        }
        let mut by = BTreeSet::from([by]);
        if let Some(block) = spec.block() {
            let place = (id, job, spec.walks().get());
            let blocks = self.blocks.entry(place).or_default();
            blocks.entry(block).or_insert(*by.first().unwrap());
            if blocks.len() < spec.walks().blocks() as usize {
                return Some(Outcome::Part);
            }
            by = self.blocks.remove(&place).unwrap().into_values().collect();
        }
        let needed = walks_needed(dictionary.grid.seed());
        if let Some(more) = needed.filter(|needed| needed.get() > spec.walks().get()) {
            return Some(Outcome::MoreWalks(more));
        }
        let records = self.digest(id, job, spec, &by);
        self.given_up.remove(&(id, job));
        self.done.insert((id, job), DoneJob { walks: spec.walks(), records, by, verified: false });
        Some(Outcome::Finished { records })
    }

    /// Removes the results of a machine, except those that are verified. Returns the jobs to be computed again.
    pub fn fence(&mut self, machine: Origin, reason: String) -> Vec<(DictionaryId, u32)> {
        self.fenced.insert(machine, reason);
        self.blocks.retain(|_, blocks| !blocks.values().any(|by| *by == machine));
        let own = self.done.iter().filter(|(_, done)| done.by.contains(&machine) && !done.verified);
        let forgotten: Vec<_> = own.map(|(job, _)| *job).collect();
        for job in &forgotten {
            self.done.remove(job);
        }
        forgotten
    }
}
