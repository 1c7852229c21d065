//! Compares two measurements of resins by their intervals and their covariance.

use anyhow::{Result, bail};
use farm_figures::numbers::{minus, significant};
use farm_lab::media_file::{MediaChannel, MediaFile, MediaInterval, MediaMaterial};
use optics_model::fit::Z;
use serde::Serialize;

/// Differences of two materials in one channel.
#[derive(Debug, Serialize)]
pub(crate) struct ComparedChannel {
    pub(crate) material: String,
    pub(crate) channel: String,
    pub(crate) quantities: Vec<ComparedQuantity>,
    /// Probability that the media differ as much by chance, with the covariances of both; null without covariance.
    probability: Option<f64>,
}

#[derive(Debug, Serialize)]
pub(crate) struct ComparedQuantity {
    pub(crate) quantity: &'static str,
    pub(crate) a: f64,
    pub(crate) b: f64,
    /// Difference over the root of the sum of squares of the half-widths; null where an interval is open.
    pub(crate) e_n: Option<f64>,
    /// Weighted mean and its 95 % half-width, which grows with the disagreement.
    pooled: Option<[f64; 2]>,
}

/// The materials of two measurements.
#[derive(Debug, Default, Serialize)]
pub(crate) struct Comparison {
    pub(crate) channels: Vec<ComparedChannel>,
    /// Materials of one file only.
    pub(crate) unmatched: Vec<String>,
    /// Both are of the same profiles, so that a mean of both would count them twice.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub(crate) same_profiles: bool,
}

/// Probability that any of the media that agree is called different; each has its share of it (Bonferroni).
const CHANCE: f64 = 0.05;

impl ComparedQuantity {
    /// Texts of A, B, E_n, the pooled value and its interval.
    pub(crate) fn texts(&self) -> [String; 5] {
        let number = |value: f64| significant(value, 4);
        let pooled = self.pooled.map_or_else(
            || ["–".to_owned(), "–".to_owned()],
            |[v, h]| [number(v), format!("± {}", significant(h, 2))],
        );
        let [value, interval] = pooled;
        let e_n = self.e_n.map_or_else(|| "–".to_owned(), |e| minus(&format!("{e:.2}")));
        [number(self.a), number(self.b), e_n, value, interval]
    }

    /// Whether the difference exceeds the uncertainties of both.
    pub(crate) fn differs(&self) -> bool {
        self.e_n.is_some_and(|e| e.abs() >= 1.0)
    }
}

impl Comparison {
    /// The comparison of two answers about the same profiles: without pooled values.
    pub(crate) fn of_same_profiles(mut self) -> Self {
        self.same_profiles = true;
        self.channels.iter_mut().flat_map(|c| &mut c.quantities).for_each(|q| q.pooled = None);
        self
    }

    /// Whether the media differ, in words.
    pub(crate) fn conclusion(&self) -> String {
        let known: Vec<(&ComparedChannel, f64)> =
            self.channels.iter().filter_map(|c| Some((c, c.probability?))).collect();
        let differ: Vec<String> = known
            .iter()
            .filter(|(_, p)| *p < CHANCE / known.len() as f64)
            .map(|(c, p)| format!("{} {} (p {})", c.material, c.channel, significant(*p, 2)))
            .collect();
        if self.same_profiles {
            return "both are of the same profiles: their differences are those of the options, and nothing is \
                                        pooled"
                .to_owned();
        }
        match (known.len(), differ.len()) {
            (0, _) => "without covariances E_n alone counts".to_owned(),
            (n, 0) => format!("no difference: all {n} media with a covariance agree within it"),
            _ => format!("different media, with the covariances of both: {}", differ.join(", ")),
        }
    }
}

