//! Compares what fits found with the truth: whether intervals hold it, errors, and widths, as numbers and as tables.
//!
//! Tests of coverage have media, set-ups and bounds as data and fit them in their own way; the comparison is the same.

use optics_model::Medium;
use optics_model::fit::{ChannelFit, Interval, MaterialFit, Refined, SceneEstimate, Z};
use serde_json::Value;

use crate::statistics::{Share, quantile};

/// Names of the quantities of a medium, in the order of all arrays.
pub const QUANTITIES: [&str; 5] = ["σ_t", "1 − α", "σ_s(1−g)", "σ_a", "1 − g"];
/// Names of interval and bound in JSON, and whether the quantity is 1 less the number there.
const FIELDS: [(&str, &str, bool); 5] = [
    ("sigma_t_interval", "sigma_t_per_mm", false),
    ("albedo_interval", "albedo", true),
    ("reduced_scattering_interval", "reduced_scattering_per_mm", false),
    ("absorption_interval", "absorption_per_mm", false),
    ("g_interval", "g", true),
];

fn quantities(m: &Medium) -> [f64; 5] {
    let (scattering, absorption) = (m.reduced_scattering_per_mm(), m.absorption_per_mm());
    [m.sigma_t_per_mm(), 1.0 - m.albedo(), scattering, absorption, 1.0 - m.g()]
}

/// An estimated number, with its 95 % interval and the truth.
#[derive(Debug, Clone, Copy)]
pub struct Estimate {
    pub truth: f64,
    pub found: f64,
    pub interval: Interval,
    /// Width of the Cramér–Rao bound; infinite if there is none.
    pub bound: f64,
}

impl Estimate {
    /// An estimate with its standard error.
    pub fn normal(found: f64, std_error: f64, truth: f64) -> Self {
        let (low, high) = (found - Z * std_error, found + Z * std_error);
        let interval = Interval { low, high, open_low: false, open_high: false };
        Self { truth, found, interval, bound: f64::INFINITY }
    }

    pub fn holds(&self) -> bool {
        self.interval.contains(self.truth)
    }

    /// Relative error, with its sign.
    pub fn error(&self) -> f64 {
        self.found / self.truth - 1.0
    }

    /// Half-width of the interval over the truth.
    pub fn half_width(&self) -> f64 {
        0.5 * (self.interval.high - self.interval.low) / self.truth.abs()
    }

    /// The error in half-widths of the interval, which are 1.96 standard errors.
    pub fn off(&self) -> f64 {
        (self.found - self.truth) / (0.5 * (self.interval.high - self.interval.low))
    }

    /// The interval's width over that of the bound; None if one of them is open.
    pub fn over_bound(&self) -> Option<f64> {
        let (i, ratio) = (&self.interval, (self.interval.high - self.interval.low) / self.bound);
        (!i.open_low && !i.open_high && ratio.is_finite() && self.bound.is_finite()).then_some(ratio)
    }

    fn ends(&self) -> [String; 2] {
        let Interval { low, high, open_low, open_high } = self.interval;
        [(low, open_low), (high, open_high)]
            .map(|(end, is_open)| if is_open { "open".to_owned() } else { significant(end, 4) })
    }
}

/// A quantity of the scene; its truth is NaN if there is none.
#[derive(Debug, Clone)]
pub struct SceneQuantity {
    pub name: String,
    pub slab_mm: Option<f64>,
    pub estimate: Estimate,
    /// Standard error, and over that of the prior.
    pub std_error: f64,
    pub share_of_prior: f64,
    pub at_end: bool,
    /// Whether it contradicts its prior.
    is_conflict: bool,
}

impl SceneQuantity {
    pub fn z(&self) -> f64 {
        Z * self.estimate.off()
    }
}

/// A medium as a fit found it.
#[derive(Debug, Clone)]
pub struct Answer {
    pub name: String,
    pub medium: [Estimate; 5],
    pub scene: Vec<SceneQuantity>,
    /// The fit in JSON: a `refined` of `farmctl/1`, or the channel of an ink.
    pub json: Value,
}

