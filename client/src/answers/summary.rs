//! A medium's numbers with their intervals, as tables and the page show them.

use farm_figures::numbers::{albedo, albedo_end, interval, significant};
use optics_model::Medium;
use optics_model::fit::{InkChannel, Interval, Refined};
use serde::Serialize;

/// A number with its meaningful digits, and its interval of 95 %.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct NumberWithInterval {
    pub(crate) value: String,
    pub(crate) interval: String,
}

/// The numbers of a medium.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct ChannelSummary {
    pub(crate) reduced_scattering_per_mm: NumberWithInterval,
    pub(crate) absorption_per_mm: NumberWithInterval,
    pub(crate) sigma_t_per_mm: NumberWithInterval,
    pub(crate) albedo: NumberWithInterval,
    pub(crate) g: NumberWithInterval,
    /// Empty for an ink from mixtures.
    pub(crate) misfit: String,
    is_resolved: bool,
}

impl ChannelSummary {
    /// Columns of [`Self::shared_cells`].
    pub(super) const SHARED: &'static str = ">σ_s(1−g)\n/mm | \n95 % | >σ_a\n/mm | \n95 %";
    /// Columns of [`Self::medium_cells`].
    pub(super) const MEDIUM: &'static str = ">σ_t\n/mm | \n95 % | >α | \n95 % | >g | \n95 %";

    pub(crate) fn of(r: &Refined) -> Self {
        Self { misfit: significant(r.misfit, 2), ..Self::new(quantities(r), 2, r.resolved) }
    }

    /// Inks may absorb much, so that their absorption is known well.
    pub(super) fn ink(c: &InkChannel) -> Self {
        let intervals = [c.reduced_scattering_per_mm, c.absorption_per_mm, c.sigma_t_per_mm, c.albedo, c.g];
        Self::new(with_intervals(&c.medium, intervals), 3, c.resolved)
    }

    fn new(quantities: [Estimated; 5], absorption_digits: i32, is_resolved: bool) -> Self {
        let number = |(value, ends): Estimated, digits: i32, end_digits: i32| NumberWithInterval {
            value: significant(value, digits),
            interval: interval(&ends, |end| significant(end, end_digits)),
        };
        let [reduced_scattering, absorption, sigma_t, (albedo_value, albedo_ends), g] = quantities;
        Self {
            reduced_scattering_per_mm: number(reduced_scattering, 3, 3),
            absorption_per_mm: number(absorption, absorption_digits, absorption_digits),
            sigma_t_per_mm: number(sigma_t, 3, 3),
            albedo: NumberWithInterval {
                value: albedo(albedo_value),
                interval: interval(&albedo_ends, albedo_end),
            },
            g: number(g, 3, 2),
            misfit: String::new(),
            is_resolved,
        }
    }

    /// The quantities that similar media share.
    pub(super) fn shared_cells(self) -> Vec<String> {
        let numbers = [self.reduced_scattering_per_mm, self.absorption_per_mm];
        numbers.into_iter().flat_map(|n| [n.value, n.interval]).collect()
    }

    /// The medium, in brackets where it is not determined.
    pub(super) fn medium_cells(self) -> Vec<String> {
        let mark = |n: NumberWithInterval| {
            let value = if self.is_resolved { n.value } else { format!("({})", n.value) };
            [value, n.interval]
        };
        let cells = [mark(self.sigma_t_per_mm), mark(self.albedo), [self.g.value, self.g.interval]];
        cells.into_iter().flatten().collect()
    }
}

/// A value and its interval of 95 %.
pub(super) type Estimated = (f64, Interval);

/// σ_s(1 − g), σ_a, σ_t, α and g.
pub(super) fn quantities(r: &Refined) -> [Estimated; 5] {
    let intervals = [r.reduced_scattering_per_mm, r.absorption_per_mm, r.sigma_t_per_mm, r.albedo, r.g];
    with_intervals(&r.best.medium, intervals)
}

fn with_intervals(
    m: &Medium,
    [reduced_scattering, absorption, sigma_t, albedo, g]: [Interval; 5],
) -> [Estimated; 5] {
    [
        (m.reduced_scattering_per_mm(), reduced_scattering),
        (m.absorption_per_mm(), absorption),
        (m.sigma_t_per_mm(), sigma_t),
        (m.albedo(), albedo),
        (m.g(), g),
    ]
}
