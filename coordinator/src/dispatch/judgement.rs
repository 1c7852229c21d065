//! Compares results with the stored ones, records the votes of machines, and fences off those that are outvoted.
//! A result that was not asked for never decides: it can only open a dispute.

use farm_proto::lease::LeaseKey;
use optics_model::Digest;

use super::checks::Verdict;
use super::job::{Job, Stage};
use super::{Arrived, Count, Dispatcher, Effect, Event, EventKind, JobRef, PartId, Purpose};
use crate::stored::{Origin, Vote};

/// The machine that computed the stored result, if it is known.
struct Producer(Option<Origin>);

impl Dispatcher {
    /// Compares a result with the one that is stored. True if they are equal.
    ///
    /// It is a vote only if its worker was given it to check. Otherwise it can bring about a check, but decide nothing: a
    /// worker that once held a lease could deliver for it any number of times.
    pub fn compare_with_stored(&mut self, arrived: &Arrived, stored: Digest, new: Digest) -> bool {
        let Arrived { by, key, .. } = *arrived;
        let was_asked = self.end_check(arrived);
        if self.workers.machines.is_fenced(by) {
            return stored == new;
        }
        let part = PartId::from(key);
        let Some(Producer(first)) = self.producer(part, stored) else {
            // What it was compared with is not what is there now: either not noted yet, or forgotten meanwhile.
            if stored != new && self.dictionaries.get(&part.dictionary).is_some_and(|d| d.job(part).is_some())
            {
                self.suspects.insert((key.dictionary, key.job));
            }
            return stored == new;
        };
        self.outbox.changed = true;
        if was_asked {
            self.record_vote(arrived, first, stored, new);
        } else if stored != new {
            self.open_dispute(arrived, first, stored);
        }
        stored == new
    }

    /// Ends the lease of a check; whether the result was one that its worker was asked for.
    fn end_check(&mut self, arrived: &Arrived) -> bool {
        let held = self.leases.get(arrived.key).filter(|held| held.purpose == Purpose::Check);
        let Some(own) = held.map(|held| held.worker == *arrived.worker) else { return false };
        if own {
            self.leases.remove(arrived.key.token);
            // If this settles nothing another machine may check.
            self.outbox.work = true;
        }
        own
    }

    /// The producer of the stored result of a part; None if this is not the stored result.
    fn producer(&self, part: PartId, stored: Digest) -> Option<Producer> {
        let job = self.dictionaries.get(&part.dictionary)?.job(part)?;
        match &job.stage {
            Stage::Done { records, by, .. } if !job.is_divided() => {
                (*records == stored).then_some(Producer(*by))
            }
            // Only what is being checked is still known.
            _ => (job.is_divided() && self.checks.subject(part) == Some(stored)).then_some(Producer(None)),
        }
    }

    /// Records the vote of a machine that was asked to check, and acts on the verdict.
    fn record_vote(&mut self, arrived: &Arrived, first: Option<Origin>, stored: Digest, new: Digest) {
        let Arrived { by, key, .. } = *arrived;
        let part = PartId::from(key);
        let machines = &self.workers.machines;
        let is_own = |other| machines.share_a_vote(by, other);
        let verdict = self.checks.vote(part, Vote { by: Some(by), digest: new }, is_own);
        let confirms = match &verdict {
            Verdict::Agreed => true,
            Verdict::Wrong { right, .. } => *right == stored && stored == new,
            Verdict::Disputed | Verdict::NotCounted => false,
        };
        if stored == new {
            self.workers.machines.succeeded(by);
        }
        if confirms {
            self.confirm(part, first, by);
        }
        match verdict {
            Verdict::NotCounted => {}
            Verdict::Agreed => self.outbox.counts.push(Count::Agreed),
            Verdict::Disputed => {
                self.outbox.counts.push(Count::Disputed);
                // A third machine decides, which may be waiting for work.
                self.outbox.work = true;
                let first = first.map_or_else(|| "an earlier one".to_owned(), |o| self.workers.label_of(o));
                let message = format!("other records than those of {first}: a third machine decides");
                self.tell_difference(by, key, message);
            }
            Verdict::Wrong { right, wrong } => {
                self.tell_difference(by, key, "records differ between machines");
                for machine in wrong {
                    match machine {
                        Some(machine) => self.fence(part, machine),
                        // The producer of the stored result is not known.
                        None if right != stored => {
                            let (dictionary, job) = (part.dictionary, part.job);
                            self.outbox.effects.push(Effect::Recompute { dictionary, job });
                        }
                        None => {}
                    }
                }
            }
        }
    }

    /// A machine has found what is stored of a job. Of a divided one that is known of the block alone.
    fn confirm(&mut self, part: PartId, first: Option<Origin>, by: Origin) {
        let (dictionary, job) = (part.dictionary, part.job);
        let divided =
            self.dictionaries.get(&dictionary).and_then(|d| d.job(part)).is_none_or(Job::is_divided);
        if !divided && first != Some(by) {
            let confirmed = self.confirmed.entry((dictionary, job)).or_default();
            if !confirmed.contains(&by) {
                confirmed.push(by);
                self.outbox.effects.push(Effect::Agreed { dictionary, job, machine: by });
            }
        }
    }

