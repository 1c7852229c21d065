//! Measures the light of a shot relative to that of the bare shots, from the parts of the board that are not covered by
//! the slab: a factor, an offset and a slope.
//!
//! At a free edge, the contrast of both sides is multiplied by the same factor, whatever is added to both. A slab lowers the
//! contrast, by scattering, absorption or reflection. So edges with the highest common contrast are free.

use super::patch::PatchRadiance;
use crate::estimate::Estimate;
use crate::frame::{Colour, Photo};
use crate::least_squares::{FittedParameters, NormalEquations, median, spread, tukey};
use crate::light_field::{LightChange, LightField};
use crate::refusal::Refusal;

/// Deviation from the most frequent ratio within which ratios count as equal: noise of one row or column.
const ALIKE: f64 = 0.012;

/// Deviation of a free edge's light side from the most frequent ratio: noise, and bands of flickering lamps.
pub(super) const FLICKER: f64 = 0.025;

/// Fewest edge points that determine a ratio.
const POINTS: usize = 12;

/// A brighter ratio needs the most frequent one's number of points divided by this.
const LEAST_SHARE: usize = 20;

/// The brightest ratio that is frequent enough.
pub(super) fn brightest(mut ratios: Vec<f64>) -> Option<f64> {
    ratios.sort_by(f64::total_cmp);
    let around = |centre: f64, within: f64| {
        let from = ratios.partition_point(|r| *r < centre * (1.0 - within));
        &ratios[from..ratios.partition_point(|r| *r <= centre * (1.0 + within)).max(from)]
    };
    let most = ratios.iter().map(|r| around(*r, ALIKE).len()).max()?;
    let least = POINTS.max(most / LEAST_SHARE);
    let mut centre = *ratios.iter().rev().find(|r| around(**r, ALIKE).len() >= least)?;
    // Mean shift to the densest ratios.
    for _ in 0..30 {
        let near = around(centre, FLICKER);
        centre = near.iter().sum::<f64>() / near.len().max(1) as f64;
    }
    Some(centre)
}

/// Fewest patches that determine a factor.
const PATCHES: usize = 3;

/// Standard deviation of a slope between shots, per 10 mm: the prior, which counts where the free board lies on one side of
/// the slab.
pub(crate) const SLOPE: f64 = 0.002;

/// Standard errors beyond which an offset or a slope is corrected, and their least values.
const CERTAIN: f64 = 4.0;
const LEAST_OFFSET: f64 = 2e-4;
const LEAST_SLOPE: f64 = 5e-4;

/// Standard error of an offset that is subtracted, as a share: stray light is not the same everywhere.
const OFFSET_UNEVEN: f64 = 0.1;

/// The terms of a change: factor, offset, and the slopes.
const TERMS: usize = 4;

/// Light of a shot relative to the bare shots by the free patches, in each column.
pub(crate) fn changes(
    bare: &[PatchRadiance],
    shot: &[PatchRadiance],
    free: &[bool],
) -> Option<Vec<LightChange>> {
    (0..bare.first()?.means.len()).map(|c| change(bare, shot, free, c)).collect()
}

/// A free patch in a bare shot and in another one.
struct PatchPair {
    is_light: bool,
    row: [f64; TERMS],
    value: f64,
    variance: f64,
}

/// Change in one column. Where patches differ by more than noise, the light is uneven, for example by bands of flicker;
/// this error of the factor does not decrease with their number.
pub(crate) fn change(
    bare: &[PatchRadiance],
    shot: &[PatchRadiance],
    free: &[bool],
    c: usize,
) -> Option<LightChange> {
    let pairs = bare.iter().zip(shot).zip(free).filter(|(_, free)| **free).map(|(pair, _)| pair);
    let pairs = pairs.map(|(bare, shot)| {
        let (b, s) = (bare.means[c], shot.means[c]);
        let row = [b.value, bare.of_offset[c], b.value * bare.place[0], b.value * bare.place[1]];
        PatchPair { is_light: bare.is_light, row, value: s.value, variance: b.variance + s.variance }
    });
    let sound = |p: &PatchPair| p.variance > 0.0 && (!p.is_light || (p.row[0] > 0.0 && p.value > 0.0));
    let pairs: Vec<PatchPair> = pairs.filter(sound).collect();
    if pairs.iter().filter(|p| p.is_light).count() < PATCHES {
        return None;
    }
    let whole_fit = fit(&pairs, [true; TERMS], SLOPE)?;
    let whole = &whole_fit.found;
    let is_certain = |i: usize, least: f64| whole.x[i].abs() > least.max(CERTAIN * whole.std_error(i));
    let sloped = (2..TERMS).any(|i| is_certain(i, LEAST_SLOPE));
    let used = [true, is_certain(1, LEAST_OFFSET), sloped, sloped];
    // A slope that is certain has a wide prior.
    let LightFit { found, uneven, dark_scatter } = fit(&pairs, used, LEVELLED)?;
    // A term that is not corrected counts as error.
    let term = |i: usize| {
        if used[i] {
            Estimate::new(found.x[i], found.std_error(i))
        } else {
            Estimate::new(0.0, libm::hypot(whole.x[i], whole.std_error(i)))
        }
    };
    let factor = less_chance(Estimate::new(found.x[0], found.std_error(0)));
    let offset = term(1);
    let offset_error =
        [offset.std_error, OFFSET_UNEVEN * offset.value, dark_scatter].into_iter().fold(0.0, libm::hypot);
    let relative = |e: Estimate| Estimate::new(e.value / factor.value, e.std_error / factor.value);
    let errors = [factor.std_error, factor.value * uneven, whole.std_error(0)];
    Some(LightChange {
        factor: Estimate::new(factor.value, errors.iter().map(|e| e * e).sum::<f64>().sqrt()),
        offset: Estimate::new(offset.value, offset_error),
        slope: [relative(term(2)), relative(term(3))],
    })
}

