//! Maps values to positions on an axis, and places its ticks.

use super::number::{even_label, logarithmic_label, scientific};
use super::text::{TICK, Text};

/// Smallest and largest of the finite values.
pub(crate) fn extent(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    let finite = values.into_iter().filter(|v| v.is_finite());
    finite.fold(None, |found, v| match found {
        None => Some((v, v)),
        Some((low, high)) => Some((v.min(low), v.max(high))),
    })
}

/// A range of values, linear or logarithmic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Axis {
    low: f64,
    high: f64,
    logarithmic: bool,
}

/// Direction of the axis: labels in a row need more room than labels in a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AxisDirection {
    Across,
    Up,
}

/// An axis on the canvas, and the least distance of its labels.
#[derive(Clone, Copy)]
struct Room {
    pixels: f64,
    direction: AxisDirection,
    gap: f64,
}

/// A tick; minor ones have no label.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tick {
    pub(crate) value: f64,
    pub(crate) label: Option<String>,
}

impl Axis {
    /// An axis with exactly this range; a single value is centred.
    pub(crate) fn exact(range: Option<(f64, f64)>) -> Self {
        let (low, high) = range.unwrap_or((0.0, 1.0));
        let (low, high) = if high > low { (low, high) } else { (low - 0.5, high + 0.5) };
        Self { low, high, logarithmic: false }
    }

    /// An axis from zero to slightly above the largest value.
    pub(crate) fn from_zero(range: Option<(f64, f64)>) -> Self {
        let high = range.map_or(0.0, |(_, high)| high);
        let high = if high > 0.0 { 1.06 * high } else { 1.0 };
        Self { low: 0.0, high, logarithmic: false }
    }

    /// The range with a margin. It spans at least the share `least` of the largest value, so that noise does not look
    /// like a trend.
    pub(crate) fn around(range: Option<(f64, f64)>, least: f64) -> Self {
        let Some((low, high)) = range else { return Self::exact(None) };
        let size = low.abs().max(high.abs());
        let size = if size > 0.0 { size } else { 1.0 };
        let half = 0.54 * (high - low).max(least * size);
        let middle = f64::midpoint(low, high);
        Self { low: middle - half, high: middle + half, logarithmic: false }
    }

    /// A logarithmic axis; the limits must be positive.
    pub(crate) fn logarithmic(low: f64, high: f64) -> Self {
        let (low, high) = if high > low { (low, high) } else { (low / 1.2, high * 1.2) };
        Self { low, high, logarithmic: true }
    }

