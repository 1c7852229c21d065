//! Draws columns of profiles with their gradient magnitudes below, as in Figs. 3 and 7, or with residuals or noise.

use anyhow::ensure;
use optics_model::fit::Curve;

use super::axis::{Axis, extent};
use super::canvas::{Canvas, PlotArea, Stroke, at};
use super::frame::{AxesFrame, Labels, TICKS_BELOW, tick_width};
use super::head::{Head, MARGIN};
use super::legend::{Key, LegendColumn};
use super::picture::Picture;
use super::rgb::Rgb;
use super::text::{Anchor, HEADING, LABEL, Text};

/// Columns side by side before a new band begins.
const MOST_COLUMNS: usize = 8;

const PROFILE_HEIGHT: f64 = 132.0;
const LOWER_HEIGHT: f64 = 78.0;
const BETWEEN_PARTS: f64 = 10.0;
const BETWEEN_ROWS: f64 = 16.0;
const BETWEEN_COLUMNS: f64 = 14.0;
const BETWEEN_BANDS: f64 = 18.0;
const HEADING_HEIGHT: f64 = 1.6 * HEADING;
/// Width of the names of the row and of the axis, both upright.
const NAMES: f64 = 2.0 * 19.0;
/// Distance from the bottom of the tick labels to that of the axis label.
const X_LABEL: f64 = 1.5 * LABEL;

#[derive(Debug)]
pub(crate) struct Sheet<'a> {
    pub(crate) title: &'a str,
    pub(crate) legend: Vec<Key>,
    pub(crate) cells: Vec<SheetCell<'a>>,
    /// Whether the cells of a row have the same axes.
    pub(crate) alike: bool,
    /// The quantity of the panels below the profiles, where they have no residuals.
    pub(crate) lower: &'static str,
}

/// The usual one.
pub(crate) const GRADIENT: &str = "|∇| per pixel";

#[derive(Debug)]
pub(crate) struct SheetCell<'a> {
    pub(crate) column: &'a str,
    pub(crate) thickness_mm: f64,
    pub(crate) keys: Vec<Key>,
    pub(crate) x_mm: &'a [f64],
    /// The first is drawn lowest.
    pub(crate) curves: Vec<(Stroke, &'a Curve)>,
    /// For the panel below; None for the gradients of the curves.
    pub(crate) residuals: Option<Residuals<'a>>,
}

/// Residuals of the first curve in standard errors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Residuals<'a> {
    pub(crate) values: &'a [f64],
    /// Indices of pixels that are marked.
    pub(crate) left_out: &'a [u32],
}

/// Standard errors within which 95 % of the residuals lie.
const BAND: f64 = 2.0;
const RESIDUAL: Stroke = Stroke::dots(Rgb::GREY, 1.6);
pub(crate) const LEFT_OUT: Stroke = Stroke::dots(Rgb::VERMILLION, 3.2);
const LEVEL: Stroke = Stroke::dashed(Rgb::INK, 0.7, &[4, 3]);

impl Sheet<'_> {
    pub(crate) fn draw(&self) -> anyhow::Result<Picture> {
        let plan = SheetLayout::new(self)?;
        let head = Head::new(self.title, &self.legend, plan.width - 2.0 * MARGIN);
        let mut canvas = Canvas::new(plan.width, head.height() + plan.bands_height() + MARGIN);
        head.draw(&mut canvas);
        let mut top = head.height();
        for band in 0..plan.bands() {
            plan.draw_band(&mut canvas, band, top);
            top += plan.band_height(band) + BETWEEN_BANDS;
        }
        Ok(canvas.finish())
    }
}

/// A cell with its axes; `place` is its column and row.
struct Placed<'a> {
    cell: &'a SheetCell<'a>,
    place: (usize, usize),
    profile: Axis,
    lower: Axis,
}

/// Positions and sizes of the panels.
struct SheetLayout<'a> {
    columns: Vec<&'a str>,
    rows: Vec<f64>,
    placed: Vec<Placed<'a>>,
    x: Axis,
    /// Columns of a band.
    across: usize,
    panel_width: f64,
    /// Width of the tick labels next to each panel.
    tick_width: f64,
    width: f64,
    alike: bool,
    lower: &'static str,
}

