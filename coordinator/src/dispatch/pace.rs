//! How fast the farm works: for the time that is left, and for parts that take too long.

use std::time::Duration;

/// Completions fade out of the pace over this time.
const MEMORY_S: f64 = 30.0;
/// Share of the newest completion in the typical time of a part.
const NEWEST: f64 = 0.05;
/// A part is a straggler after this many times what is typical for its cost.
const PATIENCE: f64 = 3.0;
/// No part is a straggler before.
const LEAST: Duration = Duration::from_secs(2);

/// An exponential average of the cost finished per second, and of the time from lease to result per unit of cost.
#[derive(Debug, Default)]
pub(super) struct Pace {
    /// Cost finished, faded to the time `at`.
    finished: f64,
    at: Duration,
    /// When work began after the last idle time.
    since: Duration,
    seconds_per_cost: Option<f64>,
}

impl Pace {
    pub fn completed(&mut self, now: Duration, cost: f64, took: Duration) {
        self.finished = self.faded(now);
        if self.finished < 1e-3 * cost {
            self.since = now.saturating_sub(took);
            self.finished = 0.0;
        }
        self.finished += cost;
        self.at = now;
        let newest = took.as_secs_f64() / cost;
        self.seconds_per_cost = Some(match self.seconds_per_cost {
            Some(before) => before + NEWEST * (newest - before),
            None => newest,
        });
    }

    fn faded(&self, now: Duration) -> f64 {
        self.finished * (-now.saturating_sub(self.at).as_secs_f64() / MEMORY_S).exp()
    }

    /// Cost finished per second of late; None if nothing was.
    pub fn rate(&self, now: Duration) -> Option<f64> {
        let elapsed = now.saturating_sub(self.since).as_secs_f64().max(1e-3);
        let rate = self.faded(now) / (MEMORY_S * (1.0 - (-elapsed / MEMORY_S).exp()));
        (self.finished > 0.0 && rate > 1e-9).then_some(rate)
    }

    /// Whether a part of this cost has been out for too long.
    pub fn is_late(&self, cost: f64, age: Duration) -> bool {
        let typical = self.seconds_per_cost.map(|s| s * cost);
        age > LEAST && typical.is_some_and(|typical| age.as_secs_f64() > PATIENCE * typical)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(s: f64) -> Duration {
        Duration::from_secs_f64(s)
    }

    #[test]
    fn a_steady_pace_is_measured_from_the_start_and_forgotten_when_idle() {
        let mut pace = Pace::default();
        assert_eq!(pace.rate(seconds(1.0)), None);
        // Ten of cost 5 a second, on four threads.
        for i in 1..=600 {
            pace.completed(seconds(100.0 + 0.1 * f64::from(i)), 5.0, seconds(0.4));
            if i > 60 {
                let rate = pace.rate(seconds(100.0 + 0.1 * f64::from(i))).unwrap();
                assert!((rate / 50.0 - 1.0).abs() < 0.1, "{rate} after {i}");
            }
        }
        assert!(pace.rate(seconds(1e4)).is_none_or(|rate| rate < 1e-6));
    }

    #[test]
    fn only_what_takes_much_longer_than_usual_is_late() {
        let mut pace = Pace::default();
        assert!(!pace.is_late(1.0, seconds(1e6)), "nothing is known yet");
        for i in 0..50 {
            pace.completed(seconds(f64::from(i)), 10.0, seconds(20.0));
        }
        assert!(!pace.is_late(10.0, seconds(59.0)));
        assert!(pace.is_late(10.0, seconds(61.0)));
        assert!(!pace.is_late(0.01, seconds(1.9)), "two seconds are no time");
    }
}
