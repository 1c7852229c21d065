//! The answer of `farmctl measure` for a medium, compared with the truth.

use optics_model::Medium;
use optics_model::fit::Interval;
use serde_json::Value;

/// Names of the quantities, in the order of all arrays below.
pub(super) const QUANTITIES: [&str; 4] = ["σ_t", "1 − α", "σ_s(1−g)", "σ_a"];

/// A channel's medium.
#[derive(Debug)]
pub(super) struct Answer {
    name: String,
    truth: [f64; 4],
    found: [f64; 4],
    intervals: [Interval; 4],
    resolved: bool,
    /// Probability that noise alone makes χ² as large.
    probability: f64,
}

impl Answer {
    /// Reads the JSON of a channel.
    pub(super) fn new(name: String, medium: &Medium, channel: &Value) -> Self {
        let refined = &channel["refined"];
        let number = |value: &Value| value.as_f64().unwrap_or_else(|| panic!("{name}: {channel}"));
        let end = |value: &Value, otherwise| value.as_f64().unwrap_or(otherwise);
        let interval = |field: &str| {
            let ends = &refined[field];
            Interval {
                low: end(&ends["low"], f64::NEG_INFINITY),
                high: end(&ends["high"], f64::INFINITY),
                open_low: ends["open_low"].as_bool().unwrap(),
                open_high: ends["open_high"].as_bool().unwrap(),
            }
        };
        let [sigma_t, albedo, g] = ["sigma_t_per_mm", "albedo", "g"].map(|field| number(&refined[field]));
        let a = interval("albedo_interval");
        Self {
            truth: quantities(medium),
            found: quantities(&Medium::new(sigma_t, albedo, g).unwrap()),
            intervals: [
                interval("sigma_t_interval"),
                Interval {
                    low: 1.0 - a.high,
                    high: 1.0 - a.low,
                    open_low: a.open_high,
                    open_high: a.open_low,
                },
                interval("reduced_scattering_interval"),
                interval("absorption_interval"),
            ],
            resolved: refined["resolved"].as_bool().unwrap(),
            probability: number(&refined["likelihood"]["probability"]),
            name,
        }
    }

    /// Relative error, with its sign.
    pub(super) fn error(&self, quantity: usize) -> f64 {
        self.found[quantity] / self.truth[quantity] - 1.0
    }

    pub(super) fn holds(&self, quantity: usize) -> bool {
        self.intervals[quantity].contains(self.truth[quantity])
    }

    /// The error in half-widths of the interval, which are 1.96 standard errors.
    pub(super) fn off(&self, quantity: usize) -> f64 {
        let i = &self.intervals[quantity];
        (self.found[quantity] - self.truth[quantity]) / (0.5 * (i.high - i.low))
    }
}

fn quantities(m: &Medium) -> [f64; 4] {
    [m.sigma_t_per_mm(), 1.0 - m.albedo(), m.reduced_scattering_per_mm(), m.absorption_per_mm()]
}

/// Formats one row per medium (Markdown).
pub(super) fn table(answers: &[Answer]) -> String {
    let mut text =
        "| medium | σ_t truth | found | 95 % | holds | off | 1 − α truth | found | 95 % | holds | off \
                    | p(χ²) |\n|---|---|---|---|---|---|---|---|---|---|---|---|\n"
            .to_owned();
    for a in answers {
        text += &format!("| {}{} ", a.name, if a.resolved { "" } else { " (unresolved)" });
        for (q, digits) in [(0, 4), (1, 3)] {
            let i = &a.intervals[q];
            let [truth, found, low, high] =
                [a.truth[q], a.found[q], i.low, i.high].map(|v| significant(v, digits));
            let low = if i.open_low { "open".to_owned() } else { low };
            let high = if i.open_high { "open".to_owned() } else { high };
            let holds = if a.holds(q) { "yes" } else { "no" };
            text += &format!("| {truth} | {found} | {low} … {high} | {holds} | {:+.2} ", a.off(q));
        }
        text += &format!("| {:.3} |\n", a.probability);
    }
    text
}

fn significant(value: f64, digits: i32) -> String {
    let places = digits - 1 - value.abs().log10().floor() as i32;
    format!("{value:.*}", places.max(0) as usize)
}