impl Answer {
    /// # Panics
    /// If the JSON has no medium.
    pub fn new(name: impl Into<String>, truth: &Medium, json: Value) -> Self {
        let name = name.into();
        let [sigma_t, albedo, g] = ["sigma_t_per_mm", "albedo", "g"]
            .map(|field| json[field].as_f64().unwrap_or_else(|| panic!("{name}: {field} in {json}")));
        let (truth, found) = (quantities(truth), quantities(&Medium::new(sigma_t, albedo, g).unwrap()));
        let medium = std::array::from_fn(|q| {
            let (interval, bound, is_complement) = FIELDS[q];
            let (ends, bound) = (&json[interval], &json["likelihood"]["bound"][bound]);
            let number = |of: &Value, end, otherwise| of[end].as_f64().unwrap_or(otherwise);
            let [low, high] = [number(ends, "low", f64::NEG_INFINITY), number(ends, "high", f64::INFINITY)];
            let [open_low, open_high] = ["open_low", "open_high"].map(|end| ends[end] == true);
            let interval = if is_complement {
                Interval { low: 1.0 - high, high: 1.0 - low, open_low: open_high, open_high: open_low }
            } else {
                Interval { low, high, open_low, open_high }
            };
            let bound = number(bound, "high", f64::INFINITY) - number(bound, "low", f64::NEG_INFINITY);
            Estimate { truth: truth[q], found: found[q], interval, bound }
        });
        Self { name, medium, scene: Vec::new(), json }
    }

    pub fn of_fit(name: impl Into<String>, truth: &Medium, found: &Refined) -> Self {
        Self::new(name, truth, serde_json::to_value(found).unwrap())
    }

    /// The answers for materials in their channels, whose true media are in the same order.
    ///
    /// # Panics
    /// If a channel was not refined.
    pub fn all<'a>(found: &[MaterialFit], truth: impl IntoIterator<Item = &'a Medium>) -> Vec<Self> {
        let channels = found.iter().flat_map(|m| m.channels.iter().map(|c| (&m.material, c)));
        let answer = |((material, c), medium): ((_, &ChannelFit), _)| {
            Self::of_fit(format!("{material} {}", c.channel), medium, c.refined.as_ref().unwrap())
        };
        channels.zip(truth).map(answer).collect()
    }

    /// The answer with the scene's quantities; `truth` returns that of a name, a slab and the mean of the prior.
    ///
    /// # Panics
    /// If the JSON has no quantities of the scene.
    #[must_use]
    pub fn with_scene(self, truth: impl Fn(&str, Option<f64>, f64) -> Option<f64>) -> Self {
        let quantity = |e: &Value| {
            let number = |field: &str| e[field].as_f64().unwrap();
            let (name, slab_mm) = (e["quantity"].as_str().unwrap().to_owned(), e["slab_mm"].as_f64());
            let [value, std_error, prior, of_prior] =
                ["value", "std_error", "prior", "prior_std_error"].map(number);
            let truth = truth(&name, slab_mm, prior).unwrap_or(f64::NAN);
            SceneQuantity {
                name,
                slab_mm,
                estimate: Estimate::normal(value, std_error, truth),
                std_error,
                share_of_prior: std_error / of_prior,
                at_end: e["at_end"] == true,
                is_conflict: (value - prior).abs() > SceneEstimate::CONFLICT * of_prior,
            }
        };
        let scene = self.json["likelihood"]["scene"].as_array().unwrap().iter().map(quantity).collect();
        Self { scene, ..self }
    }

    /// Whether a quantity of the scene contradicts its prior, or lies at the end of the responses.
    pub fn is_doubted(&self) -> bool {
        self.scene.iter().any(|q| q.is_conflict || q.at_end)
    }

    /// Probability that noise alone makes χ² as large.
    pub fn probability(&self) -> f64 {
        self.json["likelihood"]["probability"].as_f64().unwrap()
    }
}

/// Estimates by session: those of one session have common errors.
#[derive(Debug, Clone, Default)]
pub struct Coverage(pub Vec<Vec<Estimate>>);

