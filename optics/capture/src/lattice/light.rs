//! Measures the light of a shot relative to that of the bare shots, from the parts of the board that are not covered by
//! the slab.
//!
//! At a free edge, both sides are brighter by the same factor. A slab that scatters makes the dark side too bright for
//! it, and one that does not scatter dims the light side. So among the edges whose dark side is as dark as the bare
//! one, those with the brightest common light side are free.

use super::lines::EdgeStretch;
use super::scan::{EdgePoint, Run};
use crate::calibration::Radiance;
use crate::estimate::Estimate;
use crate::frame::Photo;
use crate::least_squares::{median, robust_mean, spread};
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

/// Pixels on the light side of an edge, next to some of its points.
#[derive(Debug)]
pub(crate) struct Patch<'a> {
    stretch: &'a EdgeStretch,
    /// Rows or columns, and the number of them that have a point.
    on: [f64; 2],
    points: usize,
    /// Distance from the edge to the first pixels.
    reach_px: f64,
}

/// Mean radiance factor of a patch in each colour.
#[derive(Debug, Clone)]
pub(crate) struct PatchRadiance(Vec<RadianceMean>);

#[derive(Debug, Clone, Copy)]
struct RadianceMean {
    value: f64,
    variance: f64,
}

/// Points of an edge that share a patch.
const GROUP: usize = 8;

/// Pixels of a patch across the edge.
const WIDTH_PX: f64 = 10.0;

/// Fewest patches that determine a factor.
const PATCHES: usize = 3;

impl<'a> Patch<'a> {
    pub(super) fn of(stretch: &'a EdgeStretch, reach_px: f64) -> impl Iterator<Item = Self> {
        let groups = stretch.points.chunks(GROUP).filter(|group| 2 * group.len() > GROUP);
        groups.map(move |group| Self {
            stretch,
            on: [group[0].on, group[group.len() - 1].on],
            points: group.len(),
            reach_px,
        })
    }

    /// Whether all its points are free points of a shot.
    pub(super) fn is_among(&self, free: &[EdgePoint], within_px: f64) -> bool {
        let own = |p: &&EdgePoint| {
            p.rises == self.stretch.rises
                && (self.on[0]..=self.on[1]).contains(&p.on)
                && (self.stretch.at(p.on) - p.at).abs() < within_px
        };
        free.iter().filter(own).count() >= self.points
    }

    pub fn read(&self, radiance: &Radiance<'_>) -> PatchRadiance {
        let down = self.stretch.run == Run::Down;
        let frame = radiance.frame;
        let end = if down { frame.width() } else { frame.height() } as f64;
        let mut sums = vec![(0.0, 0.0, 0.0); frame.columns().len()];
        for on in self.on[0] as usize..=self.on[1] as usize {
            let edge = self.stretch.at(on as f64 + 0.5);
            let offset = if self.stretch.rises { self.reach_px } else { -self.reach_px - WIDTH_PX };
            let [from, to] = [edge + offset, edge + offset + WIDTH_PX].map(|v| v.clamp(0.0, end) as usize);
            for (x, y) in (from..to).map(|at| if down { (at, on) } else { (on, at) }) {
                for site in frame.sites().into_iter().filter(|s| s.has_row(y) && s.has_column(x)) {
                    let sample = radiance.sample(site, x, y);
                    let (value, variance, count) = &mut sums[site.colour.index()];
                    *value += sample.value;
                    *variance += sample.variance;
                    *count += 1.0;
                }
            }
        }
        let mean = |(value, variance, count): (f64, f64, f64)| {
            let n = f64::max(count, 1.0);
            RadianceMean { value: value / n, variance: variance / n.powi(2) }
        };
        PatchRadiance(sums.into_iter().map(mean).collect())
    }
}

impl PatchRadiance {
    /// The mean of each patch over several shots.
    pub fn mean(shots: &[Vec<Self>]) -> Vec<Self> {
        let n = shots.len() as f64;
        let mean = |k: usize, c: usize| {
            let sum = |f: fn(&RadianceMean) -> f64| shots.iter().map(|shot| f(&shot[k].0[c])).sum::<f64>();
            RadianceMean { value: sum(|r| r.value) / n, variance: sum(|r| r.variance) / (n * n) }
        };
        let patches = shots.first().map_or(&[][..], |first| first).iter().enumerate();
        patches.map(|(k, patch)| Self((0..patch.0.len()).map(|c| mean(k, c)).collect())).collect()
    }
}

