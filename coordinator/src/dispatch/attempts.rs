//! Ends attempts: admits results, notes them once they are stored, and counts failures against job and machine.

use std::time::Duration;

use farm_proto::ids::WorkerId;
use farm_proto::lease::LeaseKey;
use optics_model::{Digest, Walks};

use super::admission::{Admission, Arrived};
use super::part::JobRef;
use super::roster::Process;
use super::schedule::{Done, OpenLease, Strike};
use super::{DispatchError, Dispatcher};
use crate::stored::{Origin, Outcome};

impl Dispatcher {
    /// Decides whether a result is accepted. A result whose lease is lost is accepted too, provided that this coordinator
    /// granted the lease, even before a restart: records depend on the job alone. `identity` is the identity of the job
    /// as the worker received it, so a result for another grid or another number of walks is refused.
    pub fn admit(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        key: &LeaseKey,
        identity: Digest,
    ) -> Result<Admission, DispatchError> {
        let by = self.seen(now, worker)?;
        let holder = self.roster.access_token(by);
        let admitted = self.schedule.admit(key, identity, by, holder);
        let unused = matches!(admitted, Err(_) | Ok(Admission::Repeated { .. }));
        if unused && self.schedule.leases().held_by(key, worker).is_some() {
            // The worker drops the result and the lease, whose end must not count as silence.
            self.schedule.free(key.token, &mut self.outbox);
        }
        admitted
    }

    /// Notes the outcome of storing a result. [`Outcome::Differs`] is handled by [`Self::contradict`].
    pub fn arrived(&mut self, now: Duration, arrived: &Arrived, outcome: Outcome) {
        match outcome {
            Outcome::Finished { records } => self.finished(now, arrived, records),
            Outcome::Part => self.part_finished(now, arrived),
            Outcome::MoreWalks(walks) => self.prolong(now, arrived, walks),
            Outcome::Before { records, .. } => self.compare_with_stored(arrived, records),
            Outcome::Unwanted | Outcome::Repeated | Outcome::Differs => {}
        }
    }

    /// Notes that a job's records are stored.
    pub(super) fn finished(&mut self, now: Duration, arrived: &Arrived, records: Digest) {
        self.result_came(now, arrived);
        if self.schedule.finish(now, arrived, records) {
            self.verification.job_finished(arrived, records, &mut self.outbox);
            self.schedule.note_end(arrived.key.dictionary, &mut self.outbox);
        }
    }

    /// Notes that a block of a divided job is stored.
    pub(super) fn part_finished(&mut self, now: Duration, arrived: &Arrived) {
        // A block of fewer walks may arrive after its job was begun again with more.
        if self.schedule.has_walks(arrived.job(), arrived.walks) {
            self.result_came(now, arrived);
            if self.schedule.part_stored(arrived.part()) {
                self.verification.block_stored(arrived, &mut self.outbox);
            }
        }
    }

    /// The target error is not reached: begins the job again with more walks.
    pub(super) fn prolong(&mut self, now: Duration, arrived: &Arrived, more: Walks) {
        let job = arrived.job();
        // If two copies arrive at once, the second requests a restart that the first has already caused.
        if self.schedule.has_walks(job, arrived.walks) && self.schedule.is_open(job) {
            self.result_came(now, arrived);
            self.schedule.prolong(job, more, &mut self.outbox);
            self.verification.forget_blocks(job);
        }
    }

    fn result_came(&mut self, now: Duration, arrived: &Arrived) {
        self.schedule.result_came(now, arrived, &mut self.outbox);
        self.roster.delivered(arrived.worker, arrived.by);
    }

    /// Compares a result with the one that is stored: if they differ the coordinator computes the job itself.
    pub(super) fn compare_with_stored(&mut self, arrived: &Arrived, stored: Digest) {
        if arrived.digest != stored {
            let known = (&self.schedule, &self.roster);
            self.verification.dispute(arrived, Some(stored), known, &mut self.outbox);
        }
    }

    /// Notes that the store has ended a job with records that came for another dictionary.
    pub fn taken_over(&mut self, job: JobRef, walks: Walks, records: Digest, by: Option<Origin>) {
        self.end_open(job, walks, Done { records, by, reused: true, verified: false });
    }

    /// Notes that the stored records of a job are those that the coordinator itself has computed; `own` is its machine.
    pub fn verified(&mut self, job: JobRef, walks: Walks, records: Digest, own: Origin) {
        self.end_open(job, walks, Done { records, by: Some(own), reused: false, verified: true });
        self.schedule.set_verified(job);
        self.outbox.changed = true;
    }

    /// Ends a job, if it is open.
    fn end_open(&mut self, job: JobRef, walks: Walks, done: Done) {
        if self.schedule.take_over(job, walks, done) {
            self.outbox.work_came();
            self.schedule.note_end(job.0, &mut self.outbox);
        }
    }

    /// Handles a result that differs from the records of another job with the same walks: the coordinator computes its job
    /// itself. The blocks of a divided job are merged and cannot be separated: they and the other job's records are gone
    /// and computed again, and it counts as a failed attempt, so that this cannot repeat for ever.
    pub fn contradict(&mut self, now: Duration, arrived: &Arrived) {
        let key = arrived.key;
        self.schedule.hand_back(&[*key], &mut self.outbox);
        if arrived.walks.blocks() == 1 {
            let known = (&self.schedule, &self.roster);
            self.verification.dispute(arrived, None, known, &mut self.outbox);
            return;
        }
        let reason = format!(
            "attempt {}: other records than those of the same walks in another dictionary: both are computed again",
            key.attempt
        );
        self.strike(now, arrived.job(), Strike { machine: arrived.by, silent: None, reason });
    }

    /// Counts a failed attempt; the job is tried again or given up.
    pub fn failed(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        key: &LeaseKey,
        reason: &str,
    ) -> Result<(), DispatchError> {
        self.seen(now, worker)?;
        if self.schedule.leases().held_by(key, worker).is_none() {
            return Err(DispatchError::LeaseLost { job: key.job, attempt: key.attempt });
        }
        if let Some(held) = self.schedule.free(key.token, &mut self.outbox) {
            self.blame(now, &held, None, reason);
        }
        Ok(())
    }

    /// Counts a failed lease against its worker's machine and its job.
    pub(super) fn blame(&mut self, now: Duration, held: &OpenLease, silent: Option<Process>, what: &str) {
        let Ok(worker) = self.roster.get(&held.worker) else { return };
        let (machine, job) = (worker.origin, (held.key.dictionary, held.key.job));
        let reason = format!("attempt {}: {what}{}", held.key.attempt, worker.log_note());
        self.roster.failed(now, machine, job, &reason, &mut self.outbox);
        self.strike(now, job, Strike { machine, silent, reason });
    }

    fn strike(&mut self, now: Duration, job: JobRef, strike: Strike) {
        let machines_struck = self.schedule.strike(now, job, strike, &self.roster, &mut self.outbox);
        if machines_struck > 1 {
            self.outbox.work |= self.roster.exonerate(now, job);
        }
    }
}