impl<'a> SheetLayout<'a> {
    fn new(sheet: &'a Sheet<'a>) -> anyhow::Result<Self> {
        ensure!(!sheet.cells.is_empty(), "no panels to draw");
        let (mut columns, mut rows) = (Vec::new(), Vec::new());
        let mut placed: Vec<Placed> = Vec::new();
        for cell in &sheet.cells {
            for (_, curve) in &cell.curves {
                let [x, v, g] = [cell.x_mm, &curve.values, &curve.gradient].map(<[f64]>::len);
                ensure!(
                    x == v && x == g,
                    "{}, {} mm: {x} positions, {v} values and {g} gradients",
                    cell.column,
                    cell.thickness_mm
                );
            }
            let place = (place_of(&mut columns, cell.column), place_of(&mut rows, cell.thickness_mm));
            ensure!(
                placed.iter().all(|other| other.place != place),
                "two panels for {} at {} mm",
                cell.column,
                cell.thickness_mm
            );
            let (profile, lower) = axes(&[cell]);
            placed.push(Placed { cell, place, profile, lower });
        }
        if sheet.alike {
            for row in 0..rows.len() {
                let cells: Vec<_> = placed.iter().filter(|p| p.place.1 == row).map(|p| p.cell).collect();
                let (profile, lower) = axes(&cells);
                for p in placed.iter_mut().filter(|p| p.place.1 == row) {
                    (p.profile, p.lower) = (profile, lower);
                }
            }
        }
        let x = sheet.cells.iter().flat_map(|cell| cell.x_mm.iter().copied());
        let x = Axis::exact(extent(x));
        let across = columns.len().div_ceil(columns.len().div_ceil(MOST_COLUMNS));
        let panel_width = [420.0, 330.0, 270.0, 230.0].get(across - 1).copied().unwrap_or(190.0);
        let mut plan = Self {
            columns,
            rows,
            placed,
            x,
            across,
            panel_width,
            tick_width: 0.0,
            width: 0.0,
            alike: sheet.alike,
            lower: sheet.lower,
        };
        let tick_widths =
            plan.placed.iter().flat_map(|p| plan.frames(p, 0.0)).map(|frame| tick_width(&frame.y_ticks()));
        plan.tick_width = tick_widths.fold(0.0, f64::max);
        plan.width = plan.left(across - 1) + panel_width + MARGIN;
        Ok(plan)
    }

    fn bands(&self) -> usize {
        self.columns.len().div_ceil(self.across)
    }

    fn bands_height(&self) -> f64 {
        let heights: f64 = (0..self.bands()).map(|band| self.band_height(band)).sum();
        heights + BETWEEN_BANDS * (self.bands() - 1) as f64
    }

    fn band_height(&self, band: usize) -> f64 {
        let rows: f64 = (0..self.rows.len()).map(|row| self.keys_height(band, row) + parts_height()).sum();
        HEADING_HEIGHT + rows + BETWEEN_ROWS * (self.rows.len() - 1) as f64 + TICKS_BELOW + X_LABEL
    }

    /// Left edge of a panel by its position in the band.
    fn left(&self, across: usize) -> f64 {
        let before = if self.alike { 0.0 } else { self.tick_width };
        MARGIN + NAMES + self.tick_width + across as f64 * (self.panel_width + before + BETWEEN_COLUMNS)
    }

    fn of_band(&self, band: usize) -> impl Iterator<Item = &Placed<'a>> {
        self.placed.iter().filter(move |p| p.place.0 / self.across == band)
    }

    /// The keys of a panel, unless they are those of the panel above.
    fn keys(&self, p: &Placed<'a>) -> &'a [Key] {
        let (column, row) = p.place;
        let above = self.placed.iter().find(|other| row > 0 && other.place == (column, row - 1));
        if above.is_some_and(|above| above.cell.keys == p.cell.keys) { &[] } else { &p.cell.keys }
    }

    fn keys_height(&self, band: usize, row: usize) -> f64 {
        let panels = self.of_band(band).filter(|p| p.place.1 == row);
        panels.map(|p| LegendColumn::new(self.keys(p), self.panel_width).height()).fold(0.0, f64::max)
    }

    /// The frames of the profile and the panel below with the profile's top at `top`.
    fn frames(&self, p: &Placed, top: f64) -> [AxesFrame; 2] {
        let left = self.left(p.place.0 % self.across);
        let area = |top, height| PlotArea { left, top, width: self.panel_width, height };
        let below = top + PROFILE_HEIGHT + BETWEEN_PARTS;
        [
            AxesFrame { area: area(top, PROFILE_HEIGHT), x: self.x, y: p.profile },
            AxesFrame { area: area(below, LOWER_HEIGHT), x: self.x, y: p.lower },
        ]
    }

    fn draw_band(&self, canvas: &mut Canvas, band: usize, top: f64) {
        for (i, name) in self.columns.iter().enumerate().filter(|(i, _)| i / self.across == band) {
            let heading = Text::new(*name, HEADING).bold().fitted(self.panel_width);
            canvas.text(at(self.left(i % self.across), top + HEADING), &heading);
        }
        let mut row_top = top + HEADING_HEIGHT;
        for row in 0..self.rows.len() {
            let keys_height = self.keys_height(band, row);
            self.draw_names(canvas, row, row_top + keys_height);
            for p in self.of_band(band).filter(|p| p.place.1 == row) {
                let keys = LegendColumn::new(self.keys(p), self.panel_width);
                let frames = self.frames(p, row_top + keys_height);
                keys.draw(canvas, frames[0].area.left, frames[0].area.top - keys.height() - 3.0);
                self.draw_panel(canvas, p, &frames);
            }
            row_top += keys_height + parts_height() + BETWEEN_ROWS;
        }
    }

    /// The thickness and the names of the vertical axes, at the left of a row.
    fn draw_names(&self, canvas: &mut Canvas, row: usize, top: f64) {
        let thickness = Text::new(format!("t = {} mm", self.rows[row]), LABEL).bold().anchor(Anchor::Middle);
        canvas.text_upwards(at(MARGIN + LABEL, top + parts_height() / 2.0), &thickness);
        let lower_middle = top + PROFILE_HEIGHT + BETWEEN_PARTS + LOWER_HEIGHT / 2.0;
        let has_residuals = self.placed.iter().any(|p| p.cell.residuals.is_some());
        let lower = if has_residuals { "residual [σ]" } else { self.lower };
        for (name, middle) in [("radiance factor", top + PROFILE_HEIGHT / 2.0), (lower, lower_middle)] {
            let text = Text::new(name, LABEL).anchor(Anchor::Middle);
            canvas.text_upwards(at(MARGIN + NAMES - 6.0, middle), &text);
        }
    }

    fn draw_panel(&self, canvas: &mut Canvas, p: &Placed, frames: &[AxesFrame; 2]) {
        let (column, row) = p.place;
        let lowest = !self.placed.iter().any(|other| other.place.0 == column && other.place.1 > row);
        let [profile, lower] = frames;
        for frame in frames {
            frame.rules(canvas);
        }
        for (stroke, curve) in &p.cell.curves {
            profile.curve(canvas, p.cell.x_mm, &curve.values, *stroke);
            if p.cell.residuals.is_none() {
                lower.curve(canvas, p.cell.x_mm, &curve.gradient, *stroke);
            }
        }
        if let Some(residuals) = &p.cell.residuals {
            draw_residuals(canvas, p.cell, residuals, frames);
        }
        let y = !self.alike || column.is_multiple_of(self.across);
        profile.axes(canvas, Labels { x: false, y });
        lower.axes(canvas, Labels { x: lowest, y });
        if lowest {
            let label = Text::new("x [mm]", LABEL).anchor(Anchor::Middle);
            let place = at(lower.area.center().x, lower.area.bottom() + TICKS_BELOW + 0.8 * X_LABEL);
            canvas.text(place, &label);
        }
    }
}