/// Some of the terms, the unevenness of the light, relative, and the scatter of dark patches, both beyond their noise.
struct LightFit {
    found: FittedParameters,
    uneven: f64,
    dark_scatter: f64,
}

/// Robust fit of some of the terms, with the prior of slopes.
fn fit(pairs: &[PatchPair], used: [bool; TERMS], slope_prior: f64) -> Option<LightFit> {
    let mut weights = vec![1.0; pairs.len()];
    let (mut uneven, mut dark_scatter) = (0.0, 0.0);
    let mut fitted = None;
    for _ in 0..8 {
        let variance = |p: &PatchPair, uneven: f64, dark_scatter: f64| {
            let excess = if p.is_light { uneven * p.row[0] } else { dark_scatter };
            p.variance + excess * excess
        };
        let mut normal = NormalEquations::new(TERMS);
        for (p, weight) in pairs.iter().zip(&weights) {
            let row: [f64; TERMS] = std::array::from_fn(|i| if used[i] { p.row[i] } else { 0.0 });
            normal.add(&row, p.value, weight / variance(p, uneven, dark_scatter));
        }
        for i in 0..TERMS {
            let mut row = [0.0; TERMS];
            row[i] = 1.0;
            // A term that is not used is 0.
            let weight = if used[i] { slope_prior.powi(-2) } else { 1.0 };
            if !used[i] || i > 1 {
                normal.add(&row, 0.0, weight);
            }
        }
        let found = normal.solve()?;
        let model = |p: &PatchPair| p.row.iter().zip(found.x.iter()).map(|(r, x)| r * x).sum::<f64>();
        let residuals: Vec<f64> = pairs.iter().map(|p| p.value - model(p)).collect();
        let excess = |is_light: bool, scale: fn(&PatchPair) -> f64| {
            let kind = pairs.iter().zip(&residuals).filter(move |(p, _)| p.is_light == is_light);
            let (all, variances): (Vec<f64>, Vec<f64>) =
                kind.map(|(p, r)| (r / scale(p), p.variance / scale(p).powi(2))).unzip();
            beyond_noise(&all, variances)
        };
        (uneven, dark_scatter) = (excess(true, |p| p.row[0]), excess(false, |_| 1.0));
        let sigma = |p: &PatchPair| variance(p, uneven, dark_scatter).sqrt();
        weights = pairs.iter().zip(&residuals).map(|(p, r)| tukey(r / sigma(p))).collect();
        fitted = Some(LightFit { found, uneven, dark_scatter });
    }
    fitted
}

/// Spread beyond three standard deviations of a spread by noise of these variances; 0 without values.
fn beyond_noise(values: &[f64], mut variances: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let chance = median(&mut variances) * (1.0 + 3.0 * (2.7 / values.len() as f64).sqrt());
    (spread(values).powi(2) - chance).max(0.0).sqrt()
}

/// Shrinks a change by up to three standard errors, so that steady light is left unchanged. The shrinkage is added to
/// its error.
fn less_chance(factor: Estimate) -> Estimate {
    let change = factor.value - 1.0;
    let lost = change.abs().min(9.0 * factor.std_error.powi(2) / change.abs().max(f64::MIN_POSITIVE));
    Estimate::new(factor.value - lost.copysign(change), libm::hypot(factor.std_error, lost))
}

/// Largest offset that is subtracted, and largest slope per 10 mm that is divided out.
const SUBTRACTED: f64 = 0.03;
const LEVELLED: f64 = 0.03;

/// Largest relative change of the light that is divided out: 5 %, plus the flicker of lamps.
const DIVIDED_OUT: f64 = 0.055;

