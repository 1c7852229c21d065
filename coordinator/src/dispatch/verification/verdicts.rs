//! Compares results with stored ones, and acts on the verdicts: confirmations, disputes, and fences.

use optics_model::Digest;

use super::checks::Verdict;
use super::{Context, Verification};
use crate::dispatch::admission::Arrived;
use crate::dispatch::outbox::{Count, Effect};
use crate::dispatch::part::{JobRef, PartId};
use crate::dispatch::schedule::{Job, Schedule, Stage};
use crate::stored::{Origin, Vote};

impl Verification {
    /// Compares a result with the one that is stored. It is a vote if its worker held the lease of a check.
    pub fn compare(&mut self, arrived: &Arrived, stored: Digest, new: Digest, mut context: Context<'_>) {
        let part = arrived.part();
        let was_asked = context.schedule.end_check(arrived, context.outbox);
        if context.roster.is_fenced(arrived.by) {
            return;
        }
        let Some(StoredBy(first)) = self.producer(part, stored, context.schedule) else {
            // The result was compared with records that are not the present ones: either they are not noted yet, or they
            // were dropped meanwhile.
            if stored != new && context.schedule.job(part).is_some() {
                self.suspects.insert(arrived.job());
            }
            return;
        };
        context.outbox.changed = true;
        if was_asked {
            self.record_vote(arrived, first, (stored, new), &mut context);
        } else if stored != new {
            self.open_dispute(arrived, first, stored, &mut context);
        }
    }

    /// The producer of the stored result of a part; None if this is not the stored result.
    fn producer(&self, part: PartId, stored: Digest, schedule: &Schedule) -> Option<StoredBy> {
        let job = schedule.job(part)?;
        match &job.stage {
            Stage::Done { records, by, .. } if !job.is_divided() => {
                (*records == stored).then_some(StoredBy(*by))
            }
            // The digest of a block is known only while the block is being checked.
            _ => (job.is_divided() && self.checks.subject(part) == Some(stored)).then_some(StoredBy(None)),
        }
    }

    /// Records the vote of a machine that held a check, and acts on the verdict.
    fn record_vote(
        &mut self,
        arrived: &Arrived,
        first: Option<Origin>,
        (stored, new): (Digest, Digest),
        context: &mut Context<'_>,
    ) {
        let (by, part) = (arrived.by, arrived.part());
        let is_own = |other| context.roster.share_a_vote(by, other);
        let verdict = self.checks.vote(part, Vote { by: Some(by), digest: new }, is_own);
        if stored == new {
            context.roster.succeeded(by);
        }
        match verdict {
            Verdict::NotCounted => {}
            Verdict::Agreed => {
                self.confirm(part, first, by, context);
                context.outbox.counts.push(Count::Agreed);
            }
            Verdict::Disputed => {
                context.outbox.counts.push(Count::Disputed);
                // A third machine decides, which may be waiting for work.
                context.outbox.work = true;
                let first = first.map_or_else(|| "an earlier one".to_owned(), |o| context.roster.label_of(o));
                let message = format!("other records than those of {first}: a third machine decides");
                context.note_difference(by, part, message);
            }
            Verdict::Wrong { right, wrong } => {
                if right == stored && stored == new {
                    self.confirm(part, first, by, context);
                }
                context.note_difference(by, part, "records differ between machines");
                for machine in wrong {
                    match machine {
                        Some(machine) => self.fence(part, machine, context),
                        // The producer of the stored result is not known.
                        None if right != stored => {
                            let (dictionary, job) = part.job_ref();
                            context.outbox.effects.push(Effect::Recompute { dictionary, job });
                        }
                        None => {}
                    }
                }
            }
        }
    }

    /// Notes that a machine has confirmed the stored result of a job. In a divided job only a block is confirmed, which
    /// is not noted.
    fn confirm(&mut self, part: PartId, first: Option<Origin>, by: Origin, context: &mut Context<'_>) {
        let divided = context.schedule.job(part).is_none_or(Job::is_divided);
        if divided || first == Some(by) {
            return;
        }
        let confirmed = self.confirmed.entry(part.job_ref()).or_default();
        if !confirmed.contains(&by) {
            confirmed.push(by);
            let (dictionary, job) = part.job_ref();
            context.outbox.effects.push(Effect::Agreed { dictionary, job, machine: by });
        }
    }

