//! Whether camera and board are where the bare shots show them.

use super::blurs::blur_px;
use super::light::{FLICKER, Patch, brightest};
use super::lines::Stretch;
use super::scan::{Point, Run, Scan};
use crate::estimate::Estimate;
use crate::least_squares::robust_mean;
use crate::refusal::Refusal;
use crate::view::View;

/// Movement that refuses, in pixels: the bound that the place of the edge is held to. At a quarter of a pixel the
/// contrast at the edge is wrong by 0.8 %, so here by 0.3 %.
const MOVED_PX: f64 = 0.1;

/// Ratio of blurs that refuses.
const BLURRED: f64 = 1.3;

/// Edges of the board as a photograph shows them.
#[derive(Debug, Clone)]
pub(crate) struct Seen {
    scan: Scan,
    /// Up and down, and across.
    stretches: [Vec<Stretch>; 2],
    blur_px: [Option<Estimate>; 2],
}

/// What the free parts of the board show while a slab lies on it.
#[derive(Debug, Clone, Default)]
pub(crate) struct FreeParts {
    pub moved_px: [Option<Estimate>; 2],
    pub blur_px: [Option<Estimate>; 2],
    /// Which of [`Seen::patches`] are free; none if the light of the free board is unknown.
    pub free: Option<Vec<bool>>,
}

const RUNS: [Run; 2] = [Run::Down, Run::Across];

impl Seen {
    pub fn new(view: View<'_>, scan: Scan, stretches: [&[Stretch]; 2]) -> Self {
        let blur = |i: usize| {
            let longest = longest(stretches[i])?;
            let reach = scan.reach_px + 4.0;
            blur_px(view, RUNS[i], &longest.points, longest.slope, reach)
        };
        Self { scan, blur_px: [blur(0), blur(1)], stretches: stretches.map(<[Stretch]>::to_vec) }
    }

    pub fn blur_of(&self, run: Run) -> Option<Estimate> {
        self.blur_px[usize::from(run == Run::Across)]
    }

    pub fn longest(&self, run: Run) -> Option<&Stretch> {
        longest(&self.stretches[usize::from(run == Run::Across)])
    }

    pub fn widest(&self) -> Option<f64> {
        self.blur_px.iter().flatten().map(|b| b.value).reduce(f64::max)
    }

    /// Displacement sideways and up and down of another photograph of the bare board, and which patches it shows.
    pub fn compare(&self, other: &Self) -> FreeParts {
        let points = other.stretches.each_ref().map(|s| s.iter().flat_map(|s| s.points.clone()).collect());
        let within = self.scan.reach_px * 6.0;
        let light = self.light(&points, within);
        let moved_px = std::array::from_fn(|i| {
            displacement(&self.stretches[i], &points[i], within, self.levels(light.unwrap_or(1.0)))
        });
        let free = light.map(|light| self.free(&points, light));
        FreeParts { moved_px, blur_px: other.blur_px, free }
    }