/// Refuses a shot whose light differs too much from that of the bare shots.
pub(crate) fn check(photo: &Photo, light: &[LightChange]) -> Result<(), Refusal> {
    let beyond = |change: fn(&LightChange) -> Estimate, allowed: f64| {
        let certain = |l: &&LightChange| change(l).value.abs() - 3.0 * change(l).std_error > allowed;
        let columns = photo.frame.columns().iter().copied().zip(light).filter(|(_, l)| certain(l));
        let most = columns.max_by(|a, b| change(a.1).value.abs().total_cmp(&change(b.1).value.abs()))?;
        Some((most.0, 100.0 * change(most.1).value, 100.0 * allowed))
    };
    let label = photo.label.clone();
    if let Some((colour, percent, allowed)) = beyond(|l| l.offset, SUBTRACTED) {
        return Err(Refusal::LightAdded { label, colour, percent, allowed });
    }
    if let Some((colour, percent, allowed)) = beyond(LightChange::steepest, LEVELLED) {
        return Err(Refusal::LightTurned { label, colour, percent, allowed, since: "the bare shots" });
    }
    let factor = |l: &LightChange| Estimate::new(l.factor.value - 1.0, l.factor.std_error);
    match beyond(factor, DIVIDED_OUT) {
        Some((colour, percent, allowed)) => Err(Refusal::LightChanged { label, colour, percent, allowed }),
        None => Ok(()),
    }
}

/// Refuses a bare shot whose light is too uneven for a correction.
pub(crate) fn check_field(photo: &Photo, fields: &[LightField], has_flat: bool) -> Result<(), Refusal> {
    let slopes = photo.frame.columns().iter().zip(fields).map(|(colour, field)| (*colour, field.steepest()));
    match slopes.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())) {
        Some((colour, slope)) if slope.abs() > LEVELLED => Err(Refusal::LightTurned {
            label: photo.label.clone(),
            colour,
            percent: 100.0 * slope,
            allowed: 100.0 * LEVELLED,
            since: if has_flat { "the flat shots" } else { "even light, since there are no flat shots" },
        }),
        _ => Ok(()),
    }
}

/// The column in which something of the light has changed most.
pub(crate) fn largest(
    photo: &Photo,
    light: &[LightChange],
    change: impl Fn(&LightChange) -> Estimate,
) -> (Colour, Estimate) {
    let changes = photo.frame.columns().iter().copied().zip(light.iter().map(change));
    let most = changes.max_by(|a, b| a.1.value.abs().total_cmp(&b.1.value.abs()));
    most.unwrap_or((Colour::Mono, Estimate::default()))
}

/// Errors of the mean light of several shots.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LightErrors {
    /// Relative.
    pub factor: f64,
    /// As a radiance factor.
    pub offset: f64,
    /// Relative, per 10 mm across the edge.
    pub slope: f64,
}

/// Errors of the mean light of several shots: their differences, and the errors of these.
pub(crate) fn spread_of(shots: &[Vec<PatchRadiance>], columns: usize) -> Vec<LightErrors> {
    let n = shots.len() as f64;
    let against_others = (0..shots.len()).filter_map(|j| {
        let others: Vec<_> =
            shots.iter().enumerate().filter(|(k, _)| *k != j).map(|(_, s)| s.clone()).collect();
        changes(&PatchRadiance::mean(&others), &shots[j], &vec![true; shots[j].len()])
    });
    let mut squares = vec![[0.0_f64; 3]; columns];
    for change in against_others {
        for (sums, l) in squares.iter_mut().zip(change) {
            let parts = [
                (l.factor.value - 1.0, l.factor),
                (l.offset.value, l.offset),
                (l.slope[0].value, l.slope[0]),
            ];
            for (sum, (value, estimate)) in sums.iter_mut().zip(parts) {
                // A shot's difference from the mean of the others is n/(n − 1) times that from the mean of all.
                *sum += (value.powi(2) + estimate.std_error.powi(2)) * (n - 1.0) / n.powi(3);
            }
        }
    }
    let errors = |sums: [f64; 3]| {
        let [factor, offset, slope] = sums.map(f64::sqrt);
        LightErrors { factor, offset, slope }
    };
    squares.into_iter().map(errors).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scattered(centre: f64, count: usize) -> Vec<f64> {
        (0..count).map(|i| centre * (1.0 + 0.01 * (i as f64 / count as f64 - 0.5))).collect()
    }

    /// The brightest ratio that is common to many points is that of the free board.
    #[test]
    fn brightest_common_ratio_is_the_free_board() {
        // A clear slab over most of the board reduces the light by 8 %, the lamps by 5 %; single points are brighter by
        // chance.
        let mut ratios = scattered(0.95 * 0.92, 900);
        ratios.extend(scattered(0.95, 100));
        ratios.extend([1.02, 1.05, 1.1]);
        let found = brightest(ratios).unwrap();
        assert!((found / 0.95 - 1.0).abs() < 1e-3, "{found}");
        assert_eq!(brightest(scattered(1.0, POINTS - 1)), None);
    }

    /// A change within three standard errors counts as none, and widens the error.
    #[test]
    fn insignificant_change_is_ignored() {
        let estimate = |change: f64| less_chance(Estimate::new(1.0 + change, 1e-3));
        assert!([0.0, 1e-3, -2.9e-3].into_iter().all(|change| (estimate(change).value - 1.0).abs() < 1e-12));
        assert!((estimate(-2.9e-3).std_error / libm::hypot(1e-3, 2.9e-3) - 1.0).abs() < 1e-9);
        let far = estimate(-0.04);
        assert!((far.value - 0.960_225).abs() < 1e-9 && far.std_error < 1.03e-3, "{far:?}");
    }
}
