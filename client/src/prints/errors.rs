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
    /// A direction of the model's error in a print, of all channels.
    Model { print: usize, direction: usize },
}

/// The changes of a prediction in a channel.
pub(crate) fn changes(channel: usize, predicted: &Predicted) -> impl Iterator<Item = (ErrorKey, f64)> {
    predicted.changes.iter().map(move |(source, change)| match *source {
        ChangeSource::Shared(k) => (ErrorKey::Shared(k), *change),
        ChangeSource::Own { medium, direction } => (ErrorKey::Own { channel, medium, direction }, *change),
        ChangeSource::Model(direction) => (ErrorKey::Model { print: 0, direction }, *change),
    })
}

/// Standard error of Σ weight × change of terms.
pub(crate) fn sum_std_error(terms: impl Iterator<Item = (ErrorKey, f64)>) -> f64 {
    let mut sums: BTreeMap<ErrorKey, f64> = BTreeMap::new();
    terms.for_each(|(key, change)| *sums.entry(key).or_default() += change);
    sums.values().map(|sum| sum * sum).sum::<f64>().sqrt()
}

/// Standard error of a function of radiance factors by channel and base.
pub(crate) fn std_error(found: &[Vec<Predicted>], f: impl Fn(&[Vec<f64>]) -> f64) -> f64 {
    const STEP: f64 = 1e-4;
    let values: Vec<Vec<f64>> = found.iter().map(|of| of.iter().map(|p| p.value).collect()).collect();
    let moved = |channel: usize, base: usize, by: f64| {
        let mut values = values.clone();
        values[channel][base] += by;
        f(&values)
    };
    let mut terms: Vec<(ErrorKey, f64)> = Vec::new();
    for (channel, bases) in found.iter().enumerate() {
        for (base, predicted) in bases.iter().enumerate() {
            let slope = (moved(channel, base, STEP) - moved(channel, base, -STEP)) / (2.0 * STEP);
            terms.extend(changes(channel, predicted).map(|(key, change)| (key, slope * change)));
        }
    }
    sum_std_error(terms.into_iter())
}

/// The spectrum over a base; `order` are the channels by rising wavelength.
pub(crate) fn spectrum(values: &[Vec<f64>], order: &[usize], base: usize) -> Vec<f64> {
    order.iter().map(|channel| values[*channel][base]).collect()
}

/// Standard errors of L*, a* and b* over a base.
pub(crate) fn lab_std_errors(
    colorimetry: &Colorimetry,
    found: &[Vec<Predicted>],
    order: &[usize],
    base: usize,
) -> [f64; 3] {
    let lab = |values: &[Vec<f64>]| colorimetry.colour(&spectrum(values, order, base)).lab;
    std::array::from_fn(|k| std_error(found, |values| lab(values)[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors that two channels share add up, those of their own add up as squares.
    #[test]
    fn shared_errors_add_up() {
        let predicted = |source| vec![Predicted { value: 0.5, changes: vec![(source, 0.01)] }];
        let own = ChangeSource::Own { medium: 0, direction: 0 };
        for (source, expected) in [(ChangeSource::Shared(0), 0.03), (own, 5_f64.sqrt() * 0.01)] {
            let found = [predicted(source), predicted(source)];
            let error = std_error(&found, |v| v[0][0] + 2.0 * v[1][0]);
            assert!((error - expected).abs() < 1e-9, "{source:?} {error}");
            let difference = std_error(&found, |v| v[0][0] - v[1][0]);
            let expected = if source == own { 2_f64.sqrt() * 0.01 } else { 0.0 };
            assert!((difference - expected).abs() < 1e-9, "{source:?} {difference}");
        }
    }
}
