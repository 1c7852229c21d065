//! Averages shots, and estimates how much more they differ than by noise.
//!
//! The difference of shot j from the mean F of all is modelled as gⱼ F + zⱼ + sⱼ x F + oⱼ F′: gain, zero, slope and
//! place of one mounting, each with a prior, so that profiles without contrast stay determined. The remainder is noise.
//! In a profile without contrast, gain and zero are degenerate: the part along F counts as gain, and of each further
//! term only the part that is orthogonal to those before it.

use crate::bins::EdgeProfile;
use crate::estimate::Estimate;
use crate::least_squares::NormalEquations;

/// Standard deviations of gain, zero, slope per 10 mm and place in mm, of one mounting: the prior.
const PRIOR: [f64; 4] = [0.01, 0.003, 0.01, 0.02];

/// Bins on each side over which the scatter between shots is averaged.
const AROUND: usize = 20;

/// The mean of several shots of one subject.
#[derive(Debug, Clone)]
pub(crate) struct Joined {
    pub profile: EdgeProfile,
    /// Standard deviations between shots of gain, zero, slope per 10 mm and place in mm.
    pub between: [f64; 4],
    /// Slope per 10 mm of each shot against the mean.
    pub slopes: Vec<Estimate>,
}

/// Shots of a slab that is a wedge: some are turned by 180° against the others.
#[derive(Debug, PartialEq)]
pub(crate) struct Turned {
    /// Whether a shot is among those with the greater slope.
    pub rises: Vec<bool>,
    /// Half of the difference of the slopes per 10 mm.
    pub slope: f64,
}

/// Least distance of the slopes of turned shots, over their range within either group or their standard errors, and per
/// 10 mm.
const APART: f64 = 4.0;
const LEAST_WEDGE: f64 = 0.008;

impl Turned {
    /// The two groups of shots with these slopes; none if fewer than three shots form them clearly.
    pub(crate) fn find(slopes: &[Estimate]) -> Option<Self> {
        let mut sorted: Vec<f64> = slopes.iter().map(|slope| slope.value).collect();
        sorted.sort_by(f64::total_cmp);
        let gap = |i: &usize| sorted[*i] - sorted[*i - 1];
        let first = (1..sorted.len()).max_by(|a, b| gap(a).total_cmp(&gap(b)))?;
        let (low, high) = sorted.split_at(first);
        let range = |group: &[f64]| group[group.len() - 1] - group[0];
        let error = slopes.iter().map(|slope| slope.std_error).fold(0.0, f64::max);
        let apart = APART * range(low).max(range(high)).max(error);
        let is_clear = sorted.len() > 2 && gap(&first) > apart.max(LEAST_WEDGE);
        let mean = |group: &[f64]| group.iter().sum::<f64>() / group.len() as f64;
        is_clear.then(|| Self {
            rises: slopes.iter().map(|slope| slope.value >= high[0]).collect(),
            slope: 0.5 * (mean(high) - mean(low)),
        })
    }

    /// The mean of both groups, so that the wedge averages out, with the differences between the shots of each.
    pub(crate) fn join(&self, profiles: &[&EdgeProfile]) -> Joined {
        let [one, other] = [true, false].map(|rises| {
            let group = profiles.iter().zip(&self.rises).filter(|(_, own)| **own == rises);
            join(&group.map(|(profile, _)| *profile).collect::<Vec<_>>())
        });
        let mut profile = mean(&[&one.profile, &other.profile]);
        for k in 0..profile.values.len() {
            let [a, b] = [&one.profile, &other.profile];
            profile.values[k] = 0.5 * (a.values[k] + b.values[k]);
            profile.std_errors[k] = 0.5 * libm::hypot(a.std_errors[k], b.std_errors[k]);
        }
        let between = std::array::from_fn(|i| one.between[i].max(other.between[i]));
        Joined { profile, between, slopes: [one.slopes, other.slopes].concat() }
    }
}

/// Weighted mean of each bin.
pub(crate) fn mean(profiles: &[&EdgeProfile]) -> EdgeProfile {
    let first = profiles[0];
    let bins = first.values.len();
    let mut joined = first.clone();
    // One weight per shot: weights of single bins would be noisy.
    let weight = |p: &EdgeProfile| {
        let variances: Vec<f64> = p.std_errors.iter().filter(|e| e.is_finite()).map(|e| e * e).collect();
        variances.len() as f64 / variances.iter().sum::<f64>().max(1e-30)
    };
    let weights: Vec<f64> = profiles.iter().map(|p| weight(p)).collect();
    for k in 0..bins {
        let finite = || profiles.iter().zip(&weights).filter(|(p, _)| p.values[k].is_finite());
        let total: f64 = finite().map(|(_, w)| w).sum();
        joined.values[k] = finite().map(|(p, w)| w * p.values[k]).sum::<f64>() / total;
        let variance = finite().map(|(p, w)| (w * p.std_errors[k]).powi(2)).sum::<f64>();
        joined.std_errors[k] = variance.sqrt() / total;
        joined.counts[k] = profiles.iter().map(|p| p.counts[k]).sum();
        let lost: f64 = profiles.iter().map(|p| p.rejected[k] * f64::from(p.counts[k])).sum();
        joined.rejected[k] = lost / f64::from(joined.counts[k].max(1));
    }
    joined
}