    /// The position of a value: 0 at the lower end, 1 at the upper.
    pub(crate) fn fraction(&self, value: f64) -> f64 {
        if self.logarithmic {
            libm::log(value / self.low) / libm::log(self.high / self.low)
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    /// The value at a position; the inverse of [`Axis::fraction`].
    pub(crate) fn value(&self, fraction: f64) -> f64 {
        if self.logarithmic {
            self.low * libm::exp(fraction * libm::log(self.high / self.low))
        } else {
            self.low + fraction * (self.high - self.low)
        }
    }

    /// The finest ticks whose labels fit on an axis of this length in pixels.
    pub(crate) fn ticks(&self, pixels: f64, direction: AxisDirection) -> Vec<Tick> {
        // Labels are closer only where there would be fewer than two.
        let gaps = match direction {
            AxisDirection::Up if self.logarithmic => [1.6, 1.3],
            AxisDirection::Up => [2.1, 1.3],
            AxisDirection::Across => [1.0, 0.5],
        };
        let [loose, close] = gaps.map(|gap| Room { pixels, direction, gap: gap * TICK });
        let ticks = self.ticks_with(loose);
        let labels = ticks.iter().filter(|tick| tick.label.is_some()).count();
        if labels < 2 { self.ticks_with(close) } else { ticks }
    }

    fn ticks_with(&self, room: Room) -> Vec<Tick> {
        let decades = libm::log10(self.high / self.low);
        if self.logarithmic && decades > 0.4 { self.logarithmic_ticks(room) } else { self.even_ticks(room) }
    }

    fn even_ticks(&self, room: Room) -> Vec<Tick> {
        let span = self.high - self.low;
        let first = libm::log10(span / 50.0).floor() as i32;
        let mut too_dense = Vec::new();
        for (mantissa, exponent) in (first..first + 4).flat_map(|e| [(1, e), (2, e), (5, e)]) {
            let ticks = self.multiples(mantissa, exponent);
            if ticks.len() < 2 {
                break;
            }
            too_dense = ticks;
            if self.labels_fit(too_dense.iter().map(|(_, tick)| tick), room) {
                break;
            }
        }
        // Where the labels of no round step fit, only every n-th tick of a step keeps its label.
        for stride in 1..50 {
            let thinned = too_dense.iter().map(|(n, tick)| {
                let label = tick.label.clone().filter(|_| n % stride == 0);
                Tick { value: tick.value, label }
            });
            let ticks: Vec<_> = thinned.collect();
            if self.labels_fit(&ticks, room) {
                return ticks;
            }
        }
        Vec::new()
    }

    /// Ticks at the multiples of a round step, each with its number.
    fn multiples(&self, mantissa: i32, exponent: i32) -> Vec<(i64, Tick)> {
        let step = f64::from(mantissa) * 10_f64.powi(exponent);
        let tolerance = 1e-9 * (self.high - self.low);
        let numbers =
            ((self.low - tolerance) / step).ceil() as i64..=((self.high + tolerance) / step).floor() as i64;
        numbers
            .map(|n| (n, Tick { value: n as f64 * step, label: Some(even_label(n as f64 * step, exponent)) }))
            .collect()
    }

    fn logarithmic_ticks(&self, room: Room) -> Vec<Tick> {
        let exponents = libm::log10(self.low).floor() as i32..=libm::log10(self.high).ceil() as i32;
        let mut values: Vec<(i32, i32)> = exponents.flat_map(|e| (1..10).map(move |m| (m, e))).collect();
        values.retain(|&(m, e)| (-1e-9..=1.0 + 1e-9).contains(&self.fraction(scientific(m, e))));
        let powers = values.iter().any(|&(m, e)| m == 1 && !(-3..=4).contains(&e));
        let labelled: [fn(i32, i32) -> bool; 8] = [
            |_, _| true,
            |m, _| [1, 2, 3, 5].contains(&m),
            |m, _| [1, 2, 5].contains(&m),
            |m, _| [1, 3].contains(&m),
            |m, _| m == 1,
            |m, e| m == 1 && e % 2 == 0,
            |m, e| m == 1 && e % 3 == 0,
            |m, e| m == 1 && e % 5 == 0,
        ];
        for has_label in labelled {
            let tick = |&(m, e): &(i32, i32)| {
                let label = has_label(m, e).then(|| logarithmic_label(m, e, powers));
                Tick { value: scientific(m, e), label }
            };
            let ticks: Vec<_> = values.iter().map(tick).collect();
            if self.labels_fit(&ticks, room) {
                return ticks;
            }
        }
        Vec::new()
    }

    fn labels_fit<'a>(&self, ticks: impl IntoIterator<Item = &'a Tick>, room: Room) -> bool {
        let labelled: Vec<_> =
            ticks.into_iter().filter_map(|tick| tick.label.as_ref().map(|l| (tick.value, l))).collect();
        labelled.windows(2).all(|pair| {
            let distance = room.pixels * (self.fraction(pair[1].0) - self.fraction(pair[0].0));
            match room.direction {
                AxisDirection::Up => distance >= room.gap,
                AxisDirection::Across => {
                    let widths = pair.iter().map(|(_, label)| Text::new(*label, TICK).width());
                    distance >= widths.sum::<f64>() / 2.0 + room.gap
                }
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: Axis, pixels: f64, direction: AxisDirection) -> Vec<String> {
        axis.ticks(pixels, direction).into_iter().filter_map(|tick| tick.label).collect()
    }

    /// Ticks are round numbers, and as fine as the room allows.
    #[test]
    fn ticks_are_round_and_fine_enough() {
        let axis = Axis::exact(Some((-5.0, 5.0)));
        assert_eq!(labels(axis, 120.0, AxisDirection::Across), ["−4", "−2", "0", "2", "4"]);
        assert_eq!(labels(axis, 60.0, AxisDirection::Across), ["−5", "0", "5"]);
        let axis = Axis::exact(Some((0.0, 0.012)));
        assert_eq!(labels(axis, 60.0, AxisDirection::Up), ["0", "0.005", "0.010"]);
    }

    #[test]
    fn logarithmic_ticks_name_decades_or_round_values() {
        let axis = Axis::logarithmic(8e-6, 0.97);
        let decades = ["10^{−5}", "10^{−4}", "10^{−3}", "10^{−2}", "10^{−1}"];
        assert_eq!(labels(axis, 200.0, AxisDirection::Across), decades);
        assert_eq!(labels(axis, 90.0, AxisDirection::Across), ["10^{−4}", "10^{−2}"]);
        let axis = Axis::logarithmic(0.9, 31.0);
        assert_eq!(labels(axis, 160.0, AxisDirection::Up), ["1", "2", "3", "5", "10", "20", "30"]);
        assert!(
            axis.ticks(160.0, AxisDirection::Up).iter().any(|tick| tick.value == 4.0 && tick.label.is_none())
        );
    }

    /// Axes of one value, or of none, have an extent.
    #[test]
    fn empty_axes_have_an_extent() {
        for axis in [
            Axis::exact(Some((3.0, 3.0))),
            Axis::exact(None),
            Axis::from_zero(Some((0.0, 0.0))),
            Axis::around(Some((0.5, 0.5)), 0.05),
            Axis::around(Some((0.0, 0.0)), 0.05),
            Axis::logarithmic(2.0, 2.0),
        ] {
            assert!(axis.low < axis.high, "{axis:?}");
            assert!(axis.ticks(150.0, AxisDirection::Across).len() > 1, "{axis:?}");
        }
        assert_eq!(extent([f64::NAN, 2.0, -1.0, f64::INFINITY]), Some((-1.0, 2.0)));
        assert_eq!(extent([f64::NAN]), None);
    }

    /// The mapping of an axis is invertible.
    #[test]
    fn axis_mapping_is_invertible() {
        for axis in [Axis::exact(Some((-5.0, 5.0))), Axis::logarithmic(1e-5, 0.9)] {
            for fraction in [0.0, 0.3, 1.0] {
                assert!((axis.fraction(axis.value(fraction)) - fraction).abs() < 1e-12);
            }
        }
    }
}
