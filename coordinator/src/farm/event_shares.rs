//! Limits the events that one actor can cause: the oldest are deleted for the newest, so no actor must be able to write
//! all of them.

use std::collections::HashMap;
use std::time::Duration;

/// Events of one actor that are kept if they come at once.
const AT_ONCE: f64 = 1000.0;
/// Events of one actor that are kept per second after that: a tenth of all that are kept in nearly three hours.
const IN_A_SECOND: f64 = 1.0;
/// Number of actors from which on those with a full share are dropped: there may be as many as there are addresses.
const ACTORS: usize = 10_000;

/// The remaining shares of the actors.
#[derive(Debug, Default)]
pub(super) struct EventShares(HashMap<String, Share>);

#[derive(Debug)]
struct Share {
    left: f64,
    at: Duration,
}

impl Share {
    fn left(&self, now: Duration) -> f64 {
        (self.left + IN_A_SECOND * now.saturating_sub(self.at).as_secs_f64()).min(AT_ONCE)
    }
}

impl EventShares {
    /// Whether one more event of an actor is kept.
    pub fn take(&mut self, actor: &str, now: Duration) -> bool {
        if self.0.len() >= ACTORS {
            self.0.retain(|_, share| share.left(now) < AT_ONCE);
        }
        let full = Share { left: AT_ONCE, at: now };
        let share = self.0.entry(actor.to_owned()).or_insert(full);
        let left = share.left(now);
        let is_kept = left >= 1.0;
        *share = Share { left: if is_kept { left - 1.0 } else { left }, at: now };
        is_kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One actor cannot use up the events of others.
    #[test]
    fn one_actor_leaves_events_for_others() {
        let mut shares = EventShares::default();
        let start = Duration::from_secs(100);
        let kept = |shares: &mut EventShares, actor: &str, now| {
            (0..100_000).filter(|_| shares.take(actor, now)).count()
        };
        assert_eq!(kept(&mut shares, "mallory", start), AT_ONCE as usize);
        assert!(shares.take("alice", start));
        assert_eq!(kept(&mut shares, "mallory", start + Duration::from_mins(1)), 60);
        assert_eq!(kept(&mut shares, "mallory", start + Duration::from_hours(24)), AT_ONCE as usize);
    }

    /// Actors are dropped once their share of events is full again.
    #[test]
    fn actors_with_a_full_share_are_dropped() {
        let mut shares = EventShares::default();
        for actor in 0..ACTORS {
            shares.take(&actor.to_string(), Duration::ZERO);
        }
        shares.take("one more", Duration::from_mins(1));
        assert_eq!(shares.0.len(), 1);
    }
}
