//! Checks that camera and board have not moved since the bare shots, by the free edges of the board.

use super::blurs::blur_px;
use super::edge::{EdgeFrame, HALF_CROP_MM};
use super::light::{FLICKER, brightest};
use super::lines::EdgeStretch;
use super::patch::Patch;
use super::scan::{EdgePoint, EdgeScan, Run};
use crate::estimate::Estimate;
use crate::least_squares::{median, robust_mean};
use crate::refusal::Refusal;
use crate::view::PhotoView;

/// Movement above which a shot is refused, in pixels. It bounds the error of the edge's place: a quarter of a pixel
/// changes the contrast at the edge by 0.8 %, and this bound by 0.3 %.
const MOVED_PX: f64 = 0.1;

/// Ratio of blurs above which a shot is refused.
const BLURRED: f64 = 1.3;

/// Edges of the board in a photograph.
#[derive(Debug, Clone)]
pub(crate) struct BoardEdges {
    scan: EdgeScan,
    /// Stretches that run up and down, and across.
    stretches: [Vec<EdgeStretch>; 2],
    blur_px: [Option<Estimate>; 2],
}

/// Movement, blur and patches from the free parts of the board, while a slab lies on it.
#[derive(Debug, Clone, Default)]
pub(crate) struct FreeParts {
    pub moved_px: [Option<Estimate>; 2],
    pub blur_px: [Option<Estimate>; 2],
    /// Whether each of [`BoardEdges::patches`] is free; None if the light of the free board is unknown.
    pub free: Option<Vec<bool>>,
}

const RUNS: [Run; 2] = [Run::Down, Run::Across];

impl BoardEdges {
    pub fn new(view: PhotoView<'_>, scan: EdgeScan, stretches: [&[EdgeStretch]; 2]) -> Self {
        let blur = |i: usize| {
            let longest = longest(stretches[i])?;
            let reach = scan.reach_px + 4.0;
            blur_px(view, RUNS[i], &longest.points, longest.slope, reach)
        };
        Self { scan, blur_px: [blur(0), blur(1)], stretches: stretches.map(<[EdgeStretch]>::to_vec) }
    }

    pub fn blur_of(&self, run: Run) -> Option<Estimate> {
        self.blur_px[usize::from(run == Run::Across)]
    }

    pub fn longest(&self, run: Run) -> Option<&EdgeStretch> {
        longest(&self.stretches[usize::from(run == Run::Across)])
    }

    pub fn widest(&self) -> Option<f64> {
        self.blur_px.iter().flatten().map(|b| b.value).reduce(f64::max)
    }

    /// Displacement of another photograph of the bare board, sideways and up and down, and the patches that it shows.
    pub fn compare(&self, other: &Self) -> FreeParts {
        let points = other.stretches.each_ref().map(|s| s.iter().flat_map(|s| s.points.clone()).collect());
        let within = self.scan.reach_px * 6.0;
        let light = self.light(&points, within);
        let moved_px = std::array::from_fn(|i| {
            displacement(&self.stretches[i], &points[i], within, self.levels(light.unwrap_or_default()))
        });
        let free = light.map(|light| self.free(&points, light, UNEVEN));
        FreeParts { moved_px, blur_px: other.blur_px, free }
    }

