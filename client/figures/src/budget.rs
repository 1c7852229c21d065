//! The error budget of the intervals of σ_t as text: the share of the variance that each source of error makes, and which
//! source to improve.

use optics_model::fit::{ErrorSource, MaterialFit, Refined, SourceShare};
use serde::Serialize;

use crate::numbers::{interval, significant};

/// Shares below this are listed together.
const LEAST: f64 = 0.02;

/// Error budgets of the channels whose medium the data determine, at least with g held.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ErrorBudget {
    pub channels: Vec<ChannelBudget>,
    /// The source with the largest share, and the remedy.
    pub first: String,
}

/// The error budget of one channel's σ_t.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelBudget {
    /// Material and channel, as `white R`.
    pub about: String,
    /// Interval of 95 % of σ_t with its unit.
    pub sigma_t: String,
    /// `g 80 %, thickness 12 %, rest 8 %`.
    pub shares: String,
    /// The sources with large shares of the variance, the largest first.
    pub parts: Vec<(String, f64)>,
}

/// The error budget of all fits; `None` if no channel has one.
pub fn error_budget(fits: &[MaterialFit]) -> Option<ErrorBudget> {
    let channels = fits.iter().flat_map(|fit| fit.channels.iter().map(|c| (&fit.material, c)));
    let with_budget: Vec<(String, &Refined)> = channels
        .filter_map(|(material, channel)| {
            let refined = channel.refined.as_ref().filter(|r| r.resolved_at_g)?;
            let has_budget = !refined.likelihood.budget.is_empty();
            has_budget.then(|| (format!("{material} {}", channel.channel), refined))
        })
        .collect();
    let budgets: Vec<&[SourceShare]> = with_budget.iter().map(|(_, r)| &r.likelihood.budget[..]).collect();
    let (first, share) = largest(&budgets)?;
    let channel = |(about, refined): (String, &Refined)| ChannelBudget {
        about,
        sigma_t: format!("{} / mm", interval(&refined.sigma_t_per_mm, |v| significant(v, 3))),
        shares: shares(&refined.likelihood.budget),
        parts: large(&refined.likelihood.budget)
            .into_iter()
            .map(|s| (source_name(s).to_owned(), s.sigma_t))
            .collect(),
    };
    Some(ErrorBudget {
        first: improvement(first, share, &with_budget),
        channels: with_budget.into_iter().map(channel).collect(),
    })
}

/// The half-width of σ_t with and without the source, in per cent, as the median of the channels; only the source where all
/// are open.
fn improvement(first: &SourceShare, share: f64, with_budget: &[(String, &Refined)]) -> String {
    let (name, remedy) = (source_name(first), remedy(first.source));
    let half_percent = |r: &Refined| {
        let ends = &r.sigma_t_per_mm;
        let is_closed = !ends.open_low && !ends.open_high;
        is_closed.then(|| 50.0 * (ends.high - ends.low) / r.best.medium.sigma_t_per_mm())
    };
    let mut halves: Vec<f64> = with_budget.iter().filter_map(|(_, r)| half_percent(r)).collect();
    halves.sort_by(f64::total_cmp);
    let Some(half) = halves.get(halves.len() / 2) else {
        return format!("{name} leaves σ_t open: {remedy}");
    };
    let without = half * (1.0 - share).max(0.0).sqrt();
    let [without, half] = [without, *half].map(|percent| significant(percent, 2));
    format!("without the error of {name}, σ_t would be ± {without} %, not ± {half} %: {remedy}")
}

/// Sources with large shares, the largest first.
fn large(budget: &[SourceShare]) -> Vec<&SourceShare> {
    let mut large: Vec<&SourceShare> = budget.iter().filter(|s| s.sigma_t >= LEAST).collect();
    large.sort_by(|a, b| b.sigma_t.total_cmp(&a.sigma_t));
    large
}

/// `g 80 %, thickness 12 %, rest 8 %`.
fn shares(budget: &[SourceShare]) -> String {
    let large = large(budget);
    // Rounded to neighbouring whole numbers that add up to 100: the largest remainders are rounded up.
    let rest = 1.0 - large.iter().map(|s| s.sigma_t).sum::<f64>();
    let named = large.iter().map(|s| (source_name(s), s.sigma_t)).chain([("rest", rest.max(0.0))]);
    let named: Vec<(&str, f64)> = named.map(|(name, share)| (name, 100.0 * share)).collect();
    let mut whole: Vec<f64> = named.iter().map(|(_, percent)| percent.floor()).collect();
    let mut by_remainder: Vec<usize> = (0..named.len()).collect();
    by_remainder.sort_by(|a, b| named[*b].1.fract().total_cmp(&named[*a].1.fract()));
    let missing = (100.0 - whole.iter().sum::<f64>()).clamp(0.0, named.len() as f64) as usize;
    by_remainder.into_iter().take(missing).for_each(|i| whole[i] += 1.0);
    let shown = named.iter().zip(&whole).filter(|(_, percent)| **percent > 0.0);
    shown.map(|((name, _), percent)| format!("{name} {percent:.0} %")).collect::<Vec<_>>().join(", ")
}