    /// Asks for a check, since a result that was not asked for differs from the stored one. A machine that contradicts its
    /// own result is fenced off.
    fn open_dispute(&mut self, arrived: &Arrived, first: Option<Origin>, stored: Digest) {
        let Arrived { by, key, .. } = *arrived;
        let part = PartId::from(key);
        if first == Some(by) {
            self.outbox.counts.push(Count::Disputed);
            self.tell_difference(by, key, "other records than its own before");
            self.fence(part, by);
            return;
        }
        if self.checks.subject(part).is_some() {
            return;
        }
        let confirmed = self.confirmed.get(&(part.dictionary, part.job)).cloned().unwrap_or_default();
        let stand: Vec<Option<Origin>> =
            std::iter::once(first).chain(confirmed.into_iter().map(Some)).collect();
        let votes = stand.into_iter().map(|by| Vote { by, digest: stored }).collect();
        self.tell_difference(by, key, "other records than those that are stored: another machine is asked");
        self.checks.want(part, votes, true);
        self.outbox.work = true;
    }

    pub(super) fn tell_difference(&mut self, by: Origin, key: &LeaseKey, message: impl Into<String>) {
        if let Some(dictionary) = self.dictionaries.get(&key.dictionary) {
            let event = Event::of_job(EventKind::ResultsDiffer, dictionary.name(), key.job, message);
            self.outbox.events.push(event.by(self.workers.label_of(by)));
        }
    }

    /// Fences a machine off that has computed wrongly.
    fn fence(&mut self, part: PartId, machine: Origin) {
        if self.workers.machines.is_fenced(machine) {
            return;
        }
        let name = self.dictionaries.get(&part.dictionary).map(|d| d.name().to_string()).unwrap_or_default();
        let reason = format!(
            "its records of job {} of {name} are wrong: others agree against it; \
             once the cause is gone, `farmctl workers readmit` lets the machine in again",
            part.job
        );
        self.workers.machines.fence(machine, reason.clone());
        let label = self.workers.label_of(machine);
        self.outbox.events.push(Event::of_worker(EventKind::WorkerFenced, label, reason.clone()));
        for id in self.workers.ids_of(machine) {
            for token in self.leases.of_worker(&id) {
                self.free(token);
            }
        }
        self.checks.withdraw_votes(machine);
        self.outbox.effects.push(Effect::Fence { machine, reason });
        self.rely_on_others(machine);
    }

    /// What others have confirmed stays when a machine is fenced off, in their name.
    fn rely_on_others(&mut self, machine: Origin) {
        let of_it = |d: &super::Dictionary, job: u32| {
            let stage = d.jobs.get(job as usize).map(|job| &job.stage);
            matches!(stage, Some(Stage::Done { by: Some(by), .. }) if *by == machine)
        };
        let mut alone: Vec<(JobRef, Origin)> = Vec::new();
        for (place, confirmed) in &mut self.confirmed {
            let Some(dictionary) = self.dictionaries.get_mut(&place.0) else { continue };
            let computed = of_it(dictionary, place.1);
            confirmed.retain(|by| *by != machine);
            if computed && !confirmed.is_empty() {
                dictionary.set_by(place.1, Some(confirmed.remove(0)));
            }
            if confirmed.is_empty()
                && let Some(Stage::Done { by: Some(by), .. }) =
                    dictionary.jobs.get(place.1 as usize).map(|j| &j.stage)
                && *by != machine
            {
                alone.push((*place, *by));
            }
        }
        self.confirmed.retain(|_, confirmed| !confirmed.is_empty());
        for ((dictionary, job), by) in alone {
            let digest = self.dictionaries.get(&dictionary).and_then(|d| d.records_of(job));
            let part = PartId { dictionary, job, part: 0 };
            let Some(digest) =
                digest.filter(|digest| self.mac().is_sampled(part, *digest, self.settings.check_share))
            else {
                continue;
            };
            self.checks.want(part, vec![Vote { by: Some(by), digest }], false);
            self.outbox.work = true;
        }
    }

    /// Takes up a check that the store remembers, if it is still about what is stored.
    pub fn remember_check(&mut self, check: crate::stored::OpenCheck) {
        let part = PartId { dictionary: check.dictionary, job: check.job, part: check.block };
        let first = check.votes.first().map(|first| first.digest);
        let dictionary = self.dictionaries.get(&part.dictionary);
        let holds = dictionary.and_then(|d| d.job(part)).is_some_and(|job| {
            job.is_divided() || matches!(job.stage, Stage::Done { records, .. } if first == Some(records))
        });
        if !holds && dictionary.is_some_and(|d| d.grid().quality().is_some() && !d.is_done(part.job)) {
            // With more walks it may have this block again.
            self.checks.put_aside(part, check.votes);
            return;
        }
        self.checks.remember(part, check.votes);
        if !holds {
            // The store is told that it is over.
            self.checks.settle(part);
        }
    }

    /// The store has taken back the records of a job that were set aside.
    pub fn restored(
        &mut self,
        place: JobRef,
        walks: optics_model::Walks,
        records: Digest,
        by: Option<Origin>,
    ) {
        self.taken_over(place, walks, records, by);
    }
}