pub(crate) fn join(profiles: &[&EdgeProfile]) -> Joined {
    let mut profile = mean(profiles);
    let shots = profiles.len();
    if shots < 2 {
        return Joined { profile, between: [0.0; 4], slopes: vec![Estimate::default(); shots] };
    }
    let basis = basis(&profile);
    let freedom = shots as f64 - 1.0;
    let mut between = [0.0; 4];
    let (mut left, mut slopes) = (Vec::new(), Vec::new());
    for shot in profiles {
        let departure = Departure::of(shot, &profile, &basis);
        slopes.push(departure.coefficients[2]);
        for (sum, c) in between.iter_mut().zip(departure.coefficients) {
            // The part of a coefficient that noise explains is no difference between shots.
            *sum += c.value * c.value - c.std_error * c.std_error * freedom / shots as f64;
        }
        left.push(departure.left);
    }
    let mut between = between.map(|sum: f64| (sum / freedom).max(0.0).sqrt());
    // Only the part of the zero that is orthogonal to the gain counts.
    let zero = basis.iter().map(|row| row[1] * row[1]).filter(|v| v.is_finite());
    between[1] *= (zero.sum::<f64>() / basis.len() as f64).sqrt();
    let scatter: Vec<f64> = (0..profile.values.len())
        .map(|k| left.iter().map(|r| r[k]).filter(|z| z.is_finite()).map(|z| z * z).sum::<f64>() / freedom)
        .collect();
    for (k, error) in profile.std_errors.iter_mut().enumerate() {
        let near = &scatter[k.saturating_sub(AROUND)..(k + AROUND + 1).min(scatter.len())];
        let mean = near.iter().sum::<f64>() / near.len() as f64;
        // Scatter within three standard deviations of χ² with these degrees of freedom counts as chance.
        let chance = 1.0 + 3.0 * (2.0 / (near.len() as f64 * freedom)).sqrt();
        if mean > chance {
            *error *= mean.sqrt();
        }
    }
    Joined { profile, between, slopes }
}

/// F, 1, x F per 10 mm, F′ per mm, each orthogonal to those before it.
fn basis(profile: &EdgeProfile) -> Vec<[f64; 4]> {
    const REACH: usize = 3;
    let n = profile.values.len();
    let width = profile.x_mm[1] - profile.x_mm[0];
    let mut rows: Vec<[f64; 4]> = (0..n)
        .map(|k| {
            let (below, above) = (k.saturating_sub(REACH), (k + REACH).min(n - 1));
            let rise = (profile.values[above] - profile.values[below]) / ((above - below) as f64 * width);
            let f = profile.values[k];
            [f, 1.0, 0.1 * profile.x_mm[k] * f, rise]
        })
        .collect();
    for later in 1..4 {
        for earlier in 0..later {
            let finite = || rows.iter().filter(|row| row.iter().all(|v| v.is_finite()));
            let product: f64 = finite().map(|row| row[later] * row[earlier]).sum();
            let square: f64 = finite().map(|row| row[earlier] * row[earlier]).sum();
            let share = if square > 0.0 { product / square } else { 0.0 };
            for row in &mut rows {
                row[later] -= share * row[earlier];
            }
        }
    }
    rows
}

/// Deviation of a shot from the mean.
struct Departure {
    coefficients: [Estimate; 4],
    /// The residuals, in standard errors.
    left: Vec<f64>,
}

