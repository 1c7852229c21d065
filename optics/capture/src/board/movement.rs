//! Whether camera and board are where the bare shots show them.

use super::blurs::blur_px;
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

    /// Displacement sideways and up and down of another photograph of the bare board.
    pub fn movement(&self, other: &Self) -> [Option<Estimate>; 2] {
        std::array::from_fn(|i| {
            let points: Vec<Point> = other.stretches[i].iter().flat_map(|s| s.points.clone()).collect();
            let square = self.scan.reach_px * 6.0;
            displacement(&self.stretches[i], &points, square, self.scan.contrast.range())
        })
    }

    /// Looks for the board's edges where a slab leaves them free.
    pub fn free_parts(&self, view: View<'_>) -> FreeParts {
        let mut parts = FreeParts::default();
        let (scan, range) = (self.scan, self.scan.contrast.range());
        for (i, run) in RUNS.into_iter().enumerate() {
            let end = if run == Run::Down { view.frame().width() } else { view.frame().height() };
            let ranges = |on: f64| {
                let of = |s: &Stretch| {
                    let half = NEAR_PX + scan.reach_px + 12.0;
                    (s.at(on) - half).max(0.0) as usize..((s.at(on) + half).max(0.0) as usize).min(end)
                };
                let along = |s: &&Stretch| (s.from() - 2.0..=s.to() + 2.0).contains(&on);
                self.stretches[i].iter().filter(along).map(of).collect::<Vec<_>>()
            };
            let points = scan.within(view, run, ranges);
            let own: Vec<Point> = points
                .into_iter()
                .filter(|p| near(&self.stretches[i], p, NEAR_PX, range).is_some())
                .collect();
            parts.moved_px[i] = displacement(&self.stretches[i], &own, NEAR_PX, range);
            let slope = self.stretches[i].first().map_or(0.0, |s| s.slope);
            let mut sorted = own;
            sorted.sort_by(|a, b| a.on.total_cmp(&b.on));
            let mut free = super::lines::stretches(&sorted, run, 0.0);
            free.sort_by(|a, b| b.length().total_cmp(&a.length()));
            for stretch in free.iter().take(LONGEST) {
                let blur = blur_px(view, run, &stretch.points, slope, self.scan.reach_px + 4.0);
                if let Some(blur) = blur.filter(|b| b.std_error < 0.07 * b.value) {
                    let best = parts.blur_px[i].get_or_insert(blur);
                    if blur.std_error < best.std_error {
                        *best = blur;
                    }
                }
            }
        }
        parts
    }
}

fn longest(stretches: &[Stretch]) -> Option<&Stretch> {
    stretches.iter().max_by(|a, b| a.length().total_cmp(&b.length()))
}

/// Free edges are looked for so near to where they were, in pixels.
const NEAR_PX: f64 = 12.0;

/// Departure of the dark and the light level beside a free edge from the bare board's, as shares of the contrast: noise,
/// and flicker of the light. Where a slab or its blurred rim lies on one side, levels depart by more; at these bounds
/// they shift the edge by less than 0.1 px.
const LEVELS: [f64; 2] = [0.004, 0.012];

/// So many of the longest free stretches tell the blur.
const LONGEST: usize = 3;

/// Fewest points that tell a movement.
const POINTS: usize = 6;

/// Where the bare shot shows the edge that a point belongs to, if it lies between the same levels.
fn near(stretches: &[Stretch], point: &Point, within: f64, range: f64) -> Option<f64> {
    stretches
        .iter()
        .filter(|s| s.rises == point.rises && (s.from() - 2.0..=s.to() + 2.0).contains(&point.on))
        .find(|s| (s.at(point.on) - point.at).abs() < within)
        .and_then(|s| local(s, point, range))
}

/// The stretch there, from the points next to it: printed and bent lines are not quite straight.
fn local(stretch: &Stretch, point: &Point, range: f64) -> Option<f64> {
    const AROUND: usize = 4;
    let i = stretch.points.partition_point(|p| p.on < point.on);
    let near = &stretch.points[i.saturating_sub(AROUND)..(i + AROUND).min(stretch.points.len())];
    let mean = |f: &dyn Fn(&Point) -> f64| near.iter().map(f).sum::<f64>() / near.len().max(1) as f64;
    let like = |a: f64, b: f64, share: f64| (a - b).abs() < share * range;
    let free = like(point.low, mean(&|p| p.low), LEVELS[0]) && like(point.high, mean(&|p| p.high), LEVELS[1]);
    free.then(|| stretch.at(point.on) + mean(&|p| p.at - stretch.at(p.on)))
}

fn displacement(stretches: &[Stretch], points: &[Point], within: f64, range: f64) -> Option<Estimate> {
    let off = |p: &Point| near(stretches, p, within, range).map(|at| p.at - at);
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
