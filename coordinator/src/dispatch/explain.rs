//! Why a dictionary is not done yet.

use std::time::Duration;

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use farm_proto::status::DictionaryState;

use super::checks::is_disputed;
use super::{Dictionary, Dispatcher, PartId, Purpose};
use crate::stored::{Origin, Vote};

/// A reason, with a code that programs can rely on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reason {
    pub code: &'static str,
    pub text: String,
}

fn reason(code: &'static str, text: impl Into<String>) -> Reason {
    Reason { code, text: text.into() }
}

impl Dispatcher {
    /// Why it is not done, the most important first; None if there is no such dictionary.
    pub fn explain(&self, now: Duration, name: &DictionaryName) -> Option<Vec<Reason>> {
        let dictionary = self.by_name(name)?;
        let mut reasons = Vec::new();
        match dictionary.state() {
            DictionaryState::Done => {
                self.explain_disputes(dictionary, &mut reasons);
                self.explain_checks(now, dictionary, &mut reasons);
                reasons.push(reason("DONE", "all of its jobs are done"));
            }
            DictionaryState::Cancelled if dictionary.too_large.is_some() => {
                reasons.push(reason("TOO_LARGE", dictionary.reason()));
            }
            DictionaryState::Cancelled => {
                let why =
                    if dictionary.reason().is_empty() { "no reason given" } else { dictionary.reason() };
                reasons
                    .push(reason("CANCELLED", format!("it was cancelled: {why}; `farmctl resume` goes on")));
            }
            DictionaryState::Outdated => reasons.push(reason(
                "OUTDATED",
                "it was begun with another physics version: submit its grid under another name",
            )),
            DictionaryState::Paused => {
                reasons.push(reason("PAUSED", "it is paused: `farmctl resume` goes on"));
            }
            DictionaryState::Failed => {}
            DictionaryState::Running => self.explain_running(now, dictionary, &mut reasons),
        }
        if dictionary.state() != DictionaryState::Done {
            self.explain_disputes(dictionary, &mut reasons);
            self.explain_checks(now, dictionary, &mut reasons);
        }
        let (_, given_up) = dictionary.ended();
        if let Some(first) = dictionary.given_up(0, 1).first() {
            let text = format!(
                "{given_up} jobs were given up, the first is job {} ({}); `farmctl show` tells why of all, `farmctl \
                 retry` tries them again",
                first.job, first.reason
            );
            reasons.push(reason("JOBS_GIVEN_UP", text));
        }
        Some(reasons)
    }

    /// Jobs whose results differ between machines, and which are right is not known.
    fn explain_disputes(&self, dictionary: &Dictionary, reasons: &mut Vec<Reason>) {
        let (count, first) =
            (self.disputed(dictionary.id()), self.checks.disputed_in(dictionary.id()).next());
        if let Some(PartId { job, .. }) = first {
            let text = format!(
                "machines disagree about {count} jobs, the first is job {job}: one that has not computed it must decide"
            );
            reasons.push(reason("DISPUTED", text));
        }
    }

    /// Results that are to be compared, where every machine that works has been heard about them.
    fn explain_checks(&self, now: Duration, dictionary: &Dictionary, reasons: &mut Vec<Reason>) {
        let able: Vec<Origin> = self.able(now).collect();
        let machines = &self.workers.machines;
        let has_voted = |machine: Origin, votes: &[Vote]| {
            votes.iter().any(|vote| vote.by.is_some_and(|by| machines.share_a_vote(machine, by)))
        };
        let stuck =
            |votes: &[Vote]| !is_disputed(votes) && able.iter().all(|machine| has_voted(*machine, votes));
        let count = self.checks.of_dictionary(dictionary.id()).filter(|(_, votes)| stuck(votes)).count();
        if count > 0 {
            let text = format!(
                "{count} results wait to be compared, and no machine is there that has not computed them: start a worker \
                 on another one"
            );
            reasons.push(reason("CHECKS_WAIT", text));
        }
    }

    /// Jobs of a dictionary about which machines disagree.
    pub(super) fn disputed(&self, id: DictionaryId) -> usize {
        let mut jobs: Vec<u32> = self.checks.disputed_in(id).map(|part| part.job).collect();
        jobs.dedup();
        jobs.len()
    }

    fn explain_running(&self, now: Duration, dictionary: &Dictionary, reasons: &mut Vec<Reason>) {
        let registered = self.workers.len();
        let active = self.workers.active().count();
        let paused =
            self.workers.active().filter(|(_, w)| self.workers.machines.pause_left(now, w.origin).is_some());
        let paused = paused.count();
        if registered == 0 {
            reasons.push(reason("NO_WORKERS", "no worker is registered: start farm-worker"));
        } else if active == 0 {
            let text = format!("all {registered} workers are draining or fenced off: start others");
            reasons.push(reason("NO_WORKERS", text));
        } else if self.workers.active().all(|(_, w)| self.is_silent(now, w)) {
            let whose = if active == 1 {
                "the one worker has not".to_owned()
            } else {
                format!("none of {active} workers has")
            };
            let text = format!("{whose} been heard of for {} s", self.settings.lease.as_secs());
            reasons.push(reason("WORKERS_SILENT", text));
        }
        if paused > 0 {
            let text =
                format!("{paused} of {active} workers are suspended: they fail one job after the other");
            reasons.push(reason("WORKERS_SUSPENDED", text));
        }
        let before: Vec<_> = self.served_before(dictionary).filter(|d| d.pending() > 0).collect();
        if let (Some(next), true) = (before.first(), dictionary.pending() > 0) {
            let (count, waiting) = (before.len(), before.iter().map(|d| d.pending()).sum::<usize>());
            let others = if count == 1 { "another dictionary".to_owned() } else { format!("{count} others") };
            let (name, priority) = (next.name(), next.priority());
            let text = format!("{waiting} jobs of {others} go first, {name} with priority {priority}");
            reasons.push(reason("HIGHER_PRIORITY", text));
        }
        let held =
            self.leases.iter().filter(|h| h.key.dictionary == dictionary.id() && h.purpose != Purpose::Check);
        if let Some(oldest) = held.min_by_key(|h| h.since) {
            let label = self.workers.get(&oldest.worker).map_or("", |w| w.about.label.as_str());
            let (job, age) = (oldest.key.job, now.saturating_sub(oldest.since).as_secs_f64());
            let text = match dictionary.leased {
                1 => format!("job {job} is being computed, for {age:.1} s by {label}"),
                leased => format!(
                    "{leased} jobs are being computed, the oldest (job {job}) for {age:.1} s by {label}"
                ),
            };
            reasons.push(reason("COMPUTING", text));
        }
        if let Some(other) = self.waits_for_other(dictionary.id()) {
            let text = format!(
                "its {} jobs that wait are computed for {}, whose records serve both",
                dictionary.pending(),
                other.name()
            );
            reasons.push(reason("SHARED", text));
        } else if dictionary.pending() > 0 {
            let busy = "wait for a worker that is free";
            reasons.push(reason("WAITING", format!("{} jobs {busy}", dictionary.pending())));
        }
        if let Some((job, strikes)) = dictionary.most_troubled() {
            let last = strikes.last().map_or("", |s| s.reason.as_str());
            let text = format!(
                "job {job} has failed {} times, of {} allowed: {last}",
                strikes.len(),
                self.settings.max_attempts
            );
            reasons.push(reason("RETRYING", text));
        }
    }
}
