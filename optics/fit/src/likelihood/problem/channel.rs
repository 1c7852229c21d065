//! Finds the lowest minimum of one channel.

use crate::likelihood::problem::ChannelData;
use crate::likelihood::problem::assembly::{Assembly, Sharing, assemble};
use crate::likelihood::problem::start::{Scan, Start};
use crate::likelihood::system::COARSE;
use crate::likelihood::system::{State, System};
use crate::surrogate::Surrogate;

/// A start in the basis is followed if its cost is at most this much above the lowest, or at most this multiple of it.
const FOLLOWED: (f64, f64) = (60.0, 1.3);
/// Maximum number of starts that are followed.
const STARTS: usize = 3;

/// Starts of a channel that are worth following.
pub(crate) fn starts(scan: &Scan, surrogates: &[Surrogate]) -> Vec<Start> {
    let mut starts = scan.starts(surrogates, 1.0);
    let lowest = starts.first().map_or(0.0, |s| s.cost);
    starts.retain(|s| s.cost <= lowest + FOLLOWED.0 || s.cost <= FOLLOWED.1 * lowest);
    starts.truncate(STARTS);
    starts
}

/// The system of a channel by itself at the lowest of its minima.
pub(crate) struct ChannelMinimum<'a> {
    pub system: System<'a>,
    pub state: State,
    pub sample_ior: f64,
}

/// The lowest of the minima below some starts, without the noise of the records.
pub(crate) fn lowest<'a>(
    data: &ChannelData,
    surrogates: &'a [Surrogate<'a>],
    starts: &[Start],
) -> ChannelMinimum<'a> {
    let follow = |start: &Start| {
        let one = std::slice::from_ref(data);
        let (Assembly { mut system, .. }, state) =
            assemble(one, &[&surrogates[start.ior]], &[start.medium], 0.0, Sharing::default());
        let state = system.approach(state, COARSE);
        ChannelMinimum { system, state, sample_ior: data.dictionary.grid().sample_ior()[start.ior] }
    };
    let followed = starts.iter().map(follow);
    followed.min_by(|a, b| a.state.cost.total_cmp(&b.state.cost)).expect("a dictionary has a lowest medium")
}

/// The lowest minimum of a channel by itself.
pub(crate) fn minimum<'a>(
    data: &ChannelData,
    surrogates: &'a [Surrogate<'a>],
    scan: &Scan,
) -> ChannelMinimum<'a> {
    let ChannelMinimum { mut system, state, sample_ior } =
        lowest(data, surrogates, &starts(scan, surrogates));
    let state = system.settle(state);
    ChannelMinimum { system, state, sample_ior }
}
