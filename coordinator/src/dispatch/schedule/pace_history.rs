//! Records the work that was done in the last hour, period by period.

use std::time::Duration;

/// Length of a period.
pub const PERIOD: Duration = Duration::from_secs(10);
/// Periods that are kept: an hour, and the one that is not over.
const KEPT: usize = 361;

/// The work that was finished in a period.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Period {
    pub jobs: u32,
    /// Expected scatterings of the finished parts.
    pub cost: f64,
}

/// The periods of the last hour, but none from before the start.
#[derive(Debug, Default)]
pub(super) struct PaceHistory {
    /// The last period contains the time of the last completion.
    periods: Vec<Period>,
    /// Number of the last period, from the start.
    last: u64,
}

impl PaceHistory {
    /// Records that a part of this cost was finished.
    pub fn part_done(&mut self, now: Duration, cost: f64) {
        self.at(now).cost += cost;
    }

    /// Records that a whole job was finished.
    pub fn job_done(&mut self, now: Duration) {
        self.at(now).jobs += 1;
    }

    /// The periods up to now, the oldest first; the last is not over.
    pub fn periods(&self, now: Duration) -> Vec<Period> {
        let since = number(now).saturating_sub(self.last);
        let quiet = if self.periods.is_empty() { number(now) + 1 } else { since };
        let quiet = std::iter::repeat_n(Period::default(), quiet.min(KEPT as u64) as usize);
        let all: Vec<Period> = self.periods.iter().copied().chain(quiet).collect();
        all[all.len().saturating_sub(KEPT)..].to_vec()
    }

    fn at(&mut self, now: Duration) -> &mut Period {
        if self.periods.is_empty() || number(now) > self.last {
            self.periods = self.periods(now);
            self.last = number(now);
        }
        self.periods.last_mut().expect("the present period is there")
    }
}

fn number(now: Duration) -> u64 {
    now.as_secs() / PERIOD.as_secs()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(s: u64) -> Duration {
        Duration::from_secs(s)
    }

    /// Periods are contiguous from the start of the history.
    #[test]
    fn periods_are_contiguous_from_the_start() {
        let mut history = PaceHistory::default();
        assert_eq!(history.periods(seconds(0)).len(), 1);
        assert_eq!(history.periods(seconds(25)).len(), 3);
        history.part_done(seconds(25), 2.0);
        history.part_done(seconds(29), 3.0);
        history.job_done(seconds(29));
        history.part_done(seconds(41), 4.0);
        let costs: Vec<f64> = history.periods(seconds(59)).iter().map(|p| p.cost).collect();
        assert_eq!(costs, [0.0, 0.0, 5.0, 0.0, 4.0, 0.0]);
        assert_eq!(history.periods(seconds(59))[2].jobs, 1);
    }

    /// The history of the pace covers one hour; older periods are dropped.
    #[test]
    fn pace_history_covers_one_hour() {
        let mut history = PaceHistory::default();
        history.part_done(seconds(0), 1.0);
        history.part_done(seconds(3600), 2.0);
        assert_eq!(history.periods(seconds(3600)).first().map(|p| p.cost), Some(1.0));
        let later = history.periods(seconds(3610));
        assert_eq!((later.len(), later[0].cost, later[KEPT - 2].cost), (KEPT, 0.0, 2.0));
        assert!(history.periods(seconds(1_000_000)).iter().all(|p| p.cost == 0.0));
        // Times that run backwards cost nothing.
        history.part_done(seconds(3000), 1.0);
        assert_eq!(history.periods(seconds(3600)).last().map(|p| p.cost), Some(3.0));
    }
}