impl Coverage {
    /// The estimates of some quantities of media.
    pub fn of_media<'a>(sessions: impl IntoIterator<Item = &'a [Answer]>, quantities: &[usize]) -> Self {
        let estimates = |a: &'a Answer| quantities.iter().map(|q| a.medium[*q]);
        Self(sessions.into_iter().map(|answers| answers.iter().flat_map(estimates).collect()).collect())
    }

    pub fn all(&self) -> impl Iterator<Item = &Estimate> {
        self.0.iter().flatten()
    }

    /// The share of intervals that hold, with the error that their correlation within sessions gives it.
    ///
    /// # Panics
    /// Without estimates.
    pub fn hold(&self) -> Share {
        let held = |session: &Vec<Estimate>| session.iter().map(Estimate::holds).collect();
        Share::of_groups(&self.0.iter().map(held).collect::<Vec<_>>()).unwrap()
    }

    /// The number of intervals that hold.
    pub fn count(&self) -> usize {
        self.all().filter(|e| e.holds()).count()
    }

    /// A quantile of the sizes of the relative errors.
    pub fn error(&self, share: f64) -> f64 {
        quantile(self.all().map(|e| e.error().abs()).collect(), share)
    }

    /// Geometric mean of the sizes of the relative errors.
    pub fn geometric_error(&self) -> f64 {
        let logarithms: f64 = self.all().map(|e| libm::log(e.error().abs().max(1e-6))).sum();
        libm::exp(logarithms / self.all().count() as f64)
    }

    pub fn median_half_width(&self) -> f64 {
        quantile(self.all().map(Estimate::half_width).collect(), 0.5)
    }

    /// Median ratio of the intervals' widths to those of the same media in another coverage.
    pub fn median_width_over(&self, other: &Self) -> f64 {
        let pairs = self.all().zip(other.all());
        quantile(pairs.map(|(a, b)| a.half_width() / b.half_width()).collect(), 0.5)
    }

    /// Intervals of 95 % hold in 93 to 97 %, within some standard errors of their share.
    ///
    /// # Panics
    /// If fewer or more of them hold.
    pub fn check(&self, what: &str, std_errors: f64) {
        let (hold, room) = (self.hold(), std_errors * self.hold().std_error);
        assert!((0.93 - room..=0.97 + room).contains(&hold.share), "{what}: {hold} % of the intervals hold");
    }
}

/// The quantities of the scene of all answers with this name, by session.
pub fn of_scene(sessions: &[Vec<Answer>], name: Option<&str>) -> Coverage {
    let estimates = |a: &Answer| -> Vec<Estimate> {
        let these = a.scene.iter().filter(|q| !q.estimate.truth.is_nan());
        these.filter(|q| name.is_none_or(|name| q.name == name)).map(|q| q.estimate).collect()
    };
    Coverage(sessions.iter().map(|answers| answers.iter().flat_map(estimates).collect()).collect())
}

/// Number of significant digits, without an exponent.
fn significant(value: f64, digits: i32) -> String {
    let places = digits - 1 - libm::log10(value.abs().max(1e-12)).floor() as i32;
    format!("{value:.*}", places.max(0) as usize)
}

/// Formats a table (Markdown) from the head and the cells of each row.
pub fn table(head: &str, rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let columns = head.split('|').count();
    let rows: String = rows.into_iter().map(|cells| format!("| {} |\n", cells.join(" | "))).collect();
    format!("| {head} |\n{}|\n{rows}", "|---".repeat(columns))
}

/// A row for some quantities of each medium: truth, estimate, interval, whether it holds, error in half-widths.
pub fn media_table<'a>(answers: impl IntoIterator<Item = &'a Answer>, quantities: &[usize]) -> String {
    let rows = answers.into_iter().flat_map(|a| {
        quantities.iter().map(|q| {
            let (e, mark) = (&a.medium[*q], if a.json["from_mixtures"] == true { "*" } else { "" });
            let unresolved = if a.json["resolved"] == true { "" } else { " (unresolved)" };
            let p = a.json["likelihood"]["probability"].as_f64().map_or(String::new(), |p| format!("{p:.3}"));
            let [truth, found] = [e.truth, e.found].map(|v| significant(v, 4));
            let holds = if e.holds() { "yes" } else { "no" };
            let cells = [
                format!("{}{mark}{unresolved}", a.name),
                QUANTITIES[*q].to_owned(),
                truth,
                found,
                e.ends().join(" … "),
                holds.to_owned(),
                format!("{:+.2}", e.off()),
                p,
            ];
            cells.to_vec()
        })
    });
    table("medium | quantity | truth | found | 95 % | holds | off | p(χ²)", rows)
}