/// Materials of the same name; those of two files with one material each, whatever their names are.
pub(crate) fn compared(a: &MediaFile, b: &MediaFile) -> Result<Comparison> {
    let pairs: Vec<(&MediaMaterial, &MediaMaterial)> = match (&a.materials[..], &b.materials[..]) {
        ([one], [other]) => vec![(one, other)],
        (all, _) => all.iter().filter_map(|one| Some((one, b.material(&one.material).ok()?))).collect(),
    };
    let is_matched =
        |name: &str| pairs.iter().any(|(one, other)| one.material == name || other.material == name);
    let names = a.materials.iter().chain(&b.materials).map(|m| m.material.clone());
    let channels: Vec<ComparedChannel> = pairs
        .iter()
        .flat_map(|(one, other)| {
            let both = |c: &MediaChannel| Some(channel(&one.material, c, other.channel(&c.channel)?));
            one.channels.iter().filter_map(both).collect::<Vec<_>>()
        })
        .collect();
    if channels.is_empty() {
        bail!("the files have no material with a common channel");
    }
    let is_compared = |name: &str| channels.iter().any(|c| c.material == name);
    let lacking = pairs.iter().filter(|(one, _)| !is_compared(&one.material));
    let unmatched =
        names.filter(|name| !is_matched(name)).chain(lacking.map(|(one, _)| one.material.clone())).collect();
    // Two measurements are never equal in every number.
    let same_profiles = channels.iter().flat_map(|c| &c.quantities).all(|q| q.a.to_bits() == q.b.to_bits());
    let found = Comparison { channels, unmatched, same_profiles: false };
    Ok(if same_profiles { found.of_same_profiles() } else { found })
}

/// The quantities that similar media share: σ_s(1 − g) and σ_a.
pub(crate) fn invariants(a: &MediaChannel, b: &MediaChannel) -> [ComparedQuantity; 2] {
    let scattering = |c: &MediaChannel| c.sigma_t_per_mm * c.albedo * (1.0 - c.g);
    let absorption = |c: &MediaChannel| c.sigma_t_per_mm * (1.0 - c.albedo);
    [
        quantity(
            "σ_s(1−g)",
            [scattering(a), scattering(b)],
            [a.reduced_scattering_interval, b.reduced_scattering_interval],
        ),
        quantity("σ_a", [absorption(a), absorption(b)], [a.absorption_interval, b.absorption_interval]),
    ]
}

fn channel(material: &str, a: &MediaChannel, b: &MediaChannel) -> ComparedChannel {
    let mut quantities: Vec<ComparedQuantity> = invariants(a, b).into();
    quantities.extend([
        quantity("σ_t", [a.sigma_t_per_mm, b.sigma_t_per_mm], [a.sigma_t_interval, b.sigma_t_interval]),
        quantity("α", [a.albedo, b.albedo], [a.albedo_interval, b.albedo_interval]),
        quantity("g", [a.g, b.g], [a.g_interval, b.g_interval]),
    ]);
    let (material, channel) = (material.to_owned(), a.channel.clone());
    ComparedChannel { material, channel, quantities, probability: probability(a, b) }
}

fn quantity(name: &'static str, [a, b]: [f64; 2], intervals: [MediaInterval; 2]) -> ComparedQuantity {
    let half = |i: &MediaInterval| Some(0.5 * (i.high? - i.low?)).filter(|half| *half > 0.0);
    let halves = half(&intervals[0]).zip(half(&intervals[1]));
    let e_n = halves.map(|(u, v)| (a - b) / libm::hypot(u, v));
    let pooled = halves.map(|(u, v)| {
        let [p, q] = [u.powi(-2), v.powi(-2)];
        let mean = (p * a + q * b) / (p + q);
        // The ratio of Birge: the root of χ² of the mean, which is that of the difference.
        let birge = (Z * (a - b) / libm::hypot(u, v)).abs().max(1.0);
        [mean, birge / (p + q).sqrt()]
    });
    ComparedQuantity { quantity: name, a, b, e_n, pooled }
}

