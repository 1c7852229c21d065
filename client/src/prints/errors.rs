//! Propagates the errors of predictions to numbers that are computed from several channels.

use std::collections::BTreeMap;

use farm_lab::colour::Colorimetry;
use optics_layers::{ChangeSource, Predicted};

/// An independent source of errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum ErrorKey {
    /// A source that media, channels and set-up share.
    Shared(usize),
    /// A direction in which a medium is uncertain in one channel.
    Own { channel: usize, medium: usize, direction: usize },
    /// The gain of a patch.
    Gain(usize),
    /// The thickness of a patch.
    Thickness(usize),
}

/// The changes of a prediction in a channel.
pub(crate) fn changes(channel: usize, predicted: &Predicted) -> impl Iterator<Item = (ErrorKey, f64)> {
    predicted.changes.iter().map(move |(source, change)| match *source {
        ChangeSource::Shared(k) => (ErrorKey::Shared(k), *change),
        ChangeSource::Own { medium, direction } => (ErrorKey::Own { channel, medium, direction }, *change),
    })
}

/// Standard error of Σ weight × change of terms.
pub(crate) fn sum_std_error(terms: impl Iterator<Item = (ErrorKey, f64)>) -> f64 {
    let mut sums: BTreeMap<ErrorKey, f64> = BTreeMap::new();
    terms.for_each(|(key, change)| *sums.entry(key).or_default() += change);
    sums.values().map(|sum| sum * sum).sum::<f64>().sqrt()
}

/// Standard error of Σ weight × radiance factor over channels and bases.
pub(crate) fn std_error(found: &[Vec<Predicted>], weight: impl Fn(usize, usize) -> f64) -> f64 {
    let weight = &weight;
    let of_channel = |(channel, bases): (usize, &'_ Vec<Predicted>)| -> Vec<(ErrorKey, f64)> {
        let of_base = |(base, predicted)| {
            let weight = weight(channel, base);
            changes(channel, predicted).map(move |(key, change)| (key, weight * change))
        };
        bases.iter().enumerate().flat_map(of_base).collect()
    };
    sum_std_error(found.iter().enumerate().flat_map(of_channel))
}

/// Standard errors of L*, a* and b* over a base; `order` are the channels by rising wavelength.
pub(crate) fn lab_std_errors(
    colorimetry: &Colorimetry,
    found: &[Vec<Predicted>],
    order: &[usize],
    base: usize,
) -> [f64; 3] {
    const STEP: f64 = 1e-4;
    let values: Vec<f64> = order.iter().map(|channel| found[*channel][base].value).collect();
    let lab = |at: usize, by: f64| {
        let mut values = values.clone();
        values[at] += by;
        colorimetry.colour(&values).lab
    };
    let mut slopes = vec![[0.0; 3]; found.len()];
    for (at, channel) in order.iter().enumerate() {
        let (up, down) = (lab(at, STEP), lab(at, -STEP));
        slopes[*channel] = std::array::from_fn(|k| (up[k] - down[k]) / (2.0 * STEP));
    }
    std::array::from_fn(|k| std_error(found, |channel, of| if of == base { slopes[channel][k] } else { 0.0 }))
}
