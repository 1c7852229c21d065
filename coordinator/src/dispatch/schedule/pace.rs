//! Measures the pace of the farm, to estimate the remaining time and to find parts that take too long.

use std::time::Duration;

/// Shortest time constant with which completions fade out of the pace.
const MEMORY_S: f64 = 30.0;
/// The time constant is at least this many times the time of a part: otherwise the pace would fall between completions
/// and leap with each.
const PARTS_REMEMBERED: f64 = 3.0;
/// Fewest completions from which a pace is computed.
const FEWEST: usize = 3;
/// After this time without work the pace is measured again: the workers may have changed.
const FORGOTTEN: Duration = Duration::from_mins(10);
/// Weight of the newest completion in the typical time of a part.
const NEWEST: f64 = 0.05;
/// A part is a straggler after this many times the typical time for its cost.
const PATIENCE: f64 = 3.0;
/// After this many times the typical time a part is considered abandoned by its worker, however slow the machine.
const ENDLESS: f64 = 30.0;
/// No part is considered abandoned before this: machines are put to sleep, and programs stopped for a while.
const LEAST_ENDLESS: Duration = Duration::from_hours(1);
/// Time after which a part is considered abandoned while the typical time is not known.
const LONGEST_UNKNOWN: Duration = Duration::from_hours(24);
/// No part is a straggler before this.
const LEAST: Duration = Duration::from_secs(2);
/// Time after which a part is a straggler while the typical time is not known: a worker that holds all jobs must not keep
/// others idle.
const LEAST_UNKNOWN: Duration = Duration::from_mins(1);

/// Exponential averages of the cost finished per second in which there was work, and of the time from lease to result.
#[derive(Debug, Default)]
pub(super) struct Pace {
    /// Finished cost, and the seconds of work that it took, both faded to the time `at`.
    finished: f64,
    worked_s: f64,
    at: Duration,
    /// Whether leases are out since `at`. Time without any does not measure the pace.
    working: bool,
    completions: usize,
    seconds_per_part: Option<f64>,
    seconds_per_cost: Option<f64>,
}

impl Pace {
    /// Sets whether leases are out from now on.
    pub fn working(&mut self, now: Duration, working: bool) {
        if working && !self.working && now.saturating_sub(self.at) > FORGOTTEN {
            (self.finished, self.worked_s, self.completions) = (0.0, 0.0, 0);
        }
        if working || self.working {
            (self.finished, self.worked_s) = self.faded(now);
            self.at = now;
        }
        self.working = working;
    }

    pub fn completed(&mut self, now: Duration, cost: f64, took: Duration) {
        self.working(now, self.working);
        self.finished += cost;
        self.completions += 1;
        let average = |before: Option<f64>, newest: f64| {
            Some(before.map_or(newest, |before| before + NEWEST * (newest - before)))
        };
        let took_s = took.as_secs_f64();
        self.seconds_per_part = average(self.seconds_per_part, took_s);
        self.seconds_per_cost = average(self.seconds_per_cost, took_s / cost);
    }

    /// Finished cost and seconds of work, both faded to `now`.
    fn faded(&self, now: Duration) -> (f64, f64) {
        if !self.working {
            return (self.finished, self.worked_s);
        }
        let passed_s = now.saturating_sub(self.at).as_secs_f64();
        if self.completions == 0 {
            // The time of a part is not known yet, and so neither is the time constant.
            return (0.0, self.worked_s + passed_s);
        }
        let memory_s = MEMORY_S.max(PARTS_REMEMBERED * self.seconds_per_part.unwrap_or(0.0));
        let kept = libm::exp(-passed_s / memory_s);
        (self.finished * kept, self.worked_s * kept + memory_s * (1.0 - kept))
    }

    /// Recently finished cost per second. None until at least as many parts are finished as are out, so that each of
    /// these can have replaced a finished one: parts under way do not count yet.
    pub fn rate(&self, now: Duration, out: usize) -> Option<f64> {
        let (finished, worked_s) = self.faded(now);
        let rate = finished / worked_s;
        (self.completions >= out.max(FEWEST) && rate > 1e-9).then_some(rate)
    }

    /// Whether a part of this cost has been out for too long.
    pub fn is_late(&self, cost: f64, age: Duration) -> bool {
        let longest = self.seconds_per_cost.map(|s| Duration::from_secs_f64(PATIENCE * s * cost));
        age > longest.map_or(LEAST_UNKNOWN, |longest| longest.max(LEAST))
    }