/// A row for each quantity of the scene that is known.
pub fn scene_table(sessions: &[Vec<Answer>]) -> String {
    let known = || sessions.iter().flatten().flat_map(|a| &a.scene).filter(|q| !q.estimate.truth.is_nan());
    let mut names: Vec<&str> = known().map(|q| q.name.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let row = |name: &str| {
        let these: Vec<_> = known().filter(|q| q.name == name).collect();
        let square = these.iter().map(|q| q.z().powi(2)).sum::<f64>() / these.len() as f64;
        let gain = quantile(these.iter().map(|q| q.share_of_prior).collect(), 0.5);
        let ends = these.iter().filter(|q| q.at_end).count();
        let hold = of_scene(sessions, Some(name)).hold();
        let cells = [these.len().to_string(), hold.to_string(), format!("{:.2}", square.sqrt())];
        [&[name.to_owned()], &cells[..], &[format!("{gain:.2}"), ends.to_string()]].concat()
    };
    let head =
        "quantity of the scene | estimates | hold % | rms of z | median posterior over prior | at an end";
    table(head, names.into_iter().map(row))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// σ_t = 2, found as 2.1, with an interval of this half-width about it and a bound of 0.05.
    fn answer(half: f64) -> Answer {
        let about = |v: f64, half: f64| json!({"low": v - half, "high": v + half, "open_low": false, "open_high": false});
        let json = json!({
            "sigma_t_per_mm": 2.1, "albedo": 0.8, "g": 0.4,
            "sigma_t_interval": about(2.1, half), "albedo_interval": {"low": null, "high": 0.81, "open_low": true},
            "likelihood": {
                "probability": 0.3,
                "bound": {"sigma_t_per_mm": about(2.1, 0.05)},
                "scene": [
                    {"quantity": "gel thickness", "slab_mm": 0.5, "value": 0.04, "std_error": 0.01, "prior": 0.02,
                     "prior_std_error": 0.02, "at_end": half > 0.1},
                    {"quantity": "other", "value": 1.0, "std_error": 1.0, "prior": 9.0, "prior_std_error": 2.0},
                ],
            },
        });
        let truth = |name: &str, slab_mm, prior| {
            (name == "gel thickness" && slab_mm == Some(0.5)).then_some(prior + 0.01)
        };
        Answer::new("m", &Medium::new(2.0, 0.9, 0.4).unwrap(), json).with_scene(truth)
    }

    #[test]
    fn answers_are_compared_with_the_truth() {
        let a = answer(0.15);
        let [sigma_t, co_albedo, ..] = a.medium;
        assert!(sigma_t.holds() && !answer(0.05).medium[0].holds());
        assert!((sigma_t.error() - 0.05).abs() < 1e-12 && (sigma_t.half_width() - 0.075).abs() < 1e-12);
        assert!(
            (sigma_t.off() - 0.1 / 0.15).abs() < 1e-9 && (sigma_t.over_bound().unwrap() - 3.0).abs() < 1e-9
        );
        // The open end of α is that of 1 − α on the other side.
        assert!(!co_albedo.holds() && co_albedo.interval.open_high && !co_albedo.interval.open_low);
        assert!((co_albedo.interval.low - 0.19).abs() < 1e-12 && co_albedo.over_bound().is_none());
        let [gel, other] = [&a.scene[0], &a.scene[1]];
        assert!((gel.z() - 1.0).abs() < 1e-9 && gel.share_of_prior == 0.5 && gel.estimate.holds());
        assert!(gel.at_end && !gel.is_conflict && other.is_conflict && a.is_doubted());
    }

    #[test]
    fn coverage_counts_errors_by_session() {
        let sessions = [vec![answer(0.15), answer(0.05)], vec![answer(0.15)]];
        let found = Coverage::of_media(sessions.iter().map(Vec::as_slice), &[0]);
        assert_eq!((found.count(), found.hold().to_string()), (2, "66.7 ± 15.7".to_owned()));
        assert!((found.error(0.5) - 0.05).abs() < 1e-9 && (found.geometric_error() - 0.05).abs() < 1e-9);
        let narrow = Coverage::of_media([&[answer(0.05), answer(0.05), answer(0.05)][..]], &[0]);
        assert!((found.median_width_over(&narrow) - 3.0).abs() < 1e-9);
        assert_eq!((of_scene(&sessions, None).all().count(), narrow.count()), (3, 0));
        let check = |found: &Coverage, room| std::panic::catch_unwind(|| found.check("σ_t", room)).is_ok();
        assert!(check(&found, 2.0) && !check(&found, 1.0) && !check(&narrow, 3.0));
    }

    #[test]
    fn tables_have_a_row_for_each_quantity() {
        let text = media_table(&[answer(0.15)], &[0, 1]);
        assert!(
            text.contains("| m (unresolved) | σ_t | 2.000 | 2.100 | 1.950 … 2.250 | yes | +0.67 | 0.300 |"),
            "{text}"
        );
        assert!(text.contains("| 0.1900 … open | no |"), "{text}");
        let text = scene_table(&[vec![answer(0.15), answer(0.05)]]);
        assert_eq!(text.lines().last().unwrap(), "| gel thickness | 2 | 100.0 ± 0.0 | 1.00 | 0.50 | 1 |");
    }
}