    /// Places by which the light of shots is compared.
    pub fn patches(&self) -> impl Iterator<Item = Patch<'_>> {
        (0..2).flat_map(|i| self.patches_of(i))
    }

    fn patches_of(&self, i: usize) -> impl Iterator<Item = Patch<'_>> {
        self.stretches[i].iter().flat_map(|s| Patch::of(s, self.scan.reach_px + 1.0))
    }

    /// Looks for the board's edges where a slab leaves them free.
    pub fn free_parts(&self, view: View<'_>) -> FreeParts {
        let mut points = self.edges(view, 1.0);
        let mut light = self.light(&points, NEAR_PX);
        for brightness in OTHER_LIGHT {
            if light.is_some() {
                break;
            }
            let others = self.edges(view, brightness);
            light = self.light(&others, NEAR_PX);
            if light.is_some() {
                points = others;
            }
        }
        let levels = self.levels(light.unwrap_or(1.0));
        let free = light.map(|light| self.free(&points, light));
        let mut parts = FreeParts { free, ..FreeParts::default() };
        for (i, (run, points)) in RUNS.into_iter().zip(points).enumerate() {
            let is_own =
                |p: &Point| near(&self.stretches[i], p, NEAR_PX).is_some_and(|bare| bare.fits(p, levels));
            let mut own: Vec<Point> = points.into_iter().filter(is_own).collect();
            parts.moved_px[i] = displacement(&self.stretches[i], &own, NEAR_PX, levels);
            own.sort_by(|a, b| a.on.total_cmp(&b.on));
            parts.blur_px[i] = self.blur_of_free(view, i, run, &own);
        }
        parts
    }

    /// Edges near those of the bare board, under light of this brightness.
    fn edges(&self, view: View<'_>, brightness: f64) -> [Vec<Point>; 2] {
        let scan = Scan { contrast: self.scan.contrast.under(brightness), ..self.scan };
        std::array::from_fn(|i| {
            let run = RUNS[i];
            let end = if run == Run::Down { view.frame().width() } else { view.frame().height() };
            let ranges = |on: f64| {
                let of = |s: &Stretch| {
                    let half = NEAR_PX + scan.reach_px + 12.0;
                    (s.at(on) - half).max(0.0) as usize..((s.at(on) + half).max(0.0) as usize).min(end)
                };
                let along = |s: &&Stretch| (s.from() - 2.0..=s.to() + 2.0).contains(&on);
                self.stretches[i].iter().filter(along).map(of).collect::<Vec<_>>()
            };
            scan.within(view, run, ranges)
        })
    }

    /// Brightness of the free board over that of the bare shot.
    fn light(&self, points: &[Vec<Point>; 2], within: f64) -> Option<f64> {
        let mut ratios = Vec::new();
        for (stretches, points) in self.stretches.iter().zip(points) {
            for point in points {
                let Some(bare) = near(stretches, point, within) else { continue };
                let ratio = point.high / bare.high;
                if bare.is_dark(point, self.levels(ratio)) {
                    ratios.push(ratio);
                }
            }
        }
        brightest(ratios)
    }

    /// Which patches are free, under light of this brightness.
    fn free(&self, points: &[Vec<Point>; 2], light: f64) -> Vec<bool> {
        let levels = Levels { of_high: FLICKER, ..self.levels(light) };
        let of_run = |i: usize| {
            let is_free =
                |p: &&Point| near(&self.stretches[i], p, NEAR_PX).is_some_and(|bare| bare.fits(p, levels));
            let free: Vec<Point> = points[i].iter().filter(is_free).copied().collect();
            self.patches_of(i).map(|patch| patch.is_among(&free, NEAR_PX)).collect::<Vec<_>>()
        };
        [of_run(0), of_run(1)].concat()
    }

    fn levels(&self, light: f64) -> Levels {
        Levels { light, range: self.scan.contrast.range(), of_high: LEVELS[1] }
    }

    /// The sharpest of the longest free stretches.
    fn blur_of_free(&self, view: View<'_>, i: usize, run: Run, own: &[Point]) -> Option<Estimate> {
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

fn longest(stretches: &[Stretch]) -> Option<&Stretch> {
    stretches.iter().max_by(|a, b| a.length().total_cmp(&b.length()))
}

/// Free edges are looked for so near to where they were, in pixels.
const NEAR_PX: f64 = 12.0;

/// Departure of the dark and the light level beside a free edge from the bare board's under the shot's light, as shares
/// of the contrast: noise, and flicker of the light. Where a slab or its blurred rim lies on one side, levels depart by
/// more; at these bounds they shift the edge by less than 0.1 px.
const LEVELS: [f64; 2] = [0.004, 0.012];

/// Brightness at which edges are looked for where none are found under the bare shots' light.
const OTHER_LIGHT: [f64; 6] = [0.8, 1.25, 0.64, 1.56, 0.5, 2.0];

/// So many of the longest free stretches tell the blur.
const LONGEST: usize = 3;

/// Fewest points that tell a movement.
const POINTS: usize = 6;

/// The bare board next to a point: where it has the edge, and the levels on both sides.
struct Bare {
    at: f64,
    low: f64,
    high: f64,
}

/// What levels are compared under: the shot's light over the bare shot's, and the bare contrast.
#[derive(Debug, Clone, Copy)]
struct Levels {
    light: f64,
    range: f64,
    /// Departure of the light level that is let pass, as a share of the contrast.
    of_high: f64,
}

impl Bare {
    fn is_dark(&self, point: &Point, levels: Levels) -> bool {
        (point.low - levels.light * self.low).abs() < LEVELS[0] * levels.light * levels.range
    }

    fn fits(&self, point: &Point, levels: Levels) -> bool {
        let off = (point.high - levels.light * self.high).abs();
        self.is_dark(point, levels) && off < levels.of_high * levels.light * levels.range
    }
}

/// What the bare shot shows of the edge that a point belongs to.
fn near(stretches: &[Stretch], point: &Point, within: f64) -> Option<Bare> {
    stretches
        .iter()
        .filter(|s| s.rises == point.rises && (s.from() - 2.0..=s.to() + 2.0).contains(&point.on))
        .find(|s| (s.at(point.on) - point.at).abs() < within)
        .map(|s| local(s, point))
}

/// The stretch there, from the points next to it: printed and bent lines are not quite straight.
fn local(stretch: &Stretch, point: &Point) -> Bare {
    const AROUND: usize = 4;
    let i = stretch.points.partition_point(|p| p.on < point.on);
    let near = &stretch.points[i.saturating_sub(AROUND)..(i + AROUND).min(stretch.points.len())];
    let mean = |f: &dyn Fn(&Point) -> f64| near.iter().map(f).sum::<f64>() / near.len().max(1) as f64;
    let at = stretch.at(point.on) + mean(&|p| p.at - stretch.at(p.on));
    Bare { at, low: mean(&|p| p.low), high: mean(&|p| p.high) }
}

fn displacement(stretches: &[Stretch], points: &[Point], within: f64, levels: Levels) -> Option<Estimate> {
    let off =
        |p: &Point| near(stretches, p, within).filter(|bare| bare.fits(p, levels)).map(|bare| p.at - bare.at);
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

/// The same blur as in the first shot, and alike in both directions.
pub(crate) fn check_focus(label: &str, session: &Seen, found: &Seen) -> Result<(), Refusal> {
    check_blur(label, session, &found.blur_px)
}

pub(crate) fn check_blur(label: &str, session: &Seen, found: &[Option<Estimate>; 2]) -> Result<(), Refusal> {
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

/// Blur alike in both directions.
pub(crate) fn check_shake(label: &str, found: &Seen) -> Result<(), Refusal> {
    if let [Some(across), Some(along)] = found.blur_px {
        let ratio = across.value / along.value;
        let error = ratio * (across.std_error / across.value).hypot(along.std_error / along.value);
        if ratio.max(1.0 / ratio) > BLURRED + 2.0 * error {
            let (across_px, along_px) = (across.value, along.value);
            return Err(Refusal::Shaken { label: label.to_owned(), across_px, along_px });
        }
    }
    Ok(())
}
