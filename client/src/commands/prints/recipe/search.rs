//! Minimises a cost over the shares of a mixture: exchanges of volume between two parts, in smaller and smaller steps.

use std::cmp::Ordering;

use anyhow::{Context, Result};

/// Largest share of each part.
#[derive(Debug, Clone, Copy)]
pub(super) struct ShareLimits<'a> {
    pub most: &'a [f64],
}

/// First and last step.
const STEPS: (f64, f64) = (0.25, 5e-4);

/// The shares with the least cost. All shares are within their limits and add up to 1.
///
/// The search begins at the best of the parts alone and the even mixture, each as far as the limits allow. An exchange
/// that lowers the cost is repeated; the step is halved when none does.
pub(super) fn closest(limits: &ShareLimits, cost: impl Fn(&[f64]) -> Result<f64>) -> Result<Vec<f64>> {
    let n = limits.most.len();
    let alone = (0..n).map(|i| filled(limits, |j| if i == j { 1.0 } else { 0.0 }));
    let mut best: Option<(Vec<f64>, f64)> = None;
    for start in alone.chain([filled(limits, |_| 1.0 / n as f64)]) {
        let at = cost(&start)?;
        if !at.is_nan() && best.as_ref().is_none_or(|(_, least)| at < *least) {
            best = Some((start, at));
        }
    }
    let (mut shares, mut least) =
        best.context("no mixture has a colour that can be compared with the wanted one")?;
    let mut step = STEPS.0;
    while step >= STEPS.1 {
        let mut has_fallen = false;
        for from in 0..n {
            for to in (0..n).filter(|to| *to != from) {
                while let Some(moved) = exchanged(limits, &shares, from, to, step) {
                    let at = cost(&moved)?;
                    // A cost that is no number is not lower.
                    if at.partial_cmp(&least) != Some(Ordering::Less) {
                        break;
                    }
                    (shares, least, has_fallen) = (moved, at, true);
                }
            }
        }
        if !has_fallen {
            step *= 0.5;
        }
    }
    Ok(shares)
}

/// Shares near the wanted ones; what is above a limit goes to the others in their order.
fn filled(limits: &ShareLimits, wanted: impl Fn(usize) -> f64) -> Vec<f64> {
    let mut shares: Vec<f64> = limits.most.iter().enumerate().map(|(i, most)| wanted(i).min(*most)).collect();
    for i in 0..shares.len() {
        let lacking = 1.0 - shares.iter().sum::<f64>();
        shares[i] += lacking.min(limits.most[i] - shares[i]).max(0.0);
    }
    shares
}

/// The shares after an exchange, which may be smaller than the step at a limit; None if nothing can be moved.
fn exchanged(limits: &ShareLimits, shares: &[f64], from: usize, to: usize, step: f64) -> Option<Vec<f64>> {
    let moved = step.min(shares[from]).min(limits.most[to] - shares[to]);
    (moved > 1e-9).then(|| {
        let mut shares = shares.to_vec();
        shares[from] -= moved;
        shares[to] += moved;
        shares
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(most: &[f64], wanted: &[f64]) -> Vec<f64> {
        let cost = |shares: &[f64]| {
            Ok(shares.iter().zip(wanted).zip(1..).map(|((s, w), i)| f64::from(i) * (s - w).powi(2)).sum())
        };
        closest(&ShareLimits { most }, cost).unwrap()
    }

    /// The minimum of a quadratic is found inside, on a face and at a limit; shares add up to 1.
    #[test]
    fn minima_are_found_within_limits() {
        for (most, wanted, expected) in [
            ([1.0, 1.0, 1.0], [0.2, 0.3, 0.5], [0.2, 0.3, 0.5]),
            ([1.0, 1.0, 1.0], [0.7, 0.6, -0.3], [0.5, 0.5, 0.0]),
            ([1.0, 0.1, 1.0], [0.2, 0.3, 0.5], [0.35, 0.1, 0.55]),
        ] {
            let shares = found(&most, &wanted);
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{shares:?}");
            assert!(
                shares.iter().zip(expected).all(|(s, e)| (s - e).abs() < 3e-3),
                "{shares:?} {expected:?}"
            );
        }
    }

    /// A start whose cost is no number does not hide the others; without any other nothing is found.
    #[test]
    fn starts_without_a_cost_are_passed_over() {
        let limits = ShareLimits { most: &[1.0, 1.0] };
        let cost = |shares: &[f64]| Ok(if shares[0] > 0.9 { f64::NAN } else { (shares[0] - 0.3).powi(2) });
        let shares = closest(&limits, cost).unwrap();
        assert!((shares[0] - 0.3).abs() < 3e-3, "{shares:?}");
        let refused = closest(&limits, |_| Ok(f64::NAN)).unwrap_err().to_string();
        assert!(refused.starts_with("no mixture has a colour"), "{refused}");
    }

    /// Limits that allow one mixture only leave that one.
    #[test]
    fn tight_limits_leave_one_mixture() {
        assert_eq!(found(&[0.25, 0.75], &[1.0, 0.0]), [0.25, 0.75]);
    }
}
