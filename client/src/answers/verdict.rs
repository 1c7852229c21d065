//! Sums up a measurement in words: which media are determined, how well, what makes them doubtful, and what would improve
//! them most.

use farm_figures::error_budget;
use farm_figures::numbers::significant;
use farm_lab::capture::{MeasureVerdict, PrecisionRow};
use optics_model::fit::{ChannelFit, Interval, MaterialFit, Refined};

use super::remarks::all_remarks;
use super::summary::{Estimated, quantities};

/// Ratio of the greatest half-width to the median from which on it is shown.
const UNLIKE: f64 = 1.2;

/// The verdict on all fits.
pub(crate) fn verdict(fits: &[MaterialFit]) -> MeasureVerdict {
    let channels = || fits.iter().flat_map(|fit| fit.channels.iter().map(move |c| (fit, c)));
    let named = |is: &dyn Fn(&ChannelFit) -> bool| -> Vec<String> {
        let some = channels().filter(|(_, channel)| is(channel));
        some.map(|(fit, channel)| format!("{} {}", fit.material, channel.channel)).collect()
    };
    let at_g = |c: &ChannelFit| c.refined.as_ref().is_some_and(|r| r.resolved_at_g);
    let whole = |c: &ChannelFit| c.refined.as_ref().is_some_and(|r| r.resolved);
    let ended = |c: &ChannelFit| c.refined.as_ref().is_none_or(|r| r.descent.is_minimum());
    let (open, unknown) = (named(&|c| at_g(c) && !whole(c)), named(&|c| !at_g(c) && ended(c)));
    let unended = named(&|c| !ended(c));
    let unended = (!unended.is_empty()).then(|| {
        format!("Not converged, so that no number holds, nor its interval: {}.", unended.join(", "))
    });
    let doubtful = named(&is_doubtful);
    let is_sound = |c: &ChannelFit| !is_doubtful(c);
    let (all, sound) = (channels().count(), named(&|c| at_g(c) && whole(c) && is_sound(c)).len());
    let determined = match sound {
        1 if all == 1 => "The medium is determined.".to_owned(),
        n if n == all => format!("All {all} media are determined."),
        0 if doubtful.len() == all => "No medium is determined: the set-up is in doubt.".to_owned(),
        0 => "No medium is determined whole.".to_owned(),
        n => format!("{n} of {all} media are determined."),
    };
    let if_given = |known: &str, named: Vec<String>| {
        let sentence = format!("{known}, σ_t and α only if g is given: {}.", named.join(", "));
        (!named.is_empty()).then_some(sentence)
    };
    let is_bounded = |c: &ChannelFit| {
        let absorption = c.refined.as_ref().map(|r| r.absorption_per_mm);
        absorption.is_some_and(|i| i.open_low || i.open_high)
    };
    let if_given = [
        if_given("σ_s(1 − g) and σ_a are determined", named(&|c| at_g(c) && !whole(c) && !is_bounded(c))),
        if_given(
            "σ_s(1 − g) is determined, σ_a has a bound",
            named(&|c| at_g(c) && !whole(c) && is_bounded(c)),
        ),
    ];
    let nothing = (!unknown.is_empty()).then(|| format!("Undetermined: {}.", unknown.join(", ")));
    let in_doubt = (!doubtful.is_empty())
        .then(|| format!("Doubtful, for reasons given as warnings: {}.", doubtful.join(", ")));
    let is_valley = channels().any(|(_, c)| c.refined.as_ref().is_some_and(|r| r.valley));
    // That only a given g determines σ_t says it as well.
    let trade_off = (is_valley && open.is_empty()).then(|| {
        "σ_t and g trade off: σ_s(1 − g) and σ_a are the numbers to compare, and a renderer needs σ_t, α and g of one row \
         together."
            .to_owned()
    });
    let warnings = all_remarks(fits).into_iter().filter(|remark| remark.warning);
    MeasureVerdict {
        sentences: unended
            .into_iter()
            .chain([determined])
            .chain(in_doubt)
            .chain(if_given.into_iter().flatten())
            .chain(nothing)
            .chain(trade_off)
            .collect(),
        precision: fits.iter().filter_map(precision).collect(),
        warnings: warnings.collect(),
        improve_first: error_budget(fits).map(|budget| budget.first),
    }
}

/// Whether the data contradict the set-up: a cause is suspected, or a quantity contradicts its prior or is pulled beyond
/// its range.
fn is_doubtful(channel: &ChannelFit) -> bool {
    let is =
        |r: &Refined| r.suspicion.is_some() || r.likelihood.scene.iter().any(|e| e.at_end || e.is_conflict());
    channel.refined.as_ref().is_some_and(is)
}

/// How well the determined channels of a material are known; None without one.
fn precision(fit: &MaterialFit) -> Option<PrecisionRow> {
    let known: Vec<&Refined> =
        fit.channels.iter().filter_map(|c| c.refined.as_ref()).filter(|r| r.resolved_at_g).collect();
    let cell = |half_width: &dyn Fn(&Refined) -> f64, unit: &str| {
        let mut all: Vec<f64> = known.iter().map(|r| half_width(r)).collect();
        all.sort_by(f64::total_cmp);
        let shown =
            |v: f64| if v.is_finite() { format!("{}{unit}", significant(v, 2)) } else { "open".into() };
        let (median, greatest) = (all[all.len() / 2], all[all.len() - 1]);
        let widest =
            if greatest > UNLIKE * median { format!(" ({})", shown(greatest)) } else { String::new() };
        if median.is_finite() { format!("± {}{widest}", shown(median)) } else { shown(median) }
    };
    let percent = |i: usize| {
        let share = |(value, interval): Estimated| 100.0 * half(&interval) / value.abs();
        cell(&|r| share(quantities(r)[i]), " %")
    };
    (!known.is_empty()).then(|| PrecisionRow {
        material: fit.material.clone(),
        half_widths: [percent(0), percent(1), percent(2), cell(&|r| half(&r.g), "")],
    })
}

/// Infinite for an open interval.
fn half(interval: &Interval) -> f64 {
    if interval.open_low || interval.open_high { f64::INFINITY } else { 0.5 * (interval.high - interval.low) }
}