    /// The patches at which the light of shots is compared.
    pub fn patches(&self) -> impl Iterator<Item = Patch<'_>> {
        (0..2).flat_map(|i| self.patches_of(i))
    }

    fn patches_of(&self, i: usize) -> impl Iterator<Item = Patch<'_>> {
        self.stretches[i].iter().flat_map(|s| Patch::of(s, self.scan.reach_px + 1.0))
    }

    /// Finds the edges of the board that are not covered by a slab, which lies on the edge in use.
    pub fn free_parts(&self, view: PhotoView<'_>, edge: &EdgeFrame) -> FreeParts {
        let mut points = self.edges(view, [1.0, 0.0]);
        let mut light = self.light(&points, NEAR_PX);
        for other in OTHER_LIGHT {
            if light.is_some() {
                break;
            }
            let others = self.edges(view, other);
            light = self.light(&others, NEAR_PX);
            if light.is_some() {
                points = others;
            }
        }
        let levels = self.levels(light.unwrap_or_default());
        let free = light.map(|light| {
            let high_bound = if self.scatters(&points, light, edge) { UNEVEN } else { FLICKER };
            self.free(&points, light, high_bound)
        });
        let mut parts = FreeParts { free, ..FreeParts::default() };
        for (i, (run, points)) in RUNS.into_iter().zip(points).enumerate() {
            let is_own =
                |p: &EdgePoint| near(&self.stretches[i], p, NEAR_PX).is_some_and(|bare| bare.fits(p, levels));
            let mut own: Vec<EdgePoint> = points.into_iter().filter(is_own).collect();
            parts.moved_px[i] = displacement(&self.stretches[i], &own, NEAR_PX, levels);
            own.sort_by(|a, b| a.on.total_cmp(&b.on));
            parts.blur_px[i] = self.blur_of_free(view, i, run, &own);
        }
        parts
    }

    /// Edges near those of the bare board, under light of this brightness and with this share of the contrast added.
    fn edges(&self, view: PhotoView<'_>, [brightness, added]: [f64; 2]) -> [Vec<EdgePoint>; 2] {
        let scan = EdgeScan { contrast: self.scan.contrast.under(brightness, added), ..self.scan };
        std::array::from_fn(|i| {
            let run = RUNS[i];
            let end = if run == Run::Down { view.frame().width() } else { view.frame().height() };
            let ranges = |on: f64| {
                let range = |s: &EdgeStretch| {
                    let half = NEAR_PX + scan.reach_px + 12.0;
                    (s.at(on) - half).max(0.0) as usize..((s.at(on) + half).max(0.0) as usize).min(end)
                };
                let along = |s: &&EdgeStretch| (s.from() - 2.0..=s.to() + 2.0).contains(&on);
                self.stretches[i].iter().filter(along).map(range).collect::<Vec<_>>()
            };
            scan.within(view, run, ranges)
        })
    }

    /// Light of the free board relative to the bare shot.
    fn light(&self, points: &[Vec<EdgePoint>; 2], within: f64) -> Option<FreeLight> {
        let pairs = self.stretches.iter().zip(points).flat_map(|(stretches, points)| {
            points.iter().filter_map(move |point| Some((point, near(stretches, point, within)?)))
        });
        let light = |(point, bare): (&EdgePoint, Bare)| {
            let factor = (point.high - point.low) / (bare.high - bare.low);
            FreeLight { factor, offset: point.low - factor * bare.low }
        };
        let possible = |l: &FreeLight| l.offset.abs() < OFFSET * l.factor * self.scan.contrast.range();
        let all: Vec<FreeLight> = pairs.map(light).filter(possible).collect();
        let factor = brightest(all.iter().map(|l| l.factor).collect())?;
        let own = all.iter().filter(|l| (l.factor / factor - 1.0).abs() < FLICKER);
        Some(FreeLight { factor, offset: median(&mut own.map(|l| l.offset).collect::<Vec<_>>()) })
    }

    /// Whether the slab in the crop makes its dark side brighter than the free board's: then every edge whose dark side
    /// is as dark as that is free, however uneven the light.
    fn scatters(&self, points: &[Vec<EdgePoint>; 2], light: FreeLight, edge: &EdgeFrame) -> bool {
        let levels = self.levels(light);
        let in_crop =
            |run: Run, point: &EdgePoint| edge.mm(point.px(run)).iter().all(|mm| mm.abs() < HALF_CROP_MM);
        let (mut dark, mut all) = (0, 0);
        for (i, run) in RUNS.into_iter().enumerate() {
            for point in points[i].iter().filter(|point| in_crop(run, point)) {
                let Some(bare) = near(&self.stretches[i], point, NEAR_PX) else { continue };
                (dark, all) = (dark + usize::from(bare.is_dark(point, levels)), all + 1);
            }
        }
        2 * dark <= all
    }

    /// Whether each patch is free, under this light: the light side deviates by `high_bound` of the contrast at most.
    fn free(&self, points: &[Vec<EdgePoint>; 2], light: FreeLight, high_bound: f64) -> Vec<bool> {
        let levels = LevelBounds { high_bound, ..self.levels(light) };
        let free_patches = |i: usize| {
            let is_free = |p: &&EdgePoint| {
                near(&self.stretches[i], p, NEAR_PX).is_some_and(|bare| bare.fits(p, levels))
            };
            let free: Vec<EdgePoint> = points[i].iter().filter(is_free).copied().collect();
            self.patches_of(i).map(|patch| patch.is_among(&free, NEAR_PX)).collect::<Vec<_>>()
        };
        [free_patches(0), free_patches(1)].concat()
    }

    fn levels(&self, light: FreeLight) -> LevelBounds {
        LevelBounds { light, range: self.scan.contrast.range(), high_bound: LEVELS[1] }
    }

    /// The sharpest of the longest free stretches.
    fn blur_of_free(&self, view: PhotoView<'_>, i: usize, run: Run, own: &[EdgePoint]) -> Option<Estimate> {
        let slope = self.stretches[i].first().map_or(0.0, |s| s.slope);
        let mut free = super::lines::stretches(own, run, 0.0);
        free.sort_by(|a, b| b.length().total_cmp(&a.length()));
        let blurs = free.iter().take(LONGEST).filter_map(|stretch| {
            let blur = blur_px(view, run, &stretch.points, slope, self.scan.reach_px + 4.0)?;
            (blur.std_error < 0.07 * blur.value).then_some(blur)
        });
        blurs.min_by(|a, b| a.std_error.total_cmp(&b.std_error))
    }
}