impl Departure {
    fn of(shot: &EdgeProfile, mean: &EdgeProfile, basis: &[[f64; 4]]) -> Self {
        let mut normal = NormalEquations::new(4);
        for (i, sigma) in PRIOR.iter().enumerate() {
            let mut row = [0.0; 4];
            row[i] = 1.0;
            normal.add(&row, 0.0, sigma.powi(-2));
        }
        for (k, row) in basis.iter().enumerate() {
            let (r, e) = (shot.values[k] - mean.values[k], shot.std_errors[k]);
            if r.is_finite() && e > 0.0 && row.iter().all(|v| v.is_finite()) {
                normal.add(row, r, 1.0 / (e * e));
            }
        }
        let estimates = |s: crate::least_squares::FittedParameters| {
            std::array::from_fn(|i| Estimate::new(s.x[i], s.std_error(i)))
        };
        let coefficients: [Estimate; 4] = normal.solve().map_or([Estimate::default(); 4], estimates);
        let explained = |row: &[f64; 4]| row.iter().zip(&coefficients).map(|(b, c)| b * c.value).sum::<f64>();
        let off = |k: usize| shot.values[k] - mean.values[k] - explained(&basis[k]);
        let left = (0..basis.len()).map(|k| off(k) / shot.std_errors[k]).collect();
        Self { coefficients, left }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::profile;

    fn shot(gain: f64, error: f64, noise: impl Fn(usize) -> f64) -> EdgeProfile {
        let x_mm: Vec<f64> = (0..360).map(|k| (f64::from(k) + 0.5) / 36.0 - 5.0).collect();
        let values =
            x_mm.iter().enumerate().map(|(k, x)| gain * (0.5 + 0.3 * libm::tanh(*x)) + noise(k)).collect();
        profile(x_mm, values, error)
    }

    /// Alternating by one standard error: scatter that does not exceed the noise.
    fn alternating(sign: f64) -> impl Fn(usize) -> f64 {
        move |k| if k % 2 == 0 { sign * 1e-3 } else { -sign * 1e-3 }
    }

    /// Flicker between shots counts as an error of the gain, not as noise.
    #[test]
    fn flicker_counts_as_gain() {
        let shots = [0.997, 1.0, 1.003].map(|g| shot(g, 1e-3, |_| 0.0));
        let joined = join(&shots.each_ref());
        assert!((joined.between[0] - 0.003).abs() < 1e-4, "{:?}", joined.between);
        let expected = 1e-3 / 3.0_f64.sqrt();
        assert!(joined.profile.std_errors.iter().all(|e| (e / expected - 1.0).abs() < 1e-9));
    }

    /// The flicker of a profile without contrast is found among noise.
    #[test]
    fn flicker_is_found_without_contrast() {
        let dull = |gain: f64, sign: f64| {
            let mut shot = shot(gain, 1e-3, alternating(sign));
            let noise = alternating(sign);
            shot.values =
                (0..360).map(|k| gain * (0.7 + 0.01 * (k as f64 / 180.0 - 1.0)) + noise(k)).collect();
            shot
        };
        let shots = [dull(0.997, 1.0), dull(1.0, -1.0), dull(1.003, 1.0)];
        let joined = join(&shots.each_ref());
        assert!((joined.between[0] - 0.003).abs() < 3e-4, "{:?}", joined.between);
    }

    /// Scatter between shots beyond their noise is included in the standard errors.
    #[test]
    fn excess_scatter_widens_the_errors() {
        let shots = [shot(1.0, 2e-4, alternating(1.0)), shot(1.0, 2e-4, alternating(-1.0))];
        let joined = join(&shots.each_ref());
        // Each is 1e-3 off the mean: two shots have a standard deviation of √2·1e-3, their mean one of 1e-3.
        assert!(joined.profile.std_errors[20..340].iter().all(|e| (e / 1e-3 - 1.0).abs() < 0.01));
    }

    /// Shots of a wedge that was turned by 180° form two groups, whose mean has no slope, however many shots each has.
    #[test]
    fn turned_wedges_average_out() {
        let wedge = |slope: f64, sign: f64| {
            let mut shot = shot(1.0, 1e-3, alternating(sign));
            let x_mm = shot.x_mm.clone();
            shot.values.iter_mut().zip(&x_mm).for_each(|(v, x)| *v *= 1.0 + slope * x / 10.0);
            shot
        };
        let flat = shot(1.0, 1e-3, |_| 0.0);
        let shots = [wedge(0.021, 1.0), wedge(0.02, -1.0), wedge(-0.0205, 1.0)];
        let turned = Turned::find(&join(&shots.each_ref()).slopes).unwrap();
        assert_eq!(turned.rises, [true, true, false]);
        assert!((turned.slope - 0.0205).abs() < 1e-3, "{turned:?}");
        let joined = turned.join(&shots.each_ref());
        let off = joined.profile.values.iter().zip(&flat.values).map(|(v, f)| (v - f).abs());
        assert!(off.fold(0.0, f64::max) < 1.5e-3 && joined.between[2] < 1.5e-3, "{:?}", joined.between);
        for slopes in [[0.02, 0.0, -0.02], [0.001, 0.0, 0.0012], [0.02, 0.012, 0.0]] {
            let shots = slopes.map(|slope| wedge(slope, 1.0));
            assert_eq!(Turned::find(&join(&shots.each_ref()).slopes), None, "{slopes:?}");
        }
        let two = [wedge(0.02, 1.0), wedge(-0.02, 1.0)];
        assert_eq!(Turned::find(&join(&two.each_ref()).slopes), None);
    }

    #[test]
    fn one_shot_is_its_own_mean() {
        let one = shot(1.0, 1e-3, |_| 0.0);
        let joined = join(&[&one]);
        let same = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-12;
        assert!(joined.profile.values.iter().zip(&one.values).all(same));
        assert_eq!(joined.between, [0.0; 4]);
    }
}
