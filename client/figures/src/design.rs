//! Draws how well sets of slabs would determine a medium: half-widths of intervals, one row per set.

use anyhow::ensure;
use optics_model::Medium;
use optics_model::fit::{Design, HalfWidths, SlabSet};

use crate::drawing::axis::{Axis, AxisDirection, extent};
use crate::drawing::canvas::{Canvas, PlotArea, Stroke, at};
use crate::drawing::frame::{AxesFrame, TICKS_BELOW};
use crate::drawing::head::{Head, MARGIN};
use crate::drawing::legend::{Key, KeySample};
use crate::drawing::number::number;
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::text::{Anchor, LABEL, SMALL, TICK, Text};
use crate::numbers::slabs;

const PANEL_WIDTH: f64 = 178.0;
const BETWEEN: f64 = 22.0;
const ROW: f64 = 19.0;
const BELOW: f64 = TICKS_BELOW + 1.7 * LABEL;
const RADIUS: f64 = 3.4;
/// Colours by the number of photographs, repeated if there are more.
const COLOURS: [Rgb; 5] = [Rgb::BLUE, Rgb::ORANGE, Rgb::GREEN, Rgb::VERMILLION, Rgb::PURPLE];

/// Half-width of a quantity relative to its value.
type QuantityShare = fn(&HalfWidths, &Medium) -> f64;

const QUANTITIES: [(&str, QuantityShare); 4] = [
    ("σ_t", HalfWidths::of_sigma_t),
    ("1 − α", HalfWidths::of_co_albedo),
    ("σ_s (1 − g)", HalfWidths::of_reduced_scattering),
    ("σ_a", HalfWidths::of_absorption),
];

/// Draws a panel for each quantity, a row for each set of slabs and a colour for each number of photographs; g held and
/// free.
pub fn design_figure(design: &Design) -> anyhow::Result<Picture> {
    let rows = DesignRows::of(design);
    let panels: Vec<DesignPanel> =
        QUANTITIES.iter().filter_map(|(name, share)| DesignPanel::new(name, *share, design, &rows)).collect();
    ensure!(!panels.is_empty(), "no set of slabs determines anything: there is nothing to draw");
    let left = MARGIN + rows.width();
    let width = left + panels.len() as f64 * (PANEL_WIDTH + BETWEEN) - BETWEEN + MARGIN;
    let m = &design.medium;
    let title = format!(
        "How well slabs determine σ_t = {} / mm, α = {}, g = {} (channel {})",
        number(m.sigma_t_per_mm(), 4),
        number(m.albedo(), 6),
        number(m.g(), 3),
        design.channel
    );
    let keys = rows.keys(design, panels.iter().any(|panel| panel.incomplete));
    let head = Head::new(&title, &keys, width - 2.0 * MARGIN);
    let height = rows.slabs.len() as f64 * ROW;
    let top = head.height() + 1.6 * SMALL;
    let mut canvas = Canvas::new(width, top + height + BELOW + MARGIN);
    head.draw(&mut canvas);
    rows.draw_names(&mut canvas, left, top);
    for (i, panel) in panels.iter().enumerate() {
        let left = left + i as f64 * (PANEL_WIDTH + BETWEEN);
        panel.draw(&mut canvas, PlotArea { left, top, width: PANEL_WIDTH, height });
    }
    Ok(canvas.finish())
}

/// The sets of slabs, one per row, and the numbers of photographs, one per colour.
struct DesignRows {
    /// Name of each set, and whether it is the best.
    slabs: Vec<(String, bool)>,
    shots: Vec<u32>,
}

impl DesignRows {
    fn of(design: &Design) -> Self {
        let (mut all, mut shots) = (Vec::<(String, bool)>::new(), Vec::new());
        for set in &design.sets {
            let name = slabs(set);
            match all.iter_mut().find(|(other, _)| *other == name) {
                Some((_, best)) => *best |= set.best,
                None => all.push((name, set.best)),
            }
            if !shots.contains(&set.shots) {
                shots.push(set.shots);
            }
        }
        Self { slabs: all, shots }
    }

    fn name(name: &str, best: bool) -> Text {
        let text = Text::new(name, SMALL).anchor(Anchor::End);
        if best { text.bold() } else { text }
    }

    /// Width of the column of names, up to the first panel.
    fn width(&self) -> f64 {
        let names = self.slabs.iter().map(|(name, best)| Self::name(name, *best).width());
        names.fold(Text::new("slabs in mm", SMALL).width(), f64::max) + 10.0
    }

    fn draw_names(&self, canvas: &mut Canvas, right: f64, top: f64) {
        let head = Text::new("slabs in mm", SMALL).anchor(Anchor::End).colour(Rgb::FAINT_INK);
        canvas.text(at(right - 8.0, top - 0.5 * SMALL), &head);
        for (i, (name, best)) in self.slabs.iter().enumerate() {
            let middle = top + (i as f64 + 0.5) * ROW;
            canvas.text(at(right - 8.0, middle + 0.36 * SMALL), &Self::name(name, *best));
        }
    }

    fn row(&self, set: &SlabSet) -> usize {
        let name = slabs(set);
        self.slabs.iter().position(|(other, _)| *other == name).unwrap_or(0)
    }

    fn colour(&self, set: &SlabSet) -> Rgb {
        let place = self.shots.iter().position(|n| *n == set.shots).unwrap_or(0);
        COLOURS[place % COLOURS.len()]
    }