/// Residuals with the band of 95 %, and pixels that are left out in both panels.
fn draw_residuals(canvas: &mut Canvas, cell: &SheetCell, residuals: &Residuals, frames: &[AxesFrame; 2]) {
    let [profile, lower] = frames;
    let ends = [0.0, 1.0].map(|end| lower.x.value(end));
    for level in [-BAND, BAND] {
        lower.curve(canvas, &ends, &[level; 2], LEVEL);
    }
    let inside = |v: &f64| v.clamp(lower.y.value(0.0), lower.y.value(1.0));
    let values: Vec<f64> = residuals.values.iter().map(inside).collect();
    lower.curve(canvas, cell.x_mm, &values, RESIDUAL);
    let measured = cell.curves.first().map(|(_, curve)| &curve.values[..]).unwrap_or_default();
    for (frame, y) in [(profile, measured), (lower, &values[..])] {
        let picked = |of: &[f64]| -> Vec<f64> {
            residuals.left_out.iter().filter_map(|i| of.get(*i as usize).copied()).collect()
        };
        frame.curve(canvas, &picked(cell.x_mm), &picked(y), LEFT_OUT);
    }
}

fn parts_height() -> f64 {
    PROFILE_HEIGHT + BETWEEN_PARTS + LOWER_HEIGHT
}

/// Index of a value, which is added if it is new.
fn place_of<T: PartialEq>(seen: &mut Vec<T>, value: T) -> usize {
    seen.iter().position(|other| *other == value).unwrap_or_else(|| {
        seen.push(value);
        seen.len() - 1
    })
}

/// Greatest residual that is drawn at its place; larger ones lie on the frame.
const FURTHEST: f64 = 6.0;

/// Axes for profiles, and for gradients or residuals. Zero is shown unless all profiles are far from it.
fn axes(cells: &[&SheetCell]) -> (Axis, Axis) {
    let curves = || cells.iter().flat_map(|cell| &cell.curves);
    let values = extent(curves().flat_map(|(_, curve)| curve.values.iter().copied()));
    let gradient = extent(curves().flat_map(|(_, curve)| curve.gradient.iter().copied()));
    let profile = match values {
        Some((low, high)) if low >= 0.0 && low < 0.4 * high => Axis::from_zero(values),
        _ => Axis::around(values, 0.04),
    };
    let residuals = cells.iter().filter_map(|cell| cell.residuals).flat_map(|of| of.values);
    let most = residuals.map(|v| v.abs()).fold(0.0, f64::max).clamp(1.5 * BAND, FURTHEST);
    let has_residuals = cells.iter().any(|cell| cell.residuals.is_some());
    let lower = if has_residuals { Axis::exact(Some((-most, most))) } else { Axis::from_zero(gradient) };
    (profile, lower)
}
