//! Checks linearity by the exposure time: numbers of one patch are proportional to it.
//!
//! Cameras state nominal times: 1/60 s is 1/64 s, a power of ∛2. Both are tried, and the more consistent ones count.

use super::RawReading;
use crate::frame::Colour;
use crate::refusal::Refusal;

/// Times that cameras with steps of a third of a stop state, as shares of a second above and below 1.
const NOMINAL: [f64; 19] =
    [1.0, 1.3, 1.6, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 13.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0];
/// Largest relative distance between a nominal time and its power of ∛2.
const NEAREST: f64 = 0.07;
/// Relative deviation above which a session is refused, as for patches.
const NOT_LINEAR: f64 = 0.01;
/// Shortest exposure over the longest: a smaller range shows little.
const RANGE: f64 = 0.5;
/// Fewest exposures.
pub(super) const LEAST: usize = 3;

/// The white patch at one exposure.
#[derive(Debug, Clone)]
pub(super) struct ExposedWhite {
    pub label: String,
    pub time_s: f64,
    pub readings: Vec<RawReading>,
}

/// Greatest deviation from proportionality, per channel.
pub(super) fn linearity(exposures: &[ExposedWhite], columns: &[Colour]) -> Result<Vec<f64>, Refusal> {
    let times: Vec<f64> = exposures.iter().map(|e| e.time_s).collect();
    let longest = times.iter().fold(0.0, |most: f64, t| most.max(*t));
    let shortest = times.iter().fold(f64::INFINITY, |least: f64, t| least.min(*t));
    let mut distinct = times.clone();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    if distinct.len() < LEAST || shortest > RANGE * longest {
        let seen = format!("{} different times from {shortest} to {longest} s", distinct.len());
        return Err(Refusal::FewExposures { seen });
    }
    let stated = deviations(exposures, &times);
    let exact: Option<Vec<f64>> = times.iter().map(|t| exact(*t)).collect();
    let found = exact.map(|exact| deviations(exposures, &exact)).into_iter().chain([stated]);
    let most = |each: &Vec<Vec<f64>>| each.iter().flatten().fold(0.0, |most: f64, d| most.max(d.abs()));
    let best = found.min_by(|a, b| most(a).total_cmp(&most(b))).unwrap_or_default();
    for (exposure, deviations) in exposures.iter().zip(&best) {
        for (colour, deviation) in columns.iter().copied().zip(deviations) {
            if deviation.is_nan() || deviation.abs() > NOT_LINEAR {
                let (label, percent) = (exposure.label.clone(), 100.0 * deviation);
                return Err(Refusal::NotProportional { label, colour, percent });
            }
        }
    }
    let greatest = |c: usize| best.iter().fold(0.0, |most: f64, d| most.max(d[c].abs()));
    Ok((0..columns.len()).map(greatest).collect())
}

/// Relative deviations of the numbers per second from those of the longest exposure.
fn deviations(exposures: &[ExposedWhite], times_s: &[f64]) -> Vec<Vec<f64>> {
    let longest = (0..times_s.len()).max_by(|a, b| times_s[*a].total_cmp(&times_s[*b])).unwrap_or(0);
    let rate = |i: usize, c: usize| exposures[i].readings[c].light / times_s[i];
    let deviation = |i: usize, c: usize| rate(i, c) / rate(longest, c) - 1.0;
    let columns = exposures[longest].readings.len();
    (0..times_s.len()).map(|i| (0..columns).map(|c| deviation(i, c)).collect()).collect()
}

/// The power of ∛2 that a camera means by a nominal time; none if the time is no nominal one.
fn exact(time_s: f64) -> Option<f64> {
    let decades = [0.01, 0.1, 1.0, 10.0, 100.0, 1000.0];
    let is_one = |nominal: f64| (time_s / nominal - 1.0).abs() < 0.005;
    let is_nominal = NOMINAL.iter().flat_map(|n| decades.map(|d| n * d)).any(|n| is_one(n) || is_one(1.0 / n))
        // 1/125 to 1/8000 s.
        || [125.0, 160.0, 320.0, 640.0, 1250.0, 3200.0, 6400.0].iter().any(|n| is_one(1.0 / n));
    let power = libm::exp2((3.0 * libm::log2(time_s)).round() / 3.0);
    (is_nominal && (time_s / power - 1.0).abs() < NEAREST).then_some(power)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exposures(times: &[(f64, f64)]) -> Vec<ExposedWhite> {
        let exposure = |(time_s, light): &(f64, f64)| {
            let reading = RawReading { light: *light, std_error: 1.0, veil: 0.0 };
            ExposedWhite { label: format!("{time_s} s"), time_s: *time_s, readings: vec![reading; 3] }
        };
        times.iter().map(exposure).collect()
    }

    /// Numbers that follow nominal times, or the powers that cameras mean by them, are linear.
    #[test]
    fn nominal_times_are_powers() {
        let nominal = [1.0 / 60.0, 1.0 / 30.0, 1.0 / 15.0];
        let powers = [1.0 / 64.0, 1.0 / 32.0, 1.0 / 16.0];
        for true_s in [nominal, powers] {
            let pairs: Vec<_> = nominal.into_iter().zip(true_s.map(|t| 4e4 * t)).collect();
            assert!(linearity(&exposures(&pairs), &Colour::ALL).unwrap()[1] < 1e-9, "{true_s:?}");
        }
        assert_eq!(exact(1.0 / 60.0), Some(1.0 / 64.0));
        assert_eq!(exact(0.0171), None);
    }

    /// A curve of 2 % at a quarter of the light is refused with its shot, one of 0.5 % is an error; too few or too similar
    /// times are refused.
    #[test]
    fn curves_are_refused_with_their_shot() {
        let curved = |by: f64| exposures(&[(0.01, 1e3 * (1.0 + by)), (0.02, 2e3), (0.04, 4e3)]);
        let refused = linearity(&curved(-0.02), &Colour::ALL).unwrap_err().to_string();
        assert!(refused.starts_with("0.01 s: the red samples are 2.00 % below"), "{refused}");
        assert!((linearity(&curved(0.005), &Colour::ALL).unwrap()[2] - 0.005).abs() < 1e-9);
        for few in [&[(0.01, 1.0), (0.04, 4.0)][..], &[(0.030, 3.0), (0.035, 3.5), (0.040, 4.0)]] {
            let refused = linearity(&exposures(few), &Colour::ALL).unwrap_err();
            assert!(matches!(refused, Refusal::FewExposures { .. }), "{refused}");
        }
    }
}