/// χ² of the difference in (ln σ_t, √(1 − α), ln(1 − g)) with the sum of the covariances, in the directions in which it is
/// not 0: media along a valley are near each other.
fn probability(a: &MediaChannel, b: &MediaChannel) -> Option<f64> {
    let at = |c: &MediaChannel| [libm::log(c.sigma_t_per_mm), (1.0 - c.albedo).sqrt(), libm::log(1.0 - c.g)];
    let difference: [f64; 3] = std::array::from_fn(|i| at(a)[i] - at(b)[i]);
    let sum = |i: usize, j: usize| a.covariance[i][j] + b.covariance[i][j];
    let (chi2, degrees) = optics_layers::chi2(&difference, sum)?;
    Some(exceedance(chi2, degrees))
}

/// Probability that χ² of one, two or three degrees of freedom is as large.
fn exceedance(chi2: f64, degrees: usize) -> f64 {
    let tail = libm::erfc((0.5 * chi2).sqrt());
    match degrees {
        1 => tail,
        2 => libm::exp(-0.5 * chi2),
        _ => tail + (2.0 * chi2 / std::f64::consts::PI).sqrt() * libm::exp(-0.5 * chi2),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn medium(sigma_t: f64, albedo: f64, sd: f64) -> MediaChannel {
        let interval = |value: f64| json!({"low": value * (1.0 - Z * sd), "high": value * (1.0 + Z * sd)});
        serde_json::from_value(json!({
            "channel": "R", "sigma_t_per_mm": sigma_t, "albedo": albedo, "g": 0.4, "sample_ior": 1.53,
            "covariance": [[sd * sd, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], "resolved": true, "misfit": 1.0,
            "sigma_t_interval": interval(sigma_t), "albedo_interval": {"low": albedo, "high": albedo},
            "g_interval": {"low": null, "high": 0.5},
            "reduced_scattering_interval": interval(0.6 * sigma_t * albedo),
            "absorption_interval": interval(sigma_t * (1.0 - albedo)),
        }))
        .unwrap()
    }

    /// One of twenty media that agree has a probability below 5 %: that is no difference.
    #[test]
    fn chance_is_shared_by_all_channels() {
        let with = |least: f64| {
            let channel = |i: u32| ComparedChannel {
                material: "white".to_owned(),
                channel: i.to_string(),
                quantities: Vec::new(),
                probability: Some(if i == 0 { least } else { 0.5 }),
            };
            let channels = (0..20).map(channel).collect();
            Comparison { channels, ..Comparison::default() }.conclusion()
        };
        assert!(with(0.03).contains("no difference: all 20 media"), "{}", with(0.03));
        assert!(with(0.002).contains("different media"), "{}", with(0.002));
    }

    /// 3 % apart with standard errors of 1 %: E_n = 3/(1.96 √2), p = erfc(3/2), and the mean has the error of their
    /// disagreement.
    #[test]
    fn differences_are_counted_in_uncertainties() {
        let found = channel("white", &medium(6.0 * libm::exp(0.03_f64), 0.9, 0.01), &medium(6.0, 0.9, 0.01));
        assert!((found.probability.unwrap() - libm::erfc(1.5)).abs() < 1e-9, "{found:?}");
        let named_quantity = |name: &str| found.quantities.iter().find(|q| q.quantity == name).unwrap();
        let sigma_t = named_quantity("σ_t");
        assert!((sigma_t.e_n.unwrap() - 3.0 / (Z * 2_f64.sqrt())).abs() < 0.01, "{sigma_t:?}");
        let [mean, half] = sigma_t.pooled.unwrap();
        assert!((mean / 6.09 - 1.0).abs() < 2e-3, "{sigma_t:?}");
        assert!((half / (6.0 * Z * 0.01 * 1.5) - 1.0).abs() < 0.03, "{sigma_t:?}");
        assert_eq!((named_quantity("α").e_n, named_quantity("g").e_n), (None, None), "held, and open");
    }

    /// Quantiles of χ²: 5 % of 3.841, 5.991 and 7.815.
    #[test]
    fn exceedances_match_tables() {
        for (chi2, degrees) in [(3.841_459, 1), (5.991_465, 2), (7.814_728, 3)] {
            assert!((exceedance(chi2, degrees) - 0.05).abs() < 1e-6);
        }
    }
}