fn longest(stretches: &[EdgeStretch]) -> Option<&EdgeStretch> {
    stretches.iter().max_by(|a, b| a.length().total_cmp(&b.length()))
}

/// Search range for free edges around their place in the bare shot, in pixels.
const NEAR_PX: f64 = 12.0;

/// Deviation of the dark and the light level next to a free edge from the bare board's under the shot's light, as
/// shares of the contrast: noise, and flicker of the light. Where a slab or its blurred rim lies on one side, levels
/// deviate by more; at these bounds the edge shifts by less than 0.1 px.
const LEVELS: [f64; 2] = [0.004, 0.012];

/// Deviation of a free edge's light side, where the slab scatters: slopes of the light.
const UNEVEN: f64 = 0.1;

/// Largest offset of a free edge, as a share of its contrast.
const OFFSET: f64 = 0.35;

/// Brightnesses, and shares of the contrast that are added, which are tried if no edges are found under the bare shots'
/// light.
const OTHER_LIGHT: [[f64; 2]; 8] =
    [[0.8, 0.0], [1.25, 0.0], [0.64, 0.0], [1.56, 0.0], [0.5, 0.0], [2.0, 0.0], [0.9, 0.15], [0.7, 0.2]];

/// Number of the longest free stretches that are used for the blur.
const LONGEST: usize = 3;

/// Fewest points that determine a movement.
const POINTS: usize = 6;

/// The bare board next to a point: the place of the edge, and the levels on both sides.
struct Bare {
    at: f64,
    low: f64,
    high: f64,
}

/// Light of a shot relative to the bare shot, by its edges: a factor, and what is added to both sides, in numbers.
#[derive(Debug, Clone, Copy)]
struct FreeLight {
    factor: f64,
    offset: f64,
}

impl Default for FreeLight {
    fn default() -> Self {
        Self { factor: 1.0, offset: 0.0 }
    }
}

impl FreeLight {
    fn level(self, bare: f64) -> f64 {
        self.factor * bare + self.offset
    }
}

/// Conditions for comparing levels: the shot's light, and the bare contrast.
#[derive(Debug, Clone, Copy)]
struct LevelBounds {
    light: FreeLight,
    range: f64,
    /// Accepted deviation of the light level, as a share of the contrast.
    high_bound: f64,
}

impl Bare {
    fn is_dark(&self, point: &EdgePoint, levels: LevelBounds) -> bool {
        (point.low - levels.light.level(self.low)).abs() < LEVELS[0] * levels.light.factor * levels.range
    }

