//! Jobs of several dictionaries that ask for the same walks: one of them is computed, and its records serve all.
//!
//! Nothing of this is kept. Who computes is found anew whenever work is given out, from what the dictionaries are at that
//! moment: when one is paused, cancelled or deleted, or its job given up, the others compute for themselves.

use std::cmp::Reverse;
use std::time::Duration;

use farm_proto::ids::DictionaryId;
use optics_model::{Digest, Walks};

use super::{Dictionary, Dispatcher, PartId};
use crate::stored::{Origin, Vote};

/// A job of a dictionary.
pub type JobRef = (DictionaryId, u32);

/// A machine that asks for work.
#[derive(Debug)]
pub(super) struct Taker {
    pub machine: Origin,
    /// Something was kept for others.
    pub kept: bool,
}

impl Taker {
    pub fn new(machine: Origin) -> Self {
        Self { machine, kept: false }
    }
}

/// Whether all of `some` are there; both rise.
fn holds(all: &[f64], some: &[f64]) -> bool {
    some.iter().all(|albedo| all.binary_search_by(|there| there.total_cmp(albedo)).is_ok())
}

impl Dispatcher {
    /// Jobs of other dictionaries that ask for the same walks as a job, for whatever albedos.
    fn kin(&self, (id, job): JobRef) -> impl Iterator<Item = (&Dictionary, u32)> {
        let own = self.dictionaries.get(&id).and_then(|own| {
            let walks = own.jobs.get(job as usize)?.walks;
            Some((own.family?, walks, own.grid().point(job as usize)))
        });
        own.into_iter().flat_map(move |(family, walks, point)| {
            let others = self.dictionaries.values();
            let others = others.filter(move |other| other.id() != id && other.family == Some(family));
            others.filter_map(move |other| {
                let job = other.grid().job_at(&point)?;
                (other.jobs[job].walks == walks).then_some((other, job as u32))
            })
        })
    }

    /// The job whose records will serve a job that waits, if that is not to be computed itself.
    ///
    /// It is the one for the most albedos; of equals one that is held goes first, then the oldest dictionary's. So all
    /// jobs for the same walks find the same, and it finds none.
    pub(super) fn computed_by(&self, (id, job): JobRef) -> Option<JobRef> {
        let own = &self.dictionaries[&id];
        let rank = |dictionary: &Dictionary, job| {
            let (id, albedos) = (dictionary.id(), dictionary.grid().albedo().len());
            (albedos, self.leases.is_held(id, job), Reverse(id))
        };
        let serves =
            |other: &Dictionary| other.is_active() && holds(other.grid().albedo(), own.grid().albedo());
        let others = self.kin((id, job)).filter(|(other, job)| other.is_open(*job) && serves(other));
        let (other, of_other) = others.max_by_key(|(other, job)| rank(other, *job))?;
        (rank(other, of_other) > rank(own, job)).then_some((other.id(), of_other))
    }

    /// The next part to be given out for a dictionary, the costliest or the cheapest first: one of its own, or of a job
    /// that will serve it too.
    pub(super) fn next_part(&self, id: DictionaryId, cheapest: bool) -> Option<PartId> {
        self.next_part_that(id, cheapest, |_| true)
    }

    /// The same for a machine: what it has failed at goes to others first.
    pub(super) fn next_part_for(
        &self,
        now: Duration,
        taker: &mut Taker,
        id: DictionaryId,
        cheapest: bool,
    ) -> Option<PartId> {
        self.next_part_that(id, cheapest, |part| {
            let others = self.dictionaries[&part.dictionary].job(part).is_some_and(|job| {
                job.is_struck_by(taker.machine) && self.able(now).any(|other| !job.is_struck_by(other))
            });
            taker.kept |= others;
            !others
        })
    }

    fn next_part_that(
        &self,
        id: DictionaryId,
        cheapest: bool,
        mut suits: impl FnMut(PartId) -> bool,
    ) -> Option<PartId> {
        let dictionary = self.dictionaries.get(&id).filter(|dictionary| dictionary.is_active())?;
        dictionary.waiting(cheapest).find_map(|(job, part)| {
            let part = match self.computed_by((id, job)) {
                None => PartId { dictionary: id, job, part },
                Some((dictionary, job)) => {
                    let part = self.dictionaries[&dictionary].waiting_part(job)?;
                    PartId { dictionary, job, part }
                }
            };
            suits(part).then_some(part)
        })
    }