/// Brightness of a shot relative to the bare shots at the free patches, in each colour.
pub(crate) fn factor(bare: &[PatchRadiance], shot: &[PatchRadiance], free: &[bool]) -> Option<Vec<Estimate>> {
    (0..bare.first()?.0.len()).map(|c| channel_factor(bare, shot, free, c)).collect()
}

/// Brightness in one colour. Where patches differ by more than noise, the light is uneven, for example by bands of flicker;
/// this error of the factor does not decrease with their number.
pub(crate) fn channel_factor(
    bare: &[PatchRadiance],
    shot: &[PatchRadiance],
    free: &[bool],
    c: usize,
) -> Option<Estimate> {
    let pairs = bare.iter().zip(shot).zip(free).filter(|(_, free)| **free).map(|(pair, _)| pair);
    let relative = |r: RadianceMean| r.variance.sqrt() / r.value;
    let sound = pairs.map(|(bare, shot)| (bare.0[c], shot.0[c]));
    let sound = sound.filter(|(bare, shot)| bare.value > 0.0 && shot.value > 0.0);
    let (ratios, mut noise): (Vec<f64>, Vec<f64>) =
        sound.map(|(b, s)| (s.value / b.value, libm::hypot(relative(b), relative(s)))).unzip();
    if ratios.len() < PATCHES {
        return None;
    }
    let n = ratios.len() as f64;
    let (value, _) = robust_mean(&ratios);
    let noise = median(&mut noise);
    // Three standard deviations of a spread due to chance.
    let chance = noise * noise * (1.0 + 3.0 * (2.7 / n).sqrt());
    let uneven = ((spread(&ratios) / value).powi(2) - chance).max(0.0).sqrt();
    let steady = less_chance(Estimate::new(value, value * noise / n.sqrt()));
    Some(Estimate::new(steady.value, libm::hypot(steady.std_error, value * uneven)))
}

/// Shrinks a change by up to three standard errors, so that steady light is left unchanged. The shrinkage is added to
/// its error.
fn less_chance(factor: Estimate) -> Estimate {
    let change = factor.value - 1.0;
    let lost = change.abs().min(9.0 * factor.std_error.powi(2) / change.abs().max(f64::MIN_POSITIVE));
    Estimate::new(factor.value - lost.copysign(change), libm::hypot(factor.std_error, lost))
}

/// Largest relative change of the light that is divided out: 5 %, plus the flicker of lamps.
const DIVIDED_OUT: f64 = 0.055;

/// Refuses a shot whose light differs too much from that of the bare shots.
pub(crate) fn check(photo: &Photo, light: &[Estimate]) -> Result<(), Refusal> {
    let beyond = |l: &Estimate| (l.value - 1.0).abs() - 3.0 * l.std_error > DIVIDED_OUT;
    let changes = photo.frame.columns().iter().zip(light).filter(|(_, l)| beyond(l));
    match changes.max_by(|a, b| (a.1.value - 1.0).abs().total_cmp(&(b.1.value - 1.0).abs())) {
        None => Ok(()),
        Some((colour, change)) => {
            let percent = 100.0 * (change.value - 1.0);
            Err(Refusal::LightChanged {
                label: photo.label.clone(),
                colour: *colour,
                percent,
                allowed: 100.0 * DIVIDED_OUT,
            })
        }
    }
}

/// Relative error of the mean light of several shots: their differences, and the unevenness of these.
pub(crate) fn spread_of(shots: &[Vec<PatchRadiance>], columns: usize) -> Vec<f64> {
    let n = shots.len() as f64;
    let against_others = (0..shots.len()).filter_map(|j| {
        let others: Vec<_> =
            shots.iter().enumerate().filter(|(k, _)| *k != j).map(|(_, s)| s.clone()).collect();
        factor(&PatchRadiance::mean(&others), &shots[j], &vec![true; shots[j].len()])
    });
    let mut squares = vec![0.0_f64; columns];
    for factor in against_others {
        for (sum, f) in squares.iter_mut().zip(factor) {
            // A shot's difference from the mean of the others is n/(n − 1) times that from the mean of all.
            *sum += ((f.value - 1.0).powi(2) + f.std_error.powi(2)) * (n - 1.0) / n.powi(3);
        }
    }
    squares.into_iter().map(f64::sqrt).collect()
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