    fn keys(&self, design: &Design, incomplete: bool) -> Vec<Key> {
        let patch = |(i, n): (usize, &u32)| {
            let words = if *n == 1 { "photograph" } else { "photographs" };
            let sample = KeySample::Patch(COLOURS[i % COLOURS.len()]);
            Key { sample, label: format!("{n} {words} of each slab") }
        };
        let bound = Key::note("half-widths of 95 % intervals at the Cramér–Rao bound");
        let mut keys: Vec<Key> =
            std::iter::once(bound).chain(self.shots.iter().enumerate().map(patch)).collect();
        if design.sets.iter().any(|set| set.g_free.is_some()) {
            keys.push(Key::note("filled: g held, open: g free"));
        }
        if self.slabs.iter().any(|(_, best)| *best) {
            keys.push(Key::note("bold: best"));
        }
        if incomplete {
            keys.push(Key::note("beyond 100 %: not drawn"));
        }
        keys
    }
}

/// The half-width in per cent, and its row.
struct Dot {
    row: usize,
    percent: f64,
    colour: Rgb,
    filled: bool,
}

struct DesignPanel {
    name: &'static str,
    dots: Vec<Dot>,
    axis: Axis,
    /// Some half-widths are not drawn.
    incomplete: bool,
}

impl DesignPanel {
    /// `None` if no half-width can be drawn.
    fn new(name: &'static str, share: QuantityShare, design: &Design, rows: &DesignRows) -> Option<Self> {
        let set_dots = |set: &SlabSet| {
            let dot = |widths: &HalfWidths, filled: bool| Dot {
                row: rows.row(set),
                percent: 100.0 * share(widths, &design.medium),
                colour: rows.colour(set),
                filled,
            };
            // Dots with g held are drawn above those with g free.
            let free = set.g_free.as_ref().map(|w| dot(w, false));
            free.into_iter().chain([dot(&set.g_held, true)]).collect::<Vec<_>>()
        };
        let all: Vec<Dot> = design.sets.iter().flat_map(set_dots).collect();
        let incomplete = all.iter().any(|dot| dot.percent > 100.0);
        let dots: Vec<Dot> = all.into_iter().filter(|d| d.percent > 0.0 && d.percent <= 100.0).collect();
        let (low, high) = extent(dots.iter().map(|dot| dot.percent))?;
        Some(Self { name, dots, axis: Axis::logarithmic(low / 1.15, high * 1.15), incomplete })
    }

    fn draw(&self, canvas: &mut Canvas, area: PlotArea) {
        let frame = AxesFrame { area, x: self.axis, y: Axis::exact(None) };
        let pen = Stroke::solid(Rgb::AXIS, 0.8);
        let ticks = self.axis.ticks(area.width, AxisDirection::Across);
        for tick in ticks.iter().filter(|tick| tick.label.is_some()) {
            let x = frame.across(tick.value);
            canvas.line(at(x, area.top), at(x, area.bottom()), Stroke::solid(Rgb::RULE, 0.7));
        }
        let rows = (area.height / ROW).round() as usize;
        for row in 0..rows {
            let y = area.top + (row as f64 + 0.5) * ROW;
            canvas.line(at(area.left, y), at(area.right(), y), Stroke::solid(Rgb::RULE, 0.7));
        }
        for dot in &self.dots {
            let place = at(frame.across(dot.percent), area.top + (dot.row as f64 + 0.5) * ROW);
            let fill = if dot.filled { dot.colour } else { Rgb::WHITE };
            canvas.circle(place, RADIUS, Some(fill), Stroke::solid(dot.colour, 1.4));
        }
        canvas.line(at(area.left, area.bottom()), at(area.right(), area.bottom()), pen);
        for tick in ticks {
            let (x, bottom) = (frame.across(tick.value), area.bottom());
            let length = if tick.label.is_some() { 3.5 } else { 2.0 };
            canvas.line(at(x, bottom), at(x, bottom + length), pen);
            if let Some(label) = tick.label {
                let text = Text::new(label, TICK).anchor(Anchor::Middle);
                canvas.text(at(x, bottom + TICKS_BELOW - 0.15 * TICK), &text);
            }
        }
        let name = Text::new(format!("{}: ± %", self.name), LABEL).anchor(Anchor::Middle);
        canvas.text(at(area.center().x, area.bottom() + TICKS_BELOW + 1.3 * LABEL), &name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::{assert_shows, assert_well_laid_out};
    use crate::testing::design;

    /// Every set has its row, and the best is named.
    #[test]
    fn design_has_a_row_per_set() {
        let picture = design_figure(&design()).unwrap();
        let labels = ["0.5 + 1", "1 photograph of each slab", "2 photographs of each slab", "bold: best"];
        let texts = assert_shows(&picture, &labels);
        assert!(texts.iter().any(|text| text == "beyond 100 %: not drawn"), "{texts:?}");
        // Sets that differ only in the number of photographs share a row.
        assert_eq!(texts.iter().filter(|text| *text == "0.5").count(), 1);
    }

    /// Many sets of many slabs are well laid out, and so is a single one.
    #[test]
    fn many_slab_sets_are_well_laid_out() {
        let mut design = design();
        let one = design.sets[0].clone();
        design.sets = (1..=25)
            .map(|i| SlabSet { slabs_mm: vec![0.25 * f64::from(i), 0.123_456, 1.0, 2.0], ..one.clone() })
            .collect();
        assert_well_laid_out(&design_figure(&design).unwrap());
        design.sets.truncate(1);
        assert_well_laid_out(&design_figure(&design).unwrap());
    }

    /// A design that determines nothing is not drawn.
    #[test]
    fn undetermined_design_has_no_picture() {
        let mut design = design();
        for set in &mut design.sets {
            (set.g_held, set.g_free) = (HalfWidths::UNKNOWN, None);
        }
        let refused = design_figure(&design).unwrap_err().to_string();
        assert!(refused.starts_with("no set of slabs determines anything"), "{refused}");
        design.sets[0].g_held.sigma_t_per_mm = 0.3;
        assert_well_laid_out(&design_figure(&design).unwrap());
    }
}