    /// Whether anything can be given out; a job that waits for the records of another cannot.
    pub(super) fn gives_out(&self) -> bool {
        self.order.iter().any(|(_, id)| self.next_part(*id, false).is_some())
    }

    /// A dictionary that computes what this one waits for, if it waits for nothing else.
    pub(super) fn waits_for_other(&self, id: DictionaryId) -> Option<&Dictionary> {
        let (job, _) = self.dictionaries.get(&id)?.waiting(false).next()?;
        if self.next_part(id, false).is_some() {
            return None;
        }
        self.computed_by((id, job)).map(|(other, _)| &self.dictionaries[&other])
    }

    /// Open jobs of other dictionaries that the records of a job serve too.
    pub fn served_by(&self, place: JobRef) -> Vec<JobRef> {
        let Some(own) = self.dictionaries.get(&place.0) else { return Vec::new() };
        let served = |other: &Dictionary| holds(own.grid().albedo(), other.grid().albedo());
        let open = self
            .kin(place)
            .filter(|(other, job)| other.takes_results() && other.is_open(*job) && served(other));
        open.map(|(other, job)| (other.id(), job)).collect()
    }

    /// Asks for second opinions on the results of a dictionary's jobs. Records that came for another dictionary are
    /// checked there, as long as it has them.
    pub(super) fn want_checks(&mut self, id: DictionaryId) {
        let Some(own) = self.dictionaries.get(&id) else { return };
        let elsewhere = |job: u32| self.kin((id, job)).any(|(other, job)| other.is_done(job));
        let (mac, share) = (self.mac(), self.settings.check_share);
        let wanted: Vec<(PartId, Vote)> = own
            .unchecked()
            .map(|(job, first, reused)| (PartId { dictionary: id, job, part: 0 }, first, reused))
            .filter(|(part, first, reused)| {
                mac.is_sampled(*part, first.digest, share)
                    && !self.confirmed.contains_key(&(id, part.job))
                    && !(*reused && elsewhere(part.job))
            })
            .map(|(part, first, _)| (part, first))
            .collect();
        for (part, first) in wanted {
            self.checks.want(part, vec![first], false);
        }
    }

    /// A dictionary goes: whoever shares the records of its jobs takes over the open checks, and what was confirmed.
    pub(super) fn hand_over_checks(&mut self, id: DictionaryId) {
        let Some(own) = self.dictionaries.get(&id) else { return };
        let open: Vec<_> =
            self.checks.of_dictionary(id).map(|(part, votes)| (part, votes.to_vec())).collect();
        let undivided = |part: &PartId| own.job(*part).is_some_and(|job| !job.is_divided());
        for (part, votes) in open.into_iter().filter(|(part, _)| undivided(part)) {
            let heir = self.kin((id, part.job)).find_map(|(other, job)| {
                let records = other.records_of(job)?;
                Some((PartId { dictionary: other.id(), job, part: 0 }, records))
            });
            let Some((heir, records)) = heir else { continue };
            let first = votes[0];
            if first.digest == records {
                self.checks.want(heir, votes, true);
            } else {
                // It holds other albedos of the same walks: what others said of those is of no use.
                self.checks.want(heir, vec![Vote { by: first.by, digest: records }], true);
            }
            self.outbox.work = true;
        }
    }

    /// Open jobs of a dictionary that ask for the same walks as some that are done.
    pub fn done_elsewhere(&self, id: DictionaryId) -> Vec<u32> {
        let Some(own) = self.dictionaries.get(&id).filter(|d| d.takes_results()) else { return Vec::new() };
        let is_done = |job: &u32| self.kin((id, *job)).any(|(other, job)| other.is_done(job));
        (0..own.jobs() as u32).filter(|job| own.is_open(*job)).filter(is_done).collect()
    }

    /// Notes that the store has ended a job with records that came for another dictionary.
    pub fn taken_over(&mut self, (id, job): JobRef, walks: Walks, records: Digest, by: Option<Origin>) {
        if !self.dictionaries.get(&id).is_some_and(|dictionary| dictionary.is_open(job)) {
            return;
        }
        self.end_leases_of_job(id, job);
        self.suspects.remove(&(id, job));
        if let Some(dictionary) = self.dictionaries.get_mut(&id) {
            dictionary.finish(job, walks, records, by, true);
        }
        self.checks.forget_aside(id, job);
        self.work_came();
        self.tell_end(id);
    }
}