    /// Opens a check, since an unrequested result differs from the stored one. A machine that contradicts its own result
    /// is fenced off.
    fn open_dispute(
        &mut self,
        arrived: &Arrived,
        first: Option<Origin>,
        stored: Digest,
        context: &mut Context<'_>,
    ) {
        let (by, part) = (arrived.by, arrived.part());
        if first == Some(by) {
            context.outbox.counts.push(Count::Disputed);
            context.note_difference(by, part, "other records than its own before");
            self.fence(part, by, context);
            return;
        }
        if self.checks.subject(part).is_some() {
            return;
        }
        let confirmed = self.confirmed.get(&part.job_ref()).into_iter().flatten().copied().map(Some);
        let votes = std::iter::once(first).chain(confirmed).map(|by| Vote { by, digest: stored }).collect();
        context.note_difference(
            by,
            part,
            "other records than those that are stored: another machine is asked",
        );
        self.checks.want(part, votes, true);
        context.outbox.work = true;
    }

    /// Handles a result that differs from the records of other jobs with the same walks. If these are confirmed, the
    /// result is rejected. If not, it is not known which is wrong: all are computed again, and then checked.
    pub fn contradict(
        &mut self,
        arrived: &Arrived,
        again: Option<&[JobRef]>,
        mut context: Context<'_>,
    ) -> &'static str {
        let (what, then) = match again {
            None => (
                "other records than those that several machines found for the same walks in another dictionary",
                "they are not taken",
            ),
            Some(others) => {
                self.suspects.insert(arrived.job());
                self.suspects.extend(others);
                (
                    "other records than those of the same walks in another dictionary",
                    "both are computed again",
                )
            }
        };
        context.note_difference(arrived.by, arrived.part(), format!("{what}: {then}"));
        what
    }

    /// Fences off a machine that has computed a wrong result.
    fn fence(&mut self, part: PartId, machine: Origin, context: &mut Context<'_>) {
        let name = context.schedule.by_id(part.dictionary).map(|d| d.name().to_string()).unwrap_or_default();
        let reason = format!(
            "its records of job {} of {name} are wrong: others agree against it; \
             once the cause is gone, `farmctl workers readmit` lets the machine in again",
            part.job
        );
        if !context.roster.fence(machine, &reason, context.outbox) {
            return;
        }
        for id in context.roster.ids_of(machine) {
            context.schedule.free_worker(id, context.outbox);
        }
        self.checks.withdraw_votes(machine);
        context.outbox.effects.push(Effect::Fence { machine, reason });
        self.rely_on_others(machine, context);
    }

    /// Credits the results of a fenced-off machine to the machines that have confirmed them. Results that rest on a
    /// single machine now are sampled for a check.
    fn rely_on_others(&mut self, machine: Origin, context: &mut Context<'_>) {
        let schedule = &mut *context.schedule;
        let mut alone: Vec<(JobRef, Origin)> = Vec::new();
        for (job, confirmed) in &mut self.confirmed {
            confirmed.retain(|by| *by != machine);
            if schedule.producer(*job) == Some(machine) && !confirmed.is_empty() {
                schedule.set_producer(*job, confirmed.remove(0));
            }
            if confirmed.is_empty()
                && let Some(by) = schedule.producer(*job).filter(|by| *by != machine)
            {
                alone.push((*job, by));
            }
        }
        self.confirmed.retain(|_, confirmed| !confirmed.is_empty());
        for (job, by) in alone {
            let part = PartId::first_of(job);
            if let Some(digest) = schedule.records_of(job).filter(|digest| self.is_sampled(part, *digest)) {
                self.checks.want(part, vec![Vote { by: Some(by), digest }], false);
                context.outbox.work = true;
            }
        }
    }
}

/// The machine that computed the stored result, if it is known.
struct StoredBy(Option<Origin>);
