//! Keeps the machines that workers run on: which of them are fenced off, and which are suspended because they fail one
//! job after the other.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use crate::dispatch::part::JobRef;
use crate::stored::{KnownMachine, Machine, Origin};

/// Different jobs that a machine may fail one after the other before it gets a pause.
const IN_A_ROW: usize = 3;
/// The first pause; each is twice as long as the one before.
const FIRST_PAUSE: Duration = Duration::from_secs(10);
const LONGEST_PAUSE: Duration = Duration::from_mins(10);

/// The failures of a machine since its last success.
#[derive(Debug, Default)]
struct Failures {
    jobs: BTreeSet<JobRef>,
    pauses: u32,
    until: Duration,
}

#[derive(Debug, Default)]
pub(super) struct Machines {
    known: BTreeMap<Origin, KnownMachine>,
    failures: BTreeMap<Origin, Failures>,
}

impl Machines {
    /// Adds a machine from the store.
    pub fn remember(&mut self, known: KnownMachine) {
        self.known.insert(known.origin, known);
    }

    /// Notes that a machine has connected. Its fence stays.
    pub fn met(&mut self, origin: Origin, machine: Machine, label: &str) {
        let fenced = self.known.remove(&origin).and_then(|known| known.fenced);
        self.known.insert(origin, KnownMachine { origin, machine, label: label.to_owned(), fenced });
    }

    pub fn label(&self, origin: Origin) -> &str {
        self.known.get(&origin).map_or("", |known| &known.label)
    }

    /// Name of the access token that a machine has presented.
    pub fn access_token(&self, origin: Origin) -> &str {
        self.known.get(&origin).map_or("", |known| &known.machine.token)
    }

    pub fn fence(&mut self, origin: Origin, reason: String) {
        if let Some(known) = self.known.get_mut(&origin) {
            known.fenced = Some(reason);
        }
    }

    /// The reason why a machine is fenced off, itself or under another address; None if it is not.
    pub fn fence_of(&self, machine: &Machine) -> Option<&str> {
        let mut same = self.known.values().filter(|known| known.machine.is_same(machine));
        same.find_map(|known| known.fenced.as_deref())
    }

    pub fn is_fenced(&self, origin: Origin) -> bool {
        self.reason(origin).is_some()
    }

    pub fn reason(&self, origin: Origin) -> Option<&str> {
        self.known.get(&origin)?.fenced.as_deref()
    }

    /// Notes that a job has failed on a machine. Returns the length of its pause, if it gets one now. `alone`: no other
    /// machine could do its work meanwhile, so that a long pause would only cost time.
    pub fn failed(&mut self, now: Duration, origin: Origin, job: JobRef, alone: bool) -> Option<Duration> {
        let failures = self.failures.entry(origin).or_default();
        failures.jobs.insert(job);
        if failures.jobs.len() < IN_A_ROW || failures.until > now {
            return None;
        }
        let longest = if alone { FIRST_PAUSE } else { LONGEST_PAUSE };
        let pause = FIRST_PAUSE.saturating_mul(1 << failures.pauses.min(16)).min(longest);
        failures.pauses += 1;
        failures.until = now + pause;
        Some(pause)
    }

    /// Removes a job at which several machines fail from their failures: the fault is the job's. True if that ends a pause.
    pub fn exonerate(&mut self, now: Duration, job: JobRef) -> bool {
        let mut ended = false;
        for failures in self.failures.values_mut() {
            if failures.jobs.remove(&job) && failures.jobs.len() < IN_A_ROW && failures.until > now {
                failures.until = now;
                ended = true;
            }
        }
        ended
    }

    /// Notes a success of a machine, which clears its failures.
    pub fn succeeded(&mut self, origin: Origin) {
        self.failures.remove(&origin);
    }

    /// Time until the pause of a machine ends; None if it has none.
    pub fn pause_left(&self, now: Duration, origin: Origin) -> Option<Duration> {
        let until = self.failures.get(&origin)?.until;
        until.checked_sub(now).filter(|left| !left.is_zero())
    }

    /// Whether a machine has had a pause and no success since: it gets only one job at a time.
    pub fn is_on_trial(&self, origin: Origin) -> bool {
        self.failures.get(&origin).is_some_and(|failures| failures.pauses > 0)
    }

    /// Whether a pause has ended between two times.
    pub fn pause_ended(&self, after: Duration, now: Duration) -> bool {
        self.failures.values().any(|failures| failures.until > after && failures.until <= now)
    }
}

#[cfg(test)]
mod tests {
    use farm_proto::ids::DictionaryId;

    use super::*;

    const A: Origin = Origin(1);

    fn job(number: u32) -> JobRef {
        (DictionaryId(1), number)
    }

    fn machine(token: &str, address: &str, host: &str) -> Machine {
        Machine { token: token.to_owned(), address: address.to_owned(), host: host.to_owned() }
    }

    /// A machine is suspended after failures of several jobs, for growing pauses.
    #[test]
    fn several_failed_jobs_cause_growing_pauses() {
        let mut machines = Machines::default();
        let at = Duration::from_secs;
        assert_eq!(machines.failed(at(0), A, job(0), false), None);
        assert_eq!(machines.failed(at(0), A, job(0), false), None, "one job may be bad");
        assert_eq!(machines.failed(at(0), A, job(1), false), None);
        assert_eq!(machines.failed(at(0), A, job(2), false), Some(at(10)));
        assert_eq!(machines.failed(at(1), A, job(3), false), None, "it has its pause");
        assert!(!machines.pause_ended(at(0), at(9)) && machines.pause_ended(at(9), at(10)));
        assert_eq!(machines.failed(at(10), A, job(4), false), Some(at(20)));
        for round in 1..20 {
            machines.failed(at(10_000 * round), A, job(4), false);
        }
        assert_eq!(machines.failed(at(1_000_000), A, job(4), false), Some(at(600)));
        let alone = machines.failed(at(2_000_000), A, job(4), true);
        assert_eq!(alone, Some(at(10)), "no other machine is there");
        machines.succeeded(A);
        assert_eq!((machines.is_on_trial(A), machines.pause_left(at(2_000_000), A)), (false, None));
    }

    /// A fence binds the machine, by address or host name, for all of its processes.
    #[test]
    fn fence_binds_the_machine() {
        let mut machines = Machines::default();
        machines.met(A, machine("t", "::1", "h"), "a");
        machines.fence(A, "wrong".to_owned());
        let cases = [(("t", "::1", ""), true), (("t", "::2", "h"), true), (("u", "::1", "h"), false)];
        for ((token, address, host), fenced) in cases.into_iter().chain([(("t", "::2", ""), false)]) {
            let reason = machines.fence_of(&machine(token, address, host));
            assert_eq!(reason, fenced.then_some("wrong"), "{token} {address} {host}");
        }
        machines.met(A, machine("t", "::1", "h"), "b");
        assert!(machines.is_fenced(A), "another process is the same machine");
    }
}