/// The source with the largest share of σ_t's variance, over all channels.
fn largest<'a>(budgets: &[&'a [SourceShare]]) -> Option<(&'a SourceShare, f64)> {
    let mut mean: Vec<(&SourceShare, f64)> = Vec::new();
    for share in budgets.iter().copied().flatten() {
        let part = share.sigma_t / budgets.len() as f64;
        match mean.iter_mut().find(|(other, _)| source_name(other) == source_name(share)) {
            Some((_, sum)) => *sum += part,
            None => mean.push((share, part)),
        }
    }
    mean.into_iter().max_by(|a, b| a.1.total_cmp(&b.1))
}

/// Name of a source, as in tables.
pub fn source_name(share: &SourceShare) -> &str {
    match share.source {
        ErrorSource::Scene => share.quantity.as_deref().unwrap_or("scene"),
        ErrorSource::Noise => "noise",
        ErrorSource::Dictionary => "noise of the dictionary",
        ErrorSource::Thickness => "thickness",
        ErrorSource::Origin => "origin",
        ErrorSource::Blur => "blur",
        ErrorSource::Gain => "gain of each profile",
        ErrorSource::Zero => "zero",
        ErrorSource::Slope => "slope of the light",
        ErrorSource::Wedge => "wedge of each slab",
        ErrorSource::Scale => "white reference (μ)",
        ErrorSource::OtherChannels => "other channels",
        ErrorSource::G => "g",
        ErrorSource::Unknown => "a source that this farmctl does not have",
    }
}

fn remedy(source: ErrorSource) -> &'static str {
    match source {
        ErrorSource::Scene => "measure it, and put the value with its standard error into the scene file",
        ErrorSource::Noise => "more shots",
        ErrorSource::Dictionary => "a dictionary of more walks",
        ErrorSource::Thickness => "measure the slabs again, at several places",
        ErrorSource::Origin => "a sharper edge, or more of the bare edge next to the slab",
        ErrorSource::Blur => "photograph the bare edge again, in focus",
        ErrorSource::Gain => "steadier lamps, or more of the board free next to the slab",
        ErrorSource::Zero => "less stray light; dark shots with the same exposure",
        ErrorSource::Slope => "flat-field shots with the same lamps",
        ErrorSource::Wedge => "turn each slab by 180° for half of its shots",
        ErrorSource::Scale => "a white reference of known reflectance",
        ErrorSource::OtherChannels => {
            "better data of the other channels, or channels measured each on its own"
        }
        ErrorSource::G => "give g if it is known, or add slabs of other thicknesses (a design compares them)",
        ErrorSource::Unknown => "upgrade farmctl",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::channel;

    fn share(source: ErrorSource, sigma_t: f64) -> SourceShare {
        SourceShare { source, quantity: None, sigma_t, albedo: 0.0, reduced_scattering: 0.0, absorption: 0.0 }
    }

    #[test]
    fn whole_shares_add_up_to_a_hundred() {
        use ErrorSource::{G, Gain, Noise, Thickness, Zero};
        let thirds = [Noise, Thickness, G].map(|source| share(source, 1.0 / 3.0));
        assert_eq!(shares(&thirds), "noise 34 %, thickness 33 %, g 33 %");
        let small = [share(Noise, 0.014), share(Gain, 0.004), share(Zero, 0.006), share(G, 0.976)];
        assert_eq!(shares(&small), "g 98 %, rest 2 %");
    }

    /// The budget names the source that is largest over all channels.
    #[test]
    fn budget_names_the_largest_source() {
        use ErrorSource::{G, Noise};
        let (a, b) = ([share(Noise, 0.7), share(G, 0.3)], [share(Noise, 0.1), share(G, 0.9)]);
        let (source, part) = largest(&[&a, &b]).unwrap();
        assert!(source.source == G && (part - 0.6).abs() < 1e-12, "{source:?} {part}");
        assert_eq!(largest(&[]), None);
    }

    /// A budget is shown with the interval that it explains, and sources of the scene by their quantity.
    #[test]
    fn budget_has_the_interval_it_explains() {
        assert_eq!(error_budget(&[]), None);
        let mut channels = vec![channel("G", 6.0, 1.0)];
        let budget = &mut channels[0].refined.as_mut().unwrap().likelihood.budget;
        budget.last_mut().unwrap().sigma_t = 0.75;
        let quantity = Some("gel thickness".to_owned());
        budget.push(SourceShare { quantity, ..share(ErrorSource::Scene, 0.05) });
        let found = error_budget(&[MaterialFit { material: "white".into(), channels }]).unwrap();
        let ChannelBudget { about, sigma_t, shares, .. } = &found.channels[0];
        assert_eq!((about.as_str(), sigma_t.as_str()), ("white G", "5.4…6.6 / mm"));
        assert_eq!(shares, "g 75 %, thickness 12 %, noise 8 %, gel thickness 5 %");
        assert!(
            found.first.starts_with("without the error of g, σ_t would be ± 5 %, not ± 10 %: give g"),
            "{}",
            found.first
        );
    }
}
