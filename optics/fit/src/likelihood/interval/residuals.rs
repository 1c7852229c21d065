//! Analyses the structure of the residuals: outliers, stretches, correlation.

use optics_model::fit::{OutlierPixel, Stretch};

use crate::likelihood::point::Line;
use crate::likelihood::system::System;
use crate::likelihood::term::{Linear, Term};

/// Least joint deviation of a stretch that is reported, in standard deviations.
const STRETCH: f64 = 5.0;
/// Widths of stretches that are tested, in pixels.
const WIDTHS: [usize; 5] = [6, 12, 24, 48, 96];
/// Maximum number of stretches that are reported.
const STRETCHES: usize = 4;

/// Pixels that were left out.
pub(crate) fn outliers(system: &System, linear: &[Linear]) -> Vec<OutlierPixel> {
    let term_outliers = |(term, linear): (&Term, &Linear)| -> Vec<OutlierPixel> {
        let pixel = |i: usize| OutlierPixel {
            profile_mm: term.thickness_mm,
            x_mm: term.x_mm[i],
            deviation: linear.residuals[i],
        };
        (0..term.x_mm.len()).filter(|i| term.left_out[*i]).map(pixel).collect()
    };
    system.terms.iter().zip(linear).flat_map(term_outliers).collect()
}

/// Stretches in which neighbouring residuals are large together, the largest first.
pub(crate) fn stretches(system: &System, linear: &[Linear]) -> Vec<Stretch> {
    let mut found: Vec<Stretch> = Vec::new();
    for (term, linear) in system.terms.iter().zip(linear) {
        let n = linear.residuals.len();
        let kept = |i: usize| if term.left_out[i] { 0.0 } else { linear.residuals[i] };
        let mut sums = vec![0.0];
        (0..n).for_each(|i| sums.push(sums[i] + kept(i)));
        for width in WIDTHS.into_iter().filter(|w| *w <= n) {
            for first in (0..=n - width).step_by((width / 3).max(1)) {
                let deviation = (sums[first + width] - sums[first]) / (width as f64).sqrt();
                let (from_mm, to_mm) = (term.x_mm[first], term.x_mm[first + width - 1]);
                if deviation.abs() > STRETCH {
                    found.push(Stretch { profile_mm: term.thickness_mm, from_mm, to_mm, deviation });
                }
            }
        }
    }
    found.sort_by(|a, b| b.deviation.abs().total_cmp(&a.deviation.abs()));
    let mut kept: Vec<Stretch> = Vec::new();
    for stretch in found {
        let apart = |s: &Stretch| {
            s.profile_mm != stretch.profile_mm || s.to_mm < stretch.from_mm || s.from_mm > stretch.to_mm
        };
        if kept.iter().all(apart) && kept.len() < STRETCHES {
            kept.push(stretch);
        }
    }
    kept
}

/// Factor by which correlated residuals carry less information than as many independent ones: 1 + 2 Σ of their
/// correlations, up to the first that is not positive.
pub(crate) fn clustering(system: &System, linear: &[Linear]) -> f64 {
    let kept: Vec<Line> = linear
        .iter()
        .zip(&system.terms)
        .map(|(l, t)| l.residuals.iter().zip(&t.left_out).filter(|(_, o)| !**o).map(|(r, _)| *r).collect())
        .collect();
    let product = |lag: usize| -> f64 {
        kept.iter().map(|r| r.iter().zip(r.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>()).sum()
    };
    let square = product(0).max(f64::MIN_POSITIVE);
    1.0 + 2.0 * (1..60).map(|lag| product(lag) / square).take_while(|c| *c > 0.0).sum::<f64>()
}
