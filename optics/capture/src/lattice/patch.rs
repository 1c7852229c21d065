//! Reads the radiance of the board at patches, which lie along its edges on both sides.

use super::edge::{EdgeFrame, HALF_CROP_MM};
use super::lines::EdgeStretch;
use super::scan::{EdgePoint, Run};
use crate::calibration::Radiance;

/// Pixels on one side of an edge, next to some of its points.
#[derive(Debug)]
pub(crate) struct Patch<'a> {
    stretch: &'a EdgeStretch,
    is_light: bool,
    /// Rows or columns, and the number of them that have a point.
    on: [f64; 2],
    points: usize,
    /// Distance from the edge to the first pixels.
    reach_px: f64,
}

/// Mean radiance factor of a patch in each column.
#[derive(Debug, Clone)]
pub(crate) struct PatchRadiance {
    pub is_light: bool,
    /// Place relative to the crop's middle, across the edge and along it, in units of 10 mm.
    pub place: [f64; 2],
    pub means: Vec<RadianceMean>,
    /// Radiance factor of an offset of 1 over even light, in each column.
    pub of_offset: Vec<f64>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct RadianceMean {
    pub value: f64,
    pub variance: f64,
}

/// Points of an edge that share a patch.
const GROUP: usize = 8;

/// Pixels of a patch across the edge.
const WIDTH_PX: f64 = 10.0;

impl<'a> Patch<'a> {
    /// The patches along a stretch, on both of its sides.
    pub(super) fn of(stretch: &'a EdgeStretch, reach_px: f64) -> impl Iterator<Item = Self> {
        let groups = stretch.points.chunks(GROUP).filter(|group| 2 * group.len() > GROUP);
        groups.flat_map(move |group| {
            let on = [group[0].on, group[group.len() - 1].on];
            [true, false].map(|is_light| Self { stretch, is_light, on, points: group.len(), reach_px })
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

    pub fn read(&self, radiance: &Radiance<'_>, edge: &EdgeFrame) -> PatchRadiance {
        let down = self.stretch.run == Run::Down;
        let frame = radiance.frame;
        let end = if down { frame.width() } else { frame.height() } as f64;
        let mut sums = vec![(0.0, 0.0, 0.0, 0.0); frame.columns().len()];
        let is_after = self.stretch.rises == self.is_light;
        let offset = if is_after { self.reach_px } else { -self.reach_px - WIDTH_PX };
        for on in self.on[0] as usize..=self.on[1] as usize {
            let at = self.stretch.at(on as f64 + 0.5);
            let [from, to] = [at + offset, at + offset + WIDTH_PX].map(|v| v.clamp(0.0, end) as usize);
            for (x, y) in (from..to).map(|at| if down { (at, on) } else { (on, at) }) {
                for site in frame.sites().into_iter().filter(|s| s.has_row(y) && s.has_column(x)) {
                    let sample = radiance.sample(site, x, y);
                    let (value, variance, of_offset, count) = &mut sums[site.colour.index()];
                    *value += sample.value;
                    *variance += sample.variance;
                    *of_offset += sample.of_offset;
                    *count += 1.0;
                }
            }
        }
        let mean = |(value, variance, _, count): &(f64, f64, f64, f64)| {
            let n = count.max(1.0);
            RadianceMean { value: value / n, variance: variance / n.powi(2) }
        };
        let of_offset = sums.iter().map(|(.., of_offset, count)| of_offset / f64::max(*count, 1.0)).collect();
        let on = f64::midpoint(self.on[0], self.on[1]);
        let at = self.stretch.at(on) + offset + 0.5 * WIDTH_PX;
        let place = edge.mm(if down { [at, on] } else { [on, at] }).map(|mm| 0.1 * mm);
        PatchRadiance { is_light: self.is_light, place, means: sums.iter().map(mean).collect(), of_offset }
    }
}

impl PatchRadiance {
    /// Whether it lies within the crop.
    pub fn is_in_crop(&self) -> bool {
        self.place.iter().all(|at| 10.0 * at.abs() < HALF_CROP_MM)
    }

    /// The mean of each patch over several shots.
    pub fn mean(shots: &[Vec<Self>]) -> Vec<Self> {
        let n = shots.len() as f64;
        let mean = |k: usize, c: usize| {
            let sum = |f: fn(&RadianceMean) -> f64| shots.iter().map(|s| f(&s[k].means[c])).sum::<f64>();
            RadianceMean { value: sum(|r| r.value) / n, variance: sum(|r| r.variance) / (n * n) }
        };
        let patches = shots.first().map_or(&[][..], |first| first).iter().enumerate();
        let mean_patch = |(k, patch): (usize, &Self)| {
            let means = (0..patch.means.len()).map(|c| mean(k, c)).collect();
            Self { means, ..patch.clone() }
        };
        patches.map(mean_patch).collect()
    }
}