    /// Whether a part of this cost has been out for so long that its worker will never end it, however slow it is.
    pub fn is_endless(&self, cost: f64, age: Duration) -> bool {
        let typical = self.seconds_per_cost.map(|s| ENDLESS * s * cost);
        age > typical.map_or(LONGEST_UNKNOWN, |s| Duration::from_secs_f64(s).max(LEAST_ENDLESS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(s: f64) -> Duration {
        Duration::from_secs_f64(s)
    }

    /// The pace just before and just after each completion, from the time `from_s` on, for parts of cost 1 on `slots`
    /// slots that each begin the next part when one is finished.
    fn rates(pace: &mut Pace, slots: usize, part_s: f64, parts: usize, from_s: f64) -> Vec<f64> {
        pace.working(seconds(from_s), true);
        // The regular look for expired leases.
        pace.working(seconds(from_s + 0.5 * part_s), true);
        let mut rates = Vec::new();
        for part in 0..parts {
            let now = from_s + part_s * ((part / slots + 1) as f64);
            rates.extend(pace.rate(seconds(now - 1e-3), slots));
            pace.completed(seconds(now), 1.0, seconds(part_s));
            rates.extend(pace.rate(seconds(now), slots));
        }
        pace.working(seconds(from_s + part_s * parts.div_ceil(slots) as f64), false);
        rates
    }

    fn assert_near(rates: &[f64], truth: f64, tolerance: f64) {
        for rate in rates {
            assert!(libm::log(rate / truth).abs() < tolerance, "{rate}, not {truth}");
        }
    }

    /// A part is late after three times the usual time, but never before 2 s, and after a minute as long as no part was
    /// finished.
    #[test]
    fn part_is_late_after_three_usual_times() {
        let is_late_after = |pace: &Pace, cost, limit: f64| {
            [limit - 0.1, limit + 0.1].map(|time| pace.is_late(cost, seconds(time))) == [false, true]
        };
        let mut pace = Pace::default();
        assert!(is_late_after(&pace, 1.0, 60.0));
        pace.completed(seconds(100.0), 2.0, seconds(80.0));
        assert!(is_late_after(&pace, 1.0, 120.0) && is_late_after(&pace, 0.001, 2.0));
        let mut pace = Pace::default();
        (0..50_u8).for_each(|i| pace.completed(seconds(i.into()), 10.0, seconds(20.0)));
        assert!(is_late_after(&pace, 10.0, 60.0) && is_late_after(&pace, 0.01, 2.0));
    }

    /// There is no rate before one part per slot is finished. With a steady pace it is right within a factor of 2.3 at
    /// first, and within 23 % later.
    #[test]
    fn rate_needs_one_part_per_slot() {
        let mut pace = Pace::default();
        let seen = rates(&mut pace, 40, 0.4, 6000, 100.0);
        assert_eq!(seen.len(), 2 * 6000 - (2 * 40 - 1));
        assert_near(&seen[..80], 100.0, 0.8);
        assert_near(&seen[400..], 100.0, 0.2);
    }

    /// Time without work does not slow the pace.
    #[test]
    fn idle_time_does_not_slow_the_pace() {
        let mut pace = Pace::default();
        rates(&mut pace, 4, 1.0, 400, 0.0);
        assert_near(&[pace.rate(seconds(160.0), 4).unwrap()], 4.0, 0.05);
        // A minute later the next dictionary is submitted.
        let seen = rates(&mut pace, 4, 1.0, 40, 160.0);
        assert_near(&seen, 4.0, 0.1);
    }

    /// Parts that take minutes do not make the pace jump.
    #[test]
    fn long_parts_do_not_disturb_the_pace() {
        let mut pace = Pace::default();
        let seen = rates(&mut pace, 4, 120.0, 40, 0.0);
        // Just before the second round is finished, the measurement covers four parts in twice the time.
        assert_near(&seen, 4.0 / 120.0, 0.85);
    }

    /// After a long time without work, there is no rate.
    #[test]
    fn old_pace_is_forgotten() {
        let mut pace = Pace::default();
        rates(&mut pace, 4, 1.0, 400, 0.0);
        pace.working(seconds(1e4), true);
        assert_eq!(pace.rate(seconds(1e4), 1), None);
    }

    /// Workers that have fallen silent slow the pace.
    #[test]
    fn silent_workers_slow_the_pace() {
        let mut pace = Pace::default();
        pace.working(seconds(0.0), true);
        (1..=100_u32).for_each(|s| pace.completed(seconds(s.into()), 1.0, seconds(1.0)));
        let (before, after) = (pace.rate(seconds(100.0), 1), pace.rate(seconds(160.0), 1));
        assert!(after.unwrap() < 0.2 * before.unwrap(), "{before:?} {after:?}");
    }
}