    fn fits(&self, point: &EdgePoint, levels: LevelBounds) -> bool {
        let off = (point.high - levels.light.level(self.high)).abs();
        self.is_dark(point, levels) && off < levels.high_bound * levels.light.factor * levels.range
    }
}

/// The bare edge that a point belongs to.
fn near(stretches: &[EdgeStretch], point: &EdgePoint, within: f64) -> Option<Bare> {
    stretches
        .iter()
        .filter(|s| s.rises == point.rises && (s.from() - 2.0..=s.to() + 2.0).contains(&point.on))
        .find(|s| (s.at(point.on) - point.at).abs() < within)
        .map(|s| local(s, point))
}

/// The stretch at a point, from neighbouring points, since printed and bent lines are not quite straight.
fn local(stretch: &EdgeStretch, point: &EdgePoint) -> Bare {
    const AROUND: usize = 4;
    let i = stretch.points.partition_point(|p| p.on < point.on);
    let near = &stretch.points[i.saturating_sub(AROUND)..(i + AROUND).min(stretch.points.len())];
    let mean = |f: &dyn Fn(&EdgePoint) -> f64| near.iter().map(f).sum::<f64>() / near.len().max(1) as f64;
    let at = stretch.at(point.on) + mean(&|p| p.at - stretch.at(p.on));
    Bare { at, low: mean(&|p| p.low), high: mean(&|p| p.high) }
}

fn displacement(
    stretches: &[EdgeStretch],
    points: &[EdgePoint],
    within: f64,
    levels: LevelBounds,
) -> Option<Estimate> {
    let off = |p: &EdgePoint| {
        near(stretches, p, within).filter(|bare| bare.fits(p, levels)).map(|bare| p.at - bare.at)
    };
    let all: Vec<f64> = points.iter().filter_map(off).collect();
    if all.len() < POINTS {
        return None;
    }
    let (mean, std_error) = robust_mean(&all);
    Some(Estimate::new(mean, std_error))
}

pub(crate) fn check(label: &str, moved_px: &[Option<Estimate>; 2]) -> Result<(), Refusal> {
    let far = |m: &Estimate| m.value.abs() > MOVED_PX && m.value.abs() > MOVED_PX + 3.0 * m.std_error;
    if moved_px.iter().flatten().any(far) {
        let [dx_px, dy_px] = moved_px.map(|m| m.map_or(0.0, |m| m.value));
        return Err(Refusal::Moved { label: label.to_owned(), dx_px, dy_px, allowed_px: MOVED_PX });
    }
    Ok(())
}

/// Checks that the blur is that of the first shot, and equal in both directions.
pub(crate) fn check_focus(label: &str, session: &BoardEdges, found: &BoardEdges) -> Result<(), Refusal> {
    check_blur(label, session, &found.blur_px)
}

pub(crate) fn check_blur(
    label: &str,
    session: &BoardEdges,
    found: &[Option<Estimate>; 2],
) -> Result<(), Refusal> {
    for (now, then) in found.iter().zip(&session.blur_px) {
        if let (Some(now), Some(then)) = (now, then) {
            let times = now.value / then.value;
            if times > BLURRED + 2.0 * now.std_error / then.value {
                let (blur_px, session_px) = (now.value, then.value);
                return Err(Refusal::Defocused { label: label.to_owned(), blur_px, session_px, times });
            }
        }
    }
    Ok(())
}

/// Checks that the blur is equal in both directions.
pub(crate) fn check_shake(label: &str, found: &BoardEdges) -> Result<(), Refusal> {
    if let [Some(across), Some(along)] = found.blur_px {
        let ratio = across.value / along.value;
        let error = ratio * libm::hypot(across.std_error / across.value, along.std_error / along.value);
        if ratio.max(1.0 / ratio) > BLURRED + 2.0 * error {
            let (across_px, along_px) = (across.value, along.value);
            return Err(Refusal::Shaken { label: label.to_owned(), across_px, along_px });
        }
    }
    Ok(())
}
