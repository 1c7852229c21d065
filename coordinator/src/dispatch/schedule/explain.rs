//! Explains why a dictionary is not done yet.

use std::time::Duration;

use farm_proto::status::{DictionaryState, INTERRUPTED};

use super::{Dictionary, Schedule};
use crate::dispatch::roster::Roster;

/// A reason, with a code that programs can rely on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reason {
    pub code: &'static str,
    pub text: String,
}

impl Reason {
    pub fn new(code: &'static str, text: impl Into<String>) -> Self {
        Self { code, text: text.into() }
    }
}

impl Schedule {
    /// The reasons why a dictionary is not done, the most important first. `disputes`: the one that concerns its disputes.
    pub fn explain(
        &self,
        now: Duration,
        dictionary: &Dictionary,
        roster: &Roster,
        disputes: Option<Reason>,
    ) -> Vec<Reason> {
        let is_done = dictionary.is_complete();
        let mut reasons: Vec<Reason> = disputes.iter().filter(|_| is_done).cloned().collect();
        match dictionary.state() {
            DictionaryState::Done => reasons.push(Reason::new("DONE", "all of its jobs are done")),
            DictionaryState::Cancelled if dictionary.too_large.is_some() => {
                reasons.push(Reason::new("TOO_LARGE", dictionary.reason()));
            }
            DictionaryState::Cancelled if dictionary.reason() == INTERRUPTED => reasons.push(Reason::new(
                "INTERRUPTED",
                "the command that computed it has ended: `farmctl submit` with the same grid file and name continues it, \
                 and so does the same `farmctl measure`",
            )),
            DictionaryState::Cancelled => {
                let why =
                    if dictionary.reason().is_empty() { "no reason given" } else { dictionary.reason() };
                let text = format!("it was cancelled: {why}; `farmctl resume` continues it");
                reasons.push(Reason::new("CANCELLED", text));
            }
            DictionaryState::Outdated => reasons.push(Reason::new(
                "OUTDATED",
                "it was begun with another physics version: submit its grid under another name",
            )),
            DictionaryState::Paused => {
                reasons.push(Reason::new("PAUSED", "it is paused: `farmctl resume` continues it"));
            }
            DictionaryState::Failed => {}
            DictionaryState::Running => {
                self.explain_workers(now, roster, &mut reasons);
                self.explain_running(now, dictionary, roster, &mut reasons);
            }
        }
        if !is_done {
            reasons.extend(disputes);
        }
        let (_, given_up) = dictionary.ended();
        if let Some(first) = dictionary.given_up(0, 1).first() {
            let text = format!(
                "{given_up} jobs were given up, the first is job {} ({}); `farmctl show` gives the reasons of all, \
                 `farmctl retry` tries them again",
                first.job, first.reason
            );
            reasons.push(Reason::new("JOBS_GIVEN_UP", text));
        }
        reasons
    }

    fn explain_workers(&self, now: Duration, roster: &Roster, reasons: &mut Vec<Reason>) {
        let registered = roster.len();
        let active = roster.active().count();
        let paused = roster.active().filter(|(_, w)| roster.pause_left(now, w.origin).is_some()).count();
        if registered == 0 {
            reasons.push(Reason::new("NO_WORKERS", "no worker is registered: start farm-worker"));
        } else if active == 0 {
            let text = format!("all {registered} workers are draining or fenced off: start others");
            reasons.push(Reason::new("NO_WORKERS", text));
        } else if roster.active().all(|(_, w)| roster.is_silent(now, w)) {
            let whose = if active == 1 {
                "the one worker has not".to_owned()
            } else {
                format!("none of {active} workers has")
            };
            let text = format!("{whose} been heard of for {} s", self.settings.lease.as_secs());
            reasons.push(Reason::new("WORKERS_SILENT", text));
        }
        if paused > 0 {
            let text =
                format!("{paused} of {active} workers are suspended: they fail one job after the other");
            reasons.push(Reason::new("WORKERS_SUSPENDED", text));
        }
    }

    fn explain_running(
        &self,
        now: Duration,
        dictionary: &Dictionary,
        roster: &Roster,
        reasons: &mut Vec<Reason>,
    ) {
        let before: Vec<_> = self.served_before(dictionary).filter(|d| d.pending() > 0).collect();
        if let (Some(next), true) = (before.first(), dictionary.pending() > 0) {
            let (count, waiting) = (before.len(), before.iter().map(|d| d.pending()).sum::<usize>());
            let others = if count == 1 { "another dictionary".to_owned() } else { format!("{count} others") };
            let (name, priority) = (next.name(), next.priority());
            let text = format!("{waiting} jobs of {others} go first, {name} with priority {priority}");
            reasons.push(Reason::new("HIGHER_PRIORITY", text));
        }
        let held = self.leases.iter().filter(|h| h.key.dictionary == dictionary.id());
        if let Some(oldest) = held.min_by_key(|h| h.since) {
            let label = roster.get(&oldest.worker).map_or("", |w| w.about.label.as_str());
            let (job, age) = (oldest.key.job, now.saturating_sub(oldest.since).as_secs_f64());
            let text = match dictionary.leased() {
                1 => format!("job {job} is being computed, for {age:.1} s by {label}"),
                leased => format!(
                    "{leased} jobs are being computed, the oldest (job {job}) for {age:.1} s by {label}"
                ),
            };
            reasons.push(Reason::new("COMPUTING", text));
        }
        if let Some(other) = self.waits_for_other(dictionary.id()) {
            let text = format!(
                "its {} jobs that wait are computed for {}, whose records serve both",
                dictionary.pending(),
                other.name()
            );
            reasons.push(Reason::new("SHARED", text));
        } else if dictionary.pending() > 0 {
            let busy = "wait for a worker that is free";
            reasons.push(Reason::new("WAITING", format!("{} jobs {busy}", dictionary.pending())));
        }
        if let Some((job, strikes)) = dictionary.most_troubled() {
            let last = strikes.last().map_or("", |s| s.reason.as_str());
            let text = format!(
                "job {job} has failed {} times, of {} allowed: {last}",
                strikes.len(),
                self.settings.max_attempts
            );
            reasons.push(Reason::new("RETRYING", text));
        }
    }
}
