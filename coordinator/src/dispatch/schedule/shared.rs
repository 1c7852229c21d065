//! Shares records between jobs of several dictionaries with the same walks: one job is computed, and its records serve all.
//!
//! No state is kept for this. Which job is computed is decided at each grant, from the present states of the
//! dictionaries: when one is paused, cancelled or deleted, or its job given up, the others compute for themselves.

use std::cmp::Reverse;
use std::time::Duration;

use farm_proto::ids::DictionaryId;
use optics_model::Digest;

use super::{Dictionary, Requester, Schedule};
use crate::dispatch::part::{JobRef, PartId};

/// Whether `all` contains all of `some`; both are in ascending order.
fn holds(all: &[f64], some: &[f64]) -> bool {
    some.iter().all(|albedo| all.binary_search_by(|there| there.total_cmp(albedo)).is_ok())
}

impl Schedule {
    /// Jobs of other dictionaries with the same walks as a job, for whatever albedos. Jobs of responses are not shared
    /// while they are computed: their scenes differ.
    fn kin(&self, (id, job): JobRef) -> impl Iterator<Item = (&Dictionary, u32)> {
        let is_on_axes = |own: &&Dictionary| own.grid().response_of(job as usize).is_none();
        let own = self.dictionaries.get(&id).filter(is_on_axes).and_then(|own| {
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

    /// The job whose records will serve a waiting job, if the waiting job is not to be computed itself.
    ///
    /// It is the job with the most albedos; among equals a leased one goes first, then the one of the oldest dictionary.
    /// So all jobs with the same walks find the same job, and this one finds none.
    pub(super) fn computed_by(&self, (id, job): JobRef) -> Option<JobRef> {
        let own = &self.dictionaries[&id];
        let rank = |dictionary: &Dictionary, job| {
            let (id, albedos) = (dictionary.id(), dictionary.grid().albedo().len());
            (albedos, self.leases.is_held((id, job)), Reverse(id))
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

    /// The next part to be given out to a machine: parts at which it has failed go to others first, and those of disputed
    /// jobs to no machine.
    pub(super) fn next_part_for(
        &mut self,
        now: Duration,
        requester: Requester<'_>,
        id: DictionaryId,
        cheapest: bool,
    ) -> Option<PartId> {
        let mut kept = false;
        let next = self.next_part_that(id, cheapest, |part| {
            let others = self.job(part).is_some_and(|job| {
                job.is_struck_by(requester.machine)
                    && requester.roster.able(now).any(|other| !job.is_struck_by(other))
            });
            kept |= others;
            !others && !requester.disputed.contains(&part.job_ref())
        });
        self.kept_for_others |= kept;
        next
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

    /// The dictionary that computes the records for which this one waits, if it waits for nothing else.
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

    /// A finished job of another dictionary with the same walks as an undivided job, and the digest of its records.
    pub fn heir(&self, part: PartId) -> Option<(PartId, Digest)> {
        self.job(part).filter(|job| !job.is_divided())?;
        self.kin(part.job_ref())
            .find_map(|(other, job)| Some((PartId::first_of((other.id(), job)), other.records_of(job)?)))
    }

    /// Open jobs of a dictionary with the same walks as finished jobs of other dictionaries.
    pub fn done_elsewhere(&self, id: DictionaryId) -> Vec<u32> {
        let Some(own) = self.dictionaries.get(&id).filter(|d| d.takes_results()) else { return Vec::new() };
        let is_done = |job: &u32| self.kin((id, *job)).any(|(other, job)| other.is_done(job));
        (0..own.jobs() as u32).filter(|job| own.is_open(*job)).filter(is_done).collect()
    }
}
